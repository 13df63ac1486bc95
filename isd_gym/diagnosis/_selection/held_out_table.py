"""One table of sets of laws: errors and log predictive densities on the same blocks of the same records, with one noise level.

The difference of two expected log predictive densities and its standard error are those of `arviz_stats.compare` (``elpd_diff`` and
``dse``), with blocks of consecutive samples in place of single observations, since neighbouring residuals are correlated.

References:
    Vehtari, Gelman, Gabry: Practical Bayesian model evaluation using leave-one-out cross-validation and WAIC, Statistics and
    Computing 27 (2017), section 5.2. Sivula, Magnusson, Matamoros, Vehtari: Uncertainty in Bayesian leave-one-out
    cross-validation based model comparison, arXiv:2008.10296 (2020): differences below 4 are too small to rely on their error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from .._estimation.gauss_newton import residuals
from .._estimation.noise import independent_share
from .._estimation.structure import owner_pair
from .contradictions import find_contradiction

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from ...physics.network import Network
    from .._estimation.gauss_newton import Fit
    from .._estimation.structure import Hypothesis
    from .criteria import Criteria
    from .held_out import HeldOutEvaluator

#: blocks per record, and their least number of samples
BLOCKS, LEAST_BLOCK = 20, 10
#: ratio of the errors on validation and on training records above which initial states may be wrong
LOST = 2.0


@dataclass(frozen=True)
class Member:
    """A law of a set, as it is compared with the laws of other sets."""

    effect: str
    #: terminals in alphabetical order, or the channel or motor
    place: tuple[str, ...]
    mechanism: str
    #: 'between', 'element' or 'channel'
    level: str

    @property
    def kind(self) -> tuple[str, tuple[str, ...]]:
        """Kind and place."""
        return self.mechanism, self.place


@dataclass(frozen=True, eq=False)
class Blocks:
    """Mean squared residuals of blocks of records (blocks, channels), and the samples that each block stands for (blocks,)."""

    power: Array
    samples: Array

    def log_density(self, level: Array, share: Array, least: Array) -> Array:
        """Return the log predictive density of each block (blocks,) [nats], without constants: Student's t, in which a gross error counts by
        its logarithm (Gelman et al.: Bayesian Data Analysis, 3rd edition (2013), sections 3.2 and 17.2).

        `level`: noise; `share`: share of independent samples; `least`: smallest noise, the scale of the prior (channels,).
        """
        floor = np.minimum(share * (least / level) ** 2, 1.0)
        ratio = share * self.power / level**2 / floor
        return np.asarray(
            -np.sum(self.samples[:, None] * share * np.log1p(ratio), axis=1)
        )


@dataclass(frozen=True, eq=False)
class Row:
    """A set of laws with its errors on training, validation and test records."""

    fit: Fit
    #: simulation of the held-out records
    held: Fit
    members: tuple[Member, ...]
    #: number of fitted parameters
    parameters: int
    #: errors as shares of the deviation (channels,)
    validation: Array
    test: Array
    training: Array
    validation_blocks: Blocks
    training_blocks: Blocks
    #: level of the training residuals (channels,), and share of independent samples
    level: Array
    share: Array
    #: how the values of a law contradict its name; empty where they do not
    contradiction: str

    @property
    def error(self) -> float:
        """Error on the validation records, root of the mean square over channels."""
        return float(np.sqrt(np.mean(self.validation**2)))

    @property
    def training_error(self) -> float:
        """Error on the training records, likewise."""
        return float(np.sqrt(np.mean(self.training**2)))

    @property
    def is_lost(self) -> bool:
        """Whether the error on validation records is so much larger than on training records that their initial states may be wrong."""
        return self.error > LOST * self.training_error

    @property
    def kinds(self) -> frozenset[tuple[str, tuple[str, ...]]]:
        """Kinds and places of the members."""
        return frozenset(m.kind for m in self.members)

    @property
    def is_sound(self) -> bool:
        """Whether no value contradicts its law's name, and no two laws of a kind make a curve fit at one place."""
        return not self.contradiction and len(self.kinds) == len(self.members)

    @property
    def blames(self) -> bool:
        """Whether a member is a fault of a sensor or a drive."""
        return any(m.level != "between" for m in self.members)

    def log_density(self, best: Row, least: Array) -> Array:
        """Return the log predictive density of the blocks of validation and training records (blocks,) [nats], with the noise level of the
        set `best` and the smallest noise `least` (channels,); less one nat per parameter (Akaike 1974)."""
        parts = [
            x.log_density(best.level, best.share, least)
            for x in (self.validation_blocks, self.training_blocks)
        ]
        parts[1] = parts[1] - self.parameters / len(parts[1])
        return np.concatenate(parts)


