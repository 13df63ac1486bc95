"""Typical forces of a rig, measured or computed by a fitted model: the scale for starting values and for small effects."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..._common.arrays import rms
from ...physics.network import GROUND
from .._simulation.problem import BROKEN, deviation_within
from .motion import watched

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics.network import Channel
    from .._estimation.gauss_newton import Fit
    from .._simulation.problem import Problem

#: kinds of elements that dissipate energy
DISSIPATIVE = ("dry_friction", "viscous")


@dataclass(frozen=True)
class PlaceForces:
    """Typical forces of a rig [N], or [N m] where nodes turn: a measured force, or at each node the largest of the computed forces."""

    #: Largest root mean square of a force at each node, as the model computes it.
    by_node: Mapping[str, float]
    #: Ground and nodes whose motion is an input.
    prescribed: frozenset[str]
    #: Measured force: a load cell, a known input, or an acceleration times the largest mass; 0 without a measured force.
    measured: float = 0.0

    def at(self, where: Sequence[str]) -> float:
        """Return the typical force of a place: the smaller force of the two nodes, without prescribed nodes beside a free node; else
        the largest of all forces."""
        if self.measured > 0:
            return self.measured
        free = [n for n in where if n in self.by_node and n not in self.prescribed]
        known = free or [n for n in where if n in self.by_node and n != GROUND]
        forces = [self.by_node[n] for n in known if self.by_node[n] > 0]
        return min(forces, default=self.largest)

    @property
    def largest(self) -> float:
        """Largest typical force of all nodes [N]; 1 N where nothing moves."""
        return (
            max((f for f in self.by_node.values() if math.isfinite(f)), default=0.0)
            or 1.0
        )


def place_forces(problem: Problem, fit: Fit, without: str | None = None) -> PlaceForces:
    """Return the typical forces of a rig without the element `without`, scaled up where the simulation has lost the measured motion."""
    net = fit.network
    driven = {str(c.at) for c in net.moving}
    prescribed = frozenset({GROUND, *driven})
    if measured := _measured_force(problem):
        return PlaceForces({}, prescribed, measured)
    elements = [e for e in net.elements if e.place == "between" and e.name != without]
    masses = {m: inertia for m, inertia in net.carried.items() if m not in driven}
    probes = [net.probe(f"_{e.name}", "force", element=e.name) for e in elements]
    probes += [net.probe(f"_{m}_a", "acceleration", at=m) for m in masses]
    by_node: dict[str, float] = dict.fromkeys((*net.carried, *driven), 0.0)
    scale = _lost_motion(problem, fit)
    for (nodes, factor), values in zip(
        [
            *((e.where, 1.0) for e in elements),
            *(((m,), inertia) for m, inertia in masses.items()),
        ],
        _simulated(problem, fit, tuple(probes)),
        strict=True,
    ):
        for node in nodes:
            by_node[node] = max(by_node.get(node, 0.0), scale * factor * rms(values))
    by_node.pop(GROUND, None)
    if not any(by_node.values()):
        by_node = _inertia_of_data(problem)
    return PlaceForces(by_node, prescribed)


def element_forces(
    problem: Problem, fit: Fit, where: Sequence[str]
) -> dict[str, Array]:
    """Return the force (samples,) of each element between two nodes over the records to fit by, signed from the first to the second
    node."""
    net, pair = fit.network, set(where)
    here = [e for e in net.elements if e.place == "between" and set(e.where) == pair]
    probes = tuple(net.probe(f"_{e.name}", "force", element=e.name) for e in here)
    together = np.concatenate([*watched(problem, fit, probes).values()])
    return {
        e.name: together[:, k] * (1.0 if e.where == tuple(where) else -1.0)
        for k, e in enumerate(here)
    }


def lossy_share(problem: Problem, fit: Fit) -> float:
    """Return the largest RMS force of an element that dissipates over the largest of all elements; 1 without an element that
    dissipates."""
    elements = [e for e in fit.network.elements if e.place == "between"]
    forces: dict[str, Array] = {}
    for pair in {e.between for e in elements}:
        forces |= element_forces(problem, fit, pair)
    size = {e.name: rms(forces[e.name]) for e in elements if e.name in forces}
    lossy = [
        size[e.name] for e in elements if e.name in size and e.mechanism in DISSIPATIVE
    ]
    return max(lossy) / max(*size.values(), 1e-300) if lossy else 1.0


def _measured_force(problem: Problem) -> float:
    """Return the largest deviation of a measured force [N], or of an acceleration times its mass; torques count only where nothing
    slides. 0 without one."""
    net, spread = problem.network, problem.deviation() / problem.factors
    found, slides = 0.0, net.total_mass > 0
    for j, c in enumerate(net.outputs):
        deviation = float(spread[j])
        if c.quantity == "force":
            found = max(found, deviation if c.at is not None else 0.5 * deviation)
        elif c.quantity == "acceleration":
            nodes = (c.at,) if c.at is not None else c.between or ()
            if not (slides and any(n in net.rotating for n in nodes)):
                inertia = net.inertia_at(c.at) if c.at is not None else 0.0
                found = max(found, deviation * (inertia or net.largest_inertia(*nodes)))
    for c in net.inputs:
        if c.quantity in ("force", "current"):
            pushed = np.concatenate(
                [problem.records[i].inputs[c.name] for i in problem.estimation]
            )
            motor = (
                net.element(c.elements[0]).law_parameters()
                if c.quantity == "current"
                else (1.0,)
            )
            found = max(found, float(np.prod(motor)) * float(np.std(pushed)))
    return found


def _simulated(problem: Problem, fit: Fit, outputs: tuple[Channel, ...]) -> list[Array]:
    """Return other outputs over all training records, one array per output; zero where the simulation breaks down."""
    if not outputs:
        return []
    try:
        together = np.concatenate([*watched(problem, fit, outputs).values()])
    except BROKEN:
        return [np.zeros(1) for _ in outputs]
    return list(np.where(np.isfinite(together), together, 0.0).T)


def _lost_motion(problem: Problem, fit: Fit) -> float:
    """Return the ratio of measured to simulated output deviation, pooled over channels, at least 1."""
    spread, names = (
        problem.deviation(),
        [problem.records[i].name for i in problem.estimation],
    )
    simulated = deviation_within([fit.outputs[i] for i in problem.estimation], names)
    known = (spread > 1e-300) & np.isfinite(simulated)
    pooled = rms(simulated[known] / spread[known]) if known.any() else 0.0
    return max(1.0, 1.0 / pooled) if pooled > 0 else 1.0


def _inertia_of_data(problem: Problem) -> dict[str, float]:
    """Return the inertia force of each mass by the measured motion, for a model that stands still."""
    acceleration, time = 0.0, problem.time
    rate = {"acceleration": 1.0, "velocity": 1.0 / time, "displacement": 1.0 / time**2}
    for j, c in enumerate(problem.network.outputs):
        if c.quantity in rate:
            deviation = float(problem.deviation()[j]) / problem.factors[j]
            acceleration = max(acceleration, deviation * rate[c.quantity])
    return {m: mass * acceleration for m, mass in problem.network.carried.items()}
