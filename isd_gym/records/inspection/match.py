"""Match between columns and channels of a model: names, units, and a simulation with candidate inputs."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.signal import correlate

from ..._common.errors import InputError, shown
from ..._common.units import convert, units_of
from ...physics.simulate import simulate
from ..loggers.mapping import ChannelMap, Column, Logger
from .facts import Facts, odd_scale, si_unit, unit_in_name
from .name_matching import alike

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ...physics.network import Channel, Network
    from ..loggers.recording import Raster

COLUMNS = 60  # largest number of columns; with more columns, the best by name and unit
DRIVES = 40  # largest number of simulated choices of input columns
SAMPLES = 6000  # samples of the compared stretch
LAG = 0.5  # largest lag between loggers [s]
GIVEN = 50.0  # score of the column that the user names for a channel
NOTHING = -3.0  # score below which a channel has no column
PHYSICS = 9.0  # score of a perfect match with a simulation
EXACT = 5.0  # score of a column's name that is the channel's
CLEAR = 0.85  # correlation with the turned simulation above which a sensor is turned
DOUBT = 0.7  # correlation above which the sign and the unit are questioned
# ratio of measured and simulated amplitude above which the unit is questioned
ALIKE = 3.0
FITS = 1.6  # the same ratio below which a unit fits


@dataclass(frozen=True)
class Candidate:
    """A candidate column for a channel.

    Attributes:
        facts: Properties of the column.
        unit: Assumed unit.
        sign: Factor 1 or -1.
        score: Score; larger is better.
        follows: Correlation with the simulation, with the sign.
        against: Correlation with the simulation, with the opposite sign.
        gain: Measured over simulated amplitude, in the unit.
        why: Reasons.
    """

    facts: Facts
    unit: str
    sign: int = 1
    score: float = 0.0
    follows: float = math.nan
    against: float = math.nan
    gain: float = math.nan
    why: tuple[str, ...] = ()


@dataclass
class Suggestion:
    """A suggested map.

    Attributes:
        channels: Candidate and probability by channel.
        missing: Channels without a column.
        remarks: Lines for the user.
    """

    channels: dict[str, tuple[Candidate, float]] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def map(
        self,
        files: Sequence[Sequence[Raster]],
        model: str,
        columns: Sequence[str] | None = None,
        rate: float | None = None,
    ) -> ChannelMap:
        """Return the suggestion as a map for ``--map``.

        Args:
            files: Rasters of every file.
            model: File of the model.
            columns: Names that files without a header row were given.
            rate: Sampling rate that files without time stamps were given [Hz].

        Returns:
            The map.
        """
        channels = {
            name: Column(
                c.facts.name,
                c.facts.file + 1,
                c.unit
                if c.unit != files[c.facts.file][c.facts.raster].units.get(c.facts.name)
                else None,
                c.sign,
                sure,
                "; ".join(c.why),
            )
            for name, (c, sure) in self.channels.items()
        }
        loggers = tuple(
            Logger(
                group[0].name,
                group[0].stamp or None,
                columns=tuple(columns or ()),
                rate=rate,
            )
            for group in files
        )
        return ChannelMap(channels, loggers, model)


def suggest(
    files: Sequence[Sequence[Raster]],
    facts: Sequence[Facts],
    network: Network,
    given: Mapping[str, Column] | None = None,
    signs: Mapping[str, int] | None = None,
) -> Suggestion:
    """Suggest columns for the channels of a model.

    The score of a choice is the sum over channels of the scores of name, unit, and correlation with a simulation that the chosen inputs drive. The probability of a channel's column follows
    from the loss of score in the best choice without that column.

    Args:
        files: Rasters of every file.
        facts: Properties of all columns.
        network: The model.
        given: Known columns by channel.
        signs: Known factors 1 or -1 by channel.

    Returns:
        Columns, missing channels and remarks.

    Raises:
        InputError: A known column has the unit of another quantity than its channel.
    """
    out = Suggestion()
    given = dict(given or {})
    signs = dict(signs or {})
    wanted = [*network.inputs, *network.outputs]
    live = [f for f in facts if not f.constant and f.samples - f.missing > 63]
    if len(live) > COLUMNS:
        rank = {id(f): max(_prior(f, c, network) for c in wanted) for f in live}
        live = sorted(live, key=lambda f: -rank[id(f)])[:COLUMNS]
        out.remarks.append(
            f"{COLUMNS} columns of {len(facts)} were looked at: those whose names or units speak for a channel"
        )
    prior = np.array([[_prior(f, c, network) for f in live] for c in wanted]).reshape(
        len(wanted), len(live)
    )
    window = _window(files, live)
    for j, f in enumerate(live):
        owner = next((n for n, c in given.items() if c.column == f.name), None)
        for i, c in enumerate(wanted):
            if owner == c.name and si_unit(f.unit) not in ("", c.si):
                raise InputError(
                    f"column {shown(f.name)} as {c.name}: unit {shown(f.unit)} is none of {c.si}"
                )
            if owner is not None or c.name in given:
                prior[i, j] = GIVEN if owner == c.name else -GIVEN
    if window is None:
        out.remarks.append(
            "the columns have no time in common: names and units alone were compared"
        )
    choices = _choices(network, prior)
    solved = [
        _solve(network, wanted, live, prior, window, choice, signs)
        for choice in choices
    ]
    # a constant column may be an unused input
    best = max(solved, key=lambda s: s.total)
    for i, c in enumerate(wanted):
        found = best.picks[i]
        if found is None:
            idle = [f for f in facts if f.constant and _prior(f, c, network) > 2.5]
            if c in network.inputs and idle:
                out.channels[c.name] = (
                    Candidate(
                        idle[0], _unit(idle[0], c), why=("by its name", "constant")
                    ),
                    0.6,
                )
                continue
            out.missing.append(c.name)
            continue
        others = [s.total for s in solved if s.place(i) != best.place(i)]
        others.append(best.without(i))
        sure = 1.0 / (1.0 + math.exp(-min(max(best.total - max(others), -30.0), 30.0)))
        out.channels[c.name] = (found, sure)
    out.remarks += _of_the_input(network, out.channels, signs)
    for c in wanted:
        if c.name in out.channels:
            pick, _ = out.channels[c.name]
            out.remarks += _doubts(c, pick, files[pick.facts.file][pick.facts.raster])
    if best.failed:
        out.remarks.append(
            f"the model could not be driven ({best.failed}): names and units alone were compared"
        )
    return out


def _prior(f: Facts, c: Channel, network: Network) -> float:
    """Return the score of a column's name and unit for a channel."""
    score = alike(f.name, c, network)
    if known := si_unit(f.unit):
        return score + 2.0 if known == c.si else -20.0
    if f.unit and f.unit not in ("-", "1"):  # a unit of no mechanical quantity
        return score - 4.0
    return score + 2.0 if si_unit(unit_in_name(f.name)) == c.si else score


