"""Parameters of a model that differ between records.

A payload, a temperature or wear may change between two tests. Then no law explains the records together, and each record alone fits. The
records are cut into stretches, alternately for fitting and for comparison. The smallest set of parameters is searched that, with one value
per record, removes most of the error that one value for all records leaves on the stretches for comparison.

The deviation of a value comes from the scatter of the stretches of its record (sandwich estimator with one cluster per stretch; Liang and
Zeger, Biometrika 73, 1986). A parameter that varies within the records as much as between the records does not differ between records.

Parameters of a group of records have the stated uncertainty as prior, each group for itself (no pooling; Gelman and Hill, Data Analysis
Using Regression and Multilevel/Hierarchical Models, 2007, chapter 12).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import t as student

from ..._common.errors import InputError
from .._estimation.gauss_newton import Fitter
from .._estimation.initial_states import next_states
from .._estimation.least_squares import bounded_step, damped_step
from .._estimation.noise import white_weights
from .._simulation.problem import BROKEN, Problem
from ..result import DifferingParameter, Quantity, RecordDifferences, is_far_better

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from ..._common.arrays import Array
    from .._estimation.gauss_newton import Point, Slope
    from .._estimation.structure import Structure
    from .._simulation.problem import Record

#: largest and smallest number of stretches of a record
MOST_STRETCHES, LEAST_STRETCHES = 8, 4
#: length of a stretch as a multiple of the time scale (three periods), and the least length of the stretches of a short record
USUAL_TIME, LEAST_TIME = 20.0, 1.0
#: least number of samples of a stretch
LEAST_SAMPLES = 50
#: largest number of parameters that differ; sets of each size that are fitted
MOST_DIFFERING, SETS = 2, 2
#: squared error of one value for all records, over that of noise, below which no difference is searched
LEAST_GAP = 2.0
#: share of the squared error beyond noise that values per record must remove on the stretches for comparison
LEAST_EXPLAINED = 0.35
#: share of the largest gain that a set of parameters must reach
MOST_OF_GAIN = 0.75
#: gain of a law over the gain of values per record, above which the law goes before the difference
LAW_BETTER = 1.1
#: share of the squared error beyond noise from which on a law goes before, unless values per record leave far less (`is_far_better`)
LAW_ADEQUATE = 0.75
#: probability of a chance difference between two records, for the first difference and for a further group
CHANCE, CHANCE_WITHIN = 1e-3, 1e-2
#: smallest material difference, as the distance of logarithms or relative to the value
LEAST_DIFFERENCE = 0.02
#: largest number of steps of the fit of an initial state
STATE_STEPS = 8
#: noise of the first fit, as a share of the deviation of a channel
FIRST_NOISE = 0.05
#: largest step of a parameter that is a logarithm
LARGEST_STEP = 1.5


@dataclass(frozen=True, eq=False)
class RecordwiseFit:
    """A fit with some parameters of their own for each group of records."""

    structure: Structure
    #: transformed parameters of each group (groups, parameters)
    x: Array
    #: mask of the parameters with a value per group (parameters,)
    own: NDArray[np.bool_]
    #: fitted point of each group
    points: tuple[Point, ...]
    #: derivatives by record, of each group, at the last point at which they were computed
    slopes: tuple[Mapping[int, Slope], ...]


class RecordwiseFitter(Fitter):
    """Gauss-Newton fits of parameters that groups of records share or have for themselves."""

    def fit_groups(
        self,
        structure: Structure,
        x: Array,
        groups: Sequence[Sequence[int]],
        own: NDArray[np.bool_],
        *,
        iterations: int = 8,
        tolerance: float = 1e-3,
    ) -> RecordwiseFit:
        """Fit a structure without shared offsets to groups of records, from transformed start values; `own` marks the parameters with a
        value per group."""
        layout = _Layout(structure, own, len(groups))
        z = layout.pack(np.broadcast_to(x, (len(groups), len(own))))
        each = layout.unpack(z)
        points = [self.begin(structure, row, None, None, g) for row, g in zip(each, groups, strict=True)]
        damping, cost, slopes = 1e-4, math.inf, []
        for turn in range(iterations + 1):
            fresh = [self.slopes(structure, p, g, True) for p, g in zip(points, groups, strict=True)]
            if any(s is None for s in fresh):
                if turn == 0:
                    raise InputError("the simulation breaks down at the start values")
                break
            slopes = [s for s in fresh if s is not None]
            now = self._total(points, layout, z)
            has_converged = turn > 0 and now > (1.0 - tolerance) * cost
            cost = now
            if has_converged or turn == iterations:
                break
            found, _, damping = self._step_groups(structure, points, groups, slopes, layout, z, cost, damping)
            if found is None:
                break
            z, points = found
        return RecordwiseFit(structure, layout.unpack(z), own, tuple(points), tuple(slopes))

    def gradient(self, point: Point, slopes: Mapping[int, Slope]) -> dict[int, Array]:
        """Return the descent direction of half the cost of each record (parameters,), nuisances eliminated."""
        out = {}
        for i, s in slopes.items():
            down, p = self._downhill(point, i, s), len(s.gram) - len(s.own)
            g = down[:p]
            if len(s.own):
                g = g - s.gram[:p, p:] @ np.linalg.solve(s.own, down[p:])
            out[i] = g
        return out

    def information(self, slopes: Mapping[int, Slope]) -> dict[int, Array]:
        """Return the information of each record on the parameters (parameters, parameters), nuisances eliminated."""
        return {i: self._hessian({i: s}) for i, s in slopes.items()}

    def _total(self, points: Sequence[Point], layout: _Layout, z: Array) -> float:
        return sum(sum(p.costs.values()) for p in points) + layout.prior(z)

    def _step_groups(
        self,
        structure: Structure,
        points: Sequence[Point],
        groups: Sequence[Sequence[int]],
        slopes: Sequence[Mapping[int, Slope]],
        layout: _Layout,
        z: Array,
        cost: float,
        damping: float,
    ) -> tuple[tuple[Array, list[Point]] | None, float, float]:
        """Return the parameters and points with a smaller cost, or None, the cost, and the next damping."""
        H, g = np.diag(1.0 / layout.sigma**2), (layout.mean - z) / layout.sigma**2
        for k, (point, own) in enumerate(zip(points, slopes, strict=True)):
            place = layout.index[k]
            H[np.ix_(place, place)] += self._hessian(own)
            g[place] += np.sum(list(self.gradient(point, own).values()), axis=0)

        def take(damping: float) -> tuple[tuple[Array, list[Point]], float]:
            then = z + bounded_step(H, g, z, layout.low, layout.high, layout.stride(z), damping)
            moved = []
            for k, (point, own, row) in enumerate(zip(points, slopes, layout.unpack(then), strict=True)):
                p, step = len(row), row - point.x
                moves = {
                    i: np.linalg.solve(s.own, self._downhill(point, i, s)[p:] - s.gram[p:, :p] @ step)
                    for i, s in own.items()
                }
                moved.append(self.seen(structure, self._moved(point, row, moves), groups[k]))
            return (then, moved), self._total(moved, layout, then)

        return damped_step(take, cost, damping, tries=6)


class _Layout:
    """Order in one vector of shared parameters, then those of each group (mask `own`)."""

    def __init__(self, structure: Structure, own: NDArray[np.bool_], count: int):
        p, shared = len(own), int(np.sum(~own))
        each = p - shared
        #: position of each parameter of each group (groups, parameters)
        self.index = np.empty((count, p), dtype=int)
        self.index[:, ~own] = np.arange(shared)
        self.index[:, own] = shared + each * np.arange(count)[:, None] + np.arange(each)
        size = shared + each * count
        source = np.empty(size, dtype=int)
        source[self.index] = np.arange(p)
        free = [structure.free[k] for k in source]
        self.mean, self.sigma = structure.mean[source], structure.sigma[source]
        self.low, self.high = np.array([f.low for f in free]), np.array([f.high for f in free])
        self._stride = np.array([min(f.stride, LARGEST_STEP if f.log else math.inf) for f in free])

    def pack(self, x: Array) -> Array:
        """Return the vector of the parameters (groups, parameters); shared parameters are those of the first group."""
        z = np.empty(len(self.mean))
        for place, row in zip(self.index[::-1], x[::-1], strict=True):
            z[place] = row
        return z

    def unpack(self, z: Array) -> Array:
        """Return the parameters of each group (groups, parameters)."""
        return np.asarray(z[self.index])

    def stride(self, z: Array) -> Array:
        """Return the largest permitted steps."""
        wide = 3.0 * np.maximum(np.abs(z), self.sigma)
        return np.where(np.isfinite(self._stride), self._stride, wide)

    def prior(self, z: Array) -> float:
        """Return the cost of the prior."""
        return float(np.sum(((z - self.mean) / self.sigma) ** 2))


@dataclass(frozen=True, eq=False)
class _Stretches:
    """Stretches of whole records, alternately for fitting and for comparison."""

    problem: Problem
    #: names of the whole records
    names: tuple[str, ...]
    #: deviation of each channel in each whole record (channels,)
    deviations: tuple[Array, ...]
    #: indices of the stretches of each whole record
    groups: tuple[tuple[int, ...], ...]

    @property
    def fitted(self) -> list[list[int]]:
        """Stretches for fitting, by whole record."""
        return [list(g[::2]) for g in self.groups]

    @property
    def compared(self) -> list[list[int]]:
        """Stretches for comparison, by whole record."""
        return [list(g[1::2]) for g in self.groups]


def cut_into_stretches(whole: Problem, lead: float = 0.0) -> _Stretches | None:
    """Cut whole records into an even number of stretches of equal length, with a lead [s]; None for fewer than two records of sufficient length."""
    loose = whole.loose
    pieces: list[Record] = []
    groups, names, deviations = [], [], []
    # sorted by content: results do not depend on the order of the files
    for r in sorted(loose.records, key=lambda r: (r.name, r.measured.shape, r.measured.tobytes())):
        times = len(r) * r.interval / whole.time
        count = int(min(MOST_STRETCHES, max(times / USUAL_TIME, LEAST_STRETCHES)))
        count = min(count, int(times / LEAST_TIME), len(r) // LEAST_SAMPLES)
        count -= count % 2
        if count < LEAST_STRETCHES:
            continue
        edges = np.linspace(0, len(r), count + 1).astype(int)
        groups.append(tuple(range(len(pieces), len(pieces) + count)))
        pieces += [r.part(a, b, r.name, int(lead / r.interval)) for a, b in pairwise(edges)]
        names.append(r.name)
        deviations.append(r.measured.std(axis=0))
    if len(groups) < 2:
        return None
    problem = Problem(loose.network, pieces, None, loose.step, whole.time)
    return _Stretches(problem, tuple(names), tuple(deviations), tuple(groups))


@dataclass(eq=False)
class RecordComparison:
    """Comparison of one value for all records with one value per record, over stretches, from refitted parameters and noise
    (channels,)."""

    stretches: _Stretches
    structure: Structure
    x: Array
    noise: Array

    def __post_init__(self) -> None:
        p = self.stretches.problem
        self.deviation = p.deviation()
        first = RecordwiseFitter(p, white_weights(np.maximum(self.noise, FIRST_NOISE * self.deviation)))
        joint = self._fit(first, self.structure, self.x)
        rows = [p.records[i].measured - at.outputs[i] for at in joint.points for i in at.outputs]
        #: standard deviations that weight the channels (channels,)
        self.weights = np.maximum(np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0)), self.noise)
        self.fitter = RecordwiseFitter(p, white_weights(self.weights))
        self.joint = self._fit(self.fitter, self.structure, joint.x[0])
        #: squared errors of one value for all records on the stretches for comparison (channels,)
        self.joint_squares = self.squares(self.joint)
        #: square of the noise (channels,); at most the smallest squared error of a fit, since a bound of the noise may contain motion
        self.floor = np.minimum(self.noise**2, self.joint_squares)

    def _fit(
        self, fitter: RecordwiseFitter, structure: Structure, x: Array, own: NDArray[np.bool_] | None = None
    ) -> RecordwiseFit:
        own = np.zeros(len(structure.free), bool) if own is None else own
        return fitter.fit_groups(structure, x, self.stretches.fitted, own)

    def squares(self, fit: RecordwiseFit) -> Array:
        """Return the mean squared errors on the stretches for comparison (channels,), initial states from each stretch."""
        rows, problem = [], self.stretches.problem
        for x, at, group in zip(fit.x, fit.points, self.stretches.compared, strict=True):
            # each stretch for comparison follows a fitted one, whose final state is a further start
            ends = next_states(problem, fit.structure, x, at.initial)
            known = {i: ends[i - 1] for i in group}
            found = self.fitter.follow(fit.structure, x, group, None, (known,), iterations=STATE_STEPS)
            rows += [problem.records[i].measured - found.outputs[i] for i in group]
        return np.asarray(np.mean(np.concatenate(rows) ** 2, axis=0), dtype=np.float64)

    def mean(self, squares: Array) -> float:
        """Return the mean over channels of squared errors (channels,), relative to the weights."""
        return float(np.mean(squares / self.weights**2))

    def lower_floor(self, squares: Array) -> None:
        """Lower the noise to the squared errors (channels,) of a fit."""
        self.floor = np.minimum(self.floor, squares)

    def explained(self, squares: Array) -> float:
        """Return the share of the joint fit's squared error beyond noise that a fit with these squared errors (channels,) removes."""
        joint, noise = self.mean(self.joint_squares), self.mean(self.floor)
        return (joint - self.mean(squares)) / max(joint - noise, 1e-12)

    def fit_with_own(self, names: Sequence[int]) -> RecordwiseFit:
        """Fit with one value per record of some parameters."""
        own = np.zeros(len(self.structure.free), bool)
        own[list(names)] = True
        return self._fit(self.fitter, self.structure, self.joint.x[0], own)

    def squares_of_law(self, structure: Structure, x: Array) -> Array:
        """Return the squared errors (channels,) of a model with more effects, with one value for all records."""
        return self.squares(self._fit(self.fitter, structure, x))

    def is_promising(self, names: Sequence[int]) -> bool:
        """Return whether one value per record of some parameters may, to first order, remove half of what a difference must."""
        cost = sum(sum(at.costs.values()) for at in self.joint.points)
        samples = sum(len(self.stretches.problem.records[i]) for at in self.joint.points for i in at.outputs)
        beyond = cost - samples * float(np.sum(self.floor / self.weights**2))
        return self.expected_gains(len(names))[0][0] >= 0.5 * LEAST_EXPLAINED * max(beyond, 0.0)

    def expected_gains(self, size: int) -> list[tuple[float, tuple[int, ...]]]:
        """Return sets of parameters with their gain of one value per record, to first order, largest gain first."""
        joint = self.joint
        H = [np.sum(list(self.fitter.information(s).values()), axis=0) for s in joint.slopes]
        g = [
            np.sum(list(self.fitter.gradient(at, s).values()), axis=0)
            for at, s in zip(joint.points, joint.slopes, strict=True)
        ]
        prior = 1.0 / self.structure.sigma**2
        out = []
        for names in combinations(range(len(prior)), size):
            own = list(names)
            rest = [k for k in range(len(prior)) if k not in names]
            matrix = np.sum([h[np.ix_(rest, rest)] for h in H], axis=0) + np.diag(prior[rest])
            right = np.sum([b[rest] for b in g], axis=0)
            gain = 0.0
            for h, b in zip(H, g, strict=True):
                inside = np.linalg.inv(h[np.ix_(own, own)] + np.diag(prior[own]))
                matrix = matrix - h[np.ix_(rest, own)] @ inside @ h[np.ix_(own, rest)]
                right = right - h[np.ix_(rest, own)] @ inside @ b[own]
                gain += float(b[own] @ inside @ b[own])
            if rest:
                gain += float(right @ np.linalg.lstsq(matrix, right, rcond=None)[0])
            out.append((gain, names))
        return sorted(out, key=lambda e: (-e[0], e[1]))

    def estimates(self, fit: RecordwiseFit, name: int) -> tuple[Array, Array, Array]:
        """Return the values of a parameter in the records, transformed, their deviations and degrees of freedom, each (records,)."""
        groups = self.stretches.groups
        rows = [
            self.stretches.problem.records[i].measured - at.outputs[i]
            for at in fit.points
            for i in at.outputs
        ]
        noise = np.maximum(np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0)), np.sqrt(self.floor))
        fitter = RecordwiseFitter(self.stretches.problem, white_weights(noise))
        final = fitter.fit_groups(fit.structure, fit.x, groups, fit.own)
        own = np.flatnonzero(fit.own)
        k = int(np.flatnonzero(own == name)[0])
        deviation = np.empty(len(groups))
        for n, (at, slopes) in enumerate(zip(final.points, final.slopes, strict=True)):
            scores = np.array([g[own] for g in fitter.gradient(at, slopes).values()])
            each = np.array([h[np.ix_(own, own)] for h in fitter.information(slopes).values()])
            inverse = np.linalg.pinv(each.sum(axis=0))
            # the prior leaves a gradient at the optimum
            scores = scores - each @ (inverse @ scores.sum(axis=0))
            m = len(scores)
            spread = inverse @ (scores.T @ scores * m / (m - 1)) @ inverse
            deviation[n] = np.sqrt(max(spread[k, k], inverse[k, k]))
        return final.x[:, name], deviation, np.array([len(g) - 1.0 for g in groups])


