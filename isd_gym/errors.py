"""The error every bad input ends in, and how text from a file is shown."""

from __future__ import annotations

import unicodedata
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

MESSAGE_LIMIT = 1200  # characters; longer messages lose their middle
NAME_LIMIT = 80


def plain(text: str, limit: int = NAME_LIMIT) -> str:
    """`text` as it may stand in a terminal, a table or a message: one line, nothing that steers, at most `limit` characters.

    Control and format characters, line and paragraph separators and lone surrogates become escapes such as ``\\x1b``.
    """
    if len(text) > limit:
        tail = limit // 4
        text = f"{text[: limit - tail - 1]}…{text[-tail:]}"
    if text.isprintable():
        return text
    return "".join(c if harmless(c) else c.encode("unicode_escape").decode("ascii") for c in text)


def harmless(text: str) -> bool:
    """Whether `text` holds neither control nor format characters, no line separators and no lone surrogates."""
    return text.isprintable() or not any(
        unicodedata.category(c) in ("Cc", "Cf", "Cs", "Zl", "Zp") for c in text
    )


def shown(value: Any, limit: int = NAME_LIMIT) -> str:
    """A name or another value of a file for a message: a text in quotes, escaped and cut; a container by its kind alone.

    limit: characters.
    """
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
    """The line that installs an extra of this package, which no registry of packages has yet."""
    torch = "pip install torch==2.13.0 && " if extra == "agents" else ""  # a bare torch may bring gigabytes
    return f'{torch}pip install ".[{extra}]" in a clone of the repository'


def hint(name: object, known: Iterable[str]) -> str:
    """``did you mean 'mass'?`` where one of the `known` names is near `name`, else what there is.

    name: as somebody wrote it. known: in the order in which they are told.
    """
    known = list(known)
    near = get_close_matches(str(name)[:200], known, 1)
    return f"did you mean '{near[0]}'?" if near else f"there are {', '.join(known)}"


class InputError(ValueError):
    """What a user handed over cannot be used; the message is one line that says what and where.

    Whatever a file's names hold, the message stays one line that steers no terminal.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(plain(str(message), MESSAGE_LIMIT))


class ReportError(Exception):
    """A page could not be drawn; the results that it was to show are written. The message is one line.

    what: was to be drawn. error: why it was not. where: the results are.
    """

    def __init__(self, what: str, error: BaseException, where: str) -> None:
        line = f"{type(error).__name__}: {error}"
        super().__init__(plain(f"{what} could not be drawn ({line}); {where}", MESSAGE_LIMIT))


class MissingColumn(InputError):
    """A table lacks the column `name`; `message` says what it has."""

    def __init__(self, message: object = "", name: str = "") -> None:
        super().__init__(message)
        self.name = name