def _unit(f: Facts, c: Channel) -> str:
    """Return the unit of a column as a channel: of the file or the user, else of the column's name, else of the channel.

    A column with the name of the channel has the unit of the channel, as in a diagnosis without a map.
    """
    if si_unit(f.unit):
        return f.unit
    named = unit_in_name(f.name)
    is_named = si_unit(named) == c.si and f.name.lower() != c.name.lower()
    return named if is_named else c.unit


def _of_the_input(
    network: Network,
    channels: dict[str, tuple[Candidate, float]],
    signs: Mapping[str, int],
) -> list[str]:
    """Unturn several outputs that are all turned: return a question to the user on the sign of the only input."""
    found = [c.name for c in network.outputs if c.name in channels]
    is_of_input = len(found) > 1 and len(network.inputs) == 1 and not signs
    if not (is_of_input and all(channels[name][0].sign < 0 for name in found)):
        return []
    for name in found:
        pick, sure = channels[name]
        channels[name] = (
            replace(pick, sign=1, why=pick.why[:-1], follows=math.nan),
            sure,
        )
    return [
        f"all outputs follow the model turned round: --sign {network.inputs[0].name}=-1?"
    ]


def _doubts(c: Channel, pick: Candidate, raster: Raster) -> list[str]:
    """Return questions to the user on the sign and the unit of a column as a channel."""
    out: list[str] = []
    name = pick.facts.name
    if pick.against > DOUBT > pick.follows:
        out.append(
            f"{c.name} follows the model turned round ({pick.against:.2f}): --sign {c.name}={-pick.sign:+d}?"
        )
    if pick.follows > DOUBT and not 1 / ALIKE < pick.gain < ALIKE:
        gains = {
            unit: pick.gain * convert(1.0, unit, pick.unit) for unit in units_of(c.si)
        }
        fitting = [unit for unit, gain in gains.items() if 1 / FITS < gain < FITS]
        if fitting:
            out.append(
                f"{name} as {c.name} is {pick.gain:.3g} times the model in {pick.unit}: --unit {name}={fitting[0]}?"
            )
    elif math.isnan(pick.gain) and not pick.facts.unit:
        odd = odd_scale(raster, replace(pick.facts, unit=pick.unit), c.spoken)
        out += [f"{c.name}: {remark}" for remark in odd]
    return out