def is_different(a: tuple[float, float, float], b: tuple[float, float, float], chance: float) -> bool:
    """Return whether two values differ (Welch's t-test, two-sided)."""
    square = a[1] ** 2 + b[1] ** 2
    freedom = square**2 / (a[1] ** 4 / a[2] + b[1] ** 4 / b[2])
    return bool(abs(a[0] - b[0]) > student.ppf(1.0 - 0.5 * chance, freedom) * np.sqrt(square))


def group_values(values: Array, deviations: Array, freedom: Array) -> tuple[int, ...]:
    """Return the group of each record, smallest values first: neighbouring values without a significant difference share a group; all zero
    where no pair differs."""
    each = list(zip(values.tolist(), deviations.tolist(), freedom.tolist(), strict=True))
    pairs = len(each) * (len(each) - 1) / 2
    if not any(is_different(a, b, CHANCE / pairs) for a, b in combinations(each, 2)):
        return (0,) * len(each)
    order = sorted(range(len(each)), key=lambda i: each[i])
    out, group, members = [0] * len(each), 0, [order[0]]
    for i in order[1:]:
        if all(is_different(each[i], each[j], CHANCE_WITHIN) for j in members):
            group, members = group + 1, []
        members.append(i)
        out[i] = group
    return tuple(out)


