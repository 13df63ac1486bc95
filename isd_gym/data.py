"""Tables of measured channels, read from and written to CSV, Parquet, MATLAB ``.mat`` and MDF ``.mf4`` files.

`check` (whether a record can be trusted) and the signal tools live in `quality` and `signals`; they are at hand here.
"""

from __future__ import annotations

import csv
import difflib
import io
import math
import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InputError
from .files import whole
from .quality import TIME, Finding, check
from .signals import Consistency, integral_consistency, noise_level, smooth_derivatives
from .units import convert

__all__ = [
    "Consistency",
    "Finding",
    "Table",
    "check",
    "integral_consistency",
    "noise_level",
    "read_table",
    "smooth_derivatives",
    "write_table",
]

_TIME_NAMES = ("time", "t", "zeit", "timestamp", "timestamps")


def _vector(values: Any) -> np.ndarray:
    out = np.array(values, dtype=np.float64)
    out.flags.writeable = False
    return out


def _did_you_mean(name: str, known: Iterable[str]) -> str:
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    listed = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return f"did you mean '{near[0]}'? It has: {listed}" if near else f"it has: {listed}"


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
            raise InputError(f"{self.source}: no column '{name}'; {_did_you_mean(name, self.columns)}")
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
Columns = tuple[dict[str, Any], dict[str, str]]


def read_table(
    path: str | Path,
    *,
    rename: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    expected: Mapping[str, str] | None = None,
    resample: bool = False,
) -> Table:
    """Read a table from `path`; the suffix tells the format (.csv .txt .tsv .parquet .mat .mf4 .mdf).

    rename: column in the file -> channel. units: unit of a column, by its channel or its name in the file (goes
    before what the file itself says; time is 's' unless told). expected: channel -> unit it shall have; then exactly
    these channels are returned, converted, and a column without any unit is taken to have it already.
    Without it every numeric column is returned as it is. resample: MDF channels on different rasters are
    interpolated linearly to the finest; otherwise they are refused.
    Nothing in a file is ever executed. Raises `InputError` with one line on whatever cannot be used.
    """
    path = Path(path)
    try:
        reader = _READERS[path.suffix.lower()]
    except KeyError:
        known = " ".join(_READERS)
        raise InputError(
            f"{path}: cannot tell the format from suffix '{path.suffix}' (known: {known})"
        ) from None
    if not path.is_file():
        raise InputError(f"{path}: {'is a folder, not a table' if path.is_dir() else 'no such file'}")
    rename, units = dict(rename or {}), dict(units or {})
    inverse = {channel: name for name, channel in rename.items()}
    if len(inverse) < len(rename):
        raise InputError(f"{path}: two columns are renamed to one channel")
    wanted = None if expected is None else [inverse.get(c, c) for c in expected]
    try:
        columns, file_units = reader(path, wanted, inverse.get(TIME, TIME), resample)
    except InputError:
        raise
    except ImportError as error:
        raise InputError(
            f'{path}: reading {path.suffix} needs {error.name}: pip install "isd-gym[io]"'
        ) from None
    except Exception as error:  # the formats' own libraries raise anything on a damaged file
        raise InputError(f"{path}: cannot be read ({_one_line(error)})") from None
    for name in rename if expected is None else ():
        if name not in columns:
            raise InputError(f"{path}: no column '{name}' to rename; {_did_you_mean(name, columns)}")
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
            raise InputError(f"{path}: no column '{inverse.get(name, name)}'; {_did_you_mean(name, columns)}")
        values = np.asarray(columns[name])
        if values.dtype.kind not in "fiub" or values.ndim != 1:
            if expected is None and name != TIME:
                continue
            raise InputError(f"{path}: column '{name}' does not hold plain numbers")
        try:
            unit = file_units.get(name) or target.get(name, "")
            out[name] = convert(values.astype(float), unit, target[name]) if name in target else values
        except InputError as error:
            raise InputError(f"{path}: column '{name}': {error}") from None
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
    if text.lower() in ("", "nan", "na", "n/a", "null", "none", "-", "#nv"):
        return math.nan
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError:
        return None