# ------------------------------------------------------------------------------------------------- physics


@dataclass(frozen=True)
class Window:
    """The compared stretch.

    Attributes:
        time: Time stamps (n,) [s].
        values: Samples of every column (columns, n).
        lag: Largest lag between columns [s]; 0 for columns of one clock.
    """

    time: np.ndarray
    values: np.ndarray
    lag: float

    @property
    def step(self) -> float:
        """Sampling step [s]."""
        return float(self.time[1] - self.time[0])


def _window(files: Sequence[Sequence[Raster]], live: Sequence[Facts]) -> Window | None:
    places = {(f.file, f.raster) for f in live}
    good = {}
    for i, k in places:
        r = files[i][k]
        t = r.time[np.isfinite(r.time)]
        if len(t) < 64 or (np.diff(r.time) <= 0).any():
            return None
        good[i, k] = r
    if not good:
        return None
    start = max(r.time[0] for r in good.values())
    stop = min(r.time[-1] for r in good.values())
    step = min(r.step for r in good.values())
    if stop - start < 64 * step:
        return None
    # the middle of a long record; for several rasters a common step, equal to the finest
    count = int((stop - start) / step)
    if count > SAMPLES:
        start += 0.5 * (count - SAMPLES) * step
        count = SAMPLES
    time = start + step * np.arange(count)
    rows = []
    for f in live:
        r = good[f.file, f.raster]
        x = r.columns[f.name]
        fine = np.isfinite(x)
        rows.append(np.interp(time, r.time[fine], x[fine]))
    return Window(
        time - time[0], np.array(rows), LAG if len({f.file for f in live}) > 1 else 0.0
    )


#: a choice of inputs: index of the column of each input; -1 without a column
Drive = tuple[int, ...]


def _choices(network: Network, prior: np.ndarray) -> list[Drive]:
    """Return candidate choices of input columns, most probable first."""
    options: list[list[tuple[float, int]]] = []
    for row in prior[: len(network.inputs)]:
        best = [
            (float(row[k]), int(k)) for k in np.argsort(-row)[:6] if row[k] >= NOTHING
        ]
        options.append(sorted([*best, (NOTHING, -1)], reverse=True))
    every = sorted(
        itertools.product(*options),
        key=lambda choice: -sum(score for score, _ in choice),
    )
    drives = [tuple(k for _, k in choice) for choice in every]
    return [drive for drive in drives if _is_distinct(drive)][:DRIVES]


def _is_distinct(drive: Drive) -> bool:
    """Return whether no column serves two inputs."""
    used = [k for k in drive if k >= 0]
    return len(set(used)) == len(used)


@dataclass
class _Solved:
    """The best assignment for a choice of inputs."""

    total: float
    picks: list[Candidate | None]
    table: np.ndarray  # scores (outputs, columns)
    base: float
    drive: Drive
    shift: int
    failed: str = ""

    def place(self, i: int) -> object:
        """Return file, raster and name of a channel's column; None without a column."""
        p = self.picks[i]
        return None if p is None else (p.facts.file, p.facts.raster, p.facts.name)

    def without(self, i: int) -> float:
        """Return the best total without the present column of channel `i`."""
        if i < self.shift:
            return -math.inf
        j = i - self.shift
        table = self.table.copy()
        pick = self._row_pick(j)
        table[j, pick] = -1e6
        return self.base + _assigned(table)[0]

    def _row_pick(self, j: int) -> int:
        return int(_assigned(self.table)[1][j])


