"""Tables of measured channels, read from and written to CSV, Parquet, MATLAB ``.mat`` and MDF ``.mf4`` files."""

from __future__ import annotations

import csv
import datetime as dt
import difflib
import io
import math
import os
import re
import sys
import warnings
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, plain, shown
from ..files import whole
from ..inputs import memory_limit, plain_file, read_bytes, too_large
from ..units import convert
from .quality import TIME

#: of a text table: characters of a line, columns, and how many times its size it takes in memory while it is read
LINE_LIMIT, COLUMN_LIMIT, TEXT_SHARE = 131_072, 10_000, 12
_TIME_NAMES = ("time", "t", "zeit", "timestamp", "timestamps")


def _vector(values: Any) -> np.ndarray:
    out = np.array(values, dtype=np.float64)
    out.flags.writeable = False
    return out


def _did_you_mean(name: str, known: Iterable[str]) -> str:
    names = sorted(n for n in known if len(n) <= 200)[:2000]
    near = difflib.get_close_matches(name[:200], names, n=1, cutoff=0.5)
    listed = ", ".join(plain(n, 40) for n in names[:12]) + (", ..." if len(names) > 12 else "")
    return f"did you mean {shown(near[0])}? It has: {listed}" if near else f"it has: {listed}"


@dataclass(frozen=True)
class Table:
    """Channels over a common time.

    `time` (n,) [s]; `columns`: name -> (n,) in the unit that `units` names (SI of its quantity where it names none);
    `source`: where it came from, for messages. Arrays are copied and read-only. Raises `InputError` on unequal lengths.
    """

    time: np.ndarray
    columns: dict[str, np.ndarray]
    source: str = "table"
    units: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", _vector(self.time))
        object.__setattr__(self, "columns", {k: _vector(v) for k, v in self.columns.items()})
        object.__setattr__(self, "units", dict(self.units))
        if self.time.ndim != 1:
            raise InputError(f"{self.source}: time must be one column of numbers")
        for name, column in self.columns.items():
            if column.shape != self.time.shape:
                raise InputError(
                    f"{self.source}: '{name}' has shape {column.shape}, time has {self.time.shape}"
                )

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, name: str) -> np.ndarray:
        """The column `name` (n,); raises `InputError` with the nearest name where there is none."""
        if name not in self.columns:
            raise InputError(f"{self.source}: no column {shown(name)}; {_did_you_mean(name, self.columns)}")
        return self.columns[name]

    @property
    def step(self) -> float:
        """Sampling step [s], the mean over the record, which rounding of the stamps does not touch."""
        if len(self) < 2:
            raise InputError(f"{self.source}: {len(self)} samples have no time step")
        return float((self.time[-1] - self.time[0]) / (len(self) - 1))

    def uniform(self) -> Table:
        """The same samples on an exactly uniform time (for the small jitter and rounding that `check` lets pass)."""
        return Table(self.time[0] + self.step * np.arange(len(self)), self.columns, self.source, self.units)


# ---------------------------------------------------------------------------------------------------- reading
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


def read_columns(
    path: str | Path, wanted: Choice = None, *, axis: str = TIME, resample: bool = False
) -> Columns:
    """Read the columns of a table file: any separator, decimal commas, preambles, units in the header or the file's own.

    The one reader of every table in the project; `read_table` puts a time base and channels on it. `axis`: the name under
    which MATLAB and MDF files hold what the others are told over. Raises `InputError` with one line, also for what is no
    plain file or would take more memory than `inputs.memory_limit`.
    """
    path = Path(path)
    try:
        reader = _READERS[path.suffix.lower()]
    except KeyError:
        known = " ".join(_READERS)
        raise InputError(
            f"{path}: cannot tell the format from suffix {shown(path.suffix)} (known: {known})"
        ) from None
    if os.path.isdir(path):
        raise InputError(f"{path}: is a folder, not a table")
    plain_file(path)
    try:
        return reader(path, wanted, axis, resample)
    except InputError:
        raise
    except ImportError as error:
        raise InputError(
            f'{path}: reading {path.suffix} needs {error.name}: pip install "isd-gym[io]"'
        ) from None
    except Exception as error:  # whatever it is, it is the file's fault
        raise InputError(f"{path}: cannot be read ({_one_line(error)})") from None