def _read_csv(path: Path, wanted: list[str] | None, time: str, resample: bool) -> Columns:
    raw = path.read_bytes()
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = raw.decode("utf-16")
    else:
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = raw.decode("latin-1")
    if "\0" in text:
        raise InputError(f"{path}: is not a text table")
    rows = [(i, s) for i, s in enumerate(text.splitlines(), 1) if s.strip() and s.lstrip()[0] not in "#%"]
    if not rows:
        raise InputError(f"{path}: is empty")

    def cells(line: str, delimiter: str) -> list[str]:
        return line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter))

    # The delimiter and decimal sign under which the last lines hold numbers before all else, all lines alike
    best: tuple[tuple[float, int], str, bool, int] = ((0.0, 0), ",", False, 0)
    for delimiter, comma in [(d, False) for d in ",;\t"] + [(";", True), ("\t", True), (" ", False)]:
        split = [cells(s, delimiter) for _, s in rows[-20:]]
        width = max((len(c) for c in split), key=[len(c) for c in split].count)
        numbers = sum(_number(x, comma) is not None for c in split if len(c) == width for x in c)
        share = numbers / sum(map(len, split))
        if width > 1 and (share, numbers) > best[0]:
            best = ((share, numbers), delimiter, comma, width)
    (_, numbers), delimiter, comma, width = best
    if not numbers:
        tried = "separators tried: comma, semicolon, tab, blank"
        raise InputError(f"{path}: no columns of numbers found ({tried})")
    numeric_first = [
        sum(_number(x, comma) is not None and x.strip() != "" for x in cells(s, delimiter)) > width / 2
        for _, s in rows[:200]
    ]
    first = numeric_first.index(True) if True in numeric_first else len(rows)
    heads = [[x.strip() for x in cells(s, delimiter)] for _, s in rows[:first]]
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
    for name in wanted or ():
        if name not in names:
            raise InputError(f"{path}: no column '{name}'; {_did_you_mean(name, names)}")
    for name in names:
        if names.count(name) > 1 and (wanted is None or name in wanted):
            raise InputError(f"{path}: the header names '{name}' twice")
    file_units = {n: u for (n, _), u in zip(pairs, unit_row, strict=True) if u} if unit_row else {}
    file_units |= {name: unit for name, unit in pairs if unit}
    chosen = (
        set(names) if wanted is None else {*wanted, time, *(n for n in names if n.lower() in _TIME_NAMES)}
    )
    used = [i for i, n in enumerate(names) if n in chosen]
    body = "\n".join(s for _, s in rows[first:])
    try:  # fast path: every cell of interest a number
        data = np.loadtxt(
            io.StringIO(body.replace(",", ".") if comma else body),
            delimiter=None if delimiter == " " else delimiter,
            quotechar='"',
            ndmin=2,
        )
        if data.shape[1] != width:
            raise ValueError
        return {names[i]: data[:, i] for i in used}, file_units
    except ValueError:
        pass
    columns: dict[str, Any] = {names[i]: [] for i in used}
    for number, line in rows[first:]:
        row = cells(line, delimiter)
        if len(row) != width:
            raise InputError(f"{path}: line {number} has {len(row)} fields, the header has {width}")
        for i in used:
            value = _number(row[i], comma)
            if value is None and (wanted is None and names[i] != time):
                columns.pop(names[i], None)  # a column of remarks
                continue
            if value is None:
                raise InputError(
                    f"{path}: line {number}, column '{names[i]}': '{row[i].strip()}' is not a number"
                )
            if names[i] in columns:
                columns[names[i]].append(value)
    return {name: np.array(values) for name, values in columns.items()}, file_units


def _read_parquet(path: Path, wanted: list[str] | None, time: str, resample: bool) -> Columns:
    import pyarrow.parquet as parquet

    table = parquet.read_table(path)
    columns: dict[str, Any] = {}
    units: dict[str, str] = {}
    for item in table.schema:
        name, unit = _split_header(item.name)
        unit = ((item.metadata or {}).get(b"unit") or unit.encode()).decode()
        columns[name] = table.column(item.name).to_numpy()
        if unit:
            units[name] = unit
    return columns, units