def _assigned(table: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the sum and the column of every row of the best assignment; the last columns mean no column."""
    if not table.size:
        return 0.0, np.zeros(0, int)
    rows, columns = linear_sum_assignment(-table)
    return float(table[rows, columns].sum()), columns


def _solve(
    network: Network,
    wanted: Sequence[Channel],
    live: Sequence[Facts],
    prior: np.ndarray,
    window: Window | None,
    drive: Drive,
    signs: Mapping[str, int],
) -> _Solved:
    ni, failed = len(network.inputs), ""
    base: float = 0.0
    picks: list[Candidate | None] = []
    for i, (c, k) in enumerate(zip(network.inputs, drive, strict=True)):
        if k < 0:
            base += NOTHING
            picks.append(None)
            continue
        base += prior[i, k]
        picks.append(_by_name(c, live[k], float(prior[i, k]), network, signs))
    said: Mapping[str, np.ndarray] = {}
    if window is not None and network.inputs:
        try:
            said = _driven(network, window, drive, picks)
        except InputError as error:
            failed = str(error)
    ny = len(network.outputs)
    table = np.full((ny, len(live) + ny), -1e5)
    made: dict[tuple[int, int], Candidate] = {}
    for j, c in enumerate(network.outputs):
        table[j, len(live) + j] = NOTHING
        for k, f in enumerate(live):
            if k in drive or prior[ni + j, k] < -10:
                continue
            one = _by_name(c, f, float(prior[ni + j, k]), network, signs)
            if window is not None and c.name in said and said[c.name].std() > 0:
                one = _compared(c, one, window, k, said[c.name], signs)
            made[j, k] = one
            table[j, k] = one.score
    total, columns = _assigned(table)
    picks += [made.get((j, int(k))) for j, k in enumerate(columns)]
    return _Solved(base + total, picks, table, base, drive, ni, failed)


def _driven(
    network: Network, window: Window, drive: Drive, picks: Sequence[Candidate | None]
) -> dict[str, np.ndarray]:
    inputs = {}
    for c, k, pick in zip(network.inputs, drive, picks, strict=True):
        x = np.zeros(len(window.time))
        if pick is not None:
            x = pick.sign * convert(window.values[k], pick.unit, c.unit)
        inputs[c.name] = x - x.mean() if c.quantity != "current" else x
    return simulate(network, window.time, inputs, step=min(1e-3, window.step))


def _by_name(
    c: Channel, f: Facts, prior: float, network: Network, signs: Mapping[str, int]
) -> Candidate:
    """Return a column as candidate of a channel, by name and unit alone."""
    return Candidate(
        f, _unit(f, c), signs.get(c.name, 1), prior, why=_reasons(f, c, network)
    )


def _compared(
    c: Channel,
    by_name: Candidate,
    window: Window,
    k: int,
    said: np.ndarray,
    signs: Mapping[str, int],
) -> Candidate:
    """Return a candidate of an output with the score of its correlation with the simulation.

    The sign is turned only where the turned column follows the simulation clearly and the column itself does not.
    """
    f, x = by_name.facts, window.values[k]
    lag = min(int(window.lag / window.step), len(x) // 4)
    skip = len(x) // 8  # start-up from rest
    a = said[skip:] - said[skip:].mean()
    b = x[skip:] - x[skip:].mean()
    r = correlate(b, a, mode="full", method="fft")[len(a) - 1 - lag : len(a) + lag]
    r = r / (len(a) * max(a.std() * b.std(), 1e-300))
    follows = min(float(r.max()), 1.0)
    against = min(float(-r.min()), 1.0)
    strength = max(follows, against)
    is_turned = against > CLEAR > follows
    sign = signs.get(c.name, -1 if is_turned else 1)
    if sign < 0:
        follows, against = against, follows
    size = b.std() / a.std()  # measured over simulated, in their units
    units = [f.unit] if si_unit(f.unit) else units_of(c.si)
    misfit = min(
        abs(math.log(max(float(convert(size, u, c.unit)), 1e-12))) for u in units
    )
    score = (
        by_name.score
        + PHYSICS * (strength**2 - 0.3)
        - min(1.5 * misfit, 4.0) * strength
    )
    why = by_name.why
    if follows > 0.5:
        turned = ", turned round" if sign < 0 else ""
        why = (*why, f"follows the model: {follows:.2f}{turned}")
    gain = float(convert(size, by_name.unit, c.unit))
    return replace(
        by_name,
        sign=sign,
        score=score,
        follows=follows,
        against=against,
        gain=gain,
        why=why,
    )


def _reasons(f: Facts, c: Channel, network: Network) -> tuple[str, ...]:
    out = []
    if alike(f.name, c, network) >= EXACT:
        out.append("its name")
    elif alike(f.name, c, network) > 1:
        out.append("like its name")
    if c.si in (si_unit(f.unit), si_unit(unit_in_name(f.name))):
        out.append("its unit")
    return tuple(out)
