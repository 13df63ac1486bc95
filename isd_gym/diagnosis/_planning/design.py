"""Design of tests: the excitation that best distinguishes rivals, or most hypotheses."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError
from ...physics.network import assemble
from .._estimation.gauss_newton import Fitter, residuals
from .._estimation.noise import white_weights
from .._selection.criteria import LEAST_NOISE
from .._simulation.problem import BROKEN, Problem, Record, bare
from .excitation import (
    Excitation,
    Rig,
    infer_rig,
    list_excitations,
    make_record,
    make_table,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from ..._common.arrays import Array
    from ...physics.network import Network
    from ...records.data import Table
    from .._estimation.gauss_newton import Fit
    from .._estimation.structure import Structure

FINALISTS = 5  # tests for which rivals are refitted in full
MAX_RIVALS = 3  # rivals that are compared
SAMPLES = 12000  # of a test in the linearised comparison of rivals


@dataclass(frozen=True, eq=False)
class Rival:
    """A set of effects with values."""

    label: str  # names of the effects
    structure: Structure  # the nominal model with the effects
    x: Array  # transformed free parameters (parameters,)


@dataclass(frozen=True, eq=False)
class Design:
    """A designed test."""

    excitation: Excitation  # the test signal
    rig: Rig  # the rig with the limits
    record: Record  # with the inputs of the test
    text: str  # description of the test
    #: distance of the two closest rivals after a refit [standard deviations of the noise, over the whole record]
    separation: float = 0.0
    closest: tuple[str, str] = (
        "",
        "",
    )  # labels of these rivals; empty for a test without given rivals
    watch: str = ""  # channel with the largest difference
    usual: float = 0.0  # separation by a multisine over the whole band
    tried: int = 0  # number of compared tests

    def to_dict(self) -> dict[str, Any]:
        """Return the test as `next_experiment` of a diagnosis."""
        return {
            "do": self.text,
            "watch": self.watch,
            "separates": list(self.closest),
            "separation_sigma": self.separation,
            "usual_sigma": self.usual,
            "tried": self.tried,
            "excitation": self.excitation.to_dict(),
        }


def played(network: Network, record: Record) -> Table:
    """Make the table of a record's inputs for a file format without units.

    Args:
        network: The model with the inputs.
        record: The record.

    Returns:
        The table with a column ``name [unit]`` per input, in the channels' units.
    """
    table = make_table(network, record)
    named = {f"{k} [{table.units[k]}]": v for k, v in table.columns.items()}
    return replace(table, columns=named, units={})


# ------------------------------------------------------------------------------------------------ given rivals


class RivalComparison:
    """Comparison of rivals under one test: each rival in turn is the truth, and the others are refitted.

    Args:
        network: The nominal model.
        record: The record of the test.
        rivals: The rivals.
        noise: RMS noise (channels,) [unit of the channel].

    Raises:
        InputError: The simulation of a rival fails.
    """

    def __init__(
        self, network: Network, record: Record, rivals: Sequence[Rival], noise: Array
    ):
        self.rivals = rivals
        blank = Problem(network, [record])
        self.outputs = [
            blank.simulate([r.structure.at(r.x)], 0)[:, :, 0] for r in rivals
        ]
        if not all(
            np.isfinite(y).all() and np.abs(y).max() <= 1e12 for y in self.outputs
        ):
            raise InputError("the simulation of a rival fails")
        self.problem = Problem(network, [replace(record, measured=self.outputs[0])])
        level = np.maximum(
            noise, LEAST_NOISE * np.max([y.std(axis=0) for y in self.outputs], axis=0)
        )
        self.noise = np.where(level > 0, level, 1.0)

    def linear_distance(self) -> float:
        """Return the smallest linearised distance of two rivals [standard deviations of the noise]."""
        least, fitter = math.inf, Fitter(self.problem, white_weights(self.noise))
        for b, r in enumerate(self.rivals):
            fit = fitter.fit(
                r.structure, r.x, {0: _rest_state(r.structure)}, iterations=0
            )
            others = [y for k, y in enumerate(self.outputs) if k != b]
            _, left = fitter.refit(
                fit, {0: np.stack([y - fit.outputs[0] for y in others], axis=2)}
            )
            least = min(least, float(np.sqrt(np.sum(left[0] ** 2, axis=(0, 1)).min())))
        return least

    def distance(self) -> tuple[float, tuple[str, str], int]:
        """Compute the smallest distance of two rivals after a full refit.

        Returns:
            The distance [standard deviations of the noise], the labels of the two rivals, and the index of the channel
            with the largest difference.
        """
        best: tuple[float, tuple[str, str], int] = (math.inf, ("", ""), 0)
        level = math.sqrt(2.0) * self.noise
        for a, truth in enumerate(self.rivals):
            record = replace(self.problem.records[0], measured=self.outputs[a])
            p = Problem(self.problem.network, [record], time=self.problem.time)
            fitter = Fitter(p, white_weights(self.noise))
            for b, r in enumerate(self.rivals):
                if a == b:
                    continue
                start = {0: _rest_state(r.structure)}
                (left,) = residuals(
                    p, fitter.fit(r.structure, r.x, start, iterations=6, tolerance=1e-3)
                )
                deviance = len(left) * float(
                    np.sum(np.log1p(np.mean(left**2, axis=0) / level**2))
                )
                distance = math.sqrt(max(deviance, 0.0))
                if distance < best[0]:
                    power = np.sum((left / self.noise) ** 2, axis=0)
                    best = distance, (truth.label, r.label), int(np.argmax(power))
        return best


def _rest_state(structure: Structure) -> Array:
    """Return the initial state at rest (states,)."""
    return np.zeros(assemble(bare(structure.network)).size[0])


def design_test(
    network: Network,
    rivals: Sequence[Rival],
    rig: Rig,
    noise: Array,
    *,
    tests: Iterable[Excitation] | None = None,
) -> Design | None:
    """Choose the test that maximises the distance of the two closest rivals.

    Args:
        network: The nominal model.
        rivals: The rivals, most important first.
        rig: The rig.
        noise: RMS noise (channels,) [unit of the channel].
        tests: Tests to be compared. Default: `list_excitations`.

    Returns:
        The test, or None for fewer than two rivals or if no test can be simulated.
    """
    rivals = list(rivals)[:MAX_RIVALS]
    if len(rivals) < 2:
        return None
    every = list(list_excitations(network, rig) if tests is None else tests)
    ranked = []
    for k, e in enumerate(every):
        try:
            record = make_record(network, rig, e, samples=SAMPLES)
            ranked.append(
                (RivalComparison(network, record, rivals, noise).linear_distance(), k)
            )
        except BROKEN:
            continue
    finalists = [k for _, k in sorted(ranked, key=lambda p: -p[0])[:FINALISTS]]
    # the first test is the reference
    reference = [0] if any(k == 0 for _, k in ranked) else []
    best: Design | None = None
    usual = 0.0
    for k in dict.fromkeys([*finalists, *reference]):
        e = every[k]
        record = make_record(network, rig, e, "next experiment")
        try:
            distance, pair, channel = RivalComparison(
                network, record, rivals, noise
            ).distance()
        except BROKEN:
            continue
        usual = distance if k == 0 else usual
        if best is None or distance > best.separation:
            watch = network.outputs[channel].name
            best = Design(
                e,
                rig,
                record,
                e.describe(network, rig),
                distance,
                pair,
                watch,
                tried=len(every),
            )
    return None if best is None else replace(best, usual=usual)


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
    rivals = [Rival(fit.label, fit.structure, fit.x) for fit in contenders]
    try:
        rig = infer_rig(
            problem.network, [problem.records[i] for i in problem.estimation]
        )
    except InputError:
        return None
    return design_test(
        problem.network, rivals, rig, np.asarray(floor, dtype=np.float64)
    )
