"""Tables written as text, by whatever program: separator, decimal comma, preamble, names and units are found out."""

from __future__ import annotations

import csv
import datetime as dt
import io
import math
from array import array
from collections import Counter
from pathlib import Path

import numpy as np

from ..errors import InputError, MissingColumn, shown
from ..inputs import memory_limit, plain_file, read_bytes, too_large
from .columns import TIME_NAMES, Choice, Columns, did_you_mean, split_header, unit_known

#: of a text table: characters of a line, columns, and how many times its size it takes in memory while it is read
LINE_LIMIT, COLUMN_LIMIT, TEXT_SHARE = 131_072, 10_000, 12
Dialect = tuple[str, bool, int]  # separator, decimal comma, cells of a row


def _number(text: str, comma: bool) -> float | None:
    """The number in a cell, nan for an empty one, None for text."""
    text = text.strip()
    if len(text) > 400:
        return None
    if text.lower() in ("", "nan", "na", "n/a", "null", "none", "-", "#nv"):
        return math.nan
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError:
        return _stamp(text.replace(",", "."))


def _stamp(text: str) -> float | None:
    """Seconds of a date and time, or a time of day, as ISO 8601 writes them; those of a date count from 1970 on."""
    if not text[:1].isdigit() or ":" not in text or len(text) > 40:
        return None
    try:
        if "-" not in text[:9]:
            t = dt.time.fromisoformat(text)
            return 3600.0 * t.hour + 60.0 * t.minute + t.second + 1e-6 * t.microsecond
        then = dt.datetime.fromisoformat(text)
    except ValueError:
        return None
    return (then if then.tzinfo else then.replace(tzinfo=dt.UTC)).timestamp()


def _text_of(path: Path) -> str:
    """The text of a file of bearable size, whatever its encoding."""
    limit, size = memory_limit(), plain_file(path)
    if size * TEXT_SHARE > limit:
        raise too_large(str(path), size * TEXT_SHARE, limit)
    raw = read_bytes(path, limit)
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = raw.decode("utf-16", "replace")
    else:
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = raw.decode("latin-1")
    if "\0" in text:
        raise InputError(f"{path}: is not a text table")
    return text


def _cells(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter), [])


def _dialect(path: Path, rows: list[tuple[int, str]]) -> Dialect:
    """That under which the last lines hold numbers before all else, all lines alike."""
    best: tuple[tuple[float, int], str, bool, int] = ((0.0, 0), ",", False, 0)
    for delimiter, comma in [(d, False) for d in ",;\t"] + [(";", True), ("\t", True), (" ", False)]:
        split = [_cells(s, delimiter) for _, s in rows[-20:]]
        width = max((len(c) for c in split), key=[len(c) for c in split].count)
        numbers = sum(_number(x, comma) is not None for c in split if len(c) == width for x in c)
        share = numbers / max(sum(map(len, split)), 1)
        if width > 1 and (share, numbers) > best[0]:
            best = ((share, numbers), delimiter, comma, width)
    (_, numbers), delimiter, comma, width = best
    if not numbers:
        last = [_number(s.strip(), False) is not None for _, s in rows[-20:]]
        if sum(last) > 0.5 * len(last):  # one column: the time of a rig that nothing drives
            return ",", False, 1
        tried = "separators tried: comma, semicolon, tab, blank"
        raise InputError(f"{path}: no columns of numbers found ({tried})")
    return delimiter, comma, width


