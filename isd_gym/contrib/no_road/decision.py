"""Gates and verdict of an identification without a measured road."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from isd_gym.diagnosis._estimation.structure import REACH as FAR
from isd_gym.diagnosis._selection.criteria import CRITERIA
from isd_gym.diagnosis._verdict.gates import COMPARE, Gate
from isd_gym.physics import elements as el
from isd_gym.physics.network._cut import cut_nodes

from .estimation import estimate_uncertainty
from .result import UnknownInputResult

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isd_gym._common.arrays import Array
    from isd_gym.diagnosis._estimation.structure import Hypothesis
    from isd_gym.diagnosis._simulation.time_limit import TimeLimit
    from isd_gym.diagnosis._verdict.gates import Relation, Verdict
    from isd_gym.physics.network import Network

    from .estimation import Estimates, ModelFit
    from .kalman import Prediction

LEAD = 6.0  # lead in 2 log L of a named effect over the next effect
NOISE = 0.3  # largest share of an output's standard deviation attributed to noise
LAGS = 20  # number of past samples to predict a prediction error from
COLOURED = 0.1  # largest predictable share of the power of a prediction error
TINY = 0.01  # share of the model's largest value in the same unit below which no effect is plausible


def compute_coloured_shares(errors: Sequence[Array], deviation: Array) -> Array:
    """Compute the predictable share of prediction errors; zero for a correct model.

    Args:
        errors: Prediction errors by record (samples, outputs).
        deviation: Standard deviations (outputs,).

    Returns:
        Shares of the power (outputs,), beyond chance; 0 if the predictable part is below the material share of the output.
    """
    out = np.zeros(len(deviation))
    for j in range(len(deviation)):
        series = [np.ascontiguousarray(e[:, j]) for e in errors if len(e) > 2 * LAGS]
        count = sum(map(len, series))
        if not count:
            continue
        power = sum(float(e @ e) for e in series) / count
        rows = np.concatenate([np.lib.stride_tricks.sliding_window_view(e, LAGS + 1) for e in series])
        past, now = rows[:, :-1], rows[:, -1]
        rest = float(np.mean((now - past @ np.linalg.lstsq(past, now, rcond=None)[0]) ** 2))
        share = 1.0 - rest / max(power, 1e-300) - 2.0 * LAGS / count
        if share > 0 and math.sqrt(share * power) > CRITERIA.material * deviation[j]:
            out[j] = share
    return out


def find_plausible_range(network: Network, effect: str, name: str) -> tuple[float, float]:
    """Return the plausible range of a parameter of a new effect.

    Args:
        network: The nominal model; values in the same unit may widen the range of the effect's class.
        effect: Type of the effect.
        name: Name of the parameter.

    Returns:
        Lower and upper end in the unit of the parameter.
    """
    meta = next(f.metadata for f in el.parameter_fields(el.TYPES[effect]) if f.name == name)
    low, high = meta["range"]
    own = [v for path, v in network.parameters.items() if network.unit_of(path) == meta["unit"] and v > 0]
    top = max(own, default=high)
    return min(low, TINY * top), max(high, top)


def _gate(name: str, value: float, relation: Relation, limit: float, text: str) -> Gate:
    """Return a gate with the condition ``value relation limit``."""
    return Gate(name, bool(COMPARE[relation](value, limit)), value, limit, text, relation)


def check_fit(
    network: Network, estimates: Estimates, prediction: Prediction, deviation: Array, effect: str = ""
) -> list[Gate]:
    """Return the gates for the soundness of a fit; a failed gate gives the verdict `unknown_effect`.

    Args:
        network: The nominal model.
        estimates: Estimates of the fit.
        prediction: Prediction of the fit.
        deviation: Standard deviations in SI units (outputs,).
        effect: Type of the added effect, if any.
    """
    values = {"the road's level": estimates.level, **estimates.parameters, **estimates.effect}
    broken = [k for k, q in values.items() if not all(map(math.isfinite, (q.value, q.low, q.high)))]
    text = f"values without a finite interval{': ' * bool(broken)}{' and '.join(broken)}"
    gates = [_gate("finite", len(broken), "<=", 0, text)]
    for path, off in sorted(estimates.departures.items(), key=lambda item: -abs(item[1]))[:1]:
        q = estimates.parameters[path]
        text = f"stated standard deviations between {path}, {q.value:.4g} {q.unit}, and the model's {q.prior:.4g} {q.unit}"
        gates.append(_gate("plausible", abs(off), "<=", FAR, text))
    for name, q in estimates.effect.items():
        low, high = find_plausible_range(network, effect, name)
        text = f"{q.unit}, {name} of the added {effect}, plausible from {low:.3g} to {high:.3g}"
        is_low = q.value < low
        gates.append(_gate("range", q.value, ">=" if is_low else "<=", low if is_low else high, text))
    outputs = [c.name for c in network.outputs]
    shares = np.array([estimates.noise[c] for c in outputs]) / deviation
    worst = int(np.argmax(shares))
    text = (
        f"of the standard deviation of {outputs[worst]} attributed to noise, the largest share of all outputs"
    )
    gates.append(_gate("noise", float(shares[worst]), "<=", NOISE, text))
    shares = compute_coloured_shares(prediction.errors, deviation)
    worst = int(np.argmax(shares))
    text = (
        f"of the power of the prediction error of {outputs[worst]} predicted by its past, the largest share of all outputs "
        f"with a predictable part of at least {CRITERIA.material:.0%}"
    )
    return [*gates, _gate("white", float(shares[worst]), "<=", COLOURED, text)]


def _explain_failure(nominal: Network, failed: Sequence[Gate]) -> str:
    """Return the reason for an abstention, made of the failed gates, and remedies."""
    late = [g for g in failed if g.name in ("converged", "complete")]
    wrong = [g for g in failed if g not in late]
    sentences = []
    if wrong:
        figures = "; ".join(f"{g.value:.3g} {g.text} (limit {g.limit:.3g})" for g in wrong)
        node = next(iter(cut_nodes(nominal)), None)
        option = f"isd-gym diagnose --cut {node or ''}".strip()
        sentences = [
            f"No linear model explains the records: {figures}.",
            "A nonlinear force, such as dry friction or an end stop, has this effect.",
            f"{'' if node else 'With an accelerometer at the wheel, '}{option} finds such forces without the road.",
        ]
    if any(g.name == "plausible" for g in wrong):
        sentences.append("If the parameter may be that far off, state a larger uncertainty (--uncertain).")
    if late:
        figures = "; ".join(f"{g.value:g} of {g.limit:g} {g.text}" for g in late)
        sentences.append(f"Too little time: {figures}. A longer --max-seconds or shorter records help.")
    return " ".join(sentences)


def decide(
    nominal: Network,
    nominal_fit: ModelFit,
    refit: ModelFit,
    tried: Sequence[tuple[Hypothesis, ModelFit]],
    progress: tuple[int, int],
    clock: TimeLimit,
    notes: Sequence[str],
) -> UnknownInputResult:
    """Apply the gates to the fits and return the result.

    Args:
        nominal: The nominal model.
        nominal_fit: Fit of the road's level and the noise alone, with nominal parameters.
        refit: Fit of all parameters.
        tried: Linear effects with their fits, the best first.
        progress: Numbers of tried effects and of effects.
        clock: Time limit of the search.
        notes: Notes so far.
    """
    gains = [refit.deviance - fit.deviance for _, fit in tried]
    named, fit = tried[0] if tried and gains[0] > CRITERIA.deviance_gain else (None, refit)
    network, model = refit.model.structure.network, fit.model
    estimates = estimate_uncertainty(network, fit)
    prediction = model.predict(fit.x)
    assert prediction is not None
    deviation = np.concatenate([y for _, y in model.records]).std(axis=0)
    gates = [
        _gate("converged", float(refit.converged), ">=", 1, "refits ended within the time limit"),
        *check_fit(network, estimates, prediction, deviation, named.effect if named else ""),
        _gate("complete", progress[0], ">=", progress[1], "linear effects tried within the time limit"),
    ]
    failed = [g for g in gates if not g.passed and (named or g.name != "complete")]
    if tried:
        text = "gain of the best effect in 2 log L"
        gates.append(_gate("significant", gains[0], ">", CRITERIA.deviance_gain, text))
    verdict: Verdict = "missing_effect"
    reason, found_model = "", nominal
    if named is None:
        is_refit_needed = nominal_fit.deviance - refit.deviance > CRITERIA.deviance_gain
        verdict = "parameters_only" if is_refit_needed else "no_discrepancy"
    else:
        lead = min([gains[0] - gain for gain in gains[1:2]], default=math.inf)
        text = "lead of the best effect over the next in 2 log L, at most 1000"
        gates.append(_gate("ahead", min(lead, 1e3), ">", LEAD, text))
        if not gates[-1].passed:
            verdict = "ambiguous"
            both = [f"{h.effect.replace('_', ' ')} between {' and '.join(h.where)}" for h, _ in tried[:2]]
            reason = f"A linear effect is missing, and two explain the records: {' or '.join(both)} (2 log L differs by {lead:.2g})."
    if failed:
        verdict, reason = "unknown_effect", _explain_failure(nominal, failed)
    if verdict in ("unknown_effect", "ambiguous"):
        notes = [*notes, "model.json is the nominal model"]
    else:
        fitted = model.network(fit.x)
        outside = tuple(e for e in nominal.elements if e.place != "between")
        found_model = replace(
            nominal,
            masses=fitted.masses,
            bodies=fitted.bodies,
            levers=fitted.levers,
            elements=(*fitted.elements, *outside),
        )
    if verdict == "unknown_effect":
        estimates = replace(estimates, determined=())
    return UnknownInputResult(
        **vars(estimates),
        road=model.road,
        verdict=verdict,
        gates=tuple(gates),
        reason=reason,
        model=found_model,
        effects=tuple((h.effect, h.where, gain) for (h, _), gain in zip(tried, gains, strict=True)),
        found=(named.effect, named.where, estimates.effect)
        if named and verdict == "missing_effect"
        else None,
        notes=tuple(notes),
        seconds=clock.seconds,
    )
