"""Reader of text tables: separator, decimal comma, preamble, names and units are detected."""

from __future__ import annotations

import csv
import datetime as dt
import io
import itertools
import math
import re
from array import array
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..._common.errors import InputError, MissingColumn, shown
from ..._common.inputs import memory_limit, plain_file, read_bytes, too_large
from ._columns import (
    BEGINS,
    STAMPS,
    TIME,
    TIME_NAMES,
    Choice,
    Columns,
    did_you_mean,
    distinct,
    is_time,
    side_by_side,
    split_header,
    time_unit,
    unit_known,
)

#: limits of a text table: characters of a line, number of columns, memory while reading as a multiple of the
#: size
LINE_LIMIT, COLUMN_LIMIT, TEXT_SHARE = 131_072, 10_000, 12
#: separator, decimal comma, cells of a row
Dialect = tuple[str, bool, int]


#: numbers with thousands separators that have one meaning only, by "the decimal separator is a comma"
_GROUPED = {
    comma: re.compile(
        rf"[+-]?[1-9]\d{{0,2}}(?:(?:[{sep}]\d{{3}})+[{mark}]\d*|(?:[{sep}]\d{{3}}){{2,}})"
    )
    for comma, mark, sep in (
        (True, ",", ".'\u2019 \xa0\u202f"),
        (False, ".", ",'\u2019 \xa0\u202f"),
    )
}
#: a number such as 1.234 or 1,234: one and a fraction, or more than a thousand
_EITHER = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")


class SideBySide(InputError):
    """Error for a file with several tables side by side, where a single table is wanted."""


def number_in(text: str, comma: bool) -> float | None:
    """Return the number in a cell, NaN for an empty cell, None for text."""
    text = text.strip()
    if len(text) > 400:
        return None
    if text.lower() in ("", "nan", "na", "n/a", "null", "none", "-", "#nv"):
        return math.nan
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError:
        if _GROUPED[comma].fullmatch(text):
            whole, _, part = text.partition("," if comma else ".")
            return float(re.sub(r"[^\d+-]", "", whole) + "." + part)
        return _stamp(text.replace(",", "."))


@dataclass
class _Marks:
    """Decimal marks and thousands separators in the cells of a column."""

    #: rows of cells such as 1.234 in a file with decimal commas
    either: list[int] = field(default_factory=list)
    point: bool = False  # whether the column has another cell with a point, in a file with decimal commas
    decimal: bool = False  # whether the column has a cell with the decimal mark that has one meaning only
    # first row of a cell such as 1,234 with the decimal mark; -1 without one
    grouped: int = -1
    large: bool = False  # whether the column has a whole number from 100 to 999

    def add(self, row: int, text: str, comma: bool) -> None:
        """Note the marks of a cell."""
        text = text.strip()
        mark, other = (",", ".") if comma else (".", ",")
        if comma and other in text and mark not in text and text.count(other) == 1:
            if _EITHER.fullmatch(text):
                self.either.append(row)
            else:
                self.point = True
        elif mark in text:
            if not _EITHER.fullmatch(text):
                self.decimal = True
            elif self.grouped < 0:
                self.grouped = row
        elif 3 <= len(text) <= 4 and text.lstrip("+-").isdigit():
            self.large = self.large or len(text.lstrip("+-")) == 3

    def doubtful(self) -> int | None:
        """Return the first row whose cell has two meanings, None without one."""
        if self.either and (self.point if self.decimal else not self.point):
            return self.either[0]
        if self.grouped >= 0 and not self.decimal and self.large:
            return self.grouped
        return None

    def thousands(self) -> list[int]:
        """Return the rows of cells such as 1.234 that mean more than a thousand."""
        return self.either if self.decimal else []


def _stamp(text: str) -> float | None:
    """Return the seconds of a date and time (since 1970) or of a time of day, in ISO 8601 format; None for other text."""
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


def text_of(path: Path) -> str:
    """Return the text of a file in any encoding."""
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
    return (
        line.split()
        if delimiter == " "
        else next(csv.reader([line], delimiter=delimiter), [])
    )


