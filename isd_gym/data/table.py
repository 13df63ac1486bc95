"""Tables of measured channels, read from and written to CSV, Parquet, MATLAB ``.mat`` and MDF ``.mf4`` files."""

from __future__ import annotations

import csv
import os
import re
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, MissingColumn, how_to_install, shown
from ..files import whole
from ..inputs import plain_file
from ..units import convert
from .columns import TIME_NAMES, Choice, Columns, did_you_mean, split_header
from .quality import TIME
from .text import read_text


def _vector(values: Any) -> np.ndarray:
    out = np.array(values, dtype=np.float64)
    out.flags.writeable = False
    return out


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
            raise MissingColumn(
                f"{self.source}: no column {shown(name)}; {did_you_mean(name, self.columns)}", name
            )
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
            f"{path}: reading {path.suffix} needs {error.name}: {how_to_install('io')}"
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
            raise InputError(f"{path}: no column {shown(name)} to rename; {did_you_mean(name, columns)}")
    columns = {rename.get(name, name): values for name, values in columns.items()}
    file_units = {rename.get(name, name): unit for name, unit in file_units.items()}
    file_units |= {rename.get(name, name): unit for name, unit in units.items()}
    if TIME not in columns:
        lower = {name.lower(): name for name in columns}
        other = next((lower[n] for n in TIME_NAMES if n in lower), None)
        if other is None:
            raise InputError(f"{path}: no column 'time'; {did_you_mean(TIME, columns)}")
        columns[TIME], file_units[TIME] = columns.pop(other), file_units.pop(other, "s")
    target = {TIME: "s"} | (dict(expected) if expected is not None else {})
    out: dict[str, np.ndarray] = {}
    for name in target if expected is not None else columns:
        if name not in columns:
            raise MissingColumn(
                f"{path}: no column {shown(inverse.get(name, name))}; {did_you_mean(name, columns)}", name
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
            raise InputError(f"{path}: no channel {shown(name)}; {did_you_mean(name, head['names'])}")
        columns: dict[str, Any] = {}
        units = dict(head["units"])
        told = [(name, values) for (name, _), values in zip(head["columns"], arrays, strict=True)]
        for full, values in told + [(name, _NO_NUMBERS) for name in head["other"]]:
            name, unit = split_header(full) if kind == "parquet" else (full, "")
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
    ".csv": read_text,
    ".txt": read_text,
    ".tsv": read_text,
    ".dat": read_text,
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
        raise InputError(f"{path}: writing {suffix} needs {error.name}: {how_to_install('io')}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or _one_line(error)})") from None
