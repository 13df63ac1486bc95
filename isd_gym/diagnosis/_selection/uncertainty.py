"""Uncertainty of fitted parameters: covariance, intervals, and parameters at their limits."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import brentq

from ..._common.arrays import Z95
from ...physics import elements as el
from .._estimation.gauss_newton import Fitter
from .._estimation.sensitivities import deviations
from .._hypotheses.law_matching import simulate_unmodelled_effects
from .._simulation.problem import BROKEN
from .held_out_table import block_edges

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ..._common.arrays import Array
    from ...physics.network import Network
    from .._estimation.gauss_newton import Fit
    from .._estimation.structure import Structure
    from .held_out import HeldOutEvaluator

#: force of each effect that no model contains (one sigma), as a share of the typical force
SMALL = 0.005
#: largest relative standard deviation that a model states
MOST_UNCERTAIN = 100.0
#: largest shift of a parameter by an unmodelled effect (transformed units): keeps squares finite
LARGEST_SHIFT = 1e6
#: number of times that derivatives are taken over the standard deviations found before
PASSES = 2


@dataclass(frozen=True)
class Quantity:
    """A fitted number with its 95 % interval."""

    #: estimate [unit]
    value: float
    #: lower end of the interval [unit]
    low: float
    #: upper end of the interval [unit]
    high: float
    #: unit of the parameter
    unit: str
    #: value in the nominal model [unit]; None for parameters of a new effect
    prior: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON document, without an unknown prior."""
        return {k: v for k, v in vars(self).items() if v is not None}


def covariance(evaluator: HeldOutEvaluator, fit: Fit) -> Array | None:
    """Return the mean square error of the free parameters, transformed (parameters, parameters); None where no parameter is free.

    Four parts, to first order:

    - Noise: the inverse curvature of the cost. Where the scores of blocks of the record scatter more than white noise would, the sandwich
      estimate replaces the deviation of a parameter (Huber 1967): the residual has a colour that the filters do not remove.
    - Small effects that no model contains: each has a prior size (`SMALL`), and the residual reduces its uncertainty.
      For an added effect the residual only bounds their power together: the same residual chose the effect.
    - Bias: the shift of the parameters by the sizes that the residual shows.
    - Distance from the optimum: one more step of the fit, with better derivatives. Along a direction in which the outputs hardly change, a fit
      with dry friction stops early.

    References:
        Huber, The behavior of maximum likelihood estimates under nonstandard conditions, Proc. 5th Berkeley Symposium (1967) 221.
        Gelman et al.: Bayesian Data Analysis, 3rd edition (2013), chapter 15 (effects with a common prior).
    """
    problem = evaluator.problem
    if not len(fit.x):
        return None
    fitter = Fitter(problem, evaluator.weights(fit))
    effects = simulate_unmodelled_effects(problem, fit, SMALL)
    responses = {
        i: np.concatenate(
            [(problem.records[i].measured - fit.outputs[i])[:, :, None], y], axis=2
        )
        for i, y in effects.items()
    }
    p = len(fit.x)
    H, g, parts = fitter.normal_equations(fit.structure, fit.x, fit.initial, responses)
    for _ in range(PASSES):
        steps = deviations(fit.structure, fit.x, _inverse(H)[:p, :p])
        try:
            found = fitter.normal_equations(
                fit.structure, fit.x, fit.initial, responses, over=steps
            )
        except BROKEN:
            break
        if not np.isfinite(found[0]).all():  # the model does not simulate so far away
            break
        H, g, parts = found
    inverse = _inverse(H)
    shift = inverse @ g[:, 1:]
    # normal equations of the effects' sizes, parameters eliminated; the prior of each size has variance 1
    gram, right = (
        np.eye(shift.shape[1]) - g[:, 1:].T @ shift,
        -g[:, 1:].T @ inverse @ g[:, 0],
    )
    scores: list[Array] = []
    for i, (a, c) in parts.items():
        gram, right = gram + c[:, 1:].T @ c[:, 1:], right + c[:, 1:].T @ c[:, 0]
        score = (
            (a * c[:, :1]).reshape(len(problem.records[i]), -1, a.shape[1]).sum(axis=1)
        )
        edges = block_edges(problem.records[i].measured)
        scores += [score[m:n].sum(axis=0) for m, n in pairwise(edges)]
    cost = sum(float(np.sum(c[:, 0] ** 2)) for _, c in parts.values())
    largest = np.clip(
        shift @ sizes_within(gram - np.eye(len(gram)), cost),
        -LARGEST_SHIFT,
        LARGEST_SHIFT,
    )
    size = np.linalg.solve(gram, right)
    spread = np.linalg.inv(gram) + np.outer(size, size)
    block = np.array(scores) - np.mean(scores, axis=0)
    sandwich = inverse @ (block.T @ block) @ inverse
    wider = np.sqrt(np.maximum(np.diag(sandwich) / np.diag(inverse), 1.0))
    down = g[:, 0].copy()
    down[:p] += (fit.structure.mean - fit.x) / fit.structure.sigma**2
    step = inverse @ down
    out = (
        inverse * np.outer(wider, wider)
        + shift @ spread @ shift.T
        + np.outer(step, step)
    )
    whole = np.diag(inverse) + np.sum(largest**2, axis=1)
    is_added = [
        any(f.path.startswith(f"{name}.") for name in fit.structure.names)
        for f in fit.structure.free
    ]
    grown = np.ones(len(out))
    grown[:p] = np.where(
        is_added, np.sqrt(np.maximum(whole / np.diag(out), 1.0))[:p], 1.0
    )
    return np.asarray((out * np.outer(grown, grown))[:p, :p])