def _dialect(path: Path, rows: list[tuple[int, str]]) -> Dialect:
    """Return the dialect under which the last lines are rows of numbers of equal width."""
    best: tuple[tuple[float, int], str, bool, int] = ((0.0, 0), ",", False, 0)
    for delimiter, comma in [(d, False) for d in ",;\t"] + [
        (";", True),
        ("\t", True),
        (" ", False),
    ]:
        split = [_cells(s, delimiter) for _, s in rows[-20:]]
        width = max((len(c) for c in split), key=[len(c) for c in split].count)
        numbers = sum(
            number_in(x, comma) is not None for c in split if len(c) == width for x in c
        )
        share = numbers / max(sum(map(len, split)), 1)
        if width > 1 and (share, numbers) > best[0]:
            best = ((share, numbers), delimiter, comma, width)
    (_, numbers), delimiter, comma, width = best
    if not numbers:
        last = [number_in(s.strip(), False) is not None for _, s in rows[-20:]]
        # a single column: the time of a rig without inputs and outputs
        if sum(last) > 0.5 * len(last):
            return ",", False, 1
        tried = "separators tried: comma, semicolon, tab, blank"
        raise InputError(f"{path}: no columns of numbers found ({tried})")
    return delimiter, comma, width


def _empty_at_the_end(lines: Sequence[str], delimiter: str) -> int:
    """Return the number of columns without a name or a number at the end of every line."""
    if not delimiter.strip():
        return 0

    def count(line: str) -> int:
        end = line[len(line.rstrip(delimiter + " ")) :]
        return end.count(delimiter)

    return min(map(count, lines))


def _without_last(line: str, delimiter: str, count: int) -> str:
    """Return a line without its last delimiters, at most `count`."""
    for _ in range(count):
        line = line.rstrip().removesuffix(delimiter)
    return line


def _is_numeric(cells: list[str], width: int, comma: bool) -> bool:
    """Return whether a row is data: most of its cells are finite numbers, or all its cells are numbers or gaps."""
    found = [number_in(x, comma) for x in cells]
    finite = sum(x is not None and math.isfinite(x) for x in found)
    return finite > width / 2 or (
        finite > 0 and len(cells) == width and None not in found
    )


def _are_units(cells: list[str]) -> bool:
    """Return whether at least half of a header row's cells are units."""
    told = [x for x in cells if x not in ("", "-")]
    return bool(told) and sum(map(unit_known, told)) >= 0.5 * len(told)


#: a cell that numbers a column instead of naming it
_NUMBERED = re.compile(
    r"(channel|chan|ch|kanal|column|col|spalte|sensor|no|nr|#)?[\s_.:#-]*\d+",
    re.IGNORECASE,
)


def _rank(cells: list[str]) -> int:
    """Return the rank of a header row: 2 with a name of time, 1 with a beginning of such a name, -1 for numbers or gaps."""
    names = [split_header(x)[0].lower() for x in cells]
    if "" in names or all(map(_NUMBERED.fullmatch, names)):
        return -1
    return (
        2
        if any(n in STAMPS and not unit_known(n) for n in names)
        else int(any(n.startswith(BEGINS) for n in names))
    )


def _header(
    path: Path,
    rows: list[tuple[int, str]],
    like: Dialect,
    given: Sequence[str] | None,
    comments: Sequence[tuple[int, str]] = (),
) -> tuple[list[str], dict[str, str], int]:
    """Return the names of the columns, units by name, and the row at which the numbers begin.

    Among several header rows, the row with a name of time holds the names (otherwise the last row), and a row
    of units below holds the units. Other rows, such as descriptions, are skipped. `given` are the names for a
    file without a header, and have priority over a header in the `comments` above the numbers.
    """
    first = _first_numbers(path, rows, like)
    block = _header_rows(path, rows, first, like, given, comments)
    unit_row = _row_of_units(block)
    header = _row_of_names([row for row in block if row is not unit_row])
    pairs = [split_header(x) for x in header]
    under = _bare_units(unit_row) if unit_row else [""] * len(header)
    units = [unit or other for (_, unit), other in zip(pairs, under, strict=True)]
    names = distinct([name for name, _ in pairs], header, units)
    return names, {n: u for n, u in zip(names, units, strict=True) if u}, first