def find_record_differences(
    whole: Problem,
    structure: Structure,
    x: Array,
    noise: Array,
    laws: Sequence[tuple[str, Structure, Array]] = (),
    lead: float = 0.0,
) -> RecordDifferences | None:
    """Return the parameters with different values in the records; None for short or equal records, or where a law explains more."""
    stretches = cut_into_stretches(whole, lead)
    if stretches is None or not structure.free:
        return None
    try:
        comparison = RecordComparison(stretches, structure, x, noise)
        every = tuple(range(len(structure.free)))
        if not comparison.is_promising(every):
            return None
        alone = comparison.fit_with_own(every)
        fits = {every: (alone, comparison.squares(alone))}
        comparison.lower_floor(fits[every][1])
        for size in range(1, min(MOST_DIFFERING, len(every) - 1) + 1):
            for _, names in comparison.expected_gains(size)[:SETS]:
                fit = comparison.fit_with_own(names)
                fits[names] = fit, comparison.squares(fit)
                comparison.lower_floor(fits[names][1])
                gains = {key: comparison.explained(squares) for key, (_, squares) in fits.items()}
                # where values per record gain little, no further set is tried
                if not max(gains.values()) >= 0.5 * LEAST_EXPLAINED:
                    return None
        if comparison.mean(comparison.joint_squares) < LEAST_GAP * comparison.mean(comparison.floor):
            return None
        gains = {key: comparison.explained(squares) for key, (_, squares) in fits.items()}
        needed = max(LEAST_EXPLAINED, MOST_OF_GAIN * max(gains.values()))
        enough = [(len(k), -g, k) for k, g in gains.items() if g >= needed and len(k) <= MOST_DIFFERING]
        if not enough:
            return None
        names = min(enough)[2]
        found = tuple(p for k in names if (p := _differing(comparison, fits[names][0], k)) is not None)
        if not found:
            return None
        gain = gains[names]
        law, by_law = _best_law(comparison, laws)
        least = min(LAW_BETTER * gain, LAW_ADEQUATE)
        if by_law is not None and by_law >= least and not is_far_better(gain, by_law):
            return None
        squares = {
            "joint": comparison.joint_squares,
            "differing": fits[names][1],
            "alone": fits[every][1],
        }
    except BROKEN:
        return None
    return RecordDifferences(
        found,
        stretches.names,
        tuple(
            {c: float(v) for c, v in zip(whole.channels, row, strict=True)} for row in stretches.deviations
        ),
        gain,
        law,
        by_law,
        {
            stage: {
                c: float(v)
                for c, v in zip(whole.channels, np.sqrt(square) / comparison.deviation, strict=True)
            }
            for stage, square in squares.items()
        },
    )


