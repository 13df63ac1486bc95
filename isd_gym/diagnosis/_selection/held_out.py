"""Held-out records: errors of fits, and noise."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from .._estimation.gauss_newton import Fitter, residuals
from .._estimation.initial_states import next_states, transfer_states
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
    from collections.abc import Mapping, Sequence

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
        p, fitter = self.problem, self.plain_fitter
        if near is None:
            held = fitter.follow(
                fit.structure, fit.x, p.held, None, (self._states_after_training(fit),)
            )
        else:
            states = transfer_states(p, near.network, near.initial, fit.structure)
            held = fitter.follow(fit.structure, fit.x, p.held, states)
        self._check_whole_records(fit, held)
        return held

    # -- whole records ------------------------------------------------------------------------------------
    @cached_property
    def _simulated_by_nominal(self) -> list[int]:
        """Whole records that the nominal model simulates."""
        if self.whole is None:
            return []
        structure = base_structure(self.problem.network)
        broken = self._broken_records(
            structure, structure.start, range(len(self.whole.records)), {}
        )
        return [i for i in range(len(self.whole.records)) if i not in broken]

    def first_states(self, *fits: Fit) -> dict[int, Array]:
        """Return the initial states of whole records, from fits of the records that begin with them."""
        out: dict[int, Array] = {}
        pieces = [
            (self.problem.records[j], f.initial[j]) for f in fits for j in f.initial
        ]
        for i, record in enumerate(self.whole.records if self.whole else []):
            for piece, state in pieces:
                if (
                    piece.name == record.name
                    and abs(piece.start - record.start) < 0.5 * record.interval
                ):
                    out[i] = state
        return out

    def _broken_records(
        self,
        structure: Structure,
        x: Array,
        records: Sequence[int],
        initial: Mapping[int, Array],
    ) -> list[int]:
        """Return the whole records on which a simulation breaks down."""
        assert self.whole is not None
        fitter = Fitter(self.whole, white_weights(self.least_noise))
        out = []
        for (
            i
        ) in records:  # one by one: a record that breaks down must not hide the others
            at = fitter.begin(
                structure, x, {k: v for k, v in initial.items() if k == i}, None, [i]
            )
            if not np.isfinite(fitter.seen(structure, at, [i]).total):
                out.append(i)
        return out

    def _check_whole_records(self, fit: Fit, held: Fit) -> None:
        """Raise InputError for effects that break down on a whole record of the user."""
        if not fit.structure.hypotheses or self.whole is None:
            return
        # a model that breaks down from the start that the first samples tell owes its success to start values that no sensor sees
        for states in (self.first_states(fit, held), {}):
            broken = self._broken_records(
                fit.structure, fit.x, self._simulated_by_nominal, states
            )
            if broken:
                raise InputError(
                    f"the simulation breaks down on the record {self.whole.records[broken[0]].name}"
                )

    def _states_after_training(self, fit: Fit) -> dict[int, Array]:
        """Return the initial states of held-out records that continue a training record."""
        p = self.problem
        continues = {
            j: i
            for j in p.held
            for i in p.estimation
            if p.records[j].follows(p.records[i])
        }
        if not continues or not len(next(iter(fit.initial.values()))):
            return {}
        ends = next_states(
            p, fit.structure, fit.x, {i: fit.initial[i] for i in continues.values()}
        )
        return {j: ends[i] for j, i in continues.items()}

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
