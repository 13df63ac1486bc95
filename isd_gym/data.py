"""Tables of measured channels: reading and writing them, and judging whether they can be trusted.

`read_table` and `write_table` exchange CSV, Parquet, MATLAB ``.mat`` and MDF ``.mf4`` files; `check` is the data gate
that stands before any diagnosis (DESIGN section 9, step 0); `noise_level`, `smooth_derivatives` and
`integral_consistency` are the signal tools it and the diagnosis share.
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
from typing import Any, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike
from scipy import linalg, optimize, signal

from .errors import InputError
from .files import whole
from .units import convert

TIME = "time"
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
    for name in rename:
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
            out[name] = (
                values.astype(float)
                if name not in target
                else convert(values.astype(float), unit, target[name])
            )
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

    # The delimiter and decimal sign under which the last lines hold most numbers, all lines alike
    best: tuple[int, str, bool, int] = (0, ",", False, 0)
    for delimiter, comma in (
        (",", False),
        (";", False),
        ("\t", False),
        (";", True),
        ("\t", True),
        (" ", False),
    ):
        split = [cells(s, delimiter) for _, s in rows[-20:]]
        width = max((len(c) for c in split), key=[len(c) for c in split].count)
        score = sum(_number(x, comma) is not None for c in split if len(c) == width for x in c)
        if width > 1 and score > best[0]:
            best = (score, delimiter, comma, width)
    score, delimiter, comma, width = best
    if not score:
        raise InputError(
            f"{path}: no columns of numbers found (separators tried: comma, semicolon, tab, blank)"
        )
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
    for name in names:
        if names.count(name) > 1 and (wanted is None or name in wanted):
            raise InputError(f"{path}: the header names '{name}' twice")
    file_units = {n: u for (n, _), u in zip(pairs, unit_row, strict=True) if u} if unit_row else {}
    file_units |= {name: unit for name, unit in pairs if unit}
    used = [
        i
        for i, n in enumerate(names)
        if wanted is None or n in wanted or n == time or n.lower() in _TIME_NAMES
    ]
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
        with path.open("rb") as stream, asammdf.MDF(stream) as mdf:
            masters = set(mdf.masters_db.items())
            allowed = _MDF_CONVERSIONS[4 if mdf.version >= "4" else 3]
            names = [n for n in mdf.channels_db if n != TIME] if wanted is None else dict.fromkeys(wanted)
            for name in names:
                places = [p for p in mdf.channels_db.get(name, ()) if tuple(p) not in masters]
                if not places:
                    if wanted is None:
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
                elif wanted is not None:
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


# ------------------------------------------------------------------------------------------------- the data gate
Level = Literal["error", "warning", "note"]
Span = tuple[float, float]


@dataclass(frozen=True)
class Finding:
    """What `check` found.

    `level`: error (the record cannot be used as it is), warning (a result that rests on it is in doubt) or note;
    `channel`: '' where it is the whole record; `message`: one line; `where`: the spans of time [s] concerned, the
    first 20 of them, empty where it is all of the record.
    """

    level: Level
    channel: str
    message: str
    where: tuple[Span, ...] = ()

    def __str__(self) -> str:
        return f"{self.level}: {self.channel + ': ' if self.channel else ''}{self.message}"


#: quantity -> SI unit; the spread (99.5 % of samples lie within it of the median) beyond which it is doubtful, and
#: impossible, for a suspension or its rig; and the least that a sensor of it could have seen
QUANTITIES: dict[str, tuple[str, float, float, float]] = {
    "displacement": ("m", 2.0, 5.0, 1e-6),
    "velocity": ("m/s", 10.0, 30.0, 1e-5),
    "acceleration": ("m/s^2", 200.0, 500.0, 1e-3),
    "force": ("N", 2e5, 1e6, 1e-2),
    "current": ("A", 200.0, 1000.0, 1e-4),
}
MIN_SAMPLES = 200
_MAX_SPEED = 15.0  # [m/s] RMS that a displacement may imply; wheels and rods stay below 5


def check(table: Table, *, inputs: Mapping[str, str], outputs: Mapping[str, str]) -> list[Finding]:
    """Judge whether a record can be trusted: the data gate of the diagnosis (DESIGN section 9, step 0).

    inputs, outputs: channel -> quantity (a key of `QUANTITIES`). Returns findings, errors first; no errors and no
    warnings mean that nothing speaks against the record. Every test compares a channel with itself or with what is
    physically possible; what takes a model to see (swapped channels of one kind, shifted time, sign) is not judged.
    Raises `InputError` for a channel that the table lacks or a quantity that is unknown.
    """
    channels = {**inputs, **outputs}
    values: dict[str, np.ndarray] = {}
    for name, quantity in channels.items():
        if quantity not in QUANTITIES:
            raise InputError(f"'{name}': unknown quantity '{quantity}' (known: {', '.join(QUANTITIES)})")
        unit = QUANTITIES[quantity][0]
        values[name] = convert(table[name], table.units.get(name) or unit, unit)
    found = _check_time(table.time)
    if len(table) < MIN_SAMPLES:
        found.append(Finding("error", "", f"too short: {len(table)} samples of at least {MIN_SAMPLES}"))
    if any(f.level == "error" for f in found):
        return found  # without a time base nothing else can be judged
    time = table.uniform().time
    chance: dict[str, float] = {}
    moving: dict[str, bool] = {}
    for name, quantity in channels.items():
        x = values[name]
        bad = ~np.isfinite(x)
        if bad.any():
            where = _spans(bad, time)
            text = f"{bad.sum()} samples are not finite, first at t = {where[0][0]:.6g} s"
            found.append(Finding("error", name, text, where))
            continue
        if np.ptp(x) <= 1e-12 * np.max(np.abs(x)):
            text = f"is constant ({x[0]:.6g})"
            dead = Finding("error", name, f"{text}: a dead sensor, or an empty column?")
            found.append(Finding("note", name, text) if name in inputs else dead)
            continue
        found += _check_magnitude(name, quantity, x, table.step)
        noise, resolution = _grain(x)
        if noise > resolution:
            chance[name] = min(1.0, resolution / (2.5 * noise))  # that two samples of it are equal, at rest
        if name in outputs or quantity not in ("current", "force"):  # drives saturate and hold by design
            held = _check_held(name, quantity, x, time, noise, resolution, name in inputs)
            found += held
            if all(f.level == "note" for f in held):  # what follows a frozen stretch looks like a jump
                grain = max(3 * noise, resolution)
                found += _check_spikes(name, quantity, x, time, grain, name in inputs and noise <= resolution)
        if name in outputs:
            moving[name] = _moves(x, [values[n] for n in inputs])
    for name in (n for n, moves in moving.items() if not moves):
        level: Level = "warning" if any(moving.values()) else "error"
        found.append(Finding(level, name, "holds nothing but noise: no excitation, or not connected?"))
    found += _check_copies({n: x for n, x in values.items() if np.all(np.isfinite(x))}, chance, time)
    return sorted(found, key=lambda f: ("error", "warning", "note").index(f.level))


def _spans(flags: np.ndarray, time: np.ndarray) -> tuple[Span, ...]:
    edges = np.flatnonzero(np.diff(np.r_[False, flags, False])).reshape(-1, 2)
    return tuple((float(time[a]), float(time[b - 1])) for a, b in edges[:20])


def _check_time(time: np.ndarray) -> list[Finding]:
    if not np.all(np.isfinite(time)):
        return [Finding("error", TIME, f"{np.sum(~np.isfinite(time))} time stamps are missing or not finite")]
    if len(time) < 3:
        return []
    d = np.diff(time)
    for bad, what in ((d < 0, "runs backwards"), (d == 0, "repeats")):
        if bad.any():
            text = f"time {what} after t = {time[np.argmax(bad)]:.6g} s ({bad.sum()} times)"
            return [Finding("error", TIME, text, _spans(np.r_[bad, False], time))]
    step = float(np.median(d))
    gaps = d > 1.5 * step
    if gaps.any() and np.mean(gaps) < 0.2 and np.max(np.abs(d[~gaps] - step)) < 0.2 * step:
        first = int(np.argmax(gaps))
        text = f"{gaps.sum()} gaps in time, the first of {d[first]:.4g} s after t = {time[first]:.6g} s"
        where = tuple((float(time[i]), float(time[i + 1])) for i in np.flatnonzero(gaps)[:20])
        return [Finding("error", TIME, f"{text}, where the step is {step:.4g} s", where)]
    step = float(time[-1] - time[0]) / (len(time) - 1)
    stray = float(np.ptp(time - step * np.arange(len(time)))) / 2  # from the best uniform grid
    # stamps written with few digits stray by up to half the last digit, however far apart they are
    digit = next((10.0**-k for k in range(9) if np.max(np.abs(time - np.round(time, k))) < 1e-3 * step), 0.0)
    if stray > max(0.1 * step, min(0.51 * digit, step)):
        worst = time[int(np.argmax(np.abs(d - step)))]
        text = f"sampling is not uniform: steps from {d.min():.4g} to {d.max():.4g} s, worst at t = {worst:.6g} s"
        return [Finding("error", TIME, text)]
    found = []
    if stray > 0.01 * step:
        text = f"time stamps stray by {stray:.2g} s from a step of {step:.6g} s; taken as uniform"
        found.append(Finding("note", TIME, text))
    if not 1e-6 <= step <= 0.05:
        level: Level = "error" if not 1e-6 <= step <= 0.25 else "warning"
        found.append(
            Finding(level, TIME, f"a step of {step:.4g} s is implausible: time in another unit than s?")
        )
    return found


def _check_magnitude(name: str, quantity: str, x: np.ndarray, step: float) -> list[Finding]:
    unit, doubtful, impossible, least = QUANTITIES[quantity]
    spread = float(np.quantile(np.abs(x - np.median(x)), 0.995))
    text = f"{quantity} reaches {spread:.4g} {unit}"
    lag = min(max(1, round(0.02 / step)), len(x) - 1)
    speed = float(np.std(x[lag:] - x[:-lag])) / (lag * step) if quantity == "displacement" else 0.0
    if spread > impossible or speed > _MAX_SPEED:
        text += f" at {speed:.3g} m/s" if speed > _MAX_SPEED else ""
        return [Finding("error", name, f"{text}, which cannot be: a wrong unit, or columns swapped?")]
    if spread > doubtful:
        return [Finding("warning", name, f"{text}: a wrong unit, or columns swapped?")]
    if np.ptp(x) < 2 * least:
        return [Finding("warning", name, f"{quantity} stays within {np.ptp(x):.2g} {unit}: a wrong unit?")]
    if quantity == "acceleration" and abs(abs(np.mean(x)) - 9.81) < 0.3:
        return [Finding("warning", name, f"has a mean of {np.mean(x):.3g} m/s^2: gravity is still in it")]
    return []


def _moves(x: np.ndarray, drives: list[np.ndarray]) -> bool:
    """Whether a channel holds more than noise: it is slow, or its spectrum is not flat, or it follows an input."""
    if np.std(np.diff(x)) < 0.9 * np.std(x):  # white noise has sqrt(2), AR(1) noise of 0.6 still 0.89
        return True
    if np.mean((x - x.mean()) ** 4) > 4.5 * np.var(x) ** 2:  # a train of impacts is white, but not Gaussian
        return True
    options: dict[str, Any] = {"nperseg": min(128, len(x) // 8), "detrend": "linear"}
    power = signal.welch(x, **options)[1][1:-1]
    if np.exp(np.mean(np.log(power + 1e-300))) < 0.6 * np.mean(power):  # white 1, AR(1) noise of 0.6 0.64
        return True
    least = 0.05 + 3 * options["nperseg"] / len(x)
    drives = [u for u in drives if np.all(np.isfinite(u)) and np.ptp(u) > 0]
    return any(np.mean(signal.coherence(u, x, **options)[1][2:-1]) > least for u in drives)


def _runs(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First index and length of each run of equal samples."""
    starts = np.r_[0, np.flatnonzero(np.diff(x)) + 1]
    return starts, np.diff(np.r_[starts, len(x)])