def _best_law(
    comparison: RecordComparison, laws: Sequence[tuple[str, Structure, Array]]
) -> tuple[str | None, float | None]:
    """Return the law with the largest explained share, one value for all records, and the share; None where no law can be simulated."""
    found = []
    for name, structure, x in laws:
        try:
            found.append((comparison.explained(comparison.squares_of_law(structure, x)), name))
        except BROKEN:
            continue
    if not found:
        return None, None
    share, name = max(found)
    return name, share


def _differing(comparison: RecordComparison, fit: RecordwiseFit, name: int) -> DifferingParameter | None:
    """Return a parameter with its values per record; None where no two records differ by a material amount."""
    free = fit.structure.free[name]
    values, deviations, freedom = comparison.estimates(fit, name)
    groups = group_values(values, deviations, freedom)
    scale = 1.0 if free.log else max(float(np.max(np.abs(values))), 1e-300)
    if not max(groups) or float(np.ptp(values)) < LEAST_DIFFERENCE * scale:
        return None
    network = fit.structure.network
    unit, prior = network.unit_of(free.path), network.parameters[free.path]
    quantities = []
    for v, s, n in zip(values, deviations, freedom, strict=True):
        # the 95 % interval of Student's t
        wide = float(s * student.ppf(0.975, n) / student.ppf(0.975, 1e9))
        quantities.append(Quantity(free.back(float(v)), *free.interval(float(v), wide), unit, prior))
    return DifferingParameter(free.path, tuple(quantities), groups)
