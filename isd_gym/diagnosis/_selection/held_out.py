"""Held-out records: errors of fits, and noise."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from .._estimation.gauss_newton import Fitter, residuals
from .._estimation.initial_states import transfer_states
from .._estimation.noise import (
    Floor,
    floors_of,
    independent_share,
    noise_of,
    weights_of,
    white_weights,
)
from .._estimation.structure import base_structure
from .._simulation.problem import BROKEN
from .criteria import LEAST_NOISE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from .._estimation.gauss_newton import Fit
    from .._estimation.noise import Weights
    from .._estimation.structure import Structure
    from .._simulation.problem import Problem


class HeldOutEvaluator:
    """Errors of fits on the held-out records of a problem; every fit must simulate the user's `whole` records, if any."""

    def __init__(self, problem: Problem, whole: Problem | None = None):
        self.problem = problem
        self.whole = whole
        #: noise of each channel, as the owner or the signal tells
        self.noise_estimates: list[Floor] = floors_of(problem)
        self.training_deviation = problem.deviation()
        #: smallest noise that residuals are weighted with (channels,) [unit of the channel]
        self.least_noise = np.maximum(
            [f.deviation for f in self.noise_estimates],
            LEAST_NOISE * self.training_deviation,
        )
        self.validation_deviation = problem.deviation(problem.choosing)
        self.test_deviation = problem.deviation(problem.reporting)

    @cached_property
    def plain_fitter(self) -> Fitter:
        """Fitter with white noise."""
        return Fitter(self.problem, white_weights(self.least_noise))

    def weights(self, fit: Fit) -> Weights:
        """Return weights by the level of the training residuals of a fit, and the share of independent samples."""
        left = residuals(self.problem, fit)
        weights = weights_of(left, self.least_noise)
        return replace(weights, share=independent_share(left))

    # -- errors -------------------------------------------------------------------------------------------
    def nrmse(self, fit: Fit, records: Sequence[int], deviation: Array) -> Array:
        """Return the RMS error over the deviation (channels,)."""
        r = np.concatenate(
            [self.problem.records[i].measured - fit.outputs[i] for i in records]
        )
        return np.asarray(np.sqrt(np.mean(r**2, axis=0)) / deviation, dtype=np.float64)

    @cached_property
    def nominal_nrmse(self) -> tuple[Array, Array]:
        """The NRMSE of the nominal model on the validation and on the test records, (channels,) each; NaN where it breaks down."""
        p, structure = self.problem, base_structure(self.problem.network)
        try:
            f = self.plain_fitter.follow(structure, structure.start, p.held)
        except BROKEN:
            unknown = np.full(len(p.channels), np.nan)
            return unknown, unknown
        return (
            self.nrmse(f, p.choosing, self.validation_deviation),
            self.nrmse(f, p.reporting, self.test_deviation),
        )

    def held_fit(self, fit: Fit, near: Fit | None = None) -> Fit:
        """Return the simulation of the held-out records: parameters as fitted, initial states and offsets from each record, from the
        states of a simulation `near` it if given. Raise InputError where a law breaks down on a whole record of the user."""
        p, begun = self.problem, {}
        if near is not None:
            begun = transfer_states(p, near.network, near.initial, fit.structure)
        held = self.plain_fitter.follow(fit.structure, fit.x, p.held, begun)
        if fit.hypotheses and self.whole is not None:
            broken = self._breakdowns(self.whole, fit.structure, fit.x) - self._broken
            if broken:
                name = self.whole.records[min(broken)].name
                raise InputError(f"the simulation breaks down on the record {name}")
        return held

    # -- whole records ------------------------------------------------------------------------------------
    def _breakdowns(self, whole: Problem, structure: Structure, x: Array) -> set[int]:
        """Return the whole records on which a simulation breaks down, from the states that the first samples tell."""
        fitter, out = Fitter(whole, white_weights(self.least_noise)), set()
        # one by one: a record that breaks down must not hide the others
        for i in range(len(whole.records)):
            at = fitter.begin(structure, x, None, None, [i])
            if not np.isfinite(fitter.seen(structure, at, [i]).total):
                out.add(i)
        return out

    @cached_property
    def _broken(self) -> set[int]:
        """Whole records on which the nominal model breaks down."""
        if self.whole is None:
            return set()
        structure = base_structure(self.problem.network)
        return self._breakdowns(self.whole, structure, structure.start)

    # -- noise --------------------------------------------------------------------------------------------
    def noise_share(self, held: Fit) -> Array:
        """Return the noise as a share of each channel's deviation (channels,): as the owner or the spectrum tells, and no more than is left
        above the motion of the validation records, at most the error itself."""
        p, out = self.problem, []
        first = p.records[p.choosing[0]]
        for j, known in enumerate(self.noise_estimates):
            series = [
                p.records[i].measured[:, j] - held.outputs[i][:, j] for i in p.choosing
            ]
            left = noise_of(series, first.interval, time=p.time, white=first.filtered)
            out.append(
                known.deviation
                if known.source in ("owner", "input")
                else min(left, known.deviation)
            )
        share = np.array(out) / self.validation_deviation
        return np.asarray(
            np.minimum(share, self.nrmse(held, p.choosing, self.validation_deviation))
        )

    def test_noise(self, noise: Array) -> Array:
        """Return the noise as a share of the deviation on the test records, from that on the validation records (channels,)."""
        return np.asarray(noise * self.validation_deviation / self.test_deviation)
