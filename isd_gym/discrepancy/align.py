"""How late another logger's clock is: a nuisance of every record, sought wide with the model, then refined with everything else."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from .fit import Fit, Fitter
from .initial import guess
from .noise import plain
from .problem import Array, Problem, Record
from .rasters import record_of
from .structure import Structure, base_structure
from .tangent import tangents

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from ..network import Network

LIMIT = 0.5  # [s] lags are sought up to this
TRIALS = 400  # lags of a first look
ROWS = 1500  # samples of a channel that it looks at
ROUGH = 0.1  # share of a signal that a model may be off before anything is fitted
BLOCKS = 20  # from whose scatter the interval comes
ROUNDS = 6
RIVAL, MANY = 4.0, 6  # of the least cost: lags that are fitted, too, and how many of them
ALIKE = 1.3  # times the least cost: a lag that is nearly as good


@dataclass(frozen=True)
class Lag:
    """How late the stamps of `clock` are in `record` [s], with its 95 % interval; `doubt`: another lag is nearly as good."""

    record: str
    clock: str
    value: float
    low: float
    high: float
    doubt: str = ""

    def __str__(self) -> str:
        half = 0.5 * (self.high - self.low)
        text = f"{self.record}: the clock of {self.clock.partition(' ')[2] or self.clock} is {abs(1e3 * self.value):.2f} ms "
        text += f"{'late' if self.value >= 0 else 'early'} (+- {1e3 * half:.2g} ms)"
        return f"{text}; {self.doubt}" if self.doubt else text


def aligned(
    records: Sequence[Record],
    network: Network,
    again: Callable[[Record, Mapping[str, float]], Record],
    limit: float = LIMIT,
    doubts: Sequence[Lag] | None = None,
) -> tuple[list[Record], list[Lag]]:
    """Records with their clocks' lags fitted, by the model refitted along; those of one clock stay as they are.

    again(record, lags): the same record with other lags. limit [s]: how wide they are sought; not at all where `doubts`,
    the lags of an earlier model, are given: then they are refined from there. The lags come with intervals from the
    scatter of stretches.
    """
    if not any(r.clocks for r in records):
        return list(records), []
    out = list(records)
    doubt = {i: x.doubt for i, r in enumerate(out) for x in doubts or () if x.record == r.name}
    structure = base_structure(network)
    problem = Problem(network, out, ["fit"] * len(out))
    for i, r in enumerate(out):
        if r.clocks and doubts is None:
            found, doubt[i], others = _first_look(problem, structure, i, limit)
            out[i] = again(r, found)
            if others:  # several periods fit: the one that fits best once parameters and initial state are fitted, too
                out[i], doubt[i] = _fitted_best(out[i], others, network, again)
    x, fit = structure.start, None
    for _ in range(ROUNDS):
        problem = Problem(network, out, ["fit"] * len(out))
        deviation = np.maximum(problem.measured().std(axis=0), 1e-300)
        weights = plain(0.5 * ROUGH * deviation)
        try:
            fit = Fitter(problem, weights).fit(structure, x, iterations=4)
        except InputError:  # the model breaks down on its owner's values: the first look must do
            break
        x = fit.x
        moved = 0.0
        ny = len(problem.channels)
        for i, r in enumerate(out):
            if not r.clocks:
                continue
            most = 0.3 * r.pace  # beyond, the outputs are no straight line over the lag
            by = np.clip(fit.offset[i][ny:], -most, most)
            moved = max(moved, float(np.abs(by).max() / r.pace))
            out[i] = again(r, {k: r.lags[k] + float(b) for k, b in zip(r.clocks, by, strict=True)})
        if moved < 1e-3:
            break
    lags = []
    if fit is not None:
        problem = Problem(network, out, ["fit"] * len(out))
        lags = [lag for i in range(len(out)) for lag in told(problem, fit, i, doubt.get(i, ""))]
    return out, lags


def told(problem: Problem, fit: Fit, index: int, doubt: str = "") -> list[Lag]:
    """The lags of a record under a fit, with their intervals."""
    r, ny, out = problem.records[index], len(problem.channels), []
    if not r.clocks or index not in fit.outputs:
        return []
    y = fit.outputs[index]
    n = min(len(y), len(r.measured))
    left = r.measured[:n] - y[:n]
    size = np.maximum(left.std(axis=0), 1e-300)
    slope = np.gradient(y[:n], r.rate, axis=0)
    for k, (clock, own) in enumerate(zip(r.clocks, r.late, strict=True)):
        s = slope[:, own] / size[own]
        pull, weight = (s * left[:, own] / size[own]).sum(axis=1), (s**2).sum(axis=1)
        parts = np.array([p.sum() for p in np.array_split(pull - pull.mean(), BLOCKS)])
        half = 1.96 * math.sqrt(float(np.sum(parts**2))) / max(float(weight.sum()), 1e-300)
        value = r.lags[clock] + float(fit.offset[index][ny + k])
        out.append(Lag(r.name, clock, value, value - half, value + half, doubt))
    return out


def _first_look(
    problem: Problem, base: Structure, index: int, limit: float
) -> tuple[dict[str, float], str, list[float]]:
    """The lag of every clock of a record at which the model, linear in parameters and initial state, comes closest; and a doubt.

    Clocks are looked at one after the other, the first with the channels of the reference clock alone beside it.
    """
    record, network = problem.records[index], problem.network
    x0 = guess(problem, base.at(base.start), index)
    fine = Problem(network, [record.unread()], ["fit"], time=problem.time)
    tangent = tangents(fine, base, base.start, {0: x0})[0]
    y, dp, ds = tangent.outputs, tangent.by_parameter, tangent.by_state
    columns = np.concatenate([y[:, :, None], dp, ds], axis=2)
    if not np.isfinite(columns).all():
        return dict(record.lags), "the model breaks down before anything is fitted", []
    sigma = np.array([f.sigma for f in base.free])
    prior = np.concatenate([1 / sigma, np.full(ds.shape[2], 1e-9)])
    source = record.source
    assert source is not None
    lags, doubt = dict(record.lags), ""
    others: list[float] = []
    grid = record.start + record.step * np.arange(len(y))
    known = [j for j, c in enumerate(network.outputs) if not any(own[j] for own in record.late)]
    reach = min(limit, 0.25 * (grid[-1] - grid[0]))
    for clock, own in zip(record.clocks, record.late, strict=True):
        use = [*known, *np.flatnonzero(own)]
        blocks = {}
        for j in use:
            c = network.outputs[j]
            s = source.signals[c.name]
            t, v = s.time, s.values * problem.factors[j]
            # what moves at all, thinned: a lag is told by the motion, not by the noise above it
            inside = (t > grid[0] + reach) & (t < grid[-1] - reach)
            t, v = t[inside], v[inside]
            stride = max(1, len(t) // ROWS)
            if stride > 1:
                v = np.convolve(v, np.ones(stride) / stride, mode="same")
            blocks[j] = (t[::stride], v[::stride], max(float(v.std()), 1e-300), stride)
        if min(len(b[0]) for b in blocks.values()) < 16:
            return lags, "too short to look for it", []

        def rows(j: int, lag: float, blocks: dict[int, tuple[Array, Array, float, int]] = blocks) -> Array:
            t, v, size, _ = blocks[j]
            place = (t - lag - grid[0]) / record.step
            k = np.clip(place.astype(int), 0, len(grid) - 2)
            u = (place - k)[:, None]
            said = (1 - u) * columns[k, j] + u * columns[k + 1, j]
            out = np.column_stack([v, np.ones(len(v)), said])
            return np.asarray((out - out.mean(axis=0) * (problem.free_offset[j])) / (ROUGH * size))

        fixed = [rows(j, 0.0) for j in known]

        moving = np.asarray(np.flatnonzero(own))

        def cost(
            lag: float,
            moving: np.ndarray = moving,
            fixed: list[Array] = fixed,
            rows: Callable[..., Array] = rows,
        ) -> float:
            made = [*fixed, *(rows(int(j), lag) for j in moving)]
            D = np.concatenate(made)
            b, A = D[:, 0] - D[:, 2], D[:, 3:]
            if A.shape[1]:
                H = A.T @ A + np.diag(prior**2)
                g = A.T @ b
                return float(
                    b @ b - g @ np.linalg.solve(H + 1e-12 * np.trace(H) * np.eye(len(H)) / len(H), g)
                )
            return float(b @ b)

        pitch = max(0.25 * record.pace, 2 * reach / TRIALS)
        if pitch > 0.25 * record.pace:  # too many: where the outputs alone look alike is looked at closer
            trials = _alike(blocks, moving, columns[:, :, 0], grid, reach, 0.25 * record.pace)
        else:
            trials = np.arange(-reach, reach + pitch, pitch)
        costs = np.array([cost(float(t)) for t in trials])
        order = np.argsort(costs)
        best = float(trials[order[0]])
        for width in (0.15, 0.06, 0.025, 0.01):
            near = best + width * record.pace * np.arange(-2, 3)
            best = float(near[int(np.argmin([cost(float(t)) for t in near]))])
        lags[clock] = best
        least, n = cost(best), sum(len(b[0]) for b in blocks.values())
        far = np.abs(trials - best) > 2.0 * record.pace
        if far.any():
            other = float(costs[far].min())
            if other < 1.15 * least + 0.02 * n:
                at = float(trials[far][int(np.argmin(costs[far]))])
                doubt = f"{1e3 * at:.4g} ms would be nearly as good"
        valleys = [
            k
            for k in range(1, len(trials) - 1)
            if costs[k] <= min(costs[k - 1], costs[k + 1]) and abs(trials[k] - best) > record.pace
        ]
        valleys = [k for k in valleys if costs[k] < RIVAL * least]
        small = sorted(valleys, key=lambda k: abs(trials[k]))[: MANY // 2]  # clocks are rather off by little
        valleys = list(dict.fromkeys([*small, *sorted(valleys, key=lambda k: costs[k])]))[:MANY]
        others = [float(trials[k]) for k in valleys]
        if abs(best) > 0.97 * reach:
            doubt = f"at the limit of {reach:.3g} s within which it was sought"
    return lags, doubt, others if len(record.clocks) == 1 else []


def _fitted_best(
    record: Record,
    others: Sequence[float],
    network: Network,
    again: Callable[[Record, Mapping[str, float]], Record],
) -> tuple[Record, str]:
    """Of the record as it is and with `others` for its clock's lag, the one that fits best by itself; and a doubt."""
    (clock,) = record.clocks
    structure, tried = base_structure(network), []
    for r in [record, *(again(record, {clock: lag}) for lag in others)]:
        weights = plain(0.5 * ROUGH * np.maximum(r.measured.std(axis=0), 1e-300))
        try:
            f = Fitter(Problem(network, [r], ["fit"]), weights).fit(structure, iterations=5)
        except InputError:
            continue
        lag = r.lags[clock] + float(np.clip(f.offset[0][len(network.outputs)], -0.3 * r.pace, 0.3 * r.pace))
        tried.append(((f.cost + f.prior) / len(r), lag))
    if not tried:
        return record, "the model breaks down before anything is fitted"
    least, best = min(tried)
    rivals = [lag for cost, lag in tried if cost < ALIKE * least and abs(lag - best) > record.pace]
    doubt = f"{1e3 * min(rivals, key=abs):.4g} ms would be nearly as good" if rivals else ""
    return again(record, {clock: best}), doubt


def _alike(
    blocks: Mapping[int, tuple[Array, Array, float, int]],
    own: np.ndarray,
    said: np.ndarray,
    grid: np.ndarray,
    reach: float,
    pitch: float,
) -> Array:
    """The lags among a fine row at which simulated and measured channels correlate best."""
    every = np.arange(-reach, reach + pitch, pitch)
    score = np.zeros(len(every))
    for j in own:
        t, v, _, _ = blocks[int(j)]
        x = np.stack([np.interp(t - lag, grid, said[:, int(j)]) for lag in every])
        x = x - x.mean(axis=1, keepdims=True)
        score += (
            x @ (v - v.mean()) / np.maximum(np.linalg.norm(x, axis=1) * np.linalg.norm(v - v.mean()), 1e-300)
        )
    return every[np.sort(np.argsort(-score)[:TRIALS])]


def read_again(record: Record, lags: Mapping[str, float], network: Network) -> Record:
    """The record of its recording with other lags."""
    assert record.source is not None
    return replace(record_of(record.source, network, lags), name=record.name)
