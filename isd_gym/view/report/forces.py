"""Forces between two nodes over the motion of the nodes: measured, and reconstructed from residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from ..._common.units import convert
from ...diagnosis._estimation.gauss_newton import Fitter
from ...diagnosis._estimation.noise import white_weights
from ...diagnosis._estimation.structure import base_structure
from ...diagnosis._hypotheses.motion import motions
from ...diagnosis._hypotheses.pair_forces import reconstruct_force
from ...diagnosis._simulation.problem import Problem, Record
from ...physics.network import GROUND, Network
from ...physics.simulate import pace

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..._common.arrays import Array
    from ...diagnosis.result import Diagnosis, Trace

#: share of a record at either end in which the reconstruction fades out
TAPER = 20
#: points of the curve of a law: a cogging may have dozens of periods
GRID = 1601


@dataclass(frozen=True)
class Curve:
    """A force over the motion of its terminals, sample by sample."""

    travel: Array  # elongation (n,) [m]
    rate: Array  # rate of elongation (n,) [m/s]
    force: Array  # force (n,) [N], positive in tension

    def part(self, samples: slice) -> Curve:
        """Return the curve of some samples."""
        return Curve(self.travel[samples], self.rate[samples], self.force[samples])


@dataclass(frozen=True)
class Loops:
    """The measured force between two nodes and the forces of the models, over the motion of the nodes."""

    name: str  # name of the channel
    pair: tuple[str, str]  # the two nodes
    measured: Curve  # measured force
    nominal: Curve | None  # model as given; None where it cannot be simulated
    new: Curve  # completed model, or the refitted model where nothing is added


@dataclass(frozen=True)
class Law:
    """Force of an effect over elongation or rate, with its 95 % band."""

    element: str  # name of the element in the new model
    kind: str  # 'rate' or 'travel'
    axis: Array  # rate [m/s] or elongation [m] (n,)
    force: Array  # force [N] (n,)
    low: Array  # lower end of the band [N] (n,)
    high: Array  # upper end of the band [N] (n,)
    visited: Array  # operating points of the completed model, in the unit of `axis`


@dataclass(frozen=True)
class Missing:
    """The force between two nodes that the refitted model lacks, reconstructed from the residuals."""

    pair: tuple[str, str]  # the two nodes
    curve: Curve  # the force over the motion of the nodes


def laws_of(d: Diagnosis, trace: Trace) -> list[Law]:
    """Return the curves of the named effects, where a law over rate or elongation gives them."""
    out = []
    for effect in d.effects:
        if effect.between is None:
            continue
        e = d.model.element(effect.element)
        if e.place != "between" or e.plane == "time":
            continue
        try:
            travel, rate = _motion(d.model, trace, e.between)
        except (InputError, np.linalg.LinAlgError):
            continue
        visited = rate if e.plane == "rate" else travel
        reach = float(np.quantile(np.abs(visited), 0.999)) or 1e-6
        axis = np.linspace(-reach, reach, GRID)
        middle = e.curve(axis)
        spread = np.zeros(GRID)
        for key, q in effect.parameters.items():
            for value in (q.low, q.high):
                try:
                    changed = d.model.with_parameters({f"{e.name}.{key}": value})
                except InputError:
                    continue
                spread = np.maximum(
                    spread, np.abs(changed.element(e.name).curve(axis) - middle)
                )
        kind = "rate" if e.plane == "rate" else "travel"
        out.append(
            Law(e.name, kind, axis, middle, middle - spread, middle + spread, visited)
        )
    return out


def missing_force(d: Diagnosis, trace: Trace) -> Missing | None:
    """Return the missing force at the first place of the finding that allows a reconstruction; None without such a place."""
    for pair in _places(d):
        try:
            return _reconstructed(d, trace, pair)
        except (InputError, np.linalg.LinAlgError):
            continue
    return None


def _places(d: Diagnosis) -> list[tuple[str, str]]:
    """Return the pairs of nodes of the finding, or of the best candidate where nothing is found."""
    places: list[tuple[str, ...]] = [e.between for e in d.effects if e.between]
    first = d.best_candidate or next(iter(d.alternatives), None)
    if not places and not d.effects and first is not None:
        places.append(first.where[-1])
    known = {*d.refitted.nodes, GROUND}
    return [(p[0], p[1]) for p in places if len(p) == 2 and set(p) <= known]


def _reconstructed(d: Diagnosis, trace: Trace, pair: tuple[str, str]) -> Missing:
    """Return the force between two nodes that the residuals of the refitted model require."""
    names = [c.name for c in d.refitted.outputs if c.name in trace.refit]
    measured = {n: trace.measured[n] for n in names}
    noise = {n: d.gap["noise_floor"][n] * float(np.std(measured[n])) for n in names}
    residuals = {n: measured[n] - trace.refit[n] for n in names}
    force = reconstruct_force(d.refitted, pair, trace.time, measured, residuals, noise)
    edge = max(1, len(trace.time) // TAPER)
    curve = Curve(*_motion(d.model, trace, pair), force).part(
        slice(edge, len(trace.time) - edge)
    )
    return Missing(pair, curve)


def _motion(
    network: Network, trace: Trace, pair: tuple[str, str]
) -> tuple[Array, Array]:
    """Return elongation and rate (n,) between two nodes of a model that starts like a record."""
    network = replace(network, uncertainty={})
    step = float(trace.time[1] - trace.time[0])
    measured = np.stack([trace.measured[c.name] for c in network.outputs], axis=1)
    problem = Problem(network, [Record(trace.name, step, trace.inputs, measured)])
    structure = base_structure(network)
    fit = Fitter(problem, white_weights(measured.std(axis=0))).follow(
        structure, structure.start, [0], iterations=3
    )
    found = motions(problem, fit, (pair,))
    if pair not in found:
        raise InputError(f"no motion between {pair[0]} and {pair[1]}")
    return found[pair].d, found[pair].v


# --------------------------------------------------------------------------------------------- measured forces


def measured_loops(d: Diagnosis, trace: Trace) -> list[Loops]:
    """Return the loops of every measured force whose terminals have a measured or simulated motion."""
    out = []
    for name, pair, factor in _force_channels(d.base):
        if name not in trace.measured:
            continue
        try:
            out.append(_loops_of(d, trace, name, pair, factor))
        except (InputError, np.linalg.LinAlgError):
            continue
    return out


def _force_channels(network: Network) -> Iterator[tuple[str, tuple[str, str], float]]:
    """Yield the measured forces: channel, terminals, and SI value of its unit."""
    driven = {c.at for c in network.moving}
    for c in network.outputs:
        if c.quantity != "force":
            continue
        places = {network.element(e).between for e in c.elements}
        if len(places) == 1:
            yield c.name, places.pop(), convert(1.0, c.unit, c.si)
        elif not places and c.at in driven:
            yield c.name, (str(c.at), GROUND), convert(1.0, c.unit, c.si)


def _loops_of(
    d: Diagnosis, trace: Trace, name: str, pair: tuple[str, str], factor: float
) -> Loops:
    step = float(trace.time[1] - trace.time[0])
    at = _displacement(d.base, pair)

    def curve(motion: tuple[Array, Array], values: dict[str, Array]) -> Curve:
        travel, rate = motion
        if at is not None and at[0] in values:
            travel = at[1] * values[at[0]]
            rate = _rate(travel, step)
        return Curve(travel, rate, factor * values[name])

    try:
        nominal = curve(_motion(d.base, trace, pair), trace.before)
    except (InputError, np.linalg.LinAlgError):
        nominal = None
    motion = _motion(d.model, trace, pair)
    measured, new = (curve(motion, y) for y in (trace.measured, trace.after))
    return Loops(name, pair, measured, nominal, new)


def _displacement(network: Network, pair: tuple[str, str]) -> tuple[str, float] | None:
    """Return the output that measures the elongation of a pair, and its SI value with the sign of the pair."""
    for c in network.outputs:
        ends = c.between or (
            (c.at, GROUND) if c.at is not None and not c.axis else None
        )
        if c.quantity == "displacement" and ends is not None and set(ends) == set(pair):
            return c.name, convert(1.0, c.unit, c.si) * (
                1.0 if tuple(ends) == pair else -1.0
            )
    return None


def _rate(travel: Array, step: float) -> Array:
    """Return the rate of a measured travel, smoothed over a tenth of the period of the motion."""
    from scipy.signal import savgol_filter

    width = 2 * round(0.1 * np.pi * pace(travel, step) / step) + 1
    width = min(max(width, 5), len(travel) - 1 + len(travel) % 2)
    return np.asarray(savgol_filter(travel, width, 2, deriv=1, delta=step), np.float64)