def read_rasters(path: str | Path) -> list[Columns]:
    """What a file holds, every raster by itself: an MDF's groups over their own stamps (named 'time' [s]); others have one.

    path: the file. Raises `InputError` as `read_columns` does.
    """
    path = Path(path)
    if path.suffix.lower() not in (".mf4", ".mdf"):
        return [read_columns(path)]
    from . import isolated

    plain_file(path)
    head, arrays = isolated.read("mdf", path, None, TIME, "own")
    rasters: dict[str, Columns] = {}
    for (full, _), values in zip(head["columns"], arrays, strict=True):
        number, _, name = full.partition(" ")
        if not name:
            rasters[number] = Columns({TIME: values}, {TIME: "s"})
            continue
        rasters[number].values[name] = values
        if name in head["units"]:
            rasters[number].units[name] = head["units"][name]
    return list(rasters.values())


def read_table(
    path: str | Path,
    *,
    rename: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    expected: Mapping[str, str] | None = None,
    resample: bool = False,
) -> Table:
    """Read a table from `path`; the suffix tells the format (.csv .txt .tsv .dat .parquet .mat .mf4 .mdf).

    rename: column in the file -> channel. units: unit of a column, by its channel or its name in the file (goes
    before what the file itself says; time is 's' unless told). expected: channel -> unit it shall have; then exactly
    these channels are returned, converted, and a column without any unit is taken to have it already.
    Without it every numeric column is returned as it is. resample: MDF channels on different rasters are
    interpolated linearly to the finest; otherwise they are refused.
    Nothing in a file is ever executed. Raises `InputError` with one line on whatever cannot be used.
    """
    path = Path(path)
    rename, units = dict(rename or {}), dict(units or {})
    inverse = {channel: name for name, channel in rename.items()}
    if len(inverse) < len(rename):
        raise InputError(f"{path}: two columns are renamed to one channel")
    wanted = None if expected is None else [inverse.get(c, c) for c in expected]
    found = read_columns(path, wanted, axis=inverse.get(TIME, TIME), resample=resample)
    columns, file_units = found.values, found.units
    for name in rename if expected is None else ():
        if name not in columns:
            raise InputError(f"{path}: no column {shown(name)} to rename; {_did_you_mean(name, columns)}")
    columns = {rename.get(name, name): values for name, values in columns.items()}
    file_units = {rename.get(name, name): unit for name, unit in file_units.items()}
    file_units |= {rename.get(name, name): unit for name, unit in units.items()}
    if TIME not in columns:
        lower = {name.lower(): name for name in columns}
        other = next((lower[n] for n in _TIME_NAMES if n in lower), None)
        if other is None:
            raise InputError(f"{path}: no column 'time'; {_did_you_mean(TIME, columns)}")
        columns[TIME], file_units[TIME] = columns.pop(other), file_units.pop(other, "s")
    target = {TIME: "s"} | (dict(expected) if expected is not None else {})
    out: dict[str, np.ndarray] = {}
    for name in target if expected is not None else columns:
        if name not in columns:
            raise InputError(
                f"{path}: no column {shown(inverse.get(name, name))}; {_did_you_mean(name, columns)}"
            )
        values = np.asarray(columns[name])
        if values.dtype.kind not in "fiub" or values.ndim != 1:
            if expected is None and name != TIME:
                continue
            raise InputError(f"{path}: column {shown(name)} does not hold plain numbers")
        try:
            unit = file_units.get(name) or target.get(name, "")
            out[name] = convert(values.astype(float), unit, target[name]) if name in target else values
        except InputError as error:
            raise InputError(f"{path}: column {shown(name)}: {error}") from None
    time = out.pop(TIME)
    if len(time) == 0:
        raise InputError(f"{path}: no samples")
    kept = target if expected is not None else file_units
    return Table(time, out, str(path), {n: u for n, u in kept.items() if n in out and u})


def _one_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:160]


