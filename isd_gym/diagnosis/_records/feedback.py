"""Detection of feedback: inputs that follow from past outputs.

An input of an open-loop test is independent of the noise and the disturbances in the outputs. Past outputs then add nothing
to a prediction of the input from its own past. Under feedback they do: the controller answers to what the sensor saw
(Granger 1969). A simulation-error fit of closed-loop records is biased, because the controller's law looks like an element
of the plant.

References:
    Granger, Investigating causal relations by econometric models, Econometrica 37 (1969) 424.
    Ljung, System Identification, 2nd ed. (1999), chapter 13.
    Van den Hof, Closed-loop issues in system identification, Annual Reviews in Control 22 (1998) 173.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from ...physics.network import Network
    from .._simulation.problem import Record

#: Inputs that a controller commands. The motion of a moved node is measured at the node, so the controller of this motion does not
#: affect the relation between motion and outputs.
COMMANDED = ("force", "current")
OWN, OUTPUT = 30, 10  # past samples of the input and of each output in a prediction
LEVELS = 12  # most values of an input that switches
BLOCKS = 20  # blocks in time, alternately for the fit and for the test of a prediction
#: Least share of the unpredicted part of an input that past outputs explain, and significance level of the sign test over blocks:
#: of a linear law, and of levels of the outputs at which an input switches (weaker, since a switch is rare).
LINEAR, RELAY = (0.05, 1e-4), (0.1, 1e-3)
#: Share of an input's power below which its unpredicted part is rounding rather than an answer to anything.
ROUNDING = 1e-7
CYCLES = 6  # earlier intervals from which the next switch is foreseen
AHEAD = (
    0.0,
    0.1,
    0.2,
    0.4,
)  # times ahead of an output as shares of the median interval between switches


@dataclass(frozen=True)
class Feedback:
    """An input that past outputs predict beyond its own past."""

    input: str
    outputs: tuple[str, ...]  # the outputs that predict it
    share: float  # share of the unpredicted part of the input that past outputs explain, on samples not used for the fit
    significance: (
        float  # probability of such a gain in open loop (sign test over blocks)
    )


def find_feedback(records: Sequence[Record], network: Network) -> tuple[Feedback, ...]:
    """Return the commanded inputs that past outputs predict beyond their own past (with the time since the last switch of an input that
    switches), on blocks that took no part in the fit; records with time stamps by channel are left out."""
    usable = [
        r
        for r in records
        if r.reading is None and r.samples == len(r) > 4 * (OWN + OUTPUT)
    ]
    if not usable:
        return ()
    step = max(usable, key=len).step
    usable = [r for r in usable if abs(r.step - step) < 1e-3 * step]
    found = []
    for c in network.inputs:
        if c.quantity not in COMMANDED:
            continue
        every = range(len(network.outputs))
        laws = {
            limits: _gain(usable, c.name, every, relay=limits is RELAY)
            for limits in (LINEAR, RELAY)
        }
        passed = [
            limits
            for limits, (share, chance) in laws.items()
            if share >= limits[0] and chance <= limits[1]
        ]
        if not passed:
            continue
        limits = max(passed, key=lambda law: laws[law][0])
        alone = [_gain(usable, c.name, [j], relay=limits is RELAY)[0] for j in every]
        names = [
            o.name
            for o, s in zip(network.outputs, alone, strict=True)
            if s >= 0.5 * max(alone)
        ]
        found.append(Feedback(c.name, tuple(names), *laws[limits]))
    return tuple(found)


def _gain(
    records: Sequence[Record], name: str, outputs: Sequence[int], *, relay: bool
) -> tuple[float, float]:
    """Return the share of the own prediction's squared error that past outputs (with `relay`: their levels at switches) remove, and the
    probability of as many improved blocks without feedback."""
    own, more, target = [], [], []
    for r in records:
        u = r.inputs[name] - r.inputs[name].mean()
        own.append(np.concatenate([_past(u, OWN, OWN), _switching(u)], axis=1))
        y = r.measured[:, list(outputs)]
        y = (y - y.mean(axis=0)) / np.maximum(y.std(axis=0), 1e-300)
        answers = [_crossing(u, x) if relay else _past(x, OUTPUT, OWN) for x in y.T]
        more.append(np.concatenate(answers, axis=1))
        target.append(u[OWN:])
    widths = [max(m.shape[1] for m in parts) for parts in (own, more)]
    A, B = (
        np.concatenate([np.pad(m, ((0, 0), (0, width - m.shape[1]))) for m in parts])
        for parts, width in zip((own, more), widths, strict=True)
    )
    t = np.concatenate(target)
    block = np.asarray(np.arange(len(t)) * BLOCKS // len(t), float)
    before, after = (
        _unpredicted(X, t, block) for X in (A, np.concatenate([A, B], axis=1))
    )
    if not before.sum() > ROUNDING * np.sum(t**2):
        return 0.0, 1.0
    parts = [(before[block == k].sum(), after[block == k].sum()) for k in range(BLOCKS)]
    shares = [1.0 - a / b for b, a in parts if b > ROUNDING * np.sum(t**2) / BLOCKS]
    if len(shares) < BLOCKS / 2:
        return 0.0, 1.0
    better = sum(s > 0 for s in shares)
    chance = sum(
        math.comb(len(shares), k) for k in range(better, len(shares) + 1)
    ) / 2.0 ** len(shares)
    return float(np.mean(np.maximum(shares, -1.0))), chance


def _past(x: Array, count: int, start: int) -> Array:
    """Return the `count` samples before each sample from `start` on (samples - start, count)."""
    return np.stack([x[start - k : len(x) - k] for k in range(1, count + 1)], axis=1)


def _edges(u: Array) -> list[int]:
    """Return the first sample of each interval of an input that switches, and its length; empty for any other input."""
    switches = np.flatnonzero(np.diff(u) != 0) + 1
    if not 2 <= len(np.unique(u)) <= LEVELS or len(switches) < 3:
        return []
    return [0, *switches.tolist(), len(u)]


def _crossing(u: Array, y: Array) -> Array:
    """Return whether an output, or the output some time ahead along its slope, has reached the level of earlier switches (samples - OWN,
    columns); no columns for an input that does not switch."""
    edges, n = _edges(u), len(u)
    if not edges:
        return np.zeros((n - OWN, 0))
    usual = float(np.median(np.diff(edges)))
    k = max(1, round(usual / 16))
    slope = np.zeros(n)
    slope[k:] = (y[k:] - y[:-k]) / k
    values = np.unique(u)
    out = np.zeros((n, len(values) * len(AHEAD)))
    for j, share in enumerate(AHEAD):
        z = y + share * usual * slope
        known: dict[float, list[tuple[float, float]]] = {float(v): [] for v in values}
        for a, b in zip(edges[:-1], edges[1:], strict=True):
            earlier = known[float(u[a])][-CYCLES:]
            if earlier:
                level, middle = np.mean(earlier, axis=0)
                column = len(AHEAD) * int(np.searchsorted(values, u[a])) + j
                out[a:b, column] = (z[a:b] - level) * np.sign(level - middle) >= 0
            known[float(u[a])].append((float(z[b - 1]), float(np.mean(z[a:b]))))
    return out[OWN - 1 : n - 1]


def _switching(u: Array) -> Array:
    """Return what the past of an input that switches tells about its next switch, for each value (samples - OWN, columns): times since
    the last switch beside the last, the mean and the common interval."""
    n, values, edges = len(u), np.unique(u), _edges(u)
    if not edges:
        return np.zeros((n - OWN, 0))
    intervals = np.diff(edges)[1:-1]
    clock, usual = int(np.gcd.reduce(intervals)), float(np.median(intervals))
    since, last, mean = np.zeros(n), np.zeros(n), np.zeros(n)
    known: dict[float, list[int]] = {float(v): [] for v in values}
    for k, (a, b) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
        earlier = known[float(u[a])]
        since[a:b] = np.arange(1, b - a + 1)
        last[a:b] = earlier[-1] if earlier else usual
        mean[a:b] = np.mean(earlier[-CYCLES:]) if earlier else usual
        if k:  # nobody knows when the first interval began
            earlier.append(b - a)
    now = slice(OWN - 1, n - 1)  # known before the sample that is predicted
    r = since[now]
    columns = (
        np.ones(len(r)),
        r / usual,
        (r / usual) ** 2,
        r >= last[now],
        r % clock == 0,
        (r - mean[now]) / usual,
    )
    return np.stack([(u[now] == v) * c for v in values for c in columns], axis=1)


def _unpredicted(X: Array, t: Array, block: Array) -> Array:
    """Return squared errors (samples,) of a least-squares prediction of `t` by `X`, fitted on the blocks of the other parity."""
    out = np.empty(len(t))
    for parity in (0, 1):
        test = block % 2 == parity
        size = np.linalg.norm(X[~test], axis=0)
        size[size == 0] = 1.0
        w = np.linalg.lstsq(X[~test] / size, t[~test], rcond=1e-12)[0] / size
        out[test] = (t[test] - X[test] @ w) ** 2
    return out