def _first_numbers(path: Path, rows: list[tuple[int, str]], like: Dialect) -> int:
    """Return the index of the first row of numbers."""
    delimiter, comma, width = like
    for k, (_, line) in enumerate(rows[:200]):
        if _is_numeric(_cells(line, delimiter), width, comma):
            return k
    raise InputError(f"{path}: line {rows[0][0]}: no header row that names the columns")


def _header_rows(
    path: Path,
    rows: list[tuple[int, str]],
    first: int,
    like: Dialect,
    given: Sequence[str] | None,
    comments: Sequence[tuple[int, str]],
) -> list[list[str]]:
    """Return the rows that may name the columns: directly above the numbers, else as given, else in comments."""
    delimiter, _, width = like
    number = rows[first][0]
    heads = [[x.strip() for x in _cells(s, delimiter)] for _, s in rows[:first]]
    block = list(
        itertools.takewhile(lambda cells: len(cells) == width, reversed(heads))
    )
    if block:
        return block[::-1]
    if given is not None:
        if len(given) != width:
            raise InputError(
                f"{path}: --columns names {len(given)} columns, line {number} has {width}"
            )
        return [list(given)]
    above = rows[first - 1][0] if first else 0
    block = _in_comments([text for n, text in comments if above < n < number], like)
    if block:
        return block
    what = f"the header has {len(heads[-1])}" if heads else "no header row names them"
    told = f"line {number} has {width} fields, {what}"
    if delimiter == "," and heads and len(heads[-1]) < width <= 2 * len(heads[-1]):
        raise InputError(
            f"{path}: {told}: decimal commas between commas have no single meaning; export with semicolons or tabs"
        )
    raise InputError(f"{path}: {told}: name the columns with --columns NAME,NAME,...")


def _bare_units(row: list[str]) -> list[str]:
    return [x.strip("[]() ") for x in row]


def _row_of_units(block: list[list[str]]) -> list[str] | None:
    """Return the last header row below the first that holds units; None without one."""
    for row in reversed(block[1:]):
        if _rank(row) <= 0 and _are_units(_bare_units(row)):
            return row
    return None


def _row_of_names(rows: list[list[str]]) -> list[str]:
    """Return the first row with a name of time, or else the last row of the best rank."""
    rank = max(map(_rank, rows))
    best = [row for row in rows if _rank(row) == rank]
    return best[0] if rank > 0 else best[-1]


def _in_comments(comments: Sequence[str], like: Dialect) -> list[list[str]]:
    """Return the header rows among the comment lines above the numbers, such as ``# time [s], force [N]``."""
    delimiter, comma, width = like
    out = []
    for text in comments[-4:]:
        text = text.strip().lstrip("#%").strip()
        for mark in dict.fromkeys((delimiter, ",", ";", "\t", " ")):
            cells = [x.strip() for x in _cells(text, mark)]
            if len(cells) == width and not any(
                number_in(x, comma) is not None for x in cells
            ):
                out.append(cells)
                break
    return out


def _picked(
    path: Path, names: list[str], wanted: list[str] | None, time: str
) -> list[int]:
    """Return the indices of the wanted columns and of the time column; all columns if no names are given."""
    there = Counter(names)
    bases = {n: split_header(n)[0] for n in names}
    for name in wanted or ():
        if name not in there and name not in bases.values():
            raise MissingColumn(
                f"{path}: no column {shown(name)}; {did_you_mean(name, names)}", name
            )
    for name, count in there.items():
        if count > 1 and (wanted is None or name in wanted):
            raise InputError(f"{path}: the header names {shown(name)} twice")
    if wanted is None:
        return list(range(len(names)))
    chosen = {*wanted, time, *filter(is_time, names)}
    return [i for i, n in enumerate(names) if n in chosen or bases[n] in chosen]


