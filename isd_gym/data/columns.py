"""What a table file holds, whatever its format: columns of values, their units and the lines they stand on."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..errors import InputError, plain, shown
from ..units import convert

#: names under which a column of time is known
TIME_NAMES = ("time", "t", "zeit", "timestamp", "timestamps")
#: names of a column of stamps, and what such a name may begin with
STAMPS = (*TIME_NAMES, "stamp", "datetime", "date", "clock", "utc", "seconds", "sec")
BEGINS = ("time", "zeit", "stamp", "date")
#: names of the columns that are wanted, all of them, or a function that chooses among those there are
Choice = list[str] | Callable[[list[str]], list[str]] | None


@dataclass(frozen=True)
class Columns:
    """What a file holds: name -> values, name -> unit where one is told, and the line of each sample where there are lines."""

    values: dict[str, Any]
    units: dict[str, str]
    lines: list[int] = field(default_factory=list)

    def line(self, sample: int) -> str:
        """Where a sample is, for messages."""
        return f"line {self.lines[sample]}" if sample < len(self.lines) else f"sample {sample + 1}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The nearest of the `known` names, and some of them, for messages."""
    names = sorted(n for n in known if len(n) <= 200)[:2000]
    near = difflib.get_close_matches(name[:200], names, n=1, cutoff=0.5)
    listed = ", ".join(plain(n, 40) for n in names[:12]) + (", ..." if len(names) > 12 else "")
    return f"did you mean {shown(near[0])}? It has: {listed}" if near else f"it has: {listed}"


def unit_known(text: str) -> bool:
    """Whether `text` is a unit."""
    return converts(text, text)


def split_header(text: str) -> tuple[str, str]:
    """``name [unit]`` or ``name (unit)`` -> name, unit. Round brackets that hold no known unit belong to the name."""
    match = re.fullmatch(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))\s*", text.strip())
    if match and match[1]:
        unit = (match[2] if match[2] is not None else match[3]).strip()
        if match[2] is not None or unit_known(unit):
            return match[1], unit
    return text.strip(), ""


def distinct(names: Sequence[str], headers: Sequence[str], units: Sequence[str]) -> list[str]:
    """Return names that tell columns of one name apart by their units: "Force" twice becomes "Force (V)" and "Force (N)".

    Args:
        names: Names without units.
        headers: What the file writes for each column; it becomes the name where it holds the unit.
        units: Unit of each column, '' where the file names none.
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
    """Return the column that `name` stands for: `name` itself, or the one of several "name (unit)" whose unit fits.

    Args:
        name: Name of a column, with or without a unit.
        columns: Columns that there are.
        unit: Unit that the column's unit must be convertible to.

    Raises:
        InputError: Several columns have this name, and none of them or several have a unit that fits.
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
            f"column {shown(name)} is there as {told}: --rename COLUMN=CHANNEL says which is meant"
        )
    return name


def converts(unit: str, target: str) -> bool:
    """Return whether values in `unit` can be turned into `target`."""
    try:
        convert(1.0, unit, target)
    except InputError:
        return False
    return True
