"""Least costs that are known: the causal ceiling of controllers, and the clairvoyant optimum of single roads.

The **causal ceiling** estimates the lowest mean cost of controllers that know the road up to a given preview: an
information relaxation (Brown, Smith and Sun, Operations Research 58, 2010), whose minimum over the currents was
searched. A **proven bound**, for the car without end stops, stands beside each road of it. The **clairvoyant optimum**
knows the road of the whole episode. The folder `bounds` holds the values, road by road; docs/explanation/ceiling.md
has the method.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import expm

from .._common.errors import InputError
from ..env.task import CONTROL_STEP
from ..physics.cost import StageCost
from ..physics.network import Network
from ..physics.road import Road
from ..physics.road import road as find_road
from .lq_bounds import linear_car, lq_front, wheelbase_bound
from .policies import conventional

if TYPE_CHECKING:
    from .scoring import Conditions, Score

#: first seed of the roads of the ceiling, which were not used for tuning
SEED = 600_000
#: smallest number of roads of a ceiling in a score
FEWEST = 4
#: weights of the penalty of the search
SETTINGS = {"move": 0.1, "effort": 0.0, "centring": 0.04}
#: figures of the clairvoyant optimum of a road
FIGURES = ("value", "lower", "acceleration", "travel", "tyre_load")


@functools.cache
def _stored(name: str) -> dict[str, Any]:
    """Return the content of a file in the folder `bounds`."""
    data: dict[str, Any] = json.loads(
        (resources.files(__package__) / "bounds" / name).read_text()
    )
    return data


@dataclass(frozen=True)
class Ceiling:
    """A numerically searched bound of the mean cost J of every controller with a given preview.

    Attributes:
        preview: Known road ahead [s].
        roads: Penalised optimum of each road (episodes,), as found; the mean is the ceiling.
        proven: Proven lower bound of each road (episodes,), for the car without end stops.
        passive: Exact expectation of J of the conventional car.
    """

    preview: float
    roads: np.ndarray
    proven: np.ndarray
    passive: float

    @property
    def value(self) -> float:
        """Mean cost J of the ceiling [-]."""
        return float(self.roads.mean())

    @property
    def change(self) -> float:
        """Change of J against the conventional passive car, as a fraction."""
        return self.value / self.passive - 1.0

    @property
    def standard_error(self) -> float:
        """Standard error of `change` due to the choice of roads."""
        return _standard_error(self.roads) / self.passive

    @property
    def proven_change(self) -> float:
        """Proven lower bound of `change`, for the car without end stops."""
        return float(self.proven.mean()) / self.passive - 1.0

    @property
    def proven_standard_error(self) -> float:
        """Standard error of `proven_change`."""
        return _standard_error(self.proven) / self.passive

    @property
    def sentence(self) -> str:
        """Value of the ceiling and proven bound in words, as in the documentation."""
        what = "causal ceiling"
        who = "that does not see the road"
        if self.preview:
            what = f"ceiling with {self.preview:g} s of road ahead"
            who = f"that sees {self.preview:g} s of road ahead"
        bound = "There is no proven bound"
        if math.isfinite(self.proven_change):
            bound = (
                f"The proven bound, for a car without end stops, is {100 * self.proven_change:+.1f} +- "
                f"{100 * self.proven_standard_error:.1f} %"
            )
        return (
            f"The {what} is an estimate, not a proven bound: J {100 * self.change:+.1f} +- "
            f"{100 * self.standard_error:.1f} % against passive. "
            f"No controller {who} is known to be better. {bound}."
        )


def _standard_error(values: np.ndarray) -> float:
    """Return the standard error of the mean over roads."""
    return (
        float(values.std(ddof=1) / math.sqrt(len(values)))
        if len(values) > 1
        else math.nan
    )


def passive_cost(
    network: Network,
    road: Road,
    speed: float,
    duration: float,
    cost: StageCost,
    control_step: float = CONTROL_STEP,
) -> float:
    """Return the exact expectation of the mean cost of the conventional passive car from rest, which is linear.

    Args:
        network: The plant.
        road: A rough road.
        speed: Speed [m/s].
        duration: Length of an episode [s].
        cost: Stage cost.
        control_step: Control step [s].

    Returns:
        Mean stage cost J [-].
    """
    car = linear_car(conventional(network), speed=speed, road=road)
    n = len(car.A)
    noise = car.intensity * np.outer(car.G, car.G)
    loan = expm(np.block([[-car.A, noise], [np.zeros((n, n)), car.A.T]]) * control_step)
    A = loan[n:, n:].T
    W = A @ loan[:n, n:]
    weights = np.array(cost.quadratic[:3])
    X = np.zeros((n, n))
    total = 0.0
    steps = round(duration / control_step)
    for _ in range(steps):
        X = A @ X @ A.T + W
        total += float(weights @ np.einsum("ij,jk,ik->i", car.C, X, car.C))
    return total / steps


def _episode_key(
    network: Network,
    road: Road,
    speed: float,
    duration: float,
    cost: StageCost,
    **more: Any,
) -> str:
    """Return a key of everything except the seed on which the values of a road depend: 16 hexadecimal digits."""
    model = network.to_dict()
    car = {k: model[k] for k in ("masses", "elements", "inputs")}
    ground: list[Any] = [road.roughness, road.cutoff, road.over_time, road.shift]
    ground += [
        None if x is None else np.asarray(x).tolist()
        for x in (road.abscissa, road.profile)
    ]
    text = json.dumps(
        [car, ground, speed, duration, cost.quadratic, *([more] if more else [])],
        sort_keys=True,
    )
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def ceiling(
    network: Network | str | Path,
    road: str | Road = "paper",
    speed: float = 20.0,
    duration: float = 20.0,
    *,
    preview: float = 0.0,
) -> Ceiling | None:
    """Return the causal ceiling of controllers with a given preview.

    Args:
        network: The plant.
        road: The road.
        speed: Speed [m/s].
        duration: Length of an episode [s].
        preview: Known road ahead [s].

    Returns:
        The ceiling; None for a car or a road of which fewer than `FEWEST` roads are known.
    """
    network = Network.load(network)
    ground = find_road(road)
    cost = StageCost()
    key = _episode_key(
        network,
        ground,
        speed,
        duration,
        cost,
        preview=float(preview),
        settings=SETTINGS,
    )
    seeds = _stored("ceiling.json").get(key, {}).get("seeds", {})
    roads: list[dict[str, Any]] = []
    while (seed := str(SEED + len(roads))) in seeds:
        roads.append(seeds[seed])
    if len(roads) < FEWEST:
        return None
    proven = [math.nan if r["proven"] is None else r["proven"] for r in roads]
    passive = passive_cost(network, ground, speed, duration, cost)
    reached = [r["reached"] for r in roads]
    return Ceiling(preview, np.array(reached), np.array(proven), passive)


def reachable(network: Network, conditions: Conditions) -> dict[str, np.ndarray] | None:
    """Return the clairvoyant optimum of consecutive episodes.

    Args:
        network: The plant.
        conditions: Conditions of a score.

    Returns:
        Arrays (episodes,): `value` (least known cost), `lower` (proven), and RMS of body_acceleration [m/s^2],
        suspension_travel [m] and tyre_load [N] at that cost. None if an episode is unknown.
    """
    seed = conditions.seed
    stream = {"stream": "scoring"} if seed is None else {}
    key = _episode_key(
        network,
        conditions.road,
        conditions.speed,
        conditions.duration,
        StageCost(),
        **stream,
    )
    seeds = _stored("clairvoyant.json").get(key, {}).get("seeds", {})
    wanted = [str((seed or 0) + i) for i in range(conditions.episodes)]
    if any(s not in seeds for s in wanted):
        return None
    names = {"acceleration": "body_acceleration", "travel": "suspension_travel"}
    return {
        names.get(n, n): np.array([seeds[s][n] for s in wanted], dtype=np.float64)
        for n in FIGURES
    }


def bounds_beside(result: Score) -> dict[str, Any]:
    """Return one line per bound of a score, and one line about the bounds left out; every row gets its shares of the known gains."""
    lines: dict[str, Any] = {}
    allowed = result.comparable
    drives = result.conditions
    not_computed = "not computed for these conditions"
    if not allowed.clairvoyant:
        optimum = reachable(result.plant, drives)
        if optimum is None:
            allowed = replace(allowed, clairvoyant=not_computed)
        else:
            lines |= _optimum(result, optimum)
    if not allowed.lq_bound and (line := _wheelbase_bound(result) or _lq_bound(result)):
        lines["causal_bound"] = line
    if not allowed.ceiling:
        found = _ceilings(result)
        lines |= found
        if not found:
            allowed = replace(allowed, ceiling=not_computed)
    if allowed.left_out:
        lines["left_out"] = allowed.left_out
    return lines


def _ceilings(result: Score) -> dict[str, str]:
    """Return a line per known causal ceiling of the previews of a score; every row with a known ceiling gets its `share_of_causal_gain`."""
    drives, lines = result.conditions, {}
    for seconds in sorted({row["preview"]["value"] for row in result.policies}):
        bound = ceiling(
            result.plant,
            drives.road,
            drives.speed,
            drives.duration,
            preview=seconds,
        )
        if bound is None:
            continue
        lines[f"ceiling_{seconds:g}"] = bound.sentence
        for row in result.policies:
            if row["preview"]["value"] == seconds:
                share = row["cost"]["change"] / bound.change
                row["share_of_causal_gain"] = share + 0.0
    return lines


def fronts(score: Score) -> list[tuple[float, np.ndarray]]:
    """Return the causal bound in the plane of travel and acceleration for several tyre loads, if its conditions hold.

    Returns:
        Change of the tyre load, and curve (k, 2) of travel change and acceleration change.
    """
    if score.comparable.lq_bound:
        return []
    travel = [
        -0.5,
        -0.4,
        -0.35,
        -0.3,
        -0.26,
        -0.22,
        -0.18,
        -0.14,
        -0.1,
        -0.05,
        0.0,
        0.3,
    ]
    conditions: dict[str, Any] = {
        "network": score.plant,
        "speed": score.conditions.speed,
        "road": score.conditions.road,
    }
    try:
        curves = [(tyre, lq_front(tyre, travel, **conditions)) for tyre in (0.0, 0.03)]
    except InputError:  # a road or a car without such a bound
        return []
    return [(tyre, curve) for tyre, curve in curves if len(curve) > 2]


def _optimum(result: Score, optimum: dict[str, Any]) -> dict[str, Any]:
    """Return the clairvoyant optimum as a line, and the changes of its RMS against passive over all episodes."""
    own = result.runs["passive"]
    cost, least, proven = (
        float(v.mean())
        for v in (own.cost(result.cost), optimum["value"], optimum["lower"])
    )
    line = (
        f"Clairvoyant optimum, these very roads known in advance (searched): cost J {least:.3f} "
        f"({100 * (least / cost - 1):+.1f} %)"
    )
    if np.isfinite(proven):
        line += f"; proven, without end stops: not below {proven:.3f} ({100 * (proven / cost - 1):+.1f} %)"
    line += "."
    gain = cost - least
    for row in result.policies:
        reached = cost - row["cost"]["value"]
        row["share_of_reachable_gain"] = reached / gain
    changes = {
        f"{n}_change": float(
            np.sqrt(np.mean(optimum[n] ** 2) / np.mean(getattr(own, n) ** 2)) - 1
        )
        for n in ("body_acceleration", "suspension_travel", "tyre_load")
    }
    return {"clairvoyant": line, "clairvoyant_point": changes}


def _wheelbase_bound(result: Score) -> str | None:
    """Return the linear-quadratic bound of a car with two axles as a line; every row gets its share of that gain (`share_of_lq_gain`)."""
    if not result.plant.bodies:
        return None
    try:
        bound = wheelbase_bound(
            result.plant,
            speed=result.conditions.speed,
            road=result.conditions.road,
            cost=result.cost,
        )
    except InputError:  # no bound for this road or this car
        return None
    for row in result.policies:
        row["share_of_lq_gain"] = row["cost"]["change"] / bound.change + 0.0
    return (
        "LQ bound with the rear road known from the front (any force, full state, no friction, no limits; the mean over "
        f"roads): cost J {100 * bound.change:+.1f} % at best; {100 * bound.blind_change:+.1f} % for a controller that "
        "takes the rear road for a new one."
    )


def _lq_bound(result: Score) -> str | None:
    """Return the causal linear-quadratic bound beside the best policy without preview, as a line."""
    blind = [row for row in result.policies if not row["preview"]["value"]]
    if not blind:
        return None
    best = min(blind, key=lambda row: row["cost"]["value"])
    rows = [
        best[f"{k}_rms"]
        for k in ("body_acceleration", "suspension_travel", "tyre_load")
    ]
    changes = [row.get("change") for row in rows]
    if best["policy"] == "passive" or None in changes:
        return None
    try:
        front = lq_front(
            changes[2],
            [changes[1]],
            network=result.plant,
            speed=result.conditions.speed,
            road=result.conditions.road,
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
