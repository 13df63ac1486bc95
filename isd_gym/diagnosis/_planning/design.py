"""Design of the test that best distinguishes the candidates of a diagnosis."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError
from ..._common.units import convert
from ...physics.network import assemble
from ...records.data import Table
from .._estimation.gauss_newton import Fitter
from .._estimation.noise import white_weights
from .._selection.criteria import LEAST_NOISE
from .._simulation.problem import BROKEN, Problem, Record
from .excitation import infer_rig, list_excitations, make_record

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from ..._common.arrays import Array
    from ...physics.network import Network
    from .._estimation.gauss_newton import Fit
    from .excitation import Excitation, Rig

#: largest number of rivals that are compared
MAX_RIVALS = 3
#: largest number of samples of a test in the comparison
SAMPLES = 12000


@dataclass(frozen=True, eq=False)
class Separation:
    """Distance of the two closest rivals under a test, after a refit of one to the other."""

    #: distance [standard deviations of the noise, over the whole record]
    distance: float
    #: names of the two rivals
    closest: tuple[str, str]
    #: channel with the largest difference
    watch: str


@dataclass(frozen=True, eq=False)
class Design:
    """A designed test."""

    excitation: Excitation
    rig: Rig
    #: record with the inputs of the test
    record: Record
    separation: Separation

    def to_dict(self, network: Network) -> dict[str, Any]:
        """Return the test as `next_experiment` of a diagnosis."""
        return {
            "do": self.excitation.describe(network, self.rig),
            "watch": self.separation.watch,
            "separates": list(self.separation.closest),
            "separation_sigma": self.separation.distance,
            "excitation": asdict(self.excitation),
        }

    def table(self, network: Network) -> Table:
        """Return the inputs of the test, a column ``name [unit]`` each, for a file format without units."""
        columns = {
            f"{c.name} [{c.unit}]": convert(self.record.inputs[c.name], c.si, c.unit)
            for c in network.inputs
        }
        time = self.record.step * np.arange(self.record.samples)
        return Table(time, columns, "planned test")


def separate(
    network: Network, record: Record, rivals: Sequence[Fit], noise: Array
) -> Separation:
    """Return how far a test separates rivals: each in turn is the truth, and the others are refitted, to first order.

    Args:
        network: The nominal model.
        record: The record of the test.
        rivals: The rivals.
        noise: RMS noise (channels,) [unit of the channel].

    Raises:
        InputError: The simulation of a rival fails.
    """
    blank = Problem(network, [record])
    outputs = [blank.simulate([r.structure.at(r.x)], 0)[:, :, 0] for r in rivals]
    if not all(np.isfinite(y).all() and np.abs(y).max() <= 1e12 for y in outputs):
        raise InputError("the simulation of a rival fails")
    largest = np.max([y.std(axis=0) for y in outputs], axis=0)
    level = np.maximum(noise, LEAST_NOISE * largest)
    problem = Problem(network, [replace(record, measured=outputs[0])])
    fitter = Fitter(problem, white_weights(np.where(level > 0, level, 1.0)))
    found = Separation(math.inf, ("", ""), "")
    for rival, own in zip(rivals, outputs, strict=True):
        rest = np.zeros(assemble(rival.structure.network.mechanical).size[0])
        fit = fitter.fit(rival.structure, rival.x, {0: rest}, iterations=0)
        for truth, other in zip(rivals, outputs, strict=True):
            if truth is rival:
                continue
            _, left = fitter.refit(fit, {0: (other - own)[:, :, None]})
            power = np.sum(left[0][:, :, 0] ** 2, axis=0)
            distance = float(np.sqrt(power.sum()))
            if distance < found.distance:
                watch = network.outputs[int(np.argmax(power))].name
                found = Separation(distance, (truth.label, rival.label), watch)
    return found


def design_test(
    network: Network,
    rivals: Sequence[Fit],
    rig: Rig,
    noise: Array,
    tests: Iterable[Excitation] | None = None,
) -> Design | None:
    """Return the test that maximises the distance of the two closest rivals.

    Args:
        network: The nominal model.
        rivals: The rivals, most important first.
        rig: The rig.
        noise: RMS noise (channels,) [unit of the channel].
        tests: Tests to be compared. Default: `list_excitations`.

    Returns:
        The test, or None for fewer than two rivals or if no test can be simulated.
    """
    rivals = rivals[:MAX_RIVALS]
    if len(rivals) < 2:
        return None
    best: Design | None = None
    for e in tests or list_excitations(network, rig):
        record = make_record(network, rig, e)
        head = record.part(0, min(len(record), SAMPLES), record.name)
        try:
            found = separate(network, head, rivals, noise)
        except BROKEN:
            continue
        if best is None or found.distance > best.separation.distance:
            best = Design(e, rig, record, found)
    return best


def next_experiment(
    problem: Problem, contenders: Sequence[Fit], floor: Array
) -> Design | None:
    """Design the test that distinguishes the contenders of a diagnosis, within the range of the records.

    Args:
        problem: Model and records of the diagnosis.
        contenders: Fits, best first.
        floor: RMS noise (channels,) [unit of the channel].

    Returns:
        The test, or None if the model has no inputs or no test can be designed.
    """
    if not problem.network.inputs:
        return None
    try:
        rig = infer_rig(
            problem.network, [problem.records[i] for i in problem.estimation]
        )
    except InputError:
        return None
    return design_test(problem.network, contenders, rig, floor)
