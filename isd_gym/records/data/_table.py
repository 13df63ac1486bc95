"""Tables of measured channels: read from text, Excel, Parquet, MATLAB, MDF and TDMS files; written."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError, MissingColumn, how_to_install, shown
from ..._common.files import whole
from ..._common.inputs import plain_file
from ..._common.units import convert
from ._columns import (
    TIME,
    Choice,
    Columns,
    column_for,
    did_you_mean,
    distinct,
    split_header,
    stamps_of,
    time_unit,
)
from ._signals import even_stamps, stamp_rounding
from ._text import read_text, read_text_rasters
from ._writing import write_binary

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    Reader = Callable[[Path, Choice, str, Sequence[str] | None], Columns]


def _vector(values: Any) -> np.ndarray:
    out = np.array(values, dtype=np.float64)
    out.flags.writeable = False
    return out


@dataclass(frozen=True)
class Table:
    """Channels over a common time. Arrays are copied and read-only.

    Raises:
        InputError: Lengths differ.
    """

    time: np.ndarray  # time stamps (n,) [s]
    columns: dict[str, np.ndarray]  # samples (n,) by channel, in the unit of `units`
    source: str = "table"  # origin, for messages
    #: unit by channel; a channel without a unit has the SI unit of its quantity
    units: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", _vector(self.time))
        object.__setattr__(
            self, "columns", {k: _vector(v) for k, v in self.columns.items()}
        )
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
        """Return a column (n,)."""
        if name not in self.columns:
            raise MissingColumn(
                f"{self.source}: no column {shown(name)}; {did_you_mean(name, self.columns)}",
                name,
            )
        return self.columns[name]

    @property
    def step(self) -> float:
        """Mean sampling step [s]; for rounded stamps the slope of the fitted line."""
        return float((self._ends[1] - self._ends[0]) / (len(self) - 1))

    @property
    def _ends(self) -> tuple[float, float]:
        """First and last instant [s] of the uniform sampling."""
        if len(self) < 2:
            raise InputError(f"{self.source}: {len(self)} samples have no time step")
        time = even_stamps(self.time) if stamp_rounding(self.time) else self.time
        return float(time[0]), float(time[-1])

    def uniform(self) -> Table:
        """Return the same samples on exactly uniform stamps, without jitter and rounding."""
        time = self._ends[0] + self.step * np.arange(len(self))
        return Table(time, self.columns, self.source, self.units)


# ---------------------------------------------------------------------------------------------------- reading
def read_columns(
    path: str | Path,
    wanted: Choice = None,
    *,
    axis: str = TIME,
    columns: Sequence[str] | None = None,
) -> Columns:
    """Read the wanted columns of a table file, or all with None.

    All tables of the project are read here. Separators, decimal commas, preambles and units in a text file
    are detected. `read_table` adds a time base and channel names. `axis` is the time column of MATLAB files; `columns` names all columns of a text file
    without a header row.
    """
    path = Path(path)
    kind = format_of(path)
    if os.path.isdir(path):
        raise InputError(f"{path}: is a folder, not a table")
    plain_file(path)
    try:
        return kind.read(path, wanted, axis, columns)
    except InputError:
        raise
    except ImportError as error:
        raise InputError(
            f"{path}: reading {path.suffix} needs {error.name or error}: {how_to_install('io')}"
        ) from None
    except Exception as error:  # any error of a reader is a fault of the file
        raise InputError(f"{path}: cannot be read ({_one_line(error)})") from None


def read_rasters(
    path: str | Path, columns: Sequence[str] | None = None
) -> list[Columns]:
    """Return the content of a file, one entry per raster.

    The groups of an MDF or TDMS file have their own time stamps, named 'time' [s], and so have tables side by
    side in a text file (`_columns.side_by_side`). Other formats have one raster.
    """
    path = Path(path)
    kind = format_of(path)
    if kind.read_rasters is None:
        return [read_columns(path, columns=columns)]
    plain_file(path)
    return kind.read_rasters(path, columns)


def read_table(
    path: str | Path,
    *,
    rename: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    expected: Mapping[str, str] | None = None,
    header: Sequence[str] | None = None,
    signs: Mapping[str, int] | None = None,
) -> Table:
    """Read a table of channels over time from a file.

    The suffix gives the format: .csv .txt .tsv .dat .xlsx .parquet .mat .mf4 .mdf .tdms. No content of a file is executed. Among columns that differ only by their unit, such as "Force (V)" and "Force (N)", the name
    "Force" means the column whose unit fits the channel.

    Args:
        path: The file.
        rename: Column in the file -> channel.
        units: Unit by channel or by column; has priority over the unit in the file. Time is in 's' by
            default.
        expected: Channel -> wanted unit. Exactly these channels are returned, converted; a column without a
            unit is assumed to have the wanted unit. None for all numeric columns, unconverted.
        header: Names of all columns of a text file without a header row, with or without units.
        signs: Factor 1 or -1 by channel or by column; -1 for a sensor that is turned round.

    Returns:
        Time stamps [s] and channels.

    Raises:
        InputError: The file cannot be read, has no time, or holds a unit that cannot be converted.
        MissingColumn: A wanted channel is missing.
    """
    path = Path(path)
    rename = dict(rename or {})
    units = dict(units or {})
    inverse = {channel: name for name, channel in rename.items()}
    if len(inverse) < len(rename):
        raise InputError(f"{path}: two columns are renamed to one channel")
    wanted = None if expected is None else [inverse.get(c, c) for c in expected]
    found = read_columns(path, wanted, axis=inverse.get(TIME, TIME), columns=header)
    columns, file_units = _as_channels(path, found, rename, units, expected)
    _find_time(path, columns, file_units)
    target = {TIME: "s"} | dict(expected or {})
    out: dict[str, np.ndarray] = {}
    for name in columns if expected is None else target:
        if name not in columns:
            raise MissingColumn(
                f"{path}: no column {shown(inverse.get(name, name))}; {did_you_mean(name, columns)}",
                name,
            )
        values = np.asarray(columns[name])
        if values.dtype.kind in "fiub" and values.ndim == 1:
            out[name] = _converted(
                path, name, values, file_units.get(name), target.get(name)
            )
        elif expected is not None or name == TIME:
            raise InputError(
                f"{path}: column {shown(name)} does not hold plain numbers"
            )
    time = out.pop(TIME)
    if len(time) == 0:
        raise InputError(f"{path}: no samples")
    signs = signs or {}
    for name in out:
        sign = signs.get(name) or signs.get(inverse.get(name, name)) or 1
        if sign < 0:
            out[name] = -np.asarray(out[name], float)
    kept = file_units if expected is None else target
    return Table(
        time, out, str(path), {n: u for n, u in kept.items() if n in out and u}
    )


def _as_channels(
    path: Path,
    found: Columns,
    rename: dict[str, str],
    units: Mapping[str, str],
    expected: Mapping[str, str] | None,
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the columns of a file and their units by channel; columns with text among the numbers are left out."""
    columns = {n: x for n, x in found.values.items() if n not in found.texts}
    try:
        rename = _by_unit(rename, columns, units, expected)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    for name in rename if expected is None else ():
        if name not in columns:
            raise InputError(
                f"{path}: no column {shown(name)} to rename; {did_you_mean(name, columns)}"
            )
    stated = [*found.units.items(), *units.items()]
    renamed_units = {rename.get(name, name): unit for name, unit in stated}
    return {
        rename.get(name, name): values for name, values in columns.items()
    }, renamed_units