def sizes_within(visible: Array, cost: float) -> Array:
    """Return a root of the covariance of effects' sizes (effects, directions): standard normal sizes, whose responses together have no more
    power than the residual.

    A small force moves a free mass far, and the sensors would measure this motion.

    `visible`: products of the effects' responses (effects, effects).
    `cost`: power of the residual.
    """
    power, directions = np.linalg.eigh(visible)
    power = np.maximum(power, 0.0)

    def beyond(weight: float) -> float:
        return float(np.sum(power / (1.0 + weight * power))) - cost

    weight = brentq(beyond, 0.0, len(power) / cost) if beyond(0.0) > 0 else 0.0
    return np.asarray(directions / np.sqrt(1.0 + weight * power))


def _inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric positive definite matrix, whatever the units of its rows."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    return np.asarray(
        scale[:, None] * np.linalg.inv(matrix * np.outer(scale, scale)) * scale,
        dtype=np.float64,
    )


def intervals(
    evaluator: HeldOutEvaluator, f: Fit, known: Array | None = None
) -> dict[str, Quantity]:
    """Return every free parameter with its 95 % interval, by path; no interval is wider than the stated uncertainty."""
    problem = evaluator.problem
    matrix = covariance(evaluator, f) if known is None else known
    out: dict[str, Quantity] = {}
    if matrix is None:
        return out
    variance = np.minimum(np.maximum(np.diag(matrix), 0.0), f.structure.sigma**2)
    prior = problem.network.parameters
    for k, q in enumerate(f.structure.free):
        ends = q.interval(f.x[k], math.sqrt(variance[k]))
        out[q.path] = Quantity(
            q.back(f.x[k]), *ends, f.network.unit_of(q.path), prior.get(q.path)
        )
    return out


def with_posterior(network: Network, quantities: Mapping[str, Quantity]) -> Network:
    """Return a fitted model whose stated uncertainties, as relative standard deviations, are those of the fit; parameters without an
    interval keep theirs."""
    own, found = network.parameters, {}
    for path, q in quantities.items():
        if (
            path not in own
            or q.value == 0
            or not math.isfinite(q.low)
            or not math.isfinite(q.high)
        ):
            continue
        if q.value > 0 and q.low > 0:
            sigma = math.expm1(min(0.5 * math.log(q.high / q.low) / Z95, 10.0))
        else:
            sigma = 0.5 * (q.high - q.low) / Z95 / abs(q.value)
        found[path] = float(f"{min(sigma, MOST_UNCERTAIN):.3g}")
    return replace(network, uncertainty={**network.uncertainty, **found})


def parameters_at_limits(fit: Fit) -> tuple[str, ...]:
    """Return the parameters of the nominal model that end at the limit of their stated uncertainty."""
    return tuple(
        q.path
        for q, x in zip(fit.structure.free, fit.x, strict=True)
        if q.owner < 0 and (x <= q.low + 1e-6 * q.sigma or x >= q.high - 1e-6 * q.sigma)
    )


def sums_with_dampers(
    network: Network, structure: Structure, x: Array, element: el.Element, matrix: Array
) -> dict[str, Quantity]:
    """Return the damping of an added law together with the dampers of the fitted model beside it, by path; empty for other laws."""
    here = [e for e in el.beside(network, element.where) if e.name != element.name]
    pair = element.differing(here)
    if pair is None:
        return {}
    dampers = [e for e in here if isinstance(e, el.LinearDamping)]
    beside = sum(e.damping for e in dampers)
    scale = {f"{e.name}.damping": e.damping for e in dampers}
    out: dict[str, Quantity] = {}
    for name in pair:
        own = f"{element.name}.{name}"
        paths = {own, *scale}
        slopes = [
            scale[q.path] if q.log else 1.0 for q in structure.free if q.path in paths
        ]
        places = [k for k, q in enumerate(structure.free) if q.path in paths]
        variance = float(
            np.array(slopes) @ matrix[np.ix_(places, places)] @ np.array(slopes)
        )
        total, half = (
            getattr(element, name) + beside,
            Z95 * math.sqrt(max(variance, 0.0)),
        )
        out[own] = Quantity(total, total - half, total + half, network.unit_of(own))
    return out
