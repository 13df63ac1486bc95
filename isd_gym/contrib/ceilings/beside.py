"""Bounds beside a score: the clairvoyant optimum, the causal ceiling, the causal linear-quadratic bound."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError

from .bounds import lq_front, wheelbase_bound
from .ceiling import known
from .clairvoyant import reachable

if TYPE_CHECKING:
    from collections.abc import Callable

    from isd_gym.benchmark.scoring import Score

__all__ = ["bounds_beside", "fronts", "known", "known_ceilings", "reachable"]


def known_ceilings(
    plant: Any, road: Any, speed: float, duration: float
) -> Callable[[float], dict[str, Any] | None]:
    """Return a function from preview [s] to the causal ceiling of controllers with that preview, or None."""
    return functools.cache(lambda preview: known(plant, road, speed, duration, preview=preview))


def bounds_beside(
    result: Any, optimum: dict[str, Any] | None, ceilings: Callable[[float], dict[str, Any] | None]
) -> dict[str, Any]:
    """Return one line per bound of a score, and one line about the bounds left out."""
    lines: dict[str, Any] = {}
    allowed = result.comparable
    not_computed = "not computed for these conditions"
    if optimum is None or allowed.clairvoyant:
        allowed = replace(allowed, clairvoyant=allowed.clairvoyant or not_computed)
    else:
        lines |= _optimum(result, optimum)
    if not allowed.lq_bound and (line := _wheelbase_bound(result) or _lq_bound(result)):
        lines["causal_bound"] = line
    if not allowed.ceiling:
        found = {s: ceilings(s) for s in sorted({row["preview"]["value"] for row in result.policies})}
        lines |= {f"ceiling_{s:g}": bound["sentence"] for s, bound in found.items() if bound is not None}
        if not any(found.values()):
            allowed = replace(allowed, ceiling=not_computed)
    if allowed.left_out:
        lines["left_out"] = allowed.left_out
    return lines


def fronts(score: Score) -> list[tuple[float, np.ndarray]]:
    """Return the causal bound in the plane of travel and acceleration for several tyre loads, if its conditions hold.

    Returns:
        Change of the tyre load, and curve (k, 2) of travel change and acceleration change.
    """
    if score.plant is None or score.comparable.lq_bound:
        return []
    travel = [-0.5, -0.4, -0.35, -0.3, -0.26, -0.22, -0.18, -0.14, -0.1, -0.05, 0.0, 0.3]
    conditions: dict[str, Any] = {"network": score.plant, "speed": score.speed, "road": score.ground}
    try:
        curves = [(tyre, lq_front(tyre, travel, **conditions)) for tyre in (0.0, 0.03)]
    except InputError:  # a road or a car without such a bound
        return []
    return [(tyre, curve) for tyre, curve in curves if len(curve) > 2]


def _optimum(result: Any, optimum: dict[str, Any]) -> dict[str, Any]:
    """Return the clairvoyant optimum as a line, and the changes of its RMS against passive over all episodes."""
    own = result.runs["passive"]
    cost, least, proven = (
        float(v.mean()) for v in (own.cost(result.cost), optimum["value"], optimum["lower"])
    )
    line = (
        f"Clairvoyant optimum, these very roads known in advance (searched): cost J {least:.3f} "
        f"({100 * (least / cost - 1):+.1f} %)"
    )
    if np.isfinite(proven):
        line += f"; proven, without end stops: not below {proven:.3f} ({100 * (proven / cost - 1):+.1f} %)"
    line += "."
    changes = {
        f"{n}_change": float(np.sqrt(np.mean(optimum[n] ** 2) / np.mean(getattr(own, n) ** 2)) - 1)
        for n in ("body_acceleration", "suspension_travel", "tyre_load")
    }
    return {"clairvoyant": line, "clairvoyant_point": changes}


def _wheelbase_bound(result: Any) -> str | None:
    """Return the linear-quadratic bound of a car with two axles as a line; every row gets its share of that gain (`share_of_lq_gain`)."""
    if not result.plant.bodies:
        return None
    try:
        bound = wheelbase_bound(result.plant, speed=result.speed, road=result.ground, cost=result.cost)
    except InputError:  # no bound for this road or this car
        return None
    for row in result.policies:
        row["share_of_lq_gain"] = row["cost"]["change"] / bound.change + 0.0
    return (
        "LQ bound with the rear road known from the front (any force, full state, no friction, no limits; the mean over "
        f"roads): cost J {100 * bound.change:+.1f} % at best; {100 * bound.blind_change:+.1f} % for a controller that "
        "takes the rear road for a new one."
    )


def _lq_bound(result: Any) -> str | None:
    """Return the causal linear-quadratic bound beside the best policy without preview, as a line."""
    blind = [row for row in result.policies if not row["preview"]["value"]]
    if not blind:
        return None
    best = min(blind, key=lambda row: row["cost"]["value"])
    rows = [best[f"{k}_rms"] for k in ("body_acceleration", "suspension_travel", "tyre_load")]
    changes = [row.get("change") for row in rows]
    if best["policy"] == "passive" or None in changes:
        return None
    try:
        front = lq_front(
            changes[2], [changes[1]], network=result.plant, speed=result.speed, road=result.ground
        )
    except InputError:  # no bound for this car
        return None
    if not len(front):
        return None
    a, l, f = (f"{100 * c:+.1f} %" for c in changes)
    low, high = (100 * rows[0][k] for k in ("low", "high"))
    return (
        f"Causal LQ bound (any force, full state, no friction, no limits; the mean over roads): at the travel ({l}) "
        f"and tyre load ({f}) of {best['policy']}, acceleration {100 * front[0, 1]:+.1f} % at best; "
        f"{best['policy']}: {a} [{low:+.1f}, {high:+.1f}]"
    )
