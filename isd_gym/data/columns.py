"""Content of a table file in any format: columns of values, units, and line numbers."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..errors import InputError, plain, shown
from ..units import convert

#: names of a time column
TIME_NAMES = ("time", "t", "zeit", "timestamp", "timestamps")
#: names and beginnings of names of a column of time stamps
STAMPS = (*TIME_NAMES, "stamp", "datetime", "date", "clock", "utc", "seconds", "sec")
BEGINS = ("time", "zeit", "stamp", "date")
#: names of the wanted columns, a function that chooses from the available names, or None for all columns
Choice = list[str] | Callable[[list[str]], list[str]] | None


@dataclass(frozen=True)
class Columns:
    """Content of a table file.

    Attributes:
        values: Values (n,) by column name.
        units: Unit by column name, for columns with a unit.
        lines: Line number of each sample in a text file; empty for other formats.
    """

    values: dict[str, Any]
    units: dict[str, str]
    lines: list[int] = field(default_factory=list)

    def line(self, sample: int) -> str:
        """Return the position of a sample, for messages.

        Args:
            sample: Index of the sample, from 0.

        Returns:
            Text such as 'line 12'.
        """
        return f"line {self.lines[sample]}" if sample < len(self.lines) else f"sample {sample + 1}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the nearest known name and a list of known names, for messages.

    Args:
        name: Name that a user wrote.
        known: Available names.

    Returns:
        A clause for the end of an error message.
    """
    names = sorted(n for n in known if len(n) <= 200)[:2000]
    near = difflib.get_close_matches(name[:200], names, n=1, cutoff=0.5)
    listed = ", ".join(plain(n, 40) for n in names[:12]) + (", ..." if len(names) > 12 else "")
    return f"did you mean {shown(near[0])}? It has: {listed}" if near else f"it has: {listed}"


def unit_known(text: str) -> bool:
    """Return whether a text is the name of a unit.

    Args:
        text: Any text.
    """
    return converts(text, text)


def split_header(text: str) -> tuple[str, str]:
    """Split a header such as ``name [unit]`` or ``name (unit)`` into name and unit.

    Round brackets without a known unit belong to the name.

    Args:
        text: Cell of a header row.

    Returns:
        Name, and unit ('' without a unit).
    """
    match = re.fullmatch(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))\s*", text.strip())
    if match and match[1]:
        unit = (match[2] if match[2] is not None else match[3]).strip()
        if match[2] is not None or unit_known(unit):
            return match[1], unit
    return text.strip(), ""


def distinct(names: Sequence[str], headers: Sequence[str], units: Sequence[str]) -> list[str]:
    """Return unique column names; the unit is appended to repeated names, as in "Force (V)" and "Force (N)".

    Args:
        names: Names without units.
        headers: Header of each column in the file, used as the name if the header includes the unit.
        units: Unit of each column, '' for a column without a unit.

    Returns:
        One name per column.
    """
    count = Counter(names)
    out = []
    for name, header, unit in zip(names, headers, units, strict=True):
        if count[name] > 1 and header.strip() != name:
            name = header.strip()
        elif count[name] > 1 and unit:
            name = f"{name} [{unit}]"
        out.append(name)
    return out


def column_for(name: str, columns: Collection[str], unit: str = "") -> str:
    """Return the column that a name stands for.

    Among several columns "name (unit)", the column with a convertible unit is meant.

    Args:
        name: Name of a column, with or without a unit.
        columns: Available columns.
        unit: Unit to which the column's unit must be convertible.

    Returns:
        Full name of the column, or `name` if no column matches.

    Raises:
        InputError: Several columns have the name, and not exactly one of them has a convertible unit.
    """
    if name in columns:
        return name
    same = [n for n in columns if split_header(n)[0] == name]
    fits = [n for n in same if unit and converts(split_header(n)[1], unit)]
    if len(fits) == 1:
        return fits[0]
    if same:
        told = " and ".join(shown(n) for n in same[:4])
        raise InputError(
            f"several columns are called {shown(name)}: {told}; choose one with --rename COLUMN=CHANNEL"
        )
    return name


def converts(unit: str, target: str) -> bool:
    """Return whether values in one unit can be converted to another.

    Args:
        unit: Name of the present unit.
        target: Name of the wanted unit.
    """
    try:
        convert(1.0, unit, target)
    except InputError:
        return False
    return True