def row_of(evaluator: HeldOutEvaluator, fit: Fit, near: Fit | None = None) -> Row:
    """Return the row of a fitted set; raise InputError where a record cannot be simulated. `near`: a simulation of the held-out records
    whose initial states are tried, too."""
    p, held = evaluator.problem, evaluator.held_fit(fit, near)
    left = residuals(p, fit)
    level = np.maximum(
        np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0)), evaluator.least_noise
    )
    contradictions = [find_contradiction(p, fit, element) for element in fit.elements]
    return Row(
        fit=fit,
        held=held,
        members=tuple(_member(p.network, h) for h in fit.hypotheses),
        parameters=len(fit.x),
        validation=evaluator.nrmse(held, p.choosing, evaluator.validation_deviation),
        test=evaluator.nrmse(held, p.reporting, evaluator.test_deviation),
        training=evaluator.nrmse(fit, p.estimation, evaluator.training_deviation),
        validation_blocks=_blocks(evaluator, held, p.choosing),
        training_blocks=_blocks(evaluator, fit, p.estimation),
        level=level,
        share=independent_share(left),
        contradiction="; ".join(c for c in contradictions if c),
    )


def _member(network: Network, h: Hypothesis) -> Member:
    pair = owner_pair(network, h)
    place = tuple(sorted(pair)) if pair else h.where
    return Member(h.effect, place, h.kind.mechanism, h.place)


def _blocks(evaluator: HeldOutEvaluator, fit: Fit, records: Sequence[int]) -> Blocks:
    power, samples = [], []
    for i in records:
        y = evaluator.problem.records[i].measured
        square = (y - fit.outputs[i]) ** 2
        edges = block_edges(y)
        for a, b in pairwise(edges):
            power.append(square[a:b].mean(axis=0))
            samples.append(len(y) / (len(edges) - 1))
    return Blocks(np.array(power), np.array(samples))


def block_edges(
    measured: Array, blocks: int = BLOCKS, least: int = LEAST_BLOCK
) -> Array:
    """Return indices (edges,) of blocks of equal signal energy of measured channels (samples, channels): a decay has most in its first
    periods."""
    deviation = measured - measured.mean(axis=0)
    power = np.sum((deviation / np.maximum(measured.std(axis=0), 1e-300)) ** 2, axis=1)
    energy = np.cumsum(power + 0.02 * max(float(power.mean()), 1e-300))
    wanted = np.searchsorted(energy, np.linspace(0.0, energy[-1], blocks + 1)[1:-1]) + 1
    edges = [0]
    for edge in wanted:
        if edge - edges[-1] >= least and len(measured) - edge >= least:
            edges.append(int(edge))
    return np.array([*edges, len(measured)])


@dataclass(frozen=True)
class Comparison:
    """Difference of the held-out log predictive density between two sets."""

    #: Log predictive density of the first set minus that of the second [nats], summed over blocks.
    elpd_diff: float = 0.0
    #: Standard error of the difference [nats].
    dse: float = math.inf

    @property
    def errors(self) -> float:
        """The difference in standard errors."""
        return self.elpd_diff / max(self.dse, 1e-12)

    def is_better(self, c: Criteria) -> bool:
        """Return whether the first set predicts better, beyond chance."""
        return self.elpd_diff > c.elpd_diff and self.errors > c.elpd_errors


def compare(first: Array, second: Array) -> Comparison:
    """Return the difference of log predictive densities (blocks,) [nats] and its standard error, which is infinite for a single block."""
    difference = np.asarray(first) - np.asarray(second)
    count = len(difference)
    dse = (
        math.sqrt(count * float(np.var(difference, ddof=1))) if count > 1 else math.inf
    )
    return Comparison(float(difference.sum()), dse)
