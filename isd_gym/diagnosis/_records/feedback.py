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
from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

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


@dataclass(frozen=True)
class Feedback:
    """An input that past outputs predict beyond its own past."""

    input: str
    #: outputs that predict the input
    outputs: tuple[str, ...]
    #: share of the unpredicted part of the input that past outputs explain, on samples not used for the fit
    share: float
    #: probability of such a gain in open loop (sign test over blocks)
    significance: float


def find_feedback(records: Sequence[Record], network: Network) -> tuple[Feedback, ...]:
    """Return the commanded inputs that past outputs predict beyond their own past (with the time since the last switch of an input that
    switches), on blocks that took no part in the fit; resampled records are left out."""
    usable = [
        r
        for r in records
        if r.source is None and r.samples == len(r) > 4 * (OWN + OUTPUT)
    ]
    step = max(usable, key=len).step if usable else 0.0
    usable = [r for r in usable if abs(r.step - step) < 1e-3 * step]
    found = []
    for c in network.inputs:
        if usable and c.quantity in COMMANDED:
            found += _feedback_to(c.name, usable, [o.name for o in network.outputs])
    return tuple(found)


def _feedback_to(
    name: str, records: Sequence[Record], outputs: Sequence[str]
) -> list[Feedback]:
    """Return the law that predicts an input best, linear or of a relay; empty where neither predicts the input."""
    every = range(len(outputs))
    best = 0.0
    found = []
    for answer, (least, most) in ((_past_output, LINEAR), (_reached_level, RELAY)):
        share, chance = _gain(records, name, every, answer)
        if share < max(least, best) or chance > most:
            continue
        best = share
        alone = [_gain(records, name, [j], answer)[0] for j in every]
        leading = [outputs[j] for j in every if alone[j] >= 0.5 * max(alone)]
        found = [Feedback(name, tuple(leading), share, chance)]
    return found


def _gain(
    records: Sequence[Record],
    name: str,
    outputs: Sequence[int],
    answer: Callable[[Array, Array], Array],
) -> tuple[float, float]:
    """Return the share of the own prediction's squared error that an `answer` to past outputs removes, and the probability of as many
    improved blocks without feedback."""
    own, more, target = [], [], []
    for r in records:
        u = r.inputs[name] - r.inputs[name].mean()
        own.append(np.concatenate([_past(u, OWN), _switching(u)], axis=1))
        y = r.measured[:, list(outputs)]
        y = (y - y.mean(axis=0)) / np.maximum(y.std(axis=0), 1e-300)
        more.append(np.concatenate([answer(u, x) for x in y.T], axis=1))
        target.append(u[OWN:])
    past, t = _stacked(own), np.concatenate(target)
    block = np.arange(len(t)) * BLOCKS // len(t)
    before = _unpredicted(past, t, block)
    after = _unpredicted(np.concatenate([past, _stacked(more)], axis=1), t, block)
    rounding = ROUNDING * np.sum(t**2)
    if not before.sum() > rounding:
        return 0.0, 1.0
    errors = np.array([np.bincount(block, e) for e in (before, after)])
    errors = errors[:, errors[0] > rounding / BLOCKS]
    shares = 1.0 - errors[1] / errors[0]
    count = len(shares)
    if count < BLOCKS / 2:
        return 0.0, 1.0
    better = int(np.sum(shares > 0))
    ways = sum(math.comb(count, k) for k in range(better, count + 1))
    return float(np.mean(np.maximum(shares, -1.0))), ways / 2.0**count


def _stacked(parts: Sequence[Array]) -> Array:
    """Return the regressors of all records in a sequence, with zeros for missing columns."""
    width = max(m.shape[1] for m in parts)
    return np.concatenate([np.pad(m, ((0, 0), (0, width - m.shape[1]))) for m in parts])


def _past(x: Array, count: int) -> Array:
    """Return the `count` samples before each sample from `OWN` on (samples - OWN, count)."""
    return np.stack([x[OWN - k : len(x) - k] for k in range(1, count + 1)], axis=1)


def _past_output(_: Array, y: Array) -> Array:
    """Return the past samples of an output (samples - OWN, OUTPUT), to which a linear law answers."""
    return _past(y, OUTPUT)


def _intervals(u: Array) -> list[tuple[int, int, int]]:
    """Return first sample, end and index of the value of each interval of an input that switches; empty for any other input."""
    values, level = np.unique(u, return_inverse=True)
    edges = [0, *(np.flatnonzero(np.diff(level)) + 1).tolist(), len(u)]
    if not 2 <= len(values) <= LEVELS or len(edges) < 5:
        return []
    return [(a, b, int(level[a])) for a, b in pairwise(edges)]


def _reached_level(u: Array, y: Array) -> Array:
    """Return whether an output has reached the level of earlier switches, a column for each value of the input (samples - OWN, values); no
    columns for an input that does not switch."""
    intervals = _intervals(u)
    count = 1 + max((k for _, _, k in intervals), default=-1)
    out = np.zeros((len(u), count))
    known: dict[int, list[tuple[float, float]]] = defaultdict(list)
    for a, b, k in intervals:
        if known[k]:
            level, middle = np.mean(known[k][-CYCLES:], axis=0)
            out[a:b, k] = (y[a:b] - level) * np.sign(level - middle) >= 0
        known[k].append((float(y[b - 1]), float(np.mean(y[a:b]))))
    return out[OWN - 1 : -1]


def _switching(u: Array) -> Array:
    """Return what the past of an input that switches tells about its next switch, for each value (samples - OWN, columns): times since
    the last switch beside the last, the mean and the common interval."""
    intervals = _intervals(u)
    if not intervals:
        return np.zeros((len(u) - OWN, 0))
    lengths = [b - a for a, b, _ in intervals[1:-1]]
    clock, usual = int(np.gcd.reduce(lengths)), float(np.median(lengths))
    # value, time since the last switch, last and mean interval with this value
    state = np.zeros((len(u), 4))
    known: dict[int, list[float]] = defaultdict(list)
    for a, b, k in intervals:
        earlier = known[k][-CYCLES:] or [usual]
        state[a:b, 0] = k
        state[a:b, 1] = np.arange(1, b - a + 1)
        state[a:b, 2:] = earlier[-1], np.mean(earlier)
        if a:  # nobody knows when the first interval began
            known[k].append(b - a)
    # known before the sample that is predicted
    value, since, last, mean = state[OWN - 1 : -1].T
    columns = (
        np.ones(len(since)),
        since / usual,
        (since / usual) ** 2,
        since >= last,
        since % clock == 0,
        (since - mean) / usual,
    )
    return np.stack(
        [(value == k) * c for k in np.unique(state[:, 0]) for c in columns], axis=1
    )


def _unpredicted(X: Array, t: Array, block: NDArray[np.int_]) -> Array:
    """Return squared errors (samples,) of a least-squares prediction of `t` by `X`, fitted on the blocks of the other parity."""
    out = np.empty(len(t))
    for parity in (0, 1):
        test = block % 2 == parity
        size = np.linalg.norm(X[~test], axis=0)
        size[size == 0] = 1.0
        w = np.linalg.lstsq(X[~test] / size, t[~test], rcond=1e-12)[0] / size
        out[test] = (t[test] - X[test] @ w) ** 2
    return out
