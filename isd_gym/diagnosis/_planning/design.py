"""Design of the test that best distinguishes the candidates of a diagnosis."""

from __future__ import annotations

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
class Design:
    """A designed test and the two closest rivals under the test."""

    excitation: Excitation
    #: record with the inputs of the test
    record: Record
    #: distance of the two rivals, after a refit of one to the other [standard deviations of the noise, over the whole record]
    distance: float
    #: names of the two rivals
    closest: tuple[str, str]
    #: channel with the largest difference
    watch: str

    def to_dict(self, network: Network) -> dict[str, Any]:
        """Return the test as `next_experiment` of a diagnosis."""
        return {
            "do": self._describe(network),
            "watch": self.watch,
            "separates": list(self.closest),
            "separation_sigma": self.distance,
            "excitation": asdict(self.excitation),
        }

    def table(self, network: Network) -> Table:
        """Return the inputs of the test, a column ``name [unit]`` each, for a file format without units."""
        columns = {
            f"{c.name} [{c.unit}]": convert(self.record.inputs[c.name], c.si, c.unit)
            for c in network.inputs
        }
        return Table(self.record.time, columns, "planned test")

    def _describe(self, network: Network) -> str:
        """Return the test in words, such as ``multisine, 0.5 to 15 Hz, 20 s: road to 8.2 mm``."""
        e = self.excitation
        sizes = []
        for c in network.inputs:
            if c.name in e.at:
                size = float(np.abs(self.record.inputs[c.name]).max())
                is_length = c.quantity == "displacement"
                text = f"{1e3 * size:.3g} m" if is_length else f"{size:.3g} "
                sizes.append(f"{c.name} to {text}{c.si}")
        low, high = e.band_hz
        length = self.record.time[-1]
        return (
            f"{e.kind}, {low:.3g} to {high:.3g} Hz, {length:g} s: {' and '.join(sizes)}"
        )


def separate(
    network: Network, record: Record, rivals: Sequence[Fit], noise: Array
) -> tuple[float, tuple[str, str], str]:
    """Return how far a test separates the two closest rivals: each in turn is the truth, and the others are refitted, to first order.

    Args:
        network: The nominal model.
        record: The record of the test.
        rivals: The rivals.
        noise: RMS noise (channels,) [unit of the channel].

    Returns:
        `distance`, `closest` and `watch` of a `Design`.

    Raises:
        InputError: The simulation of a rival fails.
    """
    blank = Problem(network, [record])
    simulated = [blank.simulate([r.structure.at(r.x)], 0) for r in rivals]
    outputs = np.concatenate(simulated, axis=2)
    if not (np.isfinite(outputs).all() and np.abs(outputs).max() <= 1e12):
        raise InputError("the simulation of a rival fails")
    largest = outputs.std(axis=0).max(axis=1)
    level = np.maximum(noise, LEAST_NOISE * largest)
    problem = Problem(network, [replace(record, measured=outputs[:, :, 0])])
    fitter = Fitter(problem, white_weights(np.where(level > 0, level, 1.0)))
    power = np.full((len(rivals), len(rivals), len(network.outputs)), np.inf)
    for k, rival in enumerate(rivals):
        rest = np.zeros(assemble(rival.structure.network.mechanical).size[0])
        fit = fitter.fit(rival.structure, rival.x, {0: rest}, iterations=0)
        others = np.arange(len(rivals)) != k
        changes = outputs[:, :, others] - outputs[:, :, [k]]
        left = fitter.unabsorbed(fit, {0: changes})
        power[k, others] = np.sum(left[0] ** 2, axis=0).T
    distance = np.sqrt(power.sum(axis=2))
    own, truth = divmod(int(np.argmin(distance)), len(rivals))
    watch = network.outputs[int(np.argmax(power[own, truth]))].name
    closest = rivals[truth].label, rivals[own].label
    return float(distance[own, truth]), closest, watch


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
    designs = []
    for e in tests or list_excitations(rig):
        record = make_record(network, rig, e)
        head = record.part(0, min(len(record), SAMPLES), record.name)
        try:
            designs.append(Design(e, record, *separate(network, head, rivals, noise)))
        except BROKEN:
            continue
    return max(designs, key=lambda d: d.distance, default=None)


def next_experiment(
    problem: Problem, contenders: Sequence[Fit], floor: Array
) -> Design | None:
    """Design the test that distinguishes the contenders of a diagnosis, within the range of the records.

    Args:
        problem: Model and records of the diagnosis.
        contenders: Fits, best first.
        floor: RMS noise (channels,) [unit of the channel].

    Returns:
        The test, or None if the records show no rig or no test can be designed.
    """
    records = [problem.records[i] for i in problem.estimation]
    rig = infer_rig(problem.network, records)
    if rig is None:
        return None
    return design_test(problem.network, contenders, rig, floor)
