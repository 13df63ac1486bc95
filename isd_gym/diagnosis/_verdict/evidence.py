"""Evidence: the numbers from which `gates.decide` draws the verdict, and the fitted values with their intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from .._hypotheses.motion import motions
from .._selection.answer import removed_share
from .._selection.uncertainty import (
    covariance,
    intervals,
    parameters_at_limits,
    sums_with_dampers,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ..._common.arrays import Array
    from .._selection.answer import Answer
    from .._selection.held_out import HeldOutEvaluator
    from .._selection.held_out_table import Row
    from .._selection.uncertainty import Quantity


@dataclass(frozen=True)
class Evidence:
    """Evidence for the foremost set of laws against the refitted nominal model.

    Errors are RMS errors on the validation records as shares of the channel's deviation, one number per channel, unless stated
    otherwise. An excess error is the error beyond noise.
    """

    channels: tuple[str, ...]
    #: error of the nominal model
    before: tuple[float, ...]
    #: error of the refitted nominal model
    refit: tuple[float, ...]
    #: error of the set
    after: tuple[float, ...]
    #: noise
    noise: tuple[float, ...]
    #: whether the owner or the signal tells the noise; otherwise the noise is only bounded
    noise_known: tuple[bool, ...]
    #: error of the refitted model on the training records
    training_refit: tuple[float, ...]
    #: log predictive density minus that of the refitted model [nats]
    elpd_diff: float = 0.0
    #: standard error of that difference [nats]
    elpd_dse: float = math.inf
    #: share of the refitted model's squared error beyond noise that the set removes
    explained: float = 0.0
    #: the same on the test records
    test_explained: float = 0.0
    #: parameters of the nominal model at the limit of their stated uncertainty, in the set
    limits: tuple[str, ...] = ()
    #: the same in the refitted model
    refit_limits: tuple[str, ...] = ()
    #: smallest share of the samples on the rarer side of a law's characteristic point; 1 where no law has one
    support: float = 1.0

    def excess(self, errors: tuple[float, ...]) -> tuple[float, ...]:
        """Return errors beyond noise."""
        return tuple(
            math.sqrt(max(x**2 - f**2, 0.0))
            for x, f in zip(errors, self.noise, strict=True)
        )

    def width(self, errors: tuple[float, ...]) -> float:
        """Return errors beyond noise, mean over channels."""
        return sum(self.excess(errors)) / len(self.channels)

    def has_credible_noise(self, misses: float) -> bool:
        """Return whether a noise that is only bounded covers a small error only."""
        return all(
            k or r < misses for k, r in zip(self.noise_known, self.refit, strict=True)
        )


@dataclass(frozen=True, eq=False)
class Measurements:
    """Measurements of the foremost set of a search."""

    evidence: Evidence
    #: noise of each channel on the validation records, as a share of the deviation (channels,)
    noise: Array
    #: parameters with intervals, by path
    quantities: dict[str, Quantity]
    #: damping of added laws together with the dampers beside them, with intervals, by path
    sums: dict[str, Quantity] = field(default_factory=dict)


def collect_evidence(evaluator: HeldOutEvaluator, answer: Answer) -> Measurements:
    """Measure the foremost set."""
    refit, best = answer.refit, answer.foremost
    noise = evaluator.noise_share(answer.best.held)
    fit = best.fit
    matrix = covariance(evaluator, fit)
    evidence = Evidence(
        channels=tuple(evaluator.problem.channels),
        before=_numbers(evaluator.nominal_nrmse[0]),
        refit=_numbers(refit.validation),
        after=_numbers(best.validation),
        noise=_numbers(noise),
        noise_known=tuple(f.known for f in evaluator.noise_estimates),
        training_refit=_numbers(refit.training),
        elpd_diff=answer.gain.elpd_diff,
        elpd_dse=answer.gain.dse,
        explained=removed_share(refit.validation, best.validation, noise),
        test_explained=removed_share(
            refit.test, best.test, evaluator.test_noise(noise)
        ),
        limits=parameters_at_limits(fit),
        refit_limits=parameters_at_limits(refit.fit),
        support=_support(evaluator, best),
    )
    sums: dict[str, Quantity] = {}
    for element in fit.elements:
        if matrix is not None and element.place == "between":
            sums |= sums_with_dampers(
                fit.network, fit.structure, fit.x, element, matrix
            )
    return Measurements(evidence, noise, intervals(evaluator, fit, matrix), sums)


def _numbers(values: Iterable[float]) -> tuple[float, ...]:
    """Return one plain number per channel."""
    return tuple(float(v) for v in values)


def _support(evaluator: HeldOutEvaluator, row: Row) -> float:
    """Return the smallest share of the samples on the rarer side of a law's characteristic point."""
    found = [1.0]
    for e in row.fit.elements:
        motion = (
            motions(evaluator.problem, row.fit).get(e.between)
            if e.place == "between"
            else None
        )
        if motion is not None:
            found.append(e.support(motion))
    return float(np.min(found))
