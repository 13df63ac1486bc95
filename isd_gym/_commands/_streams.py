"""Standard streams of the program: closed streams, and characters that the encoding of a stream lacks."""

from __future__ import annotations

import codecs
import os
import sys
import unicodedata
from typing import TextIO

#: name of the handler for characters that an encoding lacks
PLAINER = "isd_gym.plainer"
#: replacements of the same width for characters whose decomposition says nothing
ALIKE = {
    "−": "-", "–": "-", "—": "-", "─": "-", "━": "-", "╴": "-", "╸": "-", "╺": "-", "·": ".", "×": "x", "µ": "u", "μ": "u",
    "…": "~", "≤": "<", "≥": ">", "≈": "~", "±": "~", "→": ">", "‘": "'", "’": "'", "“": '"', "”": '"', "°": "o", "Ω": "O",
}  # fmt: skip


def plainer(error: UnicodeError) -> tuple[str, int]:
    """Return similar ASCII characters for characters that an encoding lacks, one for one: 'm/s²' becomes 'm/s2'."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    out = []
    for c in error.object[error.start : error.end]:
        if 0xD800 <= ord(c) < 0xE000:  # bytes of a file name that are no text
            out.append(c.encode("unicode_escape").decode())
        else:
            alike = ALIKE.get(c, unicodedata.normalize("NFKD", c)[0])
            out.append(alike if alike.isascii() else "?")
    return "".join(out), error.end


def prepare_streams() -> None:
    """Make the standard streams writable for every text: a closed stream becomes the null device."""
    codecs.register_error(PLAINER, plainer)
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream: TextIO | None = getattr(sys, name)
        if stream is None:
            stream = _closed(number)
            setattr(sys, name, stream)
        if number and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=PLAINER)


def _closed(number: int) -> TextIO:
    """Return the null device; its number is that of the closed stream, so that no other file gets that number."""
    mode = os.O_WRONLY if number else os.O_RDONLY
    handle = os.open(os.devnull, mode)
    try:
        os.fstat(number)
    except OSError:
        os.dup2(handle, number)
    if handle != number:
        os.close(handle)
    return open(os.devnull, "w" if number else "r", encoding="utf-8")