def _header(path: Path, rows: list[tuple[int, str]], like: Dialect) -> tuple[list[str], dict[str, str], int]:
    """(names of the columns, units by name, the row at which numbers begin)."""
    delimiter, comma, width = like
    numeric_first = [
        sum(_number(x, comma) is not None and x.strip() != "" for x in _cells(s, delimiter)) > width / 2
        for _, s in rows[:200]
    ]
    first = numeric_first.index(True) if True in numeric_first else len(rows)
    heads = [[x.strip() for x in _cells(s, delimiter)] for _, s in rows[:first]]
    if not heads or first == len(rows):
        raise InputError(f"{path}: line {rows[0][0]}: no header row that names the columns")
    unit_row: list[str] = []
    if len(heads) > 1 and len(heads[-1]) == len(heads[-2]) == width:
        bare = [x.strip("[]() ") for x in heads[-1]]
        if any(map(unit_known, bare)) and not any(map(unit_known, heads[-2])):
            unit_row, heads = bare, heads[:-1]
    pairs = [split_header(x) for x in heads[-1]]
    names = [name for name, _ in pairs]
    if len(names) != width:
        raise InputError(f"{path}: line {rows[first][0]} has {width} fields, the header has {len(names)}")
    units = {n: u for n, u in zip(names, unit_row, strict=True) if u} if unit_row else {}
    return names, units | {name: unit for name, unit in pairs if unit}, first


def _picked(path: Path, names: list[str], wanted: list[str] | None, time: str) -> list[int]:
    """The places of the wanted columns, all of them where none are named, and of whatever may be the time."""
    there = Counter(names)
    for name in wanted or ():
        if name not in there:
            raise MissingColumn(f"{path}: no column {shown(name)}; {did_you_mean(name, names)}", name)
    for name, count in there.items():
        if count > 1 and (wanted is None or name in wanted):
            raise InputError(f"{path}: the header names {shown(name)} twice")
    chosen = set(names) if wanted is None else {*wanted, time, *(n for n in names if n.lower() in TIME_NAMES)}
    return [i for i, n in enumerate(names) if n in chosen]


def _cell_by_cell(
    path: Path,
    rows: list[tuple[int, str]],
    names: list[str],
    used: list[int],
    needed: set[str],
    like: Dialect,
) -> dict[str, np.ndarray]:
    """The columns `used`; one with words in it is left out as remarks, unless it is `needed`."""
    delimiter, comma, width = like
    columns = {names[i]: array("d") for i in used}
    for number, line in rows:
        row = _cells(line, delimiter)
        if len(row) != width:
            raise InputError(f"{path}: line {number} has {len(row)} fields, the header has {width}")
        for i in used:
            value = _number(row[i], comma)
            if value is None and names[i] in needed:
                raise InputError(
                    f"{path}: line {number}, column {shown(names[i])}: {shown(row[i].strip())} is not a number"
                )
            if value is None:
                columns.pop(names[i], None)
            elif names[i] in columns:
                columns[names[i]].append(value)
    return {name: np.array(values) for name, values in columns.items()}


def read_text(path: Path, wanted: Choice, time: str, resample: bool) -> Columns:
    """The wanted columns and that of the `time`; a whole file is on one raster, so there is nothing to `resample`."""
    # a line ends where an editor says so, not at every separator that Unicode has
    lines = _text_of(path).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    rows = [(i, s) for i, s in enumerate(lines, 1) if s.strip() and s.lstrip()[0] not in "#%"]
    del lines
    if not rows:
        raise InputError(f"{path}: is empty")
    for number, line in rows:
        if len(line) > LINE_LIMIT:
            raise InputError(
                f"{path}: line {number} has {len(line)} characters, at most {LINE_LIMIT} are read"
            )
    delimiter, comma, width = like = _dialect(path, rows)
    if width > COLUMN_LIMIT:
        raise InputError(f"{path}: has {width} columns, at most {COLUMN_LIMIT} are read")
    names, units, first = _header(path, rows, like)
    if callable(wanted):
        wanted = wanted(names)
    used = _picked(path, names, wanted, time)
    rows = rows[first:]
    numbers = [n for n, _ in rows]
    body = "\n".join(s for _, s in rows)
    try:  # fast path: every cell of interest a number
        data = np.loadtxt(
            io.StringIO(body.replace(",", ".") if comma else body),
            delimiter=None if delimiter == " " else delimiter,
            quotechar='"',
            comments=None,
            ndmin=2,
        )
        if data.shape != (len(numbers), width):
            raise ValueError
        return Columns({names[i]: data[:, i] for i in used}, units, numbers)
    except ValueError:
        pass
    del body
    needed = {time} if wanted is None else set(names)
    return Columns(_cell_by_cell(path, rows, names, used, needed, like), units, numbers)