def _find_time(path: Path, columns: dict[str, Any], units: dict[str, str]) -> None:
    """Rename the column of time stamps to `TIME` where no column of that name holds stamps."""
    is_short = len(columns.get(TIME, ())) < 2
    is_alone = TIME in columns and not any(len(x) > 1 for x in columns.values())
    if not is_short or is_alone:
        return
    columns.pop(TIME, None)  # a single number is a setting
    other = stamps_of(columns, path, by_name=True)
    columns[TIME] = columns.pop(other)
    units.setdefault(TIME, units.pop(other, time_unit(other)))


def _converted(
    path: Path, name: str, values: np.ndarray, unit: str | None, target: str | None
) -> np.ndarray:
    """Return a column in the unit `target`; unchanged where no unit is wanted."""
    if target is None:
        return values
    try:
        return convert(values.astype(float), unit or target, target)
    except InputError as error:
        raise InputError(f"{path}: column {shown(name)}: {error}") from None


def _by_unit(
    rename: dict[str, str],
    columns: Mapping[str, Any],
    units: Mapping[str, str],
    expected: Mapping[str, str] | None,
) -> dict[str, str]:
    """Return `rename` (column -> channel) with the full names of columns that differ only by their units; `expected` is the wanted unit
    by channel, None for all columns unconverted.
    """
    if expected is None:
        return {column_for(name, columns): channel for name, channel in rename.items()}
    inverse = {channel: name for name, channel in rename.items()}
    for channel, unit in {TIME: "s", **expected}.items():
        source = inverse.get(channel, channel)
        column = column_for(
            source, columns, units.get(channel) or units.get(source) or unit
        )
        if column != source:
            rename = {n: c for n, c in rename.items() if n != source} | {
                column: channel
            }
    return rename


