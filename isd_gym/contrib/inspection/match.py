"""Match between columns and channels of a model: names, units, and physics (derivatives, and a simulation with
candidate inputs)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.signal import correlate

from isd_gym._common.errors import InputError, shown
from isd_gym._common.units import TABLE, convert
from isd_gym.physics.simulate import simulate
from isd_gym.records._loggers.mapping import ChannelMap, Column, Logger

from .consistency import integral_consistency
from .facts import Facts, factor_hint, si_unit
from .name_matching import alike

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isd_gym.physics.network import Channel, Network
    from isd_gym.records._loggers.recording import Raster

COLUMNS = 60  # largest number of columns; with more columns, the best by name and unit
DRIVES = 40  # largest number of simulated choices of input columns
SAMPLES = 6000  # samples of the compared stretch
LAG = 0.5  # largest lag between loggers [s]
GIVEN = 50.0  # score of the column that the user names for a channel
NOTHING = -3.0  # score below which a channel has no column
PHYSICS = 9.0  # score of a perfect match with a simulation
EXACT = 5.0  # score of a column's name that is the channel's
DERIVATIVE = 2.0  # score of a column that is the derivative of another column
ORDER = {"displacement": 0, "velocity": 1, "acceleration": 2}


@dataclass(frozen=True)
class Candidate:
    """A candidate column for a channel.

    Attributes:
        facts: Properties of the column.
        unit: Assumed unit.
        sign: Factor 1 or -1.
        score: Score; larger is better.
        follows: Correlation with the simulation.
        gain: Measured over simulated amplitude, in the unit.
        why: Reasons.
    """

    facts: Facts
    unit: str
    sign: int = 1
    score: float = 0.0
    follows: float = math.nan
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
                c.unit if c.unit != c.facts.unit or not c.facts.unit else None,
                c.sign,
                sure,
                "; ".join(c.why),
            )
            for name, (c, sure) in self.channels.items()
        }
        loggers = tuple(
            Logger(group[0].name, group[0].stamp or None, columns=tuple(columns or ()), rate=rate)
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

    The score of a choice is the sum over channels of the scores of name, unit, derivatives among columns, and
    correlation with a simulation that the chosen inputs drive. The probability of a channel's column follows
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
    out, given, signs = Suggestion(), dict(given or {}), dict(signs or {})
    wanted = [*network.inputs, *network.outputs]
    live = [f for f in facts if not f.constant and f.samples - f.missing > 63]
    if len(live) > COLUMNS:
        rank = {id(f): max(_prior(f, c, network) for c in wanted) for f in live}
        live = sorted(live, key=lambda f: -rank[id(f)])[:COLUMNS]
        out.remarks.append(
            f"{COLUMNS} columns of {len(facts)} were looked at: those whose names or units speak for a channel"
        )
    prior = np.array([[_prior(f, c, network) for f in live] for c in wanted]).reshape(len(wanted), len(live))
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
        out.remarks.append("the columns have no time in common: names and units alone were compared")
    else:
        prior = prior + _derivatives(wanted, live, window, prior)
    choices = _choices(network, live, prior, signs)
    solved = [_solve(network, wanted, live, prior, window, choice) for choice in choices]
    # a constant column may be an unused input
    best = max(solved, key=lambda s: s.total)
    for i, c in enumerate(wanted):
        found = best.picks[i]
        if found is None:
            idle = [f for f in facts if f.constant and _prior(f, c, network) > 2.5]
            if c in network.inputs and idle:
                out.channels[c.name] = (
                    Candidate(idle[0], idle[0].unit or c.unit, why=("by its name", "constant")),
                    0.6,
                )
                continue
            out.missing.append(c.name)
            continue
        others = [s.total for s in solved if s.place(i) != best.place(i)]
        others.append(best.without(i))
        known = signs.get(c.name, found.sign)
        if known != found.sign and found.follows > 0.7:
            way = "" if found.sign > 0 else ", turned round"
            out.remarks.append(f"{c.name} follows the model{way}: is its sign {known:+d}?")
        found = replace(found, sign=known)
        sure = 1.0 / (1.0 + math.exp(-min(max(best.total - max(others), -30.0), 30.0)))
        out.channels[c.name] = (found, sure)
    for name, (pick, _) in out.channels.items():
        hint = factor_hint(pick.gain) if pick.follows > 0.7 and pick.facts.unit else ""
        if hint:
            out.remarks.append(
                f"{pick.facts.name} as {name}: {hint} against the model: is it in another unit than {pick.unit}?"
            )
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
    return score - (4.0 if f.unit and f.unit not in ("-", "1") else 0.0)  # a unit of no mechanical quantity


# ------------------------------------------------------------------------------------------------- physics


@dataclass(frozen=True)
class Window:
    """The compared stretch.

    Attributes:
        time: Time stamps (n,) [s].
        values: Samples of every column (columns, n).
    """

    time: np.ndarray
    values: np.ndarray

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
    start, stop = max(r.time[0] for r in good.values()), min(r.time[-1] for r in good.values())
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
    return Window(time - time[0], np.array(rows))


def _derivatives(
    wanted: Sequence[Channel], live: Sequence[Facts], window: Window, prior: np.ndarray
) -> np.ndarray:
    """Return the score of each channel and column for columns that are derivatives or integrals of candidates of
    other channels."""
    out = np.zeros(prior.shape)
    known: dict[tuple[int, int, int], float] = {}

    def related(low: int, high: int, order: int) -> float:
        if (low, high, order) not in known:
            f = [live[k].band for k in (low, high) if math.isfinite(live[k].band)]
            band = (
                (max(0.3 * min(f), 5.0 / window.time[-1]), min(3.0 * max(f), 0.3 / window.step))
                if f
                else (0, 0)
            )
            try:
                made = integral_consistency(
                    window.values[low], window.values[high], window.step, order=order, band=band, max_lag=0.05
                )
                known[low, high, order] = made.coherence
            except (InputError, ValueError, FloatingPointError):
                known[low, high, order] = 0.0
        return known[low, high, order]

    for i, one in enumerate(wanted):
        for j, two in enumerate(wanted):
            same = (one.at, one.between, one.element) == (two.at, two.between, two.element)
            order = ORDER.get(two.quantity, 0) - ORDER.get(one.quantity, 9)
            if not same or order <= 0:
                continue
            lows = [k for k in np.argsort(-prior[i])[:4] if prior[i, k] > -2]
            highs = [k for k in np.argsort(-prior[j])[:4] if prior[j, k] > -2]
            for a, b in itertools.product(lows, highs):
                if a != b:
                    worth = DERIVATIVE * related(int(a), int(b), order)
                    out[i, a], out[j, b] = max(out[i, a], worth), max(out[j, b], worth)
    return out


#: a choice of inputs: index of the column, unit and sign for each input
Drive = tuple[tuple[int, str, int], ...]


def _choices(
    network: Network, live: Sequence[Facts], prior: np.ndarray, signs: Mapping[str, int]
) -> list[Drive]:
    """Return candidate choices of input columns, most probable first."""
    options: list[list[tuple[float, tuple[int, str, int]]]] = []
    for i, c in enumerate(network.inputs):
        rows = []
        for k in np.argsort(-prior[i])[:6]:
            if prior[i, k] < NOTHING:
                continue
            for unit, cost in _units(live[k], c):
                # `diagnose` reads a column with the name of a channel in the channel's unit; a missing effect must not change that
                if unit == c.unit or alike(live[k].name, c, network) < EXACT:
                    rows.append((float(prior[i, k]) - cost, (int(k), unit, signs.get(c.name, 1))))
        rows.append((NOTHING, (-1, c.unit, 1)))
        options.append(sorted(rows, reverse=True)[:8])
    every = sorted(itertools.product(*options), key=lambda row: -sum(s for s, _ in row))
    out = [tuple(x for _, x in row) for row in every]
    return [row for row in out if len({k for k, _, _ in row if k >= 0}) == sum(k >= 0 for k, _, _ in row)][
        :DRIVES
    ]


def _units(f: Facts, c: Channel) -> list[tuple[str, float]]:
    """Return candidate units of a column as a channel, with the penalty of each unit."""
    if si_unit(f.unit):
        return [(f.unit, 0.0)]
    from isd_gym.records.data._quality import QUANTITIES

    si = c.si
    _, doubtful, _, least = QUANTITIES[c.spoken if c.quantity == "condition" else c.quantity]
    out = []
    for unit in dict.fromkeys([c.unit, si, *(u for u, (s, _) in TABLE.items() if s == si)]):
        factor = convert(1.0, unit, si)
        spread = 3 * factor * f.deviation
        fast = c.quantity == "displacement" and math.isfinite(f.band) and spread * 2 * math.pi * f.band > 15
        if least < spread < doubtful and not fast:
            out.append(
                (
                    unit,
                    0.0
                    if unit == c.unit
                    else 0.3
                    if unit == si
                    else 1.0 + 0.2 * (unit in ("in", "in/s", "lbf", "um")),
                )
            )
    return out[:3] or [(c.unit, 3.0)]


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
) -> _Solved:
    ni, failed = len(network.inputs), ""
    base: float = 0.0
    picks: list[Candidate | None] = []
    for i, (k, unit, sign) in enumerate(drive):
        if k < 0:
            base += NOTHING
            picks.append(None)
            continue
        base += prior[i, k] - dict(_units(live[k], wanted[i])).get(unit, 0.0)
        picks.append(
            Candidate(live[k], unit, sign, float(prior[i, k]), why=_reasons(live[k], wanted[i], network))
        )
    said: Mapping[str, np.ndarray] = {}
    if window is not None and network.inputs:
        try:
            said = _driven(network, window, drive)
        except InputError as error:
            failed = str(error)
    taken = {k for k, _, _ in drive if k >= 0}
    ny = len(network.outputs)
    table = np.full((ny, len(live) + ny), -1e5)
    made: dict[tuple[int, int], Candidate] = {}
    for j, c in enumerate(network.outputs):
        table[j, len(live) + j] = NOTHING
        for k, f in enumerate(live):
            if k in taken or prior[ni + j, k] < -10:
                continue
            made[j, k] = one = _weighed(c, f, float(prior[ni + j, k]), window, k, said.get(c.name), network)
            table[j, k] = one.score
    total, columns = _assigned(table)
    picks += [made.get((j, int(k))) for j, k in enumerate(columns)]
    return _Solved(base + total, picks, table, base, drive, ni, failed)


def _driven(network: Network, window: Window, drive: Drive) -> dict[str, np.ndarray]:
    inputs = {}
    for c, (k, unit, sign) in zip(network.inputs, drive, strict=True):
        x = np.zeros(len(window.time)) if k < 0 else sign * window.values[k]
        x = convert(x, unit, c.unit)
        inputs[c.name] = x - x.mean() if c.quantity != "current" else x
    return simulate(network, window.time, inputs, step=min(1e-3, window.step))


def _weighed(
    c: Channel,
    f: Facts,
    prior: float,
    window: Window | None,
    k: int,
    said: np.ndarray | None,
    network: Network,
) -> Candidate:
    """Return a column as candidate of an output: score of name, unit and correlation with the simulation."""
    why = _reasons(f, c, network)
    options = _units(f, c)
    unit = options[0][0]
    if window is None or said is None or not said.std() > 0:
        return Candidate(f, unit, 1, prior - options[0][1], why=why)
    x = window.values[k]
    lag = min(int(LAG / window.step), len(x) // 4)
    skip = len(x) // 8  # start-up from rest
    a, b = said[skip:] - said[skip:].mean(), x[skip:] - x[skip:].mean()
    r = correlate(b, a, mode="full", method="fft")[len(a) - 1 - lag : len(a) + lag]
    r = r / (len(a) * max(a.std() * b.std(), 1e-300))
    at = int(np.argmax(np.abs(r)))
    follows, sign = float(min(abs(r[at]), 1.0)), 1 if r[at] >= 0 else -1
    size = b.std() / a.std()  # measured over simulated, in their units
    choice = []
    for u, cost in options if not f.unit else [(unit, 0.0)]:
        gain = float(convert(size, u, c.unit))
        choice.append((min(1.5 * abs(math.log(max(gain, 1e-12))), 4.0) * follows + cost, u, gain))
    cost, unit, gain = min(choice)
    score = prior + PHYSICS * (follows**2 - 0.3) - cost - (1.0 if sign < 0 else 0.0)
    if follows > 0.5:
        why = (*why, f"follows the model: {follows:.2f}" + (", turned round" if sign < 0 else ""))
    return Candidate(f, unit, sign, score, follows, gain, why)


def _reasons(f: Facts, c: Channel, network: Network) -> tuple[str, ...]:
    out = []
    if alike(f.name, c, network) >= EXACT:
        out.append("its name")
    elif alike(f.name, c, network) > 1:
        out.append("like its name")
    if si_unit(f.unit) == c.si:
        out.append("its unit")
    return tuple(out)
