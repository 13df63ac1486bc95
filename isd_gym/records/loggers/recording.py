"""Records in the form that loggers write: every channel on separate time stamps, from one or several files.

A `Raster` holds the columns of a file on one row of stamps; `mended` removes repeats, splits at gaps, and
reports both. A `Recording` is a run: the channels of a model, each a `Signal` with its stamps and clock.
Nothing is resampled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline

from ..._common.errors import InputError, plain, shown
from ..._common.units import convert
from ..data import Table
from ..data._columns import Columns, stamps_of, time_unit
from ..data._signals import even_stamps, stamp_rounding, unwrapped
from ..data._table import read_rasters

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


EPOCH = 1e8  # later stamps are absolute and count from 1970 [s]
LEAST = 200  # smallest number of samples between two gaps; shorter pieces are omitted
GAP = 1.7  # smallest gap, in steps
UNEVEN = 0.1  # largest deviation of stamps from a uniform grid, in steps


@dataclass(frozen=True)
class Raster:
    """Columns of a file on one row of time stamps."""

    source: str  # the file
    time: np.ndarray  # time stamps (n,) [s]
    columns: Mapping[str, np.ndarray]  # samples (n,) by column
    # unit by column, for columns with a unit
    units: Mapping[str, str] = field(default_factory=dict)
    stamp: str = "time"  # name of the column of time stamps
    # first text among the numbers (NaN there), by column
    texts: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time)

    @cached_property
    def step(self) -> float:
        """Median step [s]; for rounded stamps the mean step."""
        if stamp_rounding(self.time):
            return float(np.diff(even_stamps(self.time)).mean())
        d = np.diff(self.time)
        return float(np.median(d[d > 0])) if (d > 0).any() else math.nan

    @property
    def rate(self) -> float:
        """Mean rate [Hz] without gaps; NaN without a step."""
        d = np.diff(self.time)
        whole = d[(d > 0) & (d < 1.5 * self.step)]
        if not len(whole):
            return math.nan
        return 1.0 / (self.step if stamp_rounding(self.time) else float(whole.mean()))

    @property
    def name(self) -> str:
        """Name of the file."""
        return plain(Path(self.source).name, 60)

    def rows(self, keep: np.ndarray | slice) -> Raster:
        """Return the raster with a selection of its samples: a mask (n,) or a slice."""
        return replace(
            self,
            time=self.time[keep],
            columns={k: v[keep] for k, v in self.columns.items()},
        )


def rasters(
    path: str | Path,
    *,
    stamp: str | None = None,
    unit: str | None = None,
    units: Mapping[str, str] | None = None,
    columns: Sequence[str] | None = None,
    rate: float | None = None,
) -> list[Raster]:
    """Return all rasters of a file, with time stamps in seconds; absolute stamps stay absolute (since 1970).

    `stamp` is the column of the time stamps (None to detect it) and `unit` their unit (None for that in the file or in the name,
    otherwise s). `columns` and `rate` [Hz] serve files without a header row or time stamps. A raster without stamps has the name ''
    for its column of stamps.
    """
    out = []
    for found in read_rasters(path, columns):
        if rate is not None:
            name, time = "", _regular(found, rate)
        else:
            name = stamps_of(found.values, path, stamp)
            told = (
                unit
                or (units or {}).get(name)
                or found.units.get(name)
                or time_unit(name)
            )
            try:
                time = convert(np.asarray(found.values[name], float), told, "s")
            except InputError as error:
                raise InputError(f"{path}: column {shown(name)}: {error}") from None
        values = {
            n: np.asarray(v, float)
            for n, v in found.values.items()
            if n != name
            and v.dtype.kind in "fiub"
            and v.ndim == 1
            and len(v) == len(time)
        }
        if len(time) == 0:
            raise InputError(f"{path}: no samples")
        out.append(
            Raster(
                str(path),
                time,
                values,
                {n: u for n, u in found.units.items() if n in values},
                name,
                found.texts,
            )
        )
    return out


def _regular(found: Columns, rate: float) -> np.ndarray:
    """Return stamps at a sampling rate [Hz], for the most frequent number of samples of the columns."""
    if not 1e-6 <= rate <= 1e9:
        raise InputError(
            f"--rate must be a sampling rate in Hz from 1e-6 to 1e9, not {rate:g}"
        )
    lengths = [
        len(v) for v in found.values.values() if v.ndim == 1 and v.dtype.kind in "fiub"
    ]
    return np.arange(max(lengths, key=lengths.count, default=0)) / rate


# ------------------------------------------------------------------------------------------------ stamps


def mended(raster: Raster, notes: list[str]) -> list[Raster]:
    """Return the pieces of a raster between gaps, without repeated samples."""
    where = raster.name
    good = np.isfinite(raster.time)
    if not good.all():
        notes.append(
            f"{where}: {(~good).sum()} samples without a stamp left out, first sample {int(np.argmin(good)) + 1}"
        )
        raster = raster.rows(good)
    if len(raster) < 3:
        return [raster]
    if rounding := stamp_rounding(raster.time):
        raster = replace(raster, time=even_stamps(raster.time))
        notes.append(f"{where}: {rounded(rounding, raster.step)}")
    d = np.diff(raster.time)
    if (d < 0).any():
        k = int(np.argmax(d < 0))
        raise InputError(
            f"{raster.source}: stamps run backwards after sample {k + 1}, from {_at(raster.time[k])} to {_at(raster.time[k + 1])}: "
            "overlapping or reversed pieces; cut the file there and give the pieces as separate records"
        )
    if (d == 0).any():
        raster = _without_repeats(raster, notes)
    return _split(_measured(raster, notes), notes)


def _measured(raster: Raster, notes: list[str]) -> Raster:
    """Return the samples at which every column has a number; a stretch without numbers becomes a gap in time."""
    bad = {name: ~np.isfinite(x) for name, x in raster.columns.items()}
    for name, flags in bad.items():
        if flags.all():
            raise InputError(f"{raster.source}: column {shown(name)} holds no number")
    missing = (
        np.logical_or.reduce(list(bad.values())) if bad else np.zeros(len(raster), bool)
    )
    if not missing.any():
        return raster
    names = ", ".join(plain(n, 40) for n, flags in bad.items() if flags.any())
    first = float(raster.time[int(np.argmax(missing))] - raster.time[0])
    count = int(missing.sum())
    notes.append(
        f"{raster.name}: {count} sample{'s' * (count > 1)} without a number ({names}) left out, first {first:.6g} s after "
        "the begin"
    )
    return raster.rows(~missing)


def rounded(rounding: float, step: float) -> str:
    """Return a sentence on rounded time stamps: their resolution [s] and sampling step [s]."""
    return f"stamps are rounded to {rounding:.3g} s; taken as evenly sampled at {1 / step:.7g} Hz"


def _at(t: float) -> str:
    return f"{t:.6f} s" if abs(t) < EPOCH else f"{t:.3f} s since 1970"


def _without_repeats(raster: Raster, notes: list[str]) -> Raster:
    d, where = np.diff(raster.time), raster.name
    at = np.flatnonzero(d == 0)
    same = np.ones(len(at), bool)
    for values in raster.columns.values():
        a, b = values[at], values[at + 1]
        same &= (a == b) | (np.isnan(a) & np.isnan(b))
    first = _at(float(raster.time[at[0]] - raster.time[0]))
    if same.all():
        keep = np.ones(len(raster), bool)
        keep[at + 1] = False
        notes.append(
            f"{where}: {len(at)} samples are there twice, first {first} after its begin; taken once"
        )
        return raster.rows(keep)
    even = np.linspace(raster.time[0], raster.time[-1], len(raster))
    grain = float(np.min(d[d > 0])) if (d > 0).any() else 0.0
    # a clock coarser than the sampling
    if np.abs(raster.time - even).max() <= 1.01 * grain:
        notes.append(
            f"{where}: stamps of {grain:.3g} s for a step of {even[1] - even[0]:.3g} s; taken as evenly sampled"
        )
        return replace(raster, time=even)
    raise InputError(
        f"{raster.source}: {len(at)} time stamps occur twice with different values, first {first} after the start: two pieces overlap; "
        "cut the file and give the pieces as separate records"
    )


def _split(raster: Raster, notes: list[str]) -> list[Raster]:
    d, step = np.diff(raster.time), raster.step
    gaps = np.flatnonzero(d > GAP * step)
    if not len(gaps) or len(gaps) > 0.2 * len(d):  # uneven sampling is no gap
        return [raster]
    edges = np.r_[0, gaps + 1, len(raster)]
    pieces = [
        raster.rows(slice(a, b)) for a, b in zip(edges[:-1], edges[1:], strict=True)
    ]
    kept = [p for p in pieces if len(p) >= LEAST]
    begin = raster.time[0]
    told = ", ".join(
        f"{d[g]:.3g} s at {raster.time[g] - begin:.6g} s" for g in gaps[:3]
    )
    more = f" and {len(gaps) - 3} more" if len(gaps) > 3 else ""
    left = f"; {len(pieces) - len(kept)} of {len(pieces)} pieces are shorter than {LEAST} samples and left out"
    notes.append(
        f"{raster.name}: split at {len(gaps)} gap{'s' * (len(gaps) > 1)} ({told}{more})"
        + (left if len(kept) < len(pieces) else "")
    )
    if not kept:
        raise InputError(
            f"{raster.source}: no piece of {LEAST} samples between its {len(gaps)} gaps"
        )
    return kept


def continuous(name: str, values: np.ndarray, unit: str) -> tuple[np.ndarray, str]:
    """Return a column (n,) in `unit` without the jumps of an angle that restarts at each turn, and a line for the user.

    Columns that are no angles are returned unchanged; the line is '' without jumps.
    """
    try:
        turn = convert(1.0, "rev", unit)
    except InputError:
        return values, ""
    out, wraps = unwrapped(values, turn)
    text = f"{name}: an angle that begins anew each turn; {wraps} jump{'s' * (wraps > 1)} of {turn:.5g} {unit} taken out"
    return out, text if wraps else ""


def even(time: np.ndarray) -> bool:
    """Return whether stamps (n,) [s] lie on a uniform grid, within a tenth of a step or the resolution of the stamps."""
    if len(time) < 3 or stamp_rounding(time):
        return True
    grid = np.linspace(time[0], time[-1], len(time))
    return bool(np.abs(time - grid).max() <= UNEVEN * (grid[1] - grid[0]))


# ------------------------------------------------------------------------------------------------ a run


@dataclass(frozen=True)
class Signal:
    """A logged channel."""

    time: np.ndarray  # time stamps (n,) [s] of the clock
    values: np.ndarray  # samples (n,) in `unit`
    unit: str  # unit
    clock: str  # name of the logger's clock
    column: str = ""  # name of the column

    def __post_init__(self) -> None:
        if self.time.ndim != 1 or self.time.shape != self.values.shape:
            raise InputError(
                f"channel {shown(self.column)}: {self.values.shape} values at {self.time.shape} stamps"
            )

    @property
    def step(self) -> float:
        """Mean step [s]."""
        return float(self.time[-1] - self.time[0]) / max(len(self.time) - 1, 1)

    def within(self, start: float, stop: float) -> Signal:
        """Return the samples in an interval of time [s]."""
        keep = (self.time >= start) & (self.time <= stop)
        return replace(self, time=self.time[keep], values=self.values[keep])


@dataclass(frozen=True)
class Recording:
    """A run: the channels of a model, each on separate time stamps."""

    name: str  # name, for messages
    signals: Mapping[str, Signal]  # signal by channel
    #: known delay [s] of the stamps by clock; a clock without an entry has an unknown delay
    lags: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # changes that were made to the files

    @property
    def clocks(self) -> list[str]:
        """Names of the clocks of the channels."""
        return list(dict.fromkeys(s.clock for s in self.signals.values()))

    def table(self) -> Table | None:
        """Return the run as a table if all channels have the same uniform stamps of one clock, otherwise None."""
        first = next(iter(self.signals.values()))
        same = all(
            len(s.time) == len(first.time)
            and (s.time is first.time or np.array_equal(s.time, first.time))
            for s in self.signals.values()
        )
        if not same or len(self.clocks) > 1 or not even(first.time):
            return None
        units = {n: s.unit for n, s in self.signals.items() if s.unit}
        return Table(
            first.time, {n: s.values for n, s in self.signals.items()}, self.name, units
        )

    def together(self) -> tuple[float, float]:
        """Return the first and the last instant [s] at which all channels are present."""
        return max(s.time[0] for s in self.signals.values()), min(
            s.time[-1] for s in self.signals.values()
        )


def spans(pieces: Sequence[Sequence[tuple[float, float]]]) -> list[tuple[float, float]]:
    """Return the common part of several lists of intervals [s]."""
    out = list(pieces[0])
    for row in pieces[1:]:
        out = [
            (max(a, c), min(b, d))
            for a, b in out
            for c, d in row
            if min(b, d) > max(a, c)
        ]
    return out


def sampled(signal: Signal, at: np.ndarray, quantity: str) -> tuple[np.ndarray, str]:
    """Return an input at given instants (n,) [s] in its unit, and the kind of interpolation ('' for identical stamps).

    A current or a command is held between samples and averaged from each instant to the next. A force or a logged channel is linear, and
    a motion is a cubic spline.
    """
    t, x = signal.time, signal.values
    if len(t) >= len(at):
        first = int(np.argmin(np.abs(t - at[0])))
        own = t[first : first + len(at)]
        if len(own) == len(at) and np.abs(own - at).max() < 1e-3 * signal.step:
            return x[first : first + len(at)], ""
    if quantity == "current":
        ends = np.append(t, max(t[-1], at[-1]) + signal.step)
        area = np.append(0.0, np.cumsum(x * np.diff(ends)))
        edges = np.append(at, 2 * at[-1] - at[-2])
        mean = np.diff(np.interp(edges, ends, area)) / np.diff(edges)
        return mean, "held, averaged over each interval"
    if quantity in ("force", "condition"):
        return np.interp(at, t, x), "linear between its samples"
    return np.asarray(
        CubicSpline(t, x)(np.clip(at, t[0], t[-1]))
    ), "a cubic spline through its samples"
