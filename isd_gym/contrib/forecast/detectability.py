"""Evidence that a diagnosis would have for one effect, as a function of the effect's size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym.diagnosis._estimation.gauss_newton import Fit, Fitter
from isd_gym.diagnosis._estimation.initial_states import transfer_states
from isd_gym.diagnosis._estimation.noise import white_weights
from isd_gym.diagnosis._estimation.structure import Hypothesis, Structure, add
from isd_gym.diagnosis._selection.candidate import is_special_case
from isd_gym.diagnosis._selection.held_out import BLOCKS, Comparison, effect_size
from isd_gym.diagnosis._selection.uncertainty import differing_part, relative_uncertainty
from isd_gym.diagnosis._simulation.problem import BROKEN
from isd_gym.diagnosis._verdict.evidence import EffectEvidence, Evidence, as_numbers
from isd_gym.diagnosis._verdict.gates import decide
from isd_gym.diagnosis._verdict.measurement import find_contradiction
from isd_gym.diagnosis.result import Quantity

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from isd_gym._common.arrays import Array
    from isd_gym.diagnosis._simulation.problem import Problem
    from isd_gym.diagnosis._verdict.gates import Decision
    from isd_gym.physics import elements as el

    from .virtual_bench import BenchFit, VirtualBench

#: range of sizes, as multiples of the simulated size
SMALLEST, LARGEST = 0.02, 30.0
#: smallest excess score of a candidate, as a share of the score of noise
LEAST_EXCESS = 0.01


class NoiseFreeResidual:
    """Noise-free residual of a fit, which is proportional to the effect's size."""

    def __init__(self, bench: VirtualBench, fitted: BenchFit):
        self.bench = bench
        self.prior = fitted.fit.prior
        self.parameters = len(fitted.fit.x)
        training, validation = fitted.training, fitted.validation
        self.samples = sum(map(len, training))
        self._power = np.mean(np.concatenate(training) ** 2, axis=0)  # (channels,)
        self.validation_power = np.mean(np.concatenate(validation) ** 2, axis=0)  # (channels,)
        weight = bench.weighting_noise
        #: mean weighted square of each validation block, at the simulated size
        self._scores, _ = _blocks(validation, weight)
        #: the same of validation and training blocks, and their numbers of squares
        self._all_scores, self._all_sizes = _blocks([*validation, *training], weight)

    def excess_deviance(self, scale: float) -> float:
        """Return the deviance of noise plus residual minus the deviance of noise, at a multiple of the size."""
        total = self.samples * float(
            np.sum(np.log1p(self._power * (scale / self.bench.weighting_noise) ** 2))
        )
        return self.bench.length_factor * total + scale * scale * self.prior

    def excess_score(self, scale: float) -> float:
        """Return the excess of the validation score, at a multiple of the size."""
        return scale * scale * float(self._scores.mean())

    def compare_with_truth(self, scale: float, noise: float, parameters: int) -> Comparison:
        """Return the expected comparison of the true structure with this fit, at a multiple of the size.

        The log predictive density of a block is that of `comparison.log_density`; each parameter costs one nat.

        Args:
            scale: Multiple of the simulated size.
            noise: Score of noise.
            parameters: Number of free parameters of the true structure.

        Returns:
            The difference of the log predictive density and its standard error.
        """
        excess = scale * scale * self._all_scores
        lead = self._all_sizes * np.log1p(excess / (1.0 + noise))
        random = 4.0 * self._all_sizes * excess * noise / (1.0 + noise + excess) ** 2
        repeated = self.bench.length_factor
        spread = len(lead) * float(lead.var(ddof=1)) if len(lead) > 1 else math.inf
        return Comparison(
            repeated * float(lead.sum()) + self.parameters - parameters,
            math.sqrt(max(repeated * (spread + float(random.sum())), 1e-300)),
        )


def _blocks(residuals: Sequence[Array], weight: Array) -> tuple[Array, Array]:
    """Return the mean weighted square of each block (blocks,) and its number of squares (blocks,).

    Args:
        residuals: Residuals of records (samples, channels).
        weight: Noise of each channel (channels,).
    """
    scores, sizes = [], []
    for r in residuals:
        square = np.mean((r / weight) ** 2, axis=1)
        edges = np.linspace(0, len(square), BLOCKS + 1).astype(int)
        for a, b in pairwise(edges):
            if b > a:
                scores.append(float(square[a:b].mean()))
                sizes.append((b - a) * len(weight))
    return np.array(scores), np.array(sizes, float)