def _unit_known(text: str) -> bool:
    try:
        convert(1.0, text, text)
    except InputError:
        return False
    return True


def _split_header(text: str) -> tuple[str, str]:
    """``name [unit]`` or ``name (unit)`` -> name, unit. Round brackets that hold no known unit belong to the name."""
    match = re.fullmatch(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))\s*", text.strip())
    if match and match[1]:
        unit = (match[2] if match[2] is not None else match[3]).strip()
        if match[2] is not None or _unit_known(unit):
            return match[1], unit
    return text.strip(), ""


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


def _dialect(path: Path, rows: list[tuple[int, str]]) -> tuple[str, bool, int]:
    """(delimiter, decimal comma, width) under which the last lines hold numbers before all else, all lines alike."""
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
        tried = "separators tried: comma, semicolon, tab, blank"
        raise InputError(f"{path}: no columns of numbers found ({tried})")
    return delimiter, comma, width


def _read_csv(path: Path, wanted: Choice, time: str, resample: bool) -> Columns:
    text = _text_of(path)
    # a line ends where an editor says so, not at every separator that Unicode has
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    rows = [(i, s) for i, s in enumerate(lines, 1) if s.strip() and s.lstrip()[0] not in "#%"]
    del lines
    if not rows:
        raise InputError(f"{path}: is empty")
    for number, line in rows:
        if len(line) > LINE_LIMIT:
            raise InputError(
                f"{path}: line {number} has {len(line)} characters, at most {LINE_LIMIT} are read"
            )
    delimiter, comma, width = _dialect(path, rows)
    if width > COLUMN_LIMIT:
        raise InputError(f"{path}: has {width} columns, at most {COLUMN_LIMIT} are read")
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
        if any(map(_unit_known, bare)) and not any(map(_unit_known, heads[-2])):
            unit_row, heads = bare, heads[:-1]
    pairs = [_split_header(x) for x in heads[-1]]
    names = [name for name, _ in pairs]
    if len(names) != width:
        raise InputError(f"{path}: line {rows[first][0]} has {width} fields, the header has {len(names)}")
    if callable(wanted):
        wanted = wanted(names)
    there = Counter(names)
    for name in wanted or ():
        if name not in there:
            raise InputError(f"{path}: no column {shown(name)}; {_did_you_mean(name, names)}")
    for name, count in there.items():
        if count > 1 and (wanted is None or name in wanted):
            raise InputError(f"{path}: the header names {shown(name)} twice")
    file_units = {n: u for (n, _), u in zip(pairs, unit_row, strict=True) if u} if unit_row else {}
    file_units |= {name: unit for name, unit in pairs if unit}
    chosen = (
        set(names) if wanted is None else {*wanted, time, *(n for n in names if n.lower() in _TIME_NAMES)}
    )
    used = [i for i, n in enumerate(names) if n in chosen]
    numbers = [n for n, _ in rows[first:]]
    body = "\n".join(s for _, s in rows[first:])
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
        return Columns({names[i]: data[:, i] for i in used}, file_units, numbers)
    except ValueError:
        pass
    del body
    columns: dict[str, Any] = {names[i]: array("d") for i in used}
    for number, line in rows[first:]:
        row = _cells(line, delimiter)
        if len(row) != width:
            raise InputError(f"{path}: line {number} has {len(row)} fields, the header has {width}")
        for i in used:
            value = _number(row[i], comma)
            if value is None and (wanted is None and names[i] != time):
                columns.pop(names[i], None)  # a column of remarks
                continue
            if value is None:
                raise InputError(
                    f"{path}: line {number}, column {shown(names[i])}: {shown(row[i].strip())} is not a number"
                )
            if names[i] in columns:
                columns[names[i]].append(value)
    return Columns({name: np.array(values) for name, values in columns.items()}, file_units, numbers)