def _grain(x: np.ndarray) -> tuple[float, float]:
    """Noise (standard deviation; 0 if 70 dB below the signal) and resolution of a channel.

    From eighth differences, which a signal below a tenth of the sampling rate hardly survives, where the channel does
    not rest, and in windows of 50: noise is there all the time, friction and impacts are not.
    """
    lengths = _runs(x)[1]
    moving = sliding_window_view(np.repeat(lengths < 5, lengths), 9).all(axis=1)
    jagged = np.abs(np.diff(x, 8))[moving]
    gaps = np.diff(np.unique(x))
    resolution = float(np.quantile(gaps[gaps > 1e-9 * np.ptp(x)], 0.1))
    if len(jagged) < 50:
        return 0.0, resolution
    windows = jagged[: len(jagged) // 50 * 50].reshape(-1, 50)
    noise = float(np.quantile(np.median(windows, axis=1), 0.05)) / (0.55 * math.sqrt(math.comb(16, 8)))
    return (noise if noise > 3e-4 * np.std(x) else 0.0), resolution


def _check_held(
    name: str, quantity: str, x: np.ndarray, time: np.ndarray, noise: float, resolution: float, is_input: bool
) -> list[Finding]:
    """Clipping, frozen sensors, dropouts and slow sampling: samples that are exactly equal.

    Where the channel has noise, many equal samples have no innocent cause. One without (an encoder, a command, a
    simulation) may well rest: only stopping dead in mid-motion is remarked on, and it is no error.
    """
    n, step = len(x), time[1] - time[0]
    starts, lengths = _runs(x)
    usual = int(np.bincount(lengths).argmax())
    stairs = usual > 1 and np.mean(lengths == usual) > 0.6 and len(np.unique(x)) > 20
    if stairs and np.median(np.abs(np.diff(x[starts]))) > 1.5 * resolution:  # else an encoder at constant speed
        text = f"holds each value for {usual} samples: sampled more slowly than the table"
        return [Finding("warning", name, text)]
    found = []
    clipped: list[float] = []
    ends = ((x.max(), "largest"), (x.min(), "smallest"))
    level: Level
    if noise > resolution:
        equal = max(np.sum(lengths[lengths < 5] - 1) / n, min(0.9, resolution / (2.5 * noise)), 1.0 / n)
        least = max(5, 1 + math.ceil(math.log(1e-4 / n) / math.log(equal)))  # n equal^(least - 1) < 1e-4
        for value, what in ends:
            count = np.sum(x == value)
            beside = (np.sum(np.abs(x - value) < noise) - count) * resolution / noise  # at a value next to it
            if count >= max(least, 5 + 10 * beside):
                text = f"is clipped: {count} samples sit exactly at the {what} value, {value:.6g}"
                found.append(Finding("error", name, text, _spans(x == value, time)))
                clipped.append(value)
        held = (lengths >= least) & ~np.isin(x[starts], clipped)
        severe = lengths[held].sum() > 0.01 * n or (held.any() and lengths[held].max() * step > 0.1)
        level = "error" if severe else "warning"
    else:
        into = np.abs(np.diff(x, prepend=x[0]))[starts]  # the last step, against the curvature just before it
        second = np.abs(np.diff(x, 2, prepend=[x[0], x[0]]))
        curved = np.array([np.median(second[max(s - 6, 0) : s]) if s else np.inf for s in starts])
        held = (lengths >= 5) & (into > 4 * (curved + resolution))
        level = "warning" if quantity == "displacement" and not is_input else "note"  # no mass stops dead
        for value, what in ends:
            if np.sum(held & (x[starts] == value)) > 1:
                text = f"stops dead at its {what} value, {value:.6g}, time and again: clipped?"
                found.append(Finding(level, name, text))
                clipped.append(value)
        held &= (lengths * step > 0.1) & ~np.isin(x[starts], clipped)
    if held.any():
        flags = np.repeat(held, lengths)
        where = _spans(flags, time)
        text = f"does not change for {flags.sum()} samples, first at t = {where[0][0]:.6g} s: frozen, dropped out?"
        found.append(Finding(level, name, text, where))
    return found


def _check_spikes(
    name: str, quantity: str, x: np.ndarray, time: np.ndarray, grain: float, is_command: bool
) -> list[Finding]:
    """One to three samples far off their neighbours on both sides; and a displacement that jumps.

    "Far": four times any step within ten samples on either side, twelve times the noise, and four times what 97 % of
    all steps stay below (friction makes an acceleration jump to and fro by as much as its other jumps, not more).
    """
    n, around = len(x), 10
    d = np.abs(np.diff(x))
    largest = sliding_window_view(d, around).max(axis=1)  # [i]: of d[i] ... d[i + 9]
    usual = float(np.quantile(d, 0.97))
    flags = np.zeros(n, bool)
    # a command may well be a short pulse, and so may a force or an acceleration: an impact
    for width in (1,) if is_command or quantity in ("force", "acceleration") else (1, 2, 3):
        s = np.arange(around + 1, n - width - around)
        local = np.maximum(largest[s - 1 - around], largest[s + width])
        before, after = x[s - 1], x[s + width]
        off = np.array([x[s + k] - before - (after - before) * (k + 1) / (width + 1) for k in range(width)])
        least = np.where(np.abs(np.sign(off).sum(axis=0)) == width, np.abs(off).min(axis=0), 0.0)
        back = np.abs(after - before) <= (width + 1) * local
        hit = s[back & (least > 4 * np.maximum(local, grain)) & (least > 4 * usual)]
        for k in range(width):
            flags[hit + k] = True
    found = []
    if flags.any():
        text = f"{flags.sum()} samples are spikes or dropouts, first at t = {time[np.argmax(flags)]:.6g} s"
        sure = (
            quantity in ("displacement", "velocity") and flags.mean() > 0.005
        )  # an impact is a spike as well
        level: Level = "error" if sure else "warning"
        found.append(Finding(level, name, text, _spans(flags, time)))
    if quantity == "displacement":
        s = np.arange(around, n - 1 - around)
        local = np.maximum(largest[s - around], largest[s + 1])
        at = s[(d[s] > 5 * np.maximum(local, grain)) & (local > 0)]  # a commanded step has rest on both sides
        if len(at):
            text = f"jumps by {d[at[0]]:.3g} m in one sample after t = {time[at[0]]:.6g} s: samples lost?"
            where = tuple((float(time[i]), float(time[i + 1])) for i in at[:20])
            found.append(Finding("error", name, text, where))
    return found


def _check_copies(values: dict[str, np.ndarray], chance: dict[str, float], time: np.ndarray) -> list[Finding]:
    """Columns that are the same, and samples that occur twice, which the channels with noise (those with a `chance`)
    cannot do by themselves."""
    found = []
    names = [n for n, x in values.items() if np.ptp(x) > 0]
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            if np.array_equal(values[first], values[second]):
                found.append(Finding("error", second, f"is the same column as '{first}'"))
    rows = np.column_stack([values[n] for n in chance] or [np.arange(len(time))])
    order = np.lexsort(rows.T)
    same = np.all(rows[order[1:]] == rows[order[:-1]], axis=1)
    shift, count = np.unique(np.abs(order[1:] - order[:-1])[same], return_counts=True)
    if len(chance) > 1 and len(shift):
        by = int(shift[count.argmax()])
        flags = np.zeros(len(rows), bool)
        flags[by:] = np.all(rows[by:] == rows[:-by], axis=1)
        twice = np.sum(
            np.all(rows[2 * by :] == rows[: -2 * by], axis=1)
        )  # a periodic simulation repeats on and on
        if flags.sum() >= max(5, 3 * twice, 10 * len(rows) * math.prod(chance.values())):
            where = _spans(flags, time)
            text = f"{flags.sum()} samples, first at t = {where[0][0]:.6g} s, repeat those {by * (time[1] - time[0]):.4g} s"
            found.append(Finding("error" if flags.sum() >= 20 else "warning", "", f"{text} earlier", where))
    return found
