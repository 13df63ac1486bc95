"""Map from the columns of loggers' files to the channels of a model: the file of `isd-gym inspect --out` (`isd-map/1`).

    {"schema": "isd-map/1", "model": "car.json",
     "loggers": [{"file": "body.csv", "stamps": {"column": "Zeit", "unit": "ms"}}, {"file": "wheel.mf4",
     "lag": 0.004}],
     "channels": {"body_acceleration": {"logger": 1, "column": "az_body", "unit": "g", "sign": -1, "sure":
     0.97}}}

`logger` counts from 1, in the order of a run's files (``body.csv+wheel.mf4``). `lag` [s] is the known delay
of a logger's time stamps; an unknown delay is fitted. `sure` and `why` are for people.
"""

from __future__ import annotations

from collections.abc import Mapping as Dict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..._common.errors import InputError, hint, plain, shown
from ..._common.inputs import read_json
from ..._common.units import convert
from ...physics.network import Channel, Network, without
from ..data._columns import column_for, did_you_mean
from ..schemas import check
from .recording import (
    EPOCH,
    Raster,
    Recording,
    Signal,
    continuous,
    mended,
    rasters,
    spans,
)

SCHEMA = "isd-map/1"
JOIN = "+"  # separator between the files of a run


@dataclass(frozen=True)
class Column:
    """Column of a channel."""

    column: str  # name of the column
    logger: int = 1  # number of the logger, from 1
    unit: str | None = None  # unit of the column; None for the unit in the file
    sign: int = 1  # factor 1 or -1
    sure: float | None = None  # probability of the match, from 0 to 1; None if unknown
    why: str = ""  # reasons for the match


@dataclass(frozen=True)
class Logger:
    """A logger."""

    file: str = ""  # name of its file, for people
    stamp: str | None = None  # column of the time stamps; None to detect the column
    # unit of the time stamps; None for the unit in the file, otherwise s
    unit: str | None = None
    lag: float | None = None  # delay of the time stamps [s]; None if unknown
    columns: tuple[str, ...] = ()  # names of the columns of a file without a header row
    #: sampling rate of a file without time stamps [Hz]; None for a file with time stamps
    rate: float | None = None


@dataclass(frozen=True)
class ChannelMap:
    """Columns of the channels of a model, as `isd-gym inspect` suggests and `--map` reads."""

    channels: Dict[str, Column]  # column by channel
    loggers: tuple[Logger, ...] = ()  # loggers, in the order of a run's files
    model: str = ""  # file of the model
    source: str = "the map"  # file of the map, for messages

    @classmethod
    def load(cls, path: str | Path) -> ChannelMap:
        """Read a map file."""
        return cls.from_dict(read_json(path), str(path))

    @classmethod
    def from_dict(cls, data: Any, source: str = "the map") -> ChannelMap:
        """Return a map from the content of a map file."""
        check(data, SCHEMA, source)
        loggers = []
        for row in data.get("loggers", ()):
            stamps = row.get("stamps", {})
            lag = row.get("lag")
            loggers.append(
                Logger(
                    row.get("file", ""),
                    stamps.get("column"),
                    stamps.get("unit"),
                    None if lag is None else float(lag),
                    tuple(row.get("columns", ())),
                    stamps.get("rate"),
                )
            )
        channels = {}
        for name, row in data["channels"].items():
            unit = row.get("unit")
            if unit:
                try:
                    convert(1.0, unit, unit)
                except InputError as error:
                    raise InputError(
                        f"{source}: channel {shown(name)}: {error}"
                    ) from None
            number = int(row.get("logger", 1))
            sign = int(row.get("sign", 1))
            channels[name] = Column(
                row["column"], number, unit, sign, row.get("sure"), row.get("why", "")
            )
        return cls(channels, tuple(loggers), data.get("model", ""), source)

    def check(self, network: Network) -> None:
        """Check that the model has all channels of the map."""
        known = [c.name for c in (*network.inputs, *network.outputs)]
        for name in self.channels:
            if name not in known:
                raise InputError(
                    f"{self.source}: the model has no channel {shown(name)}; {hint(name, known)}"
                )

    def measured(self, network: Network) -> Network:
        """Return the model with only the outputs that the map has columns for."""
        self.check(network)
        found = network.with_outputs(self.channels)
        if not found.outputs:
            raise InputError(
                f"{self.source}: no output of the model has a column ({', '.join(c.name for c in network.outputs)})"
            )
        return found


# ------------------------------------------------------------------------------------------------ a run's files


def files_of(text: str | Path) -> list[Path]:
    """Return the files of one run."""
    whole = Path(text)
    if JOIN not in str(text) or whole.exists():
        return [whole]
    out = [Path(p) for p in str(text).split(JOIN) if p]
    if len({p.resolve() for p in out}) < len(out):
        raise InputError(f"{text}: a file is named twice")
    return out


@dataclass(frozen=True)
class _Named:
    """Columns of channels without a map."""

    # column by channel, for columns with another name than the channel
    columns: Dict[str, str]
    units: Dict[str, str]  # unit by channel or by column
    signs: Dict[str, int]  # factor 1 or -1 by channel or by column