def _one_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:160]


# ---------------------------------------------------------------------------------------------------- formats


@dataclass(frozen=True)
class Format:
    """How files of a format are read."""

    #: reader of wanted columns: path, wanted names, time column, names for a file without a header
    read: Reader
    #: reader of all rasters: path, names for a file without a header; None for a format with one raster
    read_rasters: Callable[[Path, Sequence[str] | None], list[Columns]] | None = None
    has_own_stamps: bool = False  # whether channels may have time stamps of their own


def _stamped_format(reader: str) -> Format:
    """Return a format whose channels may have time stamps of their own; the reader runs in a separate process."""

    def read(
        path: Path, wanted: Choice, axis: str, columns: Sequence[str] | None = None
    ) -> Columns:
        return _only_raster(path, read_rasters(path), wanted)

    def read_rasters(path: Path, columns: Sequence[str] | None = None) -> list[Columns]:
        return _read_binary_rasters(reader, path)

    return Format(read, read_rasters, has_own_stamps=True)


def _only_raster(path: Path, rasters: list[Columns], wanted: Choice) -> Columns:
    """Return the raster with the wanted columns; raise `InputError` where they have different stamps."""
    names = [name for raster in rasters for name in raster.values]
    if callable(wanted):
        wanted = wanted(names)
    for name in wanted or ():
        if name not in names:
            raise InputError(
                f"{path}: no channel {shown(name)}; {did_you_mean(name, names)}"
            )
    found = [
        raster
        for raster in rasters
        if wanted is None or set(wanted) & set(raster.values) - {TIME}
    ]
    if len(found) > 1:
        counts = ", ".join(
            str(len(next(iter(raster.values.values())))) for raster in found[:20]
        )
        raise InputError(
            f"{path}: channels are on different rasters of {counts} samples: simulate and diagnose read such a file as it is"
        )
    return (found or rasters)[0]


def _binary_format(reader: str) -> Format:
    """Return a format whose reader runs in a separate process."""

    def read(
        path: Path, wanted: Choice, axis: str, columns: Sequence[str] | None = None
    ) -> Columns:
        return _read_binary(reader, path, wanted, axis)

    return Format(read)


def _read_binary(reader: str, path: Path, wanted: Choice, axis: str) -> Columns:
    from . import _isolated as isolated

    given = None if callable(wanted) else wanted
    head, arrays = isolated.read(reader, path, given, axis)
    out: dict[str, Any] = {}
    units = dict(head["units"])
    told = [
        (name, values)
        for (name, _), values in zip(head["columns"], arrays, strict=True)
    ]
    told += [(name, _NO_NUMBERS) for name in head["other"]]
    full = [name for name, _ in told]
    pairs = [split_header(name) if reader == _PARQUET else (name, "") for name in full]
    names = distinct([n for n, _ in pairs], full, [units.get(n, "") for n in full])
    for (header, values), name, (_, unit) in zip(told, names, pairs, strict=True):
        if name in out and values is not _NO_NUMBERS:
            raise InputError(f"{path}: names {shown(name)} twice")
        out.setdefault(name, values)
        if header in units:
            units[name] = units[header]
        elif unit:
            units[name] = unit
    if callable(wanted):
        wanted(list(out))
    return Columns(out, units)


