"""Comparison of two candidates by the log predictive density of held-out records.

The difference of two expected log predictive densities and its standard error are those of `arviz_stats.compare` (``elpd_diff`` and
``dse``), with blocks of consecutive samples in place of single observations, since neighbouring residuals are correlated.

References:
    Vehtari, Gelman, Gabry: Practical Bayesian model evaluation using leave-one-out cross-validation and WAIC, Statistics and
    Computing 27 (2017), section 5.2. Sivula, Magnusson, Matamoros, Vehtari: Uncertainty in Bayesian leave-one-out
    cross-validation based model comparison, arXiv:2008.10296 (2020): differences below 4 are too small to rely on their error.
    Breiman, Friedman, Olshen, Stone: Classification and Regression Trees (1984), section 3.4.3: the rule of one standard error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from .criteria import Criteria


@dataclass(frozen=True)
class Comparison:
    """Difference of the held-out log predictive density between two candidates."""

    #: Log predictive density of the first candidate minus that of the second [nats], summed over blocks.
    elpd_diff: float
    #: Standard error of the difference [nats].
    dse: float

    @property
    def errors(self) -> float:
        """The difference in standard errors."""
        return self.elpd_diff / max(self.dse, 1e-12)

    def is_better(self, c: Criteria) -> bool:
        """Return whether the first candidate predicts better, beyond chance."""
        return self.elpd_diff > c.elpd_diff and self.errors > c.elpd_errors

    def is_preferred(self, c: Criteria) -> bool:
        """Return whether the first candidate, with more parameters, is preferred by the rule of one standard error."""
        return self.elpd_diff > c.elpd_diff and self.errors > c.simpler_errors


def compare(first: Array, second: Array) -> Comparison:
    """Return the difference of log predictive densities (blocks,) [nats] and its standard error, which is infinite for a single block."""
    difference = np.asarray(first) - np.asarray(second)
    count = len(difference)
    dse = math.sqrt(count * float(np.var(difference, ddof=1))) if count > 1 else math.inf
    return Comparison(float(difference.sum()), dse)


def log_density(squares: Array, weight: float, floor: Array) -> float:
    """Return the log predictive density [nats], without constants, of a block of squared whitened residuals (samples, channels) with
    unknown noise variance: a Student t density, in which a gross error counts by its logarithm (Gelman et al.: Bayesian Data Analysis,
    3rd edition (2013), sections 3.2 and 17.2). `weight`: independent samples; `floor` (channels,): scale of the prior."""
    return -weight * float(np.sum(np.log1p(squares.mean(axis=0) / floor)))


def block_edges(measured: Array, blocks: int, least: int) -> Array:
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