def runs(
    text: str | Path,
    network: Network,
    wanted: Sequence[Channel],
    *,
    by: ChannelMap | None = None,
    rename: Dict[str, str] | None = None,
    units: Dict[str, str] | None = None,
    columns: Sequence[str] | None = None,
    rate: float | None = None,
    signs: Dict[str, int] | None = None,
) -> list[Recording]:
    """Return the records of one or several loggers' files, split at gaps in the time stamps.

    A file with tables side by side, each with all wanted channels, holds several runs. Otherwise the files hold one. Columns of
    channels are those of the map `by`, or have the names of the channels, apart from `rename` (column -> channel). `units` and
    `signs` are by channel or by column; `columns` and `rate` [Hz] serve files without a header row or time stamps.
    """
    files = files_of(text)
    loggers = by.loggers if by else ()
    found: list[list[Raster]] = []
    renamed = {c: n for n, c in (rename or {}).items()}
    for i, file in enumerate(files):
        own = loggers[i] if i < len(loggers) else Logger(stamp=renamed.get("time"))
        there = own.stamp if by is None or i < len(loggers) else None
        found.append(
            rasters(
                file,
                stamp=there,
                unit=own.unit or (units or {}).get("time"),
                units=units,
                columns=own.columns or columns,
                rate=own.rate or rate,
            )
        )
    name = JOIN.join(f.stem for f in files)
    source = (
        {c.name: by.channels[c.name].column for c in wanted if c.name in by.channels}
        if by
        else renamed
    )
    columns_of = {c.name: source.get(c.name, c.name) for c in wanted}
    named = _Named(renamed, units or {}, signs or {})
    tables = found[0] if len(files) == 1 else []
    if len(tables) < 2 or not all(
        n in r.columns for r in tables for n in columns_of.values()
    ):
        return _run(str(text), name, files, found, network, wanted, by, named)
    out = []
    for k, table in enumerate(tables, 1):
        out += _run(
            str(text), f"{name} ({k})", files, [[table]], network, wanted, by, named
        )
    return out


def _run(
    text: str,
    name: str,
    files: Sequence[Path],
    found: list[list[Raster]],
    network: Network,
    wanted: Sequence[Channel],
    by: ChannelMap | None,
    named: _Named,
) -> list[Recording]:
    """Return the pieces of one run, in order of time, from the rasters `found` in each file."""
    notes: list[str] = []
    _common_origin(found, notes)
    if by is None:
        by = _by_name(wanted, files, found, named)
    else:
        by.check(network)
        _check_columns(by, wanted, network)
    place = {c.name: _find(c, network, by, files, found) for c in wanted}
    cut = _used_pieces(place, by, found, notes)
    whole = spans(
        [
            [(float(p.time[0]), float(p.time[-1])) for p in pieces]
            for pieces in cut.values()
        ]
    )
    if not whole:
        stretches = [
            f"{p[0].name} {p[0].time[0]:.6g} to {p[-1].time[-1]:.6g} s"
            for p in cut.values()
        ]
        raise InputError(
            f"{text}: the loggers have no time in common ({'; '.join(stretches)})"
        )
    lags = {
        _clock(i, file): logger.lag
        for i, (file, logger) in enumerate(zip(files, by.loggers, strict=False))
        if logger.lag is not None
    }
    out = []
    for k, (start, stop) in enumerate(whole, 1):
        signals: dict[str, Signal] = {}
        for channel in wanted:
            column, at = place[channel.name]
            piece = _piece_of(cut[at], start, stop)
            if piece is None:
                break
            clock = _clock(at[0], files[at[0]])
            signal = _signal(
                channel, by.channels[channel.name], piece, column, clock, notes
            )
            margin = 2 * piece.step
            signals[channel.name] = signal.within(start - margin, stop + margin)
        if len(signals) == len(wanted):
            title = name if len(whole) == 1 else f"{name} [{k}]"
            out.append(Recording(title, signals, lags, tuple(notes)))
    long = [r for r in out if min(len(s.time) for s in r.signals.values()) >= 32]
    if not long:
        raise InputError(
            f"{text}: no piece of the run is long enough: {'; '.join(notes) or 'too few samples'}"
        )
    return long


def _clock(index: int, file: Path) -> str:
    """Return the name of the clock of a logger."""
    return f"{index + 1} {plain(file.name, 40)}"


def _check_columns(by: ChannelMap, wanted: Sequence[Channel], network: Network) -> None:
    """Raise `InputError` for a wanted channel without a column in the map."""
    lost = [c.name for c in wanted if c.name not in by.channels]
    if not lost:
        return
    kind = "the input " if lost[0] in {c.name for c in network.inputs} else ""
    raise InputError(
        f"{by.source}: no column for {kind}{', '.join(lost)}{without(network, lost[0])}"
    )