def _isolated(kind: str) -> Callable[[Path, Choice, str, bool], Columns]:
    """The reader of a binary format, which runs in a process of its own."""

    def read(path: Path, wanted: Choice, axis: str, resample: bool) -> Columns:
        from . import isolated

        if sys.modules.get(_LIBRARIES[kind], 0) is None:  # as good as not installed, for this process
            raise ModuleNotFoundError(name=_LIBRARIES[kind])
        given = None if callable(wanted) else wanted
        head, arrays = isolated.read(kind, path, given, axis, resample)
        if "no_channel" in head:
            name = head["no_channel"]
            raise InputError(f"{path}: no channel {shown(name)}; {_did_you_mean(name, head['names'])}")
        columns: dict[str, Any] = {}
        units = dict(head["units"])
        told = [(name, values) for (name, _), values in zip(head["columns"], arrays, strict=True)]
        for full, values in told + [(name, _NO_NUMBERS) for name in head["other"]]:
            name, unit = _split_header(full) if kind == "parquet" else (full, "")
            if name in columns and values is not _NO_NUMBERS:
                raise InputError(f"{path}: names {shown(name)} twice")
            columns.setdefault(name, values)
            if full in units:
                units[name] = units[full]
            elif unit:
                units[name] = unit
        if callable(wanted):
            wanted(list(columns))
        return Columns(columns, units)

    return read


_NO_NUMBERS = np.empty(0, object)
_LIBRARIES = {"parquet": "pyarrow", "mat": "scipy.io", "mdf": "asammdf"}
_READERS: dict[str, Callable[[Path, Choice, str, bool], Columns]] = {
    ".csv": _read_csv,
    ".txt": _read_csv,
    ".tsv": _read_csv,
    ".dat": _read_csv,
    ".parquet": _isolated("parquet"),
    ".mat": _isolated("mat"),
    ".mf4": _isolated("mdf"),
    ".mdf": _isolated("mdf"),
}


# ---------------------------------------------------------------------------------------------------- writing
def write_table(path: str | Path, table: Table) -> None:
    """Write `table` in the format of the suffix (.csv .txt .tsv .parquet .mat .mf4), whole or not at all.

    Numbers survive exactly. Parquet, .mat and .mf4 carry the units; a CSV has the bare channel names as header.

    path: the file.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    names, data = [TIME, *table.columns], [table.time, *table.columns.values()]
    if suffix not in (".csv", ".txt", ".tsv", ".parquet", ".mat", ".mf4"):
        raise InputError(
            f"{path}: cannot write suffix '{path.suffix}' (known: .csv .txt .tsv .parquet .mat .mf4)"
        )
    try:
        with whole(path) as temporary:
            if suffix in (".csv", ".txt", ".tsv"):
                with temporary.open("w", newline="", encoding="utf-8") as stream:
                    writer = csv.writer(
                        stream, delimiter="\t" if suffix == ".tsv" else ",", lineterminator="\n"
                    )
                    writer.writerow(names)
                    writer.writerows(zip(*(column.tolist() for column in data), strict=True))
            elif suffix == ".parquet":
                import pyarrow
                import pyarrow.parquet as parquet

                units = {TIME: "s"} | table.units
                fields = [
                    pyarrow.field(n, pyarrow.float64(), metadata={"unit": units.get(n, "")}) for n in names
                ]
                parquet.write_table(pyarrow.Table.from_arrays(data, schema=pyarrow.schema(fields)), temporary)
            elif suffix == ".mat":
                from scipy.io import savemat

                for name in names:
                    if not re.fullmatch(r"[A-Za-z]\w{0,62}", name) or name == "units":
                        raise InputError(f"{path}: '{name}' is no name for a MATLAB variable")
                extra = {"units": table.units} if table.units else {}
                savemat(
                    temporary,
                    dict(zip(names, data, strict=True)) | extra,
                    long_field_names=True,
                    oned_as="column",
                )
            else:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    from asammdf import MDF, Signal

                    with MDF(version="4.10") as mdf:
                        mdf.append(
                            [
                                Signal(v, table.time, name=n, unit=table.units.get(n, ""))
                                for n, v in table.columns.items()
                            ]
                        )
                        mdf.save(temporary, overwrite=True)
    except ImportError as error:
        raise InputError(f'{path}: writing {suffix} needs {error.name}: pip install "isd-gym[io]"') from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or _one_line(error)})") from None
