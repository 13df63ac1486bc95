"""Refit of an FMU's parameters: Gauss-Newton with the stated uncertainty as prior (maximum a posteriori)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym.diagnosis._estimation.least_squares import bounded_step, damped_step
from isd_gym.diagnosis._estimation.noise import (
    Weights,
    deviance_of,
    independent_share,
    weights_of,
    white_weights,
)
from isd_gym.diagnosis._estimation.structure import Free, base_structure
from isd_gym.diagnosis.result import Quantity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isd_gym._common.arrays import Array

    from ..cosimulation import UnitModel
    from .comparison import FmuComparison, Progress, Segment


@dataclass
class FittedFmu:
    """Result of a refit."""

    x: Array  # transformed parameters (parameters,)
    model: UnitModel  # the FMU with the fitted values
    deviance: float  # -2 log L, prior included


class FmuRefit:
    """Maximum a posteriori fit of FMU parameters over whole runs. Derivatives are finite differences.

    Args:
        comparison: Records and the FMU.
        segments: Segments of the records, fitted and held out.
    """

    def __init__(self, comparison: FmuComparison, segments: Sequence[Segment]) -> None:
        self.comparison, self.segments = comparison, list(segments)
        model = comparison.model
        parameters = base_structure(model)  # type: ignore[arg-type]  # reads parameters and uncertainty only
        self.free = tuple(_limit_to_range(f, model) for f in parameters.free)
        self.mean, self.sigma, self.low, self.high = (
            np.array([getattr(f, key) for f in self.free]) for key in ("mean", "sigma", "low", "high")
        )

    def model_at(self, x: Array) -> UnitModel:
        """Return the FMU's model at transformed parameters `x` (parameters,)."""
        values = {f.path: f.back(float(v)) for f, v in zip(self.free, x, strict=True)}
        return self.comparison.model.with_parameters(values)

    def residuals(self, model: UnitModel, held_out: bool) -> list[Array]:
        """Return measured minus simulated outputs of each segment.

        Returns:
            One array (samples, channels) per segment, in the FMU's units.
        """
        c = self.comparison
        return [
            (c.records[s.record].measured - c.simulate(model, s.record))[s.first : s.stop]
            for s in self.segments
            if s.held_out == held_out
        ]

    def _prior(self, x: Array) -> float:
        """Return the squared distance from the prior mean [standard deviations squared]."""
        return float(np.sum(((x - self.mean) / self.sigma) ** 2))

    def _cost(self, x: Array, weights: Weights) -> float:
        """Return the weighted sum of squares with the prior; infinite if the simulation fails."""
        try:
            left = self.residuals(self.model_at(x), held_out=False)
        except InputError:
            return math.inf
        return sum(float(np.sum(weights(r) ** 2)) for r in left) + self._prior(x)

    def linearise(self, x: Array, weights: Weights) -> tuple[Array, Array]:
        """Linearise the residuals by finite differences.

        Args:
            x: Transformed parameters (parameters,).
            weights: Noise model.

        Returns:
            Hessian (parameters, parameters) and descent direction (parameters,) of half the cost, without prior.
        """
        p = len(x)
        here = self.residuals(self.model_at(x), held_out=False)
        columns = []
        for k, f in enumerate(self.free):
            h = 2e-3 if f.log else 1e-3 * max(abs(x[k]), 0.03 * f.sigma)
            h = -h if x[k] + h > f.high else h
            moved = x.copy()
            moved[k] += h
            there = self.residuals(self.model_at(moved), held_out=False)
            columns.append([(b - a) / h for a, b in zip(here, there, strict=True)])
        hessian, descent = np.zeros((p, p)), np.zeros(p)
        for i, r in enumerate(here):
            stack = np.stack([r, *(-c[i] for c in columns)], axis=2)
            rows = weights(stack).reshape(-1, p + 1)
            gram = rows.T @ rows
            hessian += gram[1:, 1:]
            descent += gram[1:, 0]
        return hessian, descent

    def fit(self, floors: Array, progress: Progress, rounds: int = 3, iterations: int = 6) -> FittedFmu:
        """Fit the parameters; reweight by the level of the residuals until the deviance stops falling.

        Args:
            floors: Noise floor of each channel (channels,) [unit of the channel].
            progress: Function that receives a line per round.
            rounds: Rounds of fitting and reweighting at most.
            iterations: Gauss-Newton iterations per round at most.

        Returns:
            The fit with the lowest deviance.
        """
        x, weights, best = self.mean.copy(), white_weights(floors), None
        share: Array | None = None
        for number in range(rounds):
            runs = self.comparison.fmu.runs
            progress(f"refitting {len(x)} parameters (round {number + 1}, {runs} runs of the FMU so far)")
            x = self._minimise(x, weights, iterations)
            left = self.residuals(self.model_at(x), held_out=False)
            share = independent_share(left) if share is None else share
            deviance = deviance_of(left, floors, share) + self._prior(x)
            is_converged = best is not None and deviance > best.deviance - 2.0
            if best is None or deviance < best.deviance:
                best = FittedFmu(x, self.model_at(x), deviance)
            if is_converged or not len(x):
                break
            weights = weights_of(left, floors)
        assert best is not None
        return best

    def _minimise(self, x: Array, weights: Weights, iterations: int) -> Array:
        """Minimise the cost by damped Gauss-Newton steps from `x` (parameters,); return the minimum."""
        damping, cost = 1e-4, self._cost(x, weights)
        if not math.isfinite(cost):
            path = self.comparison.fmu.path
            raise InputError(f"{path}: the simulation breaks down at the start values")
        for _ in range(iterations if len(x) else 0):
            found, lower, damping = self._step(x, cost, weights, damping)
            if found is None:
                break
            gain, x, cost = (cost - lower) / cost, found, lower
            if gain < 1e-4:
                break
        return x

    def _step(
        self, x: Array, cost: float, weights: Weights, damping: float
    ) -> tuple[Array | None, float, float]:
        """Take a damped Gauss-Newton step from `x`; return the values of `damped_step`."""
        hessian, descent = self.linearise(x, weights)
        descent = descent + (self.mean - x) / self.sigma**2
        hessian = hessian + np.diag(1 / self.sigma**2)

        def take(damping: float) -> tuple[Array, float]:
            new = x + bounded_step(hessian, descent, x, self.low, self.high, 2 * self.sigma, damping)
            return new, self._cost(new, weights)

        return damped_step(take, cost, damping, tries=5)

    def intervals(self, found: FittedFmu, floors: Array) -> dict[str, Quantity]:
        """Return each parameter with a 95 % interval by the independent samples among the residuals.

        Args:
            found: The fit.
            floors: Noise floor of each channel (channels,) [unit of the channel].

        Returns:
            Values with intervals by parameter path.
        """
        left = self.residuals(found.model, held_out=False)
        weights = replace(weights_of(left, floors), share=independent_share(left))
        hessian, _ = self.linearise(found.x, weights)
        prior = np.diag(1 / self.sigma**2)
        variance = np.diag(np.linalg.inv(hessian + prior)) if len(found.x) else np.zeros(0)
        out, model = {}, self.comparison.model
        for f, x, v in zip(self.free, found.x, np.minimum(variance, self.sigma**2), strict=True):
            ends = f.interval(float(x), math.sqrt(v))
            unit, nominal = model.unit_of(f.path), model.parameters[f.path]
            out[f.path] = Quantity(f.back(float(x)), *ends, unit, nominal)
        return out

    def parameters_at_limits(self, x: Array) -> tuple[str, ...]:
        """Return the paths of parameters at a limit of the permitted range."""
        margin = 1e-6 * self.sigma
        at_limit = (x <= self.low + margin) | (x >= self.high - margin)
        return tuple(f.path for f, reached in zip(self.free, at_limit, strict=True) if reached)


def _limit_to_range(f: Free, model: UnitModel) -> Free:
    """Return a free parameter within the limits that the FMU declares."""
    low, high = model.limits.get(f.path, (-math.inf, math.inf))
    own = [f.forward(v) if math.isfinite(v) and (v > 0 or not f.log) else v for v in (low, high)]
    return replace(
        f, low=max(f.low, own[0] if not (f.log and low <= 0) else -math.inf), high=min(f.high, own[1])
    )
