"""Errors for bad input, and safe display of text from files."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

MESSAGE_LIMIT = 1200  # characters; longer messages are shortened in the middle
NAME_LIMIT = 80


def plain(text: str, limit: int = NAME_LIMIT) -> str:
    r"""Return a text as one printable line of limited length.

    Control and format characters, line and paragraph separators and lone surrogates become escapes such as
    ``\\x1b``, so that text from a file cannot steer a terminal.
    """
    if len(text) > limit:
        tail = limit // 4
        text = f"{text[: limit - tail - 1]}…{text[-tail:]}"
    if text.isprintable():
        return text
    return "".join(
        c if harmless(c) else c.encode("unicode_escape").decode("ascii") for c in text
    )


def harmless(text: str) -> bool:
    """Return whether a text has no control or format characters, line separators or lone surrogates."""
    return text.isprintable() or not any(
        unicodedata.category(c) in ("Cc", "Cf", "Cs", "Zl", "Zp") for c in text
    )


def shown(value: Any, limit: int = NAME_LIMIT) -> str:
    """Return a value from a file as it appears in a message."""
    if isinstance(value, str):
        return f"'{plain(value, limit)}'"
    if value is None or isinstance(value, bool | float):
        return repr(value)
    if isinstance(value, int):
        digits = int(value.bit_length() * 0.30103) + 1
        return str(value) if digits < 40 else f"a whole number of {digits} digits"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    return "an object" if isinstance(value, dict) else f"a {type(value).__name__}"


def how_to_install(extra: str) -> str:
    """Return the shell command that installs an optional dependency group in a clone of the repository: the
    package is in no registry yet."""
    # the default torch wheel may download gigabytes
    torch = "pip install torch==2.13.0 && " if extra == "agents" else ""
    return f'{torch}pip install ".[{extra}]" in a clone of the repository'


def hint(name: object, known: Iterable[str]) -> str:
    """Return ``did you mean 'mass'?`` for a similar known name, otherwise the list of known names."""
    known = list(known)
    near = get_close_matches(str(name)[:200], known, 1)
    return f"did you mean '{near[0]}'?" if near else f"there are {', '.join(known)}"


class InputError(ValueError):
    """Error for input that cannot be used; the message is one line that names the input and the remedy.

    Args:
        message: Any text. Escaped and shortened to one printable line.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(plain(str(message), MESSAGE_LIMIT))


class ReportError(Exception):
    """Error for a report page that could not be drawn after its results had been written.

    Args:
        what: The page, such as "the report".
        error: Cause.
        where: Clause that tells where the results are.
    """

    def __init__(self, what: str, error: BaseException, where: str) -> None:
        line = f"{type(error).__name__}: {error}"
        super().__init__(
            plain(f"{what} could not be drawn ({line}); {where}", MESSAGE_LIMIT)
        )


class TyreContactWarning(UserWarning):
    """Warning of a road on which the linear tyres of a car would pull for more than 1 % of the time."""


class MissingColumn(InputError):
    """Error for a table that lacks a column.

    Args:
        message: One line that lists the columns of the table.
        name: The missing column.
    """

    def __init__(self, message: object = "", name: str = "") -> None:
        super().__init__(message)
        self.name = name