def _read_mat(path: Path, wanted: list[str] | None, time: str, resample: bool) -> Columns:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(path, squeeze_me=True, chars_as_strings=True)
    except NotImplementedError:
        raise InputError(
            f"{path}: is a MATLAB 7.3 file; save it with save('{path.name}', ..., '-v7')"
        ) from None
    except (MatReadError, ValueError, TypeError) as error:
        raise InputError(f"{path}: is not a MATLAB file that can be read ({_one_line(error)})") from None
    columns: dict[str, Any] = {}
    units: dict[str, str] = {}

    def take(items: Iterable[tuple[str, Any]]) -> None:
        for name, value in items:
            value = np.asarray(value)
            if value.dtype.names and value.ndim == 0:  # a struct: its fields are the channels
                fields = {n: value[n].item() for n in value.dtype.names}
                if name == "units":
                    units.update({n: str(u) for n, u in fields.items()})
                else:
                    take(fields.items())
            elif value.dtype.kind in "fiub" and value.ndim == 1 and name not in columns:
                columns[name] = value
            elif value.dtype.kind in "fiub" and value.ndim == 1:
                raise InputError(f"{path}: holds '{name}' more than once")
            elif name == time or (wanted is not None and name in wanted):
                raise InputError(
                    f"{path}: '{name}' is not a plain vector of numbers (cells and objects are refused)"
                )

    take((k, v) for k, v in content.items() if not k.startswith("__"))
    if wanted is None:  # constants and settings may lie beside the channels
        lengths = [len(v) for v in columns.values()]
        common = len(columns[time]) if time in columns else max(lengths, key=lengths.count, default=0)
        columns = {n: v for n, v in columns.items() if len(v) == common}
    return columns, units


#: MDF conversions that are mere arithmetic or tables; a formula in a file is not evaluated.
_MDF_CONVERSIONS = {4: {0, 1, 2, 4, 5}, 3: {0, 1, 2, 6, 7, 8, 9, 65535}}


def _read_mdf(path: Path, wanted: list[str] | None, time: str, resample: bool) -> Columns:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import asammdf

        found: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        units: dict[str, str] = {}
        with path.open("rb") as stream:
            if not stream.read(168).startswith(b"MDF") or stream.tell() < 168:
                raise InputError(f"{path}: is not an MDF file")
        with path.open("rb") as stream, asammdf.MDF(stream) as mdf:
            masters = set(mdf.masters_db.items())
            allowed = _MDF_CONVERSIONS[4 if mdf.version >= "4" else 3]
            names = wanted or [n for n in mdf.channels_db if n != TIME]  # no channel wanted: time alone
            for name in names:
                places = [p for p in mdf.channels_db.get(name, ()) if tuple(p) not in masters]
                if not places:
                    if not wanted:
                        continue
                    raise InputError(f"{path}: no channel '{name}'; {_did_you_mean(name, mdf.channels_db)}")
                if len(places) > 1:
                    raise InputError(
                        f"{path}: holds channel '{name}' {len(places)} times, in groups {[p[0] for p in places]}"
                    )
                group, index = places[0]
                for i in {index, mdf.masters_db.get(group, index)}:
                    conversion = mdf.groups[group].channels[i].conversion
                    if conversion is not None and conversion.conversion_type not in allowed:
                        raise InputError(
                            f"{path}: channel '{name}' needs a formula or text conversion; export it as numbers"
                        )
                item = mdf.get(group=group, index=index)
                if item.samples.ndim == 1 and item.samples.dtype.kind in "fiub" and len(item.samples):
                    found[name] = (np.array(item.timestamps), np.array(item.samples))
                    units[name] = item.unit
                elif wanted:
                    raise InputError(f"{path}: channel '{name}' does not hold plain numbers")
    if not found:
        raise InputError(f"{path}: holds no numeric channel")
    base = min((t for t, _ in found.values()), key=lambda t: (t[-1] - t[0]) / max(len(t) - 1, 1))
    same = all(len(t) == len(base) and np.allclose(t, base, rtol=0, atol=1e-9) for t, _ in found.values())
    if not same:
        if not resample:
            rates = sorted(
                {f"{(t[-1] - t[0]) / max(len(t) - 1, 1):.4g} s x {len(t)}" for t, _ in found.values()}
            )
            raise InputError(
                f"{path}: channels are on different rasters ({', '.join(rates)}); ask to resample them"
            )
        start, end = max(t[0] for t, _ in found.values()), min(t[-1] for t, _ in found.values())
        base = base[(base >= start) & (base <= end)]
    columns = {n: v if same else np.interp(base, t, v) for n, (t, v) in found.items()}
    return {time: base} | columns, {n: u for n, u in units.items() if u}


_READERS: dict[str, Callable[[Path, list[str] | None, str, bool], Columns]] = {
    ".csv": _read_csv,
    ".txt": _read_csv,
    ".tsv": _read_csv,
    ".parquet": _read_parquet,
    ".mat": _read_mat,
    ".mf4": _read_mdf,
    ".mdf": _read_mdf,
}


# ---------------------------------------------------------------------------------------------------- writing
def write_table(path: str | Path, table: Table) -> None:
    """Write `table` in the format of the suffix (.csv .txt .tsv .parquet .mat .mf4), whole or not at all.

    Numbers survive exactly. Parquet, .mat and .mf4 carry the units; a CSV has the bare channel names as header.
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