@dataclass(frozen=True, eq=False)
class RefittedRival:
    """A rival refitted to the outputs of the true effect."""

    hypothesis: Hypothesis
    residual: NoiseFreeResidual


@dataclass(eq=False)
class SimulatedEffect:
    """A true effect at one size, with the residuals of the refitted nominal model and of rivals.

    Methods with a `scale` extrapolate to a multiple of the simulated size.
    """

    bench: VirtualBench
    hypothesis: Hypothesis
    truth: Problem  # the nominal model with the outputs of the true effect
    structure: Structure  # with the effect
    fit: Fit  # of that structure
    residual: NoiseFreeResidual  # of the refitted nominal model
    share: float  # of force, current or signal at the place
    covariance: Array  # of the transformed free parameters (parameters, parameters)
    contradiction: str  # how the values contradict the name of the effect
    rivals: list[RefittedRival]

    @property
    def element(self) -> el.Element:
        """The element of the effect."""
        return self.structure.network.element(self.structure.names[-1])

    @property
    def noise_score(self) -> float:
        """Validation score of noise."""
        return float(np.mean((self.bench.noise / self.bench.weighting_noise) ** 2))

    @property
    def deviation(self) -> Array:
        """Standard deviation of the measured outputs, noise included (channels,)."""
        y = self.truth.measured(self.truth.choosing)
        return np.asarray(np.sqrt(y.var(axis=0) + self.bench.noise**2))

    def uncertainty(self, scale: float) -> float:
        """Return the widest relative 95 % interval of the effect's values (logarithm of a factor)."""
        element, quantities = self.element, {}
        for free, variance in zip(self.structure.free, np.diag(self.covariance), strict=True):
            if free.owner < 0:
                continue
            sigma = min(math.sqrt(max(float(variance), 0.0)) / scale, free.sigma)
            x = free.forward(getattr(element, free.path.rpartition(".")[2]))
            unit = self.structure.network.unit_of(free.path)
            quantities[free.path] = Quantity(free.back(x), *free.interval(x, sigma), unit)
        covariance = self.covariance / scale**2
        apart = differing_part(self.bench.network, self.structure, self.structure.start, element, covariance)
        return relative_uncertainty(element, quantities, apart)

    def is_distinguishable(self, rival: RefittedRival, scale: float) -> bool:
        """Return whether a diagnosis would distinguish the effect from a rival."""
        c, more = self.bench.criteria, rival.residual.parameters - len(self.structure.free)
        if more > 0:  # it predicts no better, at best
            return True
        versus = rival.residual.compare_with_truth(scale, self.noise_score, len(self.structure.free))
        if more == 0 and not is_special_case(self.hypothesis, rival.hypothesis):
            return versus.is_better(c)
        change = scale * np.sqrt(rival.residual.validation_power) / self.deviation
        return versus.is_preferred(c) and bool(np.any(change > self.bench.unmodelled_envelope))

    def evidence(self, scale: float = 1.0, *, with_rivals: bool = True) -> Evidence:
        """Return the evidence that a diagnosis would have.

        Returns:
            The evidence, with noise in expectation.
        """
        bench, residual, noise = self.bench, self.residual, self.noise_score
        floor = bench.noise / self.deviation
        refit = np.sqrt(scale * scale * residual.validation_power / self.deviation**2 + floor**2)
        own = LEAST_EXCESS * noise
        rivals = self.rivals if with_rivals else []
        share = self.share if self.hypothesis.kind.series else scale * self.share
        effect = EffectEvidence(
            label=self.hypothesis.label,
            share=share,
            spread=self.uncertainty(scale),
            contradiction=self.contradiction,
            sensor=self.hypothesis.place == "channel",
            fault=scale * self.element.fault(bench.problem.time),
        )
        nominal = residual.excess_score(scale)
        versus = residual.compare_with_truth(scale, noise, len(self.structure.free))
        excess = [(r.residual.excess_score(scale), r.hypothesis.place != "channel") for r in rivals]
        return Evidence(
            channels=tuple(bench.problem.channels),
            before=as_numbers(refit),
            refit=as_numbers(refit),
            after=as_numbers(floor),
            noise=as_numbers(floor),
            noise_known=tuple(True for _ in floor),
            envelope=as_numbers(bench.unmodelled_envelope),
            effects=(effect,),
            elpd_diff=versus.elpd_diff,
            elpd_dse=versus.dse,
            explained=1.0,
            rival_loss=min([nominal, *(e for e, _ in excess)]) / own,
            indistinguishable=tuple(
                r.hypothesis.label for r in rivals if not self.is_distinguishable(r, scale)
            ),
            force_loss=min([nominal, *(e for e, is_force in excess if is_force)]) / own,
            richest=as_numbers(floor),
            richest_share=share,
        )

    def decide(self, scale: float = 1.0, *, with_rivals: bool = True) -> Decision:
        """Return the decision that a diagnosis would make. See `evidence` for the arguments."""
        return decide(self.evidence(scale, with_rivals=with_rivals), self.bench.criteria)

    def is_named(self, scale: float = 1.0, *, with_rivals: bool = True) -> bool:
        """Return whether a diagnosis would name the effect. See `evidence` for the arguments."""
        return self.decide(scale, with_rivals=with_rivals).verdict == "missing_effect"

    def is_significant(self, scale: float) -> bool:
        """Return whether a diagnosis would find that the effect predicts better, rivals aside."""
        failed = {g.name for g in self.decide(scale, with_rivals=False).gates if not g.passed}
        return "predicts better" not in failed


