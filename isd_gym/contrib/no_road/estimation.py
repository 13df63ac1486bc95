"""Maximum-likelihood fits of a Kalman model, and the uncertainty of fitted numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from isd_gym._common.arrays import Z95
from isd_gym._common.errors import InputError
from isd_gym.diagnosis._estimation.structure import add
from isd_gym.diagnosis.result import Quantity
from isd_gym.physics import elements as el

from .kalman import IMPOSSIBLE, KalmanModel, Prior

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isd_gym._common.arrays import Array
    from isd_gym.diagnosis._estimation.structure import Hypothesis, Structure
    from isd_gym.diagnosis._simulation.time_limit import TimeLimit
    from isd_gym.physics.network import Network

    from .kalman import Prediction

#: Linear effects and the index of the coefficient in `Element.linear`.
LINEAR = {"linear_stiffness": 0, "linear_damping": 1, "inertance": 2}
WIDE = 3.0  # prior standard deviation of an unknown logarithm
LEVEL_SIGMA = 1e3  # prior standard deviation of the logarithm of the road's level
LEVELS = np.linspace(-30.0, 5.0, 36)  # logarithms of the road's level compared before a fit
SIZES = (0.03, 0.3)  # first values of an effect, relative to the largest coefficient of its kind in the model
DETERMINED = 0.5  # posterior relative to prior standard deviation below which a parameter is determined
SCALE = 0.1  # standard deviation of the logarithm of the common scale above which only ratios are determined
STEP = 1e-4  # step of finite differences in logarithms
REACH = 1.0  # largest change of a logarithm per iteration
ITERATIONS = 60  # largest number of iterations of a fit
SETTLED = 0.1  # gain in 2 log L per iteration below which a fit has converged
#: Units of parameters proportional to a common scale of masses and forces.
SCALED = ("kg", "N/m", "N s/m", "N/A", "N", "kg m^2", "N m/rad", "N m s/rad", "N m")


@dataclass(frozen=True)
class ModelFit:
    """A fitted Kalman model."""

    model: KalmanModel
    x: Array  # fitted numbers (n,)
    deviance: float  # -2 log of likelihood and prior
    converged: bool = True  # whether the fit ended within the time limit


@dataclass(frozen=True, kw_only=True)
class Estimates:
    """Fitted numbers with their 95 % intervals."""

    level: Quantity  # two-sided intensity of the road's velocity [m^2/s] ([rad^2/s] of a turning road)
    parameters: dict[str, Quantity]  # of the nominal model by path
    effect: dict[str, Quantity]  # parameters of the added effect by name
    #: Departures of uncertain parameters from the nominal values, in stated standard deviations.
    departures: dict[str, float]
    determined: tuple[str, ...]  # parameters whose stated uncertainty the records at least halve
    scale: float  # standard deviation of the logarithm of a factor common to all masses and forces
    ratios_only: bool  # whether the records determine ratios to mass only
    noise: dict[str, float]  # RMS noise by output in SI units


def build_model(
    structure: Structure, road: str, records: tuple[tuple[Array, Array], ...], step: float, noise: Array
) -> KalmanModel:
    """Return the Kalman model of a network, with the best road level at the prior means.

    Args:
        structure: The network in the frame of the road, with its free parameters.
        road: Name of the unmeasured input.
        records: Inputs (samples, inputs) and outputs (samples, outputs) by record about the means, in SI units.
        step: Sampling interval [s].
        noise: Assumed noise (outputs,) in SI units.

    Raises:
        InputError: The model has no stationary motion at any road level.
    """
    network = structure.network
    frictions = tuple(e.name for e in network.elements for e in e.parts() if e.bound is not None)
    stiffness = max((e.linear()[0] for e in network.elements), default=0.0)
    critical = 2.0 * math.sqrt(
        max(stiffness, 1e-12) * max(network.largest_inertia(*network.moved_nodes), 1e-12)
    )
    priors = [
        *(Prior(f.path, f.mean, f.sigma) for f in structure.free),
        Prior("level", 0.0, LEVEL_SIGMA),
        *(Prior(f"{name} as a damper", math.log(critical), WIDE) for name in frictions),
        *(Prior(c.name, math.log(s), WIDE) for c, s in zip(network.outputs, noise, strict=True)),
    ]
    inputs = tuple(c.name for c in network.inputs if c.name != road)
    model = KalmanModel(structure, road, records, step, frictions, inputs, tuple(priors))
    x, at = np.array([p.mean for p in priors]), len(structure.free)
    costs = [model.deviance(np.concatenate([x[:at], [level], x[at + 1 :]])) for level in LEVELS]
    if min(costs) >= IMPOSSIBLE:
        raise InputError(
            "the model without its road has no stationary motion: what holds its masses, and damps them?"
        )
    priors[at] = Prior("level", float(LEVELS[int(np.argmin(costs))]), LEVEL_SIGMA)
    return replace(model, priors=tuple(priors))


def _unit_steps(model: KalmanModel) -> Array:
    """Return the units of fitted numbers (n,): 1 for a logarithm, else the prior standard deviation."""
    own = [1.0 if f.log else f.sigma for f in model.structure.free]
    return np.array(own + [1.0] * (len(model.priors) - len(own)))


def compute_information(
    model: KalmanModel, x: Array, here: Prediction, free: Sequence[int]
) -> tuple[Array, Array]:
    """Compute the gradient of -2 log L of the records, and the Fisher information, both without the prior.

    Args:
        model: The Kalman model.
        x: Fitted numbers (n,).
        here: Prediction of the model at `x`.
        free: Indices (m,) of the numbers to differentiate by.

    Returns:
        Gradient (m,) and Fisher information (m, m).

    References:
        Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, section 3.4.5.
    """
    W, units = here.whitening, _unit_steps(model)
    white = np.concatenate([e @ W.T for e in here.errors])
    errors, covariances = [], []
    for k in free:
        for step in (STEP * units[k], -STEP * units[k]):
            there = model.predict(x + step * (np.arange(len(x)) == k))
            if there is not None:
                errors.append((np.concatenate([e @ W.T for e in there.errors]) - white).ravel() / step)
                covariances.append((W @ (there.covariance - here.covariance) @ W.T).ravel() / step)
                break
        else:
            errors.append(np.zeros(white.size))
            covariances.append(np.zeros(W.size))
    J, V = np.stack(errors), np.stack(covariances)
    power = (white.T @ white).ravel()
    gradient = 2.0 * J @ white.ravel() - V @ power + here.samples * V @ np.eye(len(W)).ravel()
    return gradient, J @ J.T + 0.5 * here.samples * V @ V.T


def fit_model(model: KalmanModel, x: Array, clock: TimeLimit, fixed: int = 0) -> ModelFit:
    """Maximise likelihood times prior by Fisher scoring, damped after Levenberg and Marquardt.

    Args:
        model: The Kalman model with its priors.
        x: Start of the fit (n,).
        clock: Time limit of the fit.
        fixed: Count of leading numbers with fixed values.
    """
    free = list(range(fixed, len(x)))
    precision = np.array([p.sigma for p in model.priors])[free] ** -2.0
    centre = np.array([p.mean for p in model.priors])[free]
    reach, damping = REACH * _unit_steps(model)[free], 1e-3
    x, here = np.array(x, dtype=np.float64), model.predict(x)
    if here is None:
        return ModelFit(model, x, IMPOSSIBLE)
    cost = model.penalty(x) + here.deviance
    for _ in range(ITERATIONS):
        if clock.is_over:
            return ModelFit(model, x, cost, converged=False)
        gradient, information = compute_information(model, x, here, free)
        gradient = gradient + 2.0 * precision * (x[free] - centre)
        hessian = 2.0 * (information + np.diag(precision))
        before = cost
        while damping < 1e9:
            step = -np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
            trial = x.copy()
            trial[free] += np.clip(step, -reach, reach)
            there = model.predict(trial)
            if there is not None and model.penalty(trial) + there.deviance < cost:
                x, here, cost = trial, there, model.penalty(trial) + there.deviance
                damping = max(damping / 10.0, 1e-6)
                break
            damping *= 10.0
        if before - cost < SETTLED:
            break
    return ModelFit(model, x, cost)


def fit_effect(base: ModelFit, hypothesis: Hypothesis, clock: TimeLimit) -> ModelFit | None:
    """Fit a model with one more linear effect, from a small and from a large start.

    Returns:
        The better fit; None if the effect cannot be built in or every fit fails.
    """
    model, own = base.model, len(base.model.structure.free)
    network = model.network(base.x)
    coefficient = LINEAR[hypothesis.effect]
    size = max((e.linear()[coefficient] for e in network.elements), default=0.0)
    size = size or (network.largest_inertia(*hypothesis.where) if hypothesis.effect == "inertance" else 0.0)
    if not size:
        return None
    (name,) = [f.name for f in el.parameter_fields(hypothesis.kind)]
    fits = []
    for share in SIZES:
        try:
            structure = add(model.structure, hypothesis, {name: share * size})
        except InputError:
            return None
        start = math.log(share * size)
        prior = Prior(structure.free[-1].path, start, WIDE)
        priors = (*model.priors[:own], prior, *model.priors[own:])
        fits.append(
            fit_model(
                replace(model, structure=structure, priors=priors), np.insert(base.x, own, start), clock
            )
        )
    best = min(fits, key=lambda fit: fit.deviance)
    return best if best.deviance < IMPOSSIBLE else None


def estimate_uncertainty(network: Network, fit: ModelFit) -> Estimates:
    """Compute intervals, determined parameters and the common scale from the Fisher information at a fit."""
    model, x = fit.model, fit.x
    free, at, frictions = model.structure.free, len(model.structure.free), len(model.frictions)
    here = model.predict(x)
    assert here is not None
    _, information = compute_information(model, x, here, range(len(x)))
    precision = np.array([p.sigma for p in model.priors]) ** -2.0
    unit = 1.0 / np.sqrt(np.diag(information) + precision)  # the scaled matrix has a diagonal of ones
    covariance = np.linalg.pinv((information + np.diag(precision)) * np.outer(unit, unit), hermitian=True)
    deviation = unit * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    fitted = model.network(x)
    units = [network.unit_of(f.path) if f.owner < 0 else fitted.unit_of(f.path) for f in free]
    common = np.zeros(len(x))
    common[:at] = [f.log and u in SCALED for f, u in zip(free, units, strict=True)]
    common[at + 1 : at + 1 + frictions] = 1.0
    scale = _estimate_scale(model, x, common, information)

    def quantity(v: float, s: float, unit: str, log: bool = True, prior: float | None = None) -> Quantity:
        back = _exp if log else float
        return Quantity(back(v), back(v - Z95 * s), back(v + Z95 * s), unit, prior)

    quantities = {
        f.path: quantity(v, s, u, f.log, network.parameters.get(f.path))
        for f, v, s, u in zip(free, x, deviation, units, strict=False)
    }
    own = [(f, v, s) for f, v, s in zip(free, x, deviation, strict=False) if f.owner < 0]
    return Estimates(
        level=quantity(x[at], deviation[at], "m^2/s"),
        parameters={k: q for k, q in quantities.items() if k in network.parameters},
        effect={k.rpartition(".")[2]: q for k, q in quantities.items() if k not in network.parameters},
        departures={f.path: float((v - f.mean) / f.sigma) for f, v, _ in own},
        determined=tuple(f.path for f, _, s in own if s < DETERMINED * f.sigma),
        scale=scale,
        ratios_only=bool(common.any()) and scale > SCALE,
        noise={c.name: _exp(v) for c, v in zip(network.outputs, x[at + 1 + frictions :], strict=True)},
    )


def _estimate_scale(model: KalmanModel, x: Array, common: Array, information: Array) -> float:
    """Return the standard deviation of the logarithm of a common scale of masses and forces, from the records alone.

    The smaller of two estimates of the information counts: the second difference of the deviance, and the profiled Fisher information.

    Args:
        model: The Kalman model.
        x: Fitted numbers (n,).
        common: 1 for numbers proportional to the scale, else 0 (n,).
        information: Fisher information of the records (n, n).
    """
    prior = np.array([(c / p.sigma) ** 2 for c, p in zip(common, model.priors, strict=True)]).sum()
    size = 0.02
    bend = model.deviance(x + size * common) - 2 * model.deviance(x) + model.deviance(x - size * common)
    direct = bend / (2 * size**2) - prior
    still = common == 0
    profiled = float(common @ information @ common)
    if still.any():
        pull = information[still] @ common
        profiled -= float(pull @ np.linalg.pinv(information[np.ix_(still, still)], hermitian=True) @ pull)
    known = min(direct, profiled) if profiled > 0 else direct
    return 1.0 / math.sqrt(known) if known > 0 else math.inf


def _exp(x: float) -> float:
    """Return exp(x), or infinity on overflow."""
    return math.exp(x) if x < 709.0 else math.inf
