"""The free force: a missing force as a smooth function of elongation or of rate, fitted with its band.

The force at the knots of a table is a Gaussian process (Rasmussen and Williams, 2006, chapter 2) that vanishes at rest, written in
the few directions that carry nearly all of its variance. The coordinates along these directions have unit variance and are fitted like
parameters, beside the parameters of the model. A part of the force that the sensors do not resolve stays at zero. The curvature of the
fit gives the band.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..._common.arrays import Z95, Array
from ...physics import elements as el
from ...physics.network import Network, assemble
from .._estimation.gauss_newton import Fit, Fitter, residuals
from .._estimation.noise import weights_of
from .._estimation.structure import Free, Structure, cells_beside
from .._hypotheses.forces import PlaceForces, place_forces
from .._hypotheses.library import pairs
from .._hypotheses.motion import motions
from .._simulation.problem import BROKEN, Problem
from .admissibility import travels
from .answer import removed_share
from .conditions import table_gates
from .held_out_table import Row, compare, row_of

if TYPE_CHECKING:
    from .conditions import Gate
    from .criteria import Criteria
    from .held_out import HeldOutEvaluator

#: argument of a force without a known law
Over = Literal["rate", "elongation"]
#: knots of a table: a resolution, finer than the correlation length
KNOTS = 33
#: correlation length, as a share of half the motion's range
LENGTH = 0.35
#: smallest variance of a direction, as a share of the variance of the strongest direction
KEPT = 1e-4
#: largest number of directions
MAX_DIRECTIONS = 12
#: tables that are fitted with all samples
FINALS = 3
#: prior standard deviation of the force, as a multiple of the typical force
STRONG = 3.0
#: share of the motion that the knots span
INSIDE = 0.995
PLANES: tuple[Over, ...] = ("rate", "elongation")
#: Gauss-Newton steps of a table with few samples, and with all
STEPS, LAST_STEPS = 12, 4


@dataclass(frozen=True)
class Tabulated:
    """A missing force without a known law, as a table with its 95 % band."""

    #: terminals
    between: tuple[str, str]
    #: argument of the force: 'rate' or 'elongation'
    over: Over
    #: name of the element in the new model
    element: str
    #: share of the squared held-out error beyond noise that the table removes
    explained: float
    #: knots [m], or [rad] between rotating nodes
    elongation: tuple[float, ...]
    #: knots [m/s], or [rad/s] between rotating nodes
    rate: tuple[float, ...]
    #: force at the knots [N], or torque [N m]
    force: Array
    #: lower end of the band at the knots [N]
    low: Array
    #: upper end of the band at the knots [N]
    high: Array


@dataclass(frozen=True)
class BestTable:
    """The table of a force that explains the held-out records best, accepted or not."""

    #: terminals
    between: tuple[str, str]
    #: argument of the force
    over: Over
    #: share of the squared held-out error beyond noise that the table removes
    explained: float
    #: conditions for the acceptance of the table
    gates: tuple[Gate, ...]

    @property
    def accepted(self) -> bool:
        """Whether the table passes every gate."""
        return all(g.passed for g in self.gates)


@dataclass(frozen=True)
class Table(Structure):
    """A network with a `tabulated_force`; the last free parameters are the coordinates along the directions of the prior."""

    element: str = ""
    over: Over = "rate"
    basis: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def own(self) -> Structure:
        """The network with its own free parameters alone."""
        return Structure(
            self.network, self.free[: len(self.free) - self.basis.shape[1]]
        )

    @property
    def pair(self) -> tuple[str, str]:
        """The two nodes."""
        return self.network.element(self.element).between

    def _network(self, x: Array) -> Network:
        own = self.own
        force = self.basis @ x[len(own.free) :]
        return own.at(x[: len(own.free)]).with_table(self.element, force.tolist())

    @property
    def start(self) -> Array:
        return np.append(self.own.start, np.zeros(self.basis.shape[1]))


# ---------------------------------------------------------------------------------------------------- the prior


def _axis(values: Array) -> Array:
    """Return knots over a motion, zero among them."""
    low, high = (float(np.quantile(values, q)) for q in (1 - INSIDE, INSIDE))
    reach = max(high, -low, 1e-12)
    low, high = min(low, -0.05 * reach), max(high, 0.05 * reach)
    below = max(1, round((KNOTS - 1) * -low / (high - low)))
    above = np.linspace(0.0, high, KNOTS - below)
    return np.concatenate([np.linspace(low, 0.0, below + 1), above[1:]])


def _directions(x: Array, sigma: float) -> Array:
    """Return principal directions (knots, directions) [N] of a smooth random force over knots x that is zero at rest."""
    scale = LENGTH * 0.5 * float(np.ptp(x))
    covariance = np.exp(-0.5 * ((x[:, None] - x[None, :]) / scale) ** 2)
    at = int(np.argmin(np.abs(x)))
    rest = np.outer(covariance[:, at], covariance[at]) / covariance[at, at]
    values, vectors = np.linalg.eigh(covariance - rest)
    keep = np.argsort(values)[::-1][:MAX_DIRECTIONS]
    keep = keep[values[keep] > KEPT * values[keep[0]]]
    return np.asarray(sigma * vectors[:, keep] * np.sqrt(values[keep]))


def table(
    fit: Fit, pair: tuple[str, str], over: Over, m: el.Motion, sigma: float
) -> Table:
    """Return the refitted nominal model with a table between two nodes. `sigma`: deviation of the force [N]."""
    network, base = fit.network, fit.structure
    axis = _axis(m.v if over == "rate" else m.d)
    basis = _directions(axis, sigma)
    name = network.free_name("missing_force")
    given: dict[str, Any] = {over: tuple(axis.tolist()), "force": [0.0] * len(axis)}
    element = el.TabulatedForce(name, pair, **given)
    new = [
        Free(f"{name}.{k}", False, 0.0, 1.0, -math.inf, math.inf, 0)
        for k in range(basis.shape[1])
    ]
    outputs = cells_beside(network, element)
    built = replace(network, elements=(*network.elements, element), outputs=outputs)
    assemble(built.mechanical)
    free = (*base.free, *new)
    return Table(
        built, free, offsets=base.offsets, element=name, over=over, basis=basis
    )


# ------------------------------------------------------------------------------------------------------ the fit


def _start_values(base: Fit, structure: Table) -> Array:
    return np.concatenate([base.x, np.zeros(structure.basis.shape[1])])


def _fitter(problem: Problem, base: Fit, least: Array) -> Fitter:
    """Return a fitter with weights by the level of the residuals of a fit, at least `least` (channels,)."""
    return Fitter(problem, weights_of(residuals(problem, base), least))


def gain(problem: Problem, fitter: Fitter, base: Fit, structure: Table) -> float:
    """Return the decrease of the cost that a table is expected to bring, to first order."""
    x = _start_values(base, structure)
    left = {
        i: (problem.records[i].measured - base.outputs[i])[:, :, None]
        for i in problem.estimation
    }
    H, g, _ = fitter.normal_equations(structure, x, base.initial, left)
    own = np.delete(np.arange(len(H)), np.s_[len(base.x) : len(x)])  # without the table
    gains = (
        g[k, 0] @ np.linalg.solve(H[np.ix_(k, k)], g[k, 0])
        for k in (np.arange(len(H)), own)
    )
    whole, without = map(float, gains)
    return whole - without


def _ranked(
    problem: Problem, base: Fit, least: Array, forces: PlaceForces
) -> list[Table]:
    """Return tables over rate and over elongation at every pair, largest expected gain first, on as few samples as the motion needs."""
    motion = motions(problem, base)
    known = travels(problem, base.network, motion)
    rough = _fitter(problem, base, least)
    if problem.rough is not problem:
        rough = Fitter(problem.rough, rough.weights)
    fit = rough.transfer(base)
    ranked: list[tuple[float, Table]] = []
    for pair in pairs(base.network):
        m = motion.get(pair)
        if m is None or el.rms(m.d) <= 1e-9 or el.rms(m.v) <= 1e-9:
            continue
        for over in PLANES:
            if over == "elongation" and not known[pair].is_known:
                continue
            try:
                built = table(base, pair, over, m, STRONG * forces.at(pair))
                ranked.append((gain(problem.rough, rough, fit, built), built))
            except BROKEN:
                continue
    return [s for _, s in sorted(ranked, key=lambda t: -t[0])]


@dataclass(frozen=True)
class FreeForce:
    """The best table of a force."""

    best: BestTable | None = None
    #: the model with the table, where the table passes its gates
    row: Row | None = None
    #: description of that table
    tabulated: Tabulated | None = None


def fit_free_force(
    evaluator: HeldOutEvaluator,
    refit: Row,
    criteria: Criteria,
) -> FreeForce:
    """Return the table of a force between two nodes that explains the held-out records best, with its gates by explained fraction, error
    reduction, standard errors of the gain and explained fraction of the test records."""
    problem, least, base = evaluator.problem, evaluator.least_noise, refit.fit
    forces = place_forces(problem, base)
    ranked = _ranked(problem, base, least, forces)
    first = [next((s for s in ranked if s.over == over), None) for over in PLANES]
    finals = list(
        {id(s): s for s in [*ranked[:FINALS], *first] if s is not None}.values()
    )
    tried = [row for s in finals if (row := _fit_table(evaluator, base, s)) is not None]
    if not tried:
        return FreeForce()
    found = min(tried, key=lambda row: row.error)
    gained = _gained(evaluator, refit, found)
    structure = found.fit.structure
    assert isinstance(structure, Table)
    gates = table_gates(*gained, criteria)
    best = BestTable(structure.pair, structure.over, gained[0], gates)
    if not best.accepted:
        return FreeForce(best)
    try:
        tabulated = _tabulated(problem, least, found.fit, structure, gained[0])
    except BROKEN:
        return FreeForce(best)
    return FreeForce(best, found, tabulated)


def _gained(
    evaluator: HeldOutEvaluator, refit: Row, row: Row
) -> tuple[float, float, float, float]:
    """Return what a table gains over the refitted nominal model: explained fraction, largest error reduction of a channel, standard errors
    of the gain, and explained fraction of the test records."""
    noise = evaluator.noise_share(row.held)
    moved = float(
        np.sqrt(np.maximum(refit.validation**2 - row.validation**2, 0.0)).max()
    )
    densities = (x.log_density(row, evaluator.least_noise) for x in (row, refit))
    return (
        min(removed_share(refit.validation, row.validation, noise), 1.0),
        moved,
        compare(*densities).errors,
        removed_share(refit.test, row.test, evaluator.test_noise(noise)),
    )


def _fit_table(evaluator: HeldOutEvaluator, base: Fit, structure: Table) -> Row | None:
    """Fit a table with few samples, then with all; None where the fit breaks down."""
    problem = evaluator.problem
    fitter = _fitter(problem, base, evaluator.least_noise)
    try:
        if problem.rough is not problem:
            rough = Fitter(problem.rough, fitter.weights)
            start = rough.transfer(base)
        else:
            rough, start = fitter, base
        x = _start_values(base, structure)
        found = rough.fit(structure, x, start.initial, start.offset, iterations=STEPS)
        if rough is not fitter:
            found = fitter.fit(
                structure, found.x, found.initial, found.offset, iterations=LAST_STEPS
            )
        return row_of(evaluator, found)
    except BROKEN:
        return None


def _tabulated(
    problem: Problem, least: Array, best: Fit, structure: Table, explained: float
) -> Tabulated:
    """Return the table with the band that the curvature of its fit gives."""
    f = _fitter(problem, best, least).fit(
        structure, best.x, best.initial, best.offset, iterations=0
    )
    assert f.hessian is not None
    own = len(structure.own.free)
    covariance = np.linalg.inv(f.hessian + np.diag(1 / structure.sigma**2))[own:, own:]
    force = structure.basis @ best.x[own:]
    variance = np.einsum("ij,jk,ik->i", structure.basis, covariance, structure.basis)
    spread = Z95 * np.sqrt(np.maximum(variance, 0.0))
    e = best.network.element(structure.element)
    assert isinstance(e, el.TabulatedForce)
    return Tabulated(
        structure.pair, structure.over, e.name, explained, e.elongation, e.rate,
        force, force - spread, force + spread,
    )  # fmt: skip