def _used_pieces(
    place: Dict[str, tuple[str, tuple[int, int]]],
    by: ChannelMap,
    found: list[list[Raster]],
    notes: list[str],
) -> dict[tuple[int, int], list[Raster]]:
    """Return the pieces between gaps of each raster that holds a channel, by (file, raster)."""
    columns: dict[tuple[int, int], list[str]] = {}
    for name, (_, at) in place.items():
        columns.setdefault(at, []).append(by.channels[name].column)
    cut = {}
    for (i, k), used in columns.items():
        raster = found[i][k]
        for name in used:
            if name in raster.texts:
                raise InputError(
                    f"{raster.source}: column {shown(name)}, {raster.texts[name]}"
                )
        thin = replace(raster, columns={c: raster.columns[c] for c in used})
        cut[i, k] = mended(thin, notes)
    return cut


def _piece_of(pieces: Sequence[Raster], start: float, stop: float) -> Raster | None:
    """Return the piece that covers an interval of time [s]; None without one."""
    for piece in pieces:
        if piece.time[0] <= start + 1e-9 and piece.time[-1] >= stop - 1e-9:
            return piece
    return None


def _signal(
    channel: Channel,
    source: Column,
    piece: Raster,
    column: str,
    clock: str,
    notes: list[str],
) -> Signal:
    """Return a column as the signal of a channel, in SI units and with its sign."""
    unit = source.unit or piece.units.get(column) or channel.unit
    try:
        factor = convert(1.0, unit, channel.si)
    except InputError as error:
        raise InputError(
            f"{piece.source}: column {shown(column)} as {channel.name}: {error}"
        ) from None
    values, note = continuous(
        channel.name, source.sign * factor * piece.columns[column], channel.si
    )
    told = f"{piece.name}: {note}"
    if note and told not in notes:
        notes.append(told)
    return Signal(piece.time, values, channel.si, clock, column)


def _common_origin(found: list[list[Raster]], notes: list[str]) -> None:
    """Count absolute stamps from the earliest stamp, and relative stamps of a logger from the logger's first stamp."""
    starts = [min(r.time[0] for r in group) for group in found]
    absolute = [bool(s > EPOCH) for s in starts]
    first = min((s for s, a in zip(starts, absolute, strict=True) if a), default=0.0)
    for group, start, own in zip(found, starts, absolute, strict=True):
        origin = first if own else start if any(absolute) else 0.0
        if any(absolute) and not own:
            notes.append(
                f"{group[0].name}: its stamps are not absolute; taken to begin with the other logger's"
            )
        if origin:
            group[:] = [replace(r, time=r.time - origin) for r in group]


def _by_name(
    wanted: Sequence[Channel],
    files: Sequence[Path],
    found: Sequence[Sequence[Raster]],
    named: _Named,
) -> ChannelMap:
    """Return the map of columns with the names of channels."""
    units, signs = named.units, named.signs
    channels = {}
    for c in wanted:
        column = named.columns.get(c.name, c.name)
        unit = units.get(c.name) or units.get(column) or c.unit
        full = [
            {n for r in g if (n := column_for(column, r.columns, unit)) in r.columns}
            for g in found
        ]
        column = next((n for names in full for n in names), column)
        holders = [i for i, names in enumerate(full, 1) if names]
        if len(holders) > 1:
            names = " and ".join(str(files[i - 1]) for i in holders)
            raise InputError(
                f"column {shown(column)} is in {names}: choose one with --map FILE"
            )
        channels[c.name] = Column(
            column,
            (holders or [1])[0],
            units.get(c.name) or units.get(column),
            signs.get(c.name) or signs.get(column) or 1,
        )
    return ChannelMap(channels, source="by name")


def _find(
    channel: Channel,
    network: Network,
    by: ChannelMap,
    files: Sequence[Path],
    found: Sequence[Sequence[Raster]],
) -> tuple[str, tuple[int, int]]:
    """Return (column, (file, raster)) of a channel: in the logger that the map names, or in the only logger with the column."""
    source = by.channels[channel.name]
    holders = [
        (i, k)
        for i, group in enumerate(found)
        for k, r in enumerate(group)
        if source.column in r.columns
    ]
    own = [at for at in holders if at[0] == source.logger - 1]
    if own or len(holders) == 1:
        return source.column, (own or holders)[0]
    names = [n for group in found for r in group for n in r.columns]
    told = JOIN.join(map(str, files))
    helps = did_you_mean(source.column, names)
    if by.source == "by name":
        raise InputError(
            f"{told}: no column {shown(source.column)}; {helps} (name the column with --map FILE or --rename COLUMN={channel.name}; "
            f"isd-gym inspect suggests a map){without(network, channel.name)}"
        )
    if source.logger > len(files):
        raise InputError(
            f"{told}: {by.source} has {channel.name} in logger {source.logger}; name the files of one run together, as in "
            f"FIRST.csv{JOIN}SECOND.csv"
        )
    raise InputError(
        f"{told}: no column {shown(source.column)}, which {by.source} names for {channel.name}; {helps} "
        f"(isd-gym inspect makes a map){without(network, channel.name)}"
    )
