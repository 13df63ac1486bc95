"""Content of a table file in any format: columns of values, units, and line numbers."""

from __future__ import annotations

import difflib
import itertools
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..._common.errors import InputError, plain, shown
from ..._common.units import convert

#: name of the time column of a table
TIME = "time"
#: names of a time column
TIME_NAMES = ("time", "t", "zeit", "timestamp", "timestamps")
#: names and beginnings of names of a column of time stamps
STAMPS = (*TIME_NAMES, "stamp", "datetime", "date", "clock", "utc", "seconds", "sec")
BEGINS = ("time", "zeit", "stamp", "date")
#: names of the wanted columns, a function that chooses from the available names, or None for all columns
Choice = list[str] | Callable[[list[str]], list[str]] | None


#: a name of a time column that ends with the unit, such as Time_ms or t [us]
_WITH_UNIT = re.compile(
    r"(?:time|t|zeit|stamps?|timestamps?)[\s_.\-/]*(ns|us|µs|μs|ms|s|sec|min)",
    re.IGNORECASE,
)


def is_time(name: str) -> bool:
    """Return whether the name of a column is a name of time stamps."""
    low = name.lower().strip()
    return low in STAMPS or low.startswith(BEGINS) or bool(_WITH_UNIT.fullmatch(low))


def time_unit(name: str) -> str:
    """Return the unit of time that the name of a column of time stamps states, such as 'Time_ms'; 's' for other names."""
    found = _WITH_UNIT.fullmatch(name.strip())
    return found[1].lower().replace("μ", "u").replace("µ", "u") if found else "s"


@dataclass(frozen=True)
class Columns:
    """Content of a table file."""

    values: dict[str, Any]  # values (n,) by column name
    units: dict[str, str]  # unit by column name, for columns with a unit
    #: line number of each sample in a text file; empty for other formats
    lines: list[int] = field(default_factory=list)
    #: first text among the numbers, such as "line 201: 'OVERLOAD' is not a number", by column; the texts are NaN
    texts: dict[str, str] = field(default_factory=dict)

    def line(self, sample: int) -> str:
        """Return the position of a sample for messages, such as 'line 12'."""
        return (
            f"line {self.lines[sample]}"
            if sample < len(self.lines)
            else f"sample {sample + 1}"
        )


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the nearest known name and a list of known names, for messages."""
    names = sorted(n for n in known if len(n) <= 200)[:2000]
    near = difflib.get_close_matches(name[:200], names, n=1, cutoff=0.5)
    listed = ", ".join(plain(n, 40) for n in names[:12]) + (
        ", ..." if len(names) > 12 else ""
    )
    return (
        f"did you mean {shown(near[0])}? It has: {listed}"
        if near
        else f"it has: {listed}"
    )


def unit_known(text: str) -> bool:
    """Return whether a text is the name of a unit."""
    return converts(text, text)


def split_header(text: str) -> tuple[str, str]:
    """Split a header such as ``name [unit]`` or ``name (unit)`` into name and unit ('' without a unit).

    Round brackets without a known unit belong to the name.
    """
    match = re.fullmatch(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))\s*", text.strip())
    if match and match[1]:
        unit = (match[2] if match[2] is not None else match[3]).strip()
        if match[2] is not None or unit_known(unit):
            return match[1], unit
    return text.strip(), ""


def distinct(
    names: Sequence[str], headers: Sequence[str], units: Sequence[str]
) -> list[str]:
    """Return unique column names; the unit is appended to repeated names, as in "Force (V)" and "Force (N)"."""
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
    """Return the full name of the column that a name stands for, or `name` if no column matches.

    Among several columns "name (unit)", the column with a convertible unit is meant.
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
    """Return whether values in one unit can be converted to another."""
    try:
        convert(1.0, unit, target)
    except InputError:
        return False
    return True


def stamps_of(
    found: Mapping[str, Any],
    path: object,
    wanted: str | None = None,
    *,
    by_name: bool = False,
) -> str:
    """Return the name of the column of time stamps: `wanted`, or a column with a usual name, or (without `by_name`) the only
    column that rises uniformly.

    Text and single numbers are no stamps, whatever their name.
    """
    if wanted is not None:
        if wanted not in found:
            raise InputError(
                f"{path}: no column {shown(wanted)} of stamps (it has: {_listed(found)})"
            )
        return wanted
    numbers = {
        n: x
        for n, x in found.items()
        if x.dtype.kind in "fiub" and x.ndim == 1 and len(x)
    }
    several = {n: x for n, x in numbers.items() if len(x) > 1}
    numbers = several or numbers
    lower = {n.lower().strip(): n for n in numbers}
    for name in STAMPS:
        if name in lower:
            return lower[name]
    begins = [n for low, n in lower.items() if is_time(low)]
    rising = [] if by_name else [n for n in numbers if _rises(numbers[n])]
    for names in (begins, rising):
        if len(names) == 1 or (names and names[0] == next(iter(numbers))):
            return names[0]
    raise InputError(
        f"{path}: no column 'time' [s]: name the time column with --rename COLUMN=time, or give the sampling rate "
        f"with --rate HZ (it has: {_listed(found)})"
    )


def _rises(values: np.ndarray) -> bool:
    if values.dtype.kind not in "fiu" or len(values) < 3:
        return False
    d = np.diff(values.astype(float))
    return bool((d > 0).all() and np.quantile(d, 0.9) < 1.5 * np.median(d))


def _listed(found: Collection[str]) -> str:
    names = [plain(n, 40) for n in found]
    return ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")


#: a name with the number of its run, such as "force 2" or "time_2"
_NUMBER = re.compile(r"(.*?)[\s_.#(-]*\d+\)?")


def side_by_side(names: Sequence[str]) -> list[tuple[range, list[str]]]:
    """Return the tables that stand beside one another in a file: places and names of their columns; empty for a single table.

    Each table begins with its time column. Tables with the same names, apart from a number at the end, are runs;
    their columns get the names without numbers.
    """

    def base(name: str) -> str:
        found = _NUMBER.fullmatch(name.strip())
        return (found[1] if found and found[1] else name).strip()

    begins = [
        i
        for i, n in enumerate(names)
        if base(n).lower() in TIME_NAMES or _WITH_UNIT.fullmatch(base(n))
    ]
    if len(begins) < 2 or begins[0] != 0:
        return []
    parts = [range(a, b) for a, b in itertools.pairwise([*begins, len(names)])]
    if min(len(part) for part in parts) < 2:
        return []
    bases = [[base(names[i]) for i in part] for part in parts]
    runs = all(sorted(b) == sorted(bases[0]) and len(set(b)) == len(b) for b in bases)
    return [
        (part, [TIME, *(own if runs else [names[i] for i in part])[1:]])
        for part, own in zip(parts, bases, strict=True)
    ]