def _read_binary_rasters(reader: str, path: Path) -> list[Columns]:
    """Return the rasters of a binary file, each with time stamps of its own; tables without stamps are rasters too."""
    from . import _isolated as isolated

    head, arrays = isolated.read(reader, path)
    rasters: dict[str, Columns] = {}
    for (full, _), values in zip(head["columns"], arrays, strict=True):
        number, _, name = full.partition(" ")
        raster = rasters.setdefault(number, Columns({}, {}))
        if not name:
            raster.values[TIME], raster.units[TIME] = values, "s"
            continue
        raster.values[name] = values
        if name in head["units"]:
            rasters[number].units[name] = head["units"][name]
    return list(rasters.values())


def _read_mat(
    path: Path, wanted: Choice, axis: str, columns: Sequence[str] | None = None
) -> Columns:
    """Read a MATLAB file; version 7.3 is another format."""
    with path.open("rb") as stream:
        head = stream.read(10)
    reader = "mat73" if head == b"MATLAB 7.3" else "mat"
    return _read_binary(f"{_PACKAGE}.{reader}", path, wanted, axis)


_NO_NUMBERS = np.empty(0, object)
_PACKAGE = "isd_gym.records._formats"
_PARQUET = f"{_PACKAGE}.parquet"
_TEXT = Format(read_text, read_text_rasters)
_MDF = _stamped_format(f"{_PACKAGE}.mdf")


def _sheet(path: Path) -> str:
    """Return the text of the first sheet with numbers of a workbook."""
    from . import _isolated as isolated

    return str(isolated.read(f"{_PACKAGE}.xlsx", path)[0]["text"])


def _read_workbook(
    path: Path, wanted: Choice, axis: str, columns: Sequence[str] | None = None
) -> Columns:
    return read_text(path, wanted, axis, columns, _sheet(path))


def _read_workbook_rasters(
    path: Path, columns: Sequence[str] | None = None
) -> list[Columns]:
    return read_text_rasters(path, columns, _sheet(path))


#: formats by suffix
_FORMATS = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat"), _TEXT),
    ".parquet": _binary_format(_PARQUET),
    ".mat": Format(_read_mat),
    ".mf4": _MDF,
    ".mdf": _MDF,
    ".tdms": _stamped_format(f"{_PACKAGE}.tdms"),
    ".xlsx": Format(_read_workbook, _read_workbook_rasters),
}


def suffixes() -> tuple[str, ...]:
    """Return the suffixes of all files that can be read, in small letters, such as '.csv'."""
    return tuple(_FORMATS)


def format_of(path: Path) -> Format:
    """Return the format of a file by its suffix."""
    found = _FORMATS.get(path.suffix.lower())
    if found is None:
        known = " ".join(_FORMATS)
        raise InputError(
            f"{path}: cannot tell the format from suffix {shown(path.suffix)} (known: {known})"
        )
    return found


# ---------------------------------------------------------------------------------------------------- writing
def write_table(path: str | Path, table: Table) -> None:
    """Write a table atomically in the format of the suffix (.csv .txt .tsv .parquet .mat .mf4).

    Numbers are exact. Parquet, .mat and .mf4 files carry the units; a CSV file has bare channel names as
    header.

    Args:
        path: File to write.
        table: Channels over time.

    Raises:
        InputError: The suffix is unknown, a name is impossible in the format, or the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    is_text = suffix in (".csv", ".txt", ".tsv")
    if not is_text and suffix not in (".parquet", ".mat", ".mf4"):
        raise InputError(
            f"{path}: cannot write suffix '{path.suffix}' (known: .csv .txt .tsv .parquet .mat .mf4)"
        )
    try:
        with whole(path) as temporary:
            if not is_text:
                write_binary(table, temporary, path)
                return
            with temporary.open("w", newline="", encoding="utf-8") as stream:
                writer = csv.writer(
                    stream,
                    delimiter="\t" if suffix == ".tsv" else ",",
                    lineterminator="\n",
                )
                writer.writerow([TIME, *table.columns])
                data = (table.time, *table.columns.values())
                writer.writerows(
                    zip(*(column.tolist() for column in data), strict=True)
                )
    except ImportError as error:
        raise InputError(
            f"{path}: writing {suffix} needs {error.name or error}: {how_to_install('io')}"
        ) from None
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror or _one_line(error)})"
        ) from None