def _cell_by_cell(
    path: Path,
    rows: list[tuple[int, str]],
    names: list[str],
    used: list[int],
    needed: set[str],
    like: Dialect,
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Return the columns `used`, with NaN for text, and the first text by column.

    A column without a number is omitted as remarks. Text in a `needed` column is an error.
    """
    delimiter, comma, width = like
    texts: dict[str, str] = {}
    columns = {names[i]: array("d") for i in used}
    marks = {names[i]: _Marks() for i in used}
    for k, (number, line) in enumerate(rows):
        row = _cells(line, delimiter)
        if len(row) != width:
            raise InputError(
                f"{path}: line {number} has {len(row)} fields, the header has {width}"
            )
        for i in used:
            name = names[i]
            value = number_in(row[i], comma)
            if value is not None:
                columns[name].append(value)
                marks[name].add(k, row[i], comma)
                continue
            text = f"{shown(row[i].strip())} is not a number"
            if name in needed:
                raise InputError(f"{path}: line {number}, column {shown(name)}: {text}")
            columns[name].append(math.nan)
            texts.setdefault(name, f"line {number}: {text}")
    out = {name: np.array(values) for name, values in columns.items()}
    for name in texts:
        if np.isnan(out[name]).all():
            del out[name]
    for i in used:
        name = names[i]
        if name not in out:
            continue
        if (doubt := marks[name].doubtful()) is not None:
            raise _two_meanings(path, rows[doubt], name, i, delimiter)
        if grouped := marks[name].thousands():
            out[name][grouped] = np.round(1e3 * out[name][grouped])
    return out, {name: text for name, text in texts.items() if name in out}


def _two_meanings(
    path: Path, row: tuple[int, str], name: str, place: int, delimiter: str
) -> InputError:
    cell = shown(_cells(row[1], delimiter)[place].strip())
    return InputError(
        f"{path}: line {row[0]}, column {shown(name)}: {cell} may be a fraction or thousands: write numbers without "
        "thousands separators"
    )


def _check_groups(
    path: Path,
    rows: list[tuple[int, str]],
    names: list[str],
    data: np.ndarray,
    used: list[int],
    like: Dialect,
) -> None:
    """Raise `InputError` for a column in which 999 is followed by 1.001 (more than a thousand, by its look)."""
    delimiter, comma, _ = like
    for i in used:
        x = np.abs(data[:, i])
        broken = x != np.floor(x)
        if not broken.any() or (x[broken] < 1.0).any() or x.max() >= 1000.0:
            continue
        thousands = 1e3 * x[broken]
        if (
            np.abs(thousands - np.round(thousands)).max() > 1e-6
            or not (x[~broken] >= 100.0).any()
        ):
            continue
        marks = _Marks()
        for k, (_, line) in enumerate(rows):
            marks.add(k, _cells(line, delimiter)[i], comma)
        if (doubt := marks.doubtful()) is not None:
            raise _two_meanings(path, rows[doubt], names[i], i, delimiter)


@dataclass(frozen=True)
class _Text:
    """A text table: its columns by name, and the rows of numbers with their line numbers."""

    names: list[str]
    units: dict[str, str]
    rows: list[tuple[int, str]]
    like: Dialect

    def tables(self) -> list[tuple[range, list[str]]]:
        """Return the tables side by side (`_columns.side_by_side`); empty unless their time columns rise."""
        found = side_by_side([split_header(n)[0] for n in self.names])
        delimiter, comma, width = self.like
        first = [
            cells
            for _, s in self.rows[:50]
            if len(cells := _cells(s, delimiter)) == width
        ]
        for places, _ in found:
            stamps = [number_in(cells[places[0]], comma) for cells in first]
            time = [t for t in stamps if t is not None and math.isfinite(t)]
            if len(time) < 2 or any(b <= a for a, b in itertools.pairwise(time)):
                return []
        return found


def _read(path: Path, columns: Sequence[str] | None, text: str | None = None) -> _Text:
    # lines end at line feeds and carriage returns, not at every separator of Unicode
    lines = (
        (text_of(path) if text is None else text)
        .replace("\r\n", "\n")
        .replace("\r", "\n")
        .split("\n")
    )
    told = [(i, s) for i, s in enumerate(lines, 1) if s.strip()]
    rows = [(i, s) for i, s in told if s.lstrip()[0] not in "#%"]
    comments = [
        (i, s) for i, s in told if s.lstrip()[0] in "#%" and len(s) <= LINE_LIMIT
    ]
    del lines, told
    if not rows:
        raise InputError(f"{path}: is empty")
    for number, line in rows:
        if len(line) > LINE_LIMIT:
            raise InputError(
                f"{path}: line {number} has {len(line)} characters, at most {LINE_LIMIT} are read"
            )
    delimiter, comma, width = like = _dialect(path, rows)
    empty = _empty_at_the_end([s for _, s in rows], delimiter)
    if 0 < empty < width - 1:  # spreadsheets fill every line up to the longest one
        rows = [(i, _without_last(s, delimiter, empty)) for i, s in rows]
        comments = [(i, _without_last(s, delimiter, empty)) for i, s in comments]
        like = delimiter, comma, width - empty
    if like[2] > COLUMN_LIMIT:
        raise InputError(
            f"{path}: has {like[2]} columns, at most {COLUMN_LIMIT} are read"
        )
    names, units, first = _header(path, rows, like, columns, comments)
    return _Text(names, units, rows[first:], like)


def read_text(
    path: Path,
    wanted: Choice,
    time: str,
    columns: Sequence[str] | None = None,
    text: str | None = None,
) -> Columns:
    """Return the wanted columns of a text table and its time column; `columns` names all columns of a file without a header row."""
    return _columns(path, _read(path, columns, text), wanted, time)


def _columns(path: Path, text: _Text, wanted: Choice, time: str) -> Columns:
    names = text.names
    units = text.units
    rows = text.rows
    delimiter, comma, width = like = text.like
    if count := len(text.tables()):
        raise SideBySide(
            f"{path}: holds {count} tables side by side, each with its own time: read them as rasters"
        )
    if callable(wanted):
        wanted = wanted(names)
    used = _picked(path, names, wanted, time)
    numbers = [n for n, _ in rows]
    body = "\n".join(s for _, s in rows)
    try:  # fast path: every cell of interest is a number
        if comma and "." in body:  # a point may separate thousands
            raise ValueError
        data = np.loadtxt(
            io.StringIO(body.replace(",", ".") if comma else body),
            delimiter=None if delimiter == " " else delimiter,
            quotechar='"',
            comments=None,
            ndmin=2,
        )
        if data.shape != (len(numbers), width):
            raise ValueError
    except ValueError:
        data = None
    del body
    if data is not None:
        _check_groups(path, rows, names, data, used, like)
        return Columns({names[i]: data[:, i] for i in used}, units, numbers)
    needed = {time}
    if wanted is not None:
        needed |= {
            n
            for n in names
            if n in wanted or split_header(n)[0] in wanted or n.lower() in TIME_NAMES
        }
    values, texts = _cell_by_cell(path, rows, names, used, needed, like)
    return Columns(values, units, numbers, texts)


def read_text_rasters(
    path: Path, columns: Sequence[str] | None = None, content: str | None = None
) -> list[Columns]:
    """Return the tables of a text file (or of its `content`): one, or several side by side with their own time columns."""
    text = _read(path, columns, content)
    bare = [split_header(n)[0] for n in text.names]
    tables = text.tables()
    if not tables:
        return [_columns(path, text, None, TIME)]
    # unique names while the cells are read
    keys = [str(i) for i in range(len(bare))]
    found, texts = _cell_by_cell(
        path,
        text.rows,
        keys,
        list(range(len(bare))),
        {str(t[0][0]) for t in tables},
        text.like,
    )
    out = []
    for places, names in tables:
        there = np.isfinite(found[str(places[0])])
        values = {
            n: found[str(i)][there]
            for i, n in zip(places, names, strict=True)
            if str(i) in found
        }
        units = {
            n: text.units.get(text.names[i]) or time_unit(bare[i]) * (n == TIME)
            for i, n in zip(places, names, strict=True)
        }
        lines = [line for (line, _), good in zip(text.rows, there, strict=True) if good]
        odd = {
            n: texts[str(i)]
            for i, n in zip(places, names, strict=True)
            if str(i) in texts
        }
        out.append(Columns(values, {n: u for n, u in units.items() if u}, lines, odd))
    return out