def find_smallest_scale(passes: Callable[[float], bool]) -> float:
    """Find the smallest multiple of the simulated size from which on a test passes, by bisection.

    Returns:
        The multiple, between `SMALLEST` and `LARGEST`; infinite if the test fails at `LARGEST`.
    """
    if not passes(LARGEST):
        return math.inf
    if passes(SMALLEST):
        return SMALLEST
    low, high = math.log(SMALLEST), math.log(LARGEST)
    while high - low > 0.02:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if passes(math.exp(middle)) else (middle, high)
    return math.exp(high)


def simulate_effect(bench: VirtualBench, hypothesis: Hypothesis, values: dict[str, float]) -> SimulatedEffect:
    """Simulate an effect on the bench and refit the nominal model.

    Returns:
        The simulated effect, without rivals.

    Raises:
        InputError: The simulation or the refit fails.
    """
    structure = add(bench.structure, hypothesis, values)
    truth = bench.measure(structure.network)
    residual = NoiseFreeResidual(bench, bench.fit(truth, bench.structure, bench.structure.start))
    fit, covariance = _fit_truth(bench, truth, structure)
    name = structure.names[-1]
    why = find_contradiction(truth, fit, structure.network.element(name))
    share = effect_size(truth, fit, name)
    return SimulatedEffect(bench, hypothesis, truth, structure, fit, residual, share, covariance, why, [])


def refit_rival(
    effect: SimulatedEffect, rival: Hypothesis, starts: Sequence[dict[str, float]]
) -> RefittedRival | None:
    """Refit a rival to the outputs of a simulated effect.

    Returns:
        The rival with the smallest deviance, or None if all fits fail.
    """
    bench, best = effect.bench, None
    for values in starts:
        try:
            structure = add(bench.structure, rival, values)
            residual = NoiseFreeResidual(bench, bench.fit(effect.truth, structure, structure.start))
        except BROKEN:
            continue
        if best is None or residual.excess_deviance(1.0) < best.excess_deviance(1.0):
            best = residual
    return None if best is None else RefittedRival(rival, best)


def _fit_truth(bench: VirtualBench, truth: Problem, structure: Structure) -> tuple[Fit, Array]:
    """Return the fit of the true structure, and the covariance by noise and by small unmodelled effects."""
    weights = white_weights(bench.weighting_noise)
    known = transfer_states(truth, bench.network, bench.nominal.initial, structure)
    fit = Fitter(truth, weights).fit(structure, structure.start, known, iterations=0)
    if fit.hessian is None or not np.isfinite(fit.hessian).all():
        raise InputError("the simulation fails near these values")
    covariance = np.linalg.inv(bench.length_factor * fit.hessian + np.diag(1 / structure.sigma**2))
    try:
        with np.errstate(invalid="ignore", over="ignore"):
            shift, _ = Fitter(truth, weights).refit(fit, bench.unmodelled_responses)
        shift = np.clip(np.nan_to_num(shift), -1e6, 1e6)
        covariance = covariance + shift @ shift.T
    except BROKEN:
        pass
    return fit, np.asarray(covariance, dtype=np.float64)
