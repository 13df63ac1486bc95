"""The causal ceiling: a numerically searched bound for controllers that know the road up to a given preview.

**Information relaxation** (Brown, Smith and Sun, Operations Research 58, 2010). Let pi be a penalty with zero
mean for every policy that acts on available information. For every such policy ``E[cost] = E[cost - pi] >=
E[min (cost - pi)]``, with the minimum over the currents of a completely known road. Any penalty of zero mean
gives a lower bound. The tightest penalty is the sum of the values of each step's news, ``V(x_k+1) -
E[V(x_k+1) | known at k]``, with the value function V of the true problem.

**The penalty here** belongs to the linear-quadratic car: friction replaced by the dampers of a statistical
linearisation, limits replaced by a weight on the change of current. With the finite-horizon Riccati solution
M_k (stage cost and cost to go after step k) and the news d of the road in one step, the penalty is linear in
state and current,

    pi_k = 2 d_k' [M (A x_k + B I_k) + m I_k] + d_k' M d_k - tr(M W)                                    (no
    preview)
    pi_k = 2 sigma_k' (x_k+1, I_k) + terms of the road alone                                    (n steps of
    preview)

sigma_k are the news d_k+n, n steps ahead, propagated backwards through the closed loop. The news consist of
the road's innovations, which are independent of the past for any policy and any car. The mean is therefore
exactly zero, on the real car too; the linear car only determines the tightness of the bound. On a linear car
without limits, the bound is tight on every single road: the penalised optimum equals the Riccati value (a
test). On the real car it varies little from road to road, since the constant terms act as control variates.

**The computation** is the clairvoyant's descent on the penalised cost, through the real kernel with friction,
stop and limits. Friction makes the problem non-convex and the result a local optimum. `Ceiling.value` is
therefore searched, not proven: a better search lowers the value. docs/explanation/ceiling.md lists the
results of other starts. `Ceiling.proven` is the relaxation of `relaxed` with the same penalty: a proven but
loose bound for the car without end stops. `Ceiling.sentence` states both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from scipy.linalg import expm

from isd_gym._common.errors import InputError
from isd_gym.baselines.controller import steps_ahead
from isd_gym.benchmark.policies import conventional
from isd_gym.physics import elements as el
from isd_gym.physics._prediction import (
    Model,
    Weights,
    device_reach,
    prediction_model,
    statistical_linearisation,
)
from isd_gym.physics.cost import StageCost
from isd_gym.physics.network import Network
from isd_gym.physics.road import Road
from isd_gym.physics.road import road as find_road
from isd_gym.physics.simulate import PHYSICS_STEP

from .bounds import linear_car
from .clairvoyant import CONTROL_STEP, SCHEDULES, Episode, Penalty, Schedule, episode_key, keep, read


@dataclass(frozen=True)
class CeilingSettings:
    """Parameters of the penalty's value function; any choice gives a valid bound.

    Attributes:
        move: Weight on the change of current, instead of the slew limit [1/A^2].
        effort: Weight on the current, instead of the current limit [1/A^2].
        centring: Weight on the device's travel over its stop, instead of the stop [-].

    Raises:
        InputError: A weight is negative.
    """

    move: float = 0.1
    effort: float = 0.0
    centring: float = 0.04

    def __post_init__(self) -> None:
        if not (self.move >= 0 and self.effort >= 0 and self.centring >= 0):
            raise InputError("weights of the penalty must be >= 0")


#: for the proven bound of a car without stops
PROVEN = CeilingSettings(move=0.02, centring=0.0)


class NewsValue:
    """The linear-quadratic car over one episode, and the value of news of the road.

    X (n + 1,) is the state above the road with the preceding current. M[k] are weights of (x after step k, I
    of step k) including the stage cost of step k; V[k] are weights of X_k. loop[k] maps X_k to (x_k+1, I_k)
    under the optimal law; worth[k] is the curvature with respect to the current.

    Args:
        network: The plant.
        road: A rough road.
        speed: Speed [m/s].
        steps: Number of control steps.
        cost: Stage cost.
        control_step: Control step [s].
        settings: Weights of the value function; None for the defaults.

    Raises:
        InputError: The road has a fixed profile, or the network has no motor.
    """

    def __init__(
        self,
        network: Network,
        road: Road,
        speed: float,
        steps: int,
        cost: StageCost,
        control_step: float = CONTROL_STEP,
        settings: CeilingSettings | None = None,
    ) -> None:
        s = settings or CeilingSettings()
        weights = Weights(cost, s.move, s.effort, s.centring, reach=device_reach(network))
        self.noise, self.pole = road.noise(speed, PHYSICS_STEP)
        if not self.noise > 0 or road.profile is not None:
            raise InputError(
                f"road '{road.name}' is no rough road alone (paper, A ... H): nothing about it is news"
            )
        self.sub = round(control_step / PHYSICS_STEP)
        intensity = self.noise**2 / PHYSICS_STEP
        linear = statistical_linearisation(
            network, control_step, replace(weights, move=max(s.move, 1e-3)), road_intensity=intensity
        )
        self.model: Model = linear.model
        if self.model.thrust == 0.0:
            raise InputError(f"network '{network.name}' has no motor")
        dampers = {e.name: 0.0 for e in network.elements if isinstance(e, el.BumpStop)} | linear.damping
        fine = prediction_model(network, PHYSICS_STEP, damping=dampers, road_intensity=intensity)
        # response of the state after a control step to a rise of the road in each of its physics steps
        powers = [np.linalg.matrix_power(fine.A, self.sub - 1 - i) @ fine.P for i in range(self.sub)]
        self.response = np.array(powers).T  # (n, sub)
        self.W = self.noise**2 * self.response @ self.response.T
        self._riccati(weights, steps)

    def _riccati(self, weights: Weights, steps: int) -> None:
        m, n = self.model, self.model.n
        F = np.zeros((n + 1, n + 1))
        F[:n, :n], F[:n, n], F[n, n] = m.A, m.B, 1.0
        b = np.append(m.B, 1.0)
        Y = np.column_stack([m.C, m.D])  # signals at the end of a step, as rows over (x, I)
        stage = Y.T @ (weights.signals[:, None] * Y)
        stage[n, n] += weights.current
        V = np.zeros((n + 1, n + 1))
        self.M, self.loop = np.zeros((steps, n + 1, n + 1)), np.zeros((steps, n + 1, n + 1))
        self.worth, self.V = np.zeros(steps), np.zeros((steps, n + 1, n + 1))
        for k in range(steps - 1, -1, -1):
            M = V + stage
            g = M @ b
            r = b @ g + weights.move
            self.M[k], self.worth[k] = M, r
            self.loop[k] = F - np.outer(b, g @ F) / r
            V = F.T @ M @ F - np.outer(F.T @ g, g @ F) / r
            self.V[k] = V = 0.5 * (V + V.T)
        self.b = b

    def value(self, preview: int = 0) -> float:
        """Return the mean cost per step of the linear car from rest, from the Riccati equation.

        Args:
            preview: Known road ahead [control steps].

        Returns:
            Mean stage cost [-].
        """
        n = self.model.n
        if preview == 0:
            return float(np.einsum("kij,ji->", self.M[:, :n, :n], self.W) / len(self.M))
        return -self._ahead(np.zeros((len(self.M), n)), preview)[2] / len(self.M)

    def news(self, heights: np.ndarray) -> np.ndarray:
        """Return the news of the road in each control step, as changes of the state.

        Args:
            heights: Heights of the road at every physics step [m].

        Returns:
            Changes (steps, n).
        """
        rises = heights[1:] - self.pole * heights[:-1]
        return rises.reshape(-1, self.sub) @ self.response.T

    def penalty(self, heights: np.ndarray, preview: int = 0) -> tuple[Penalty, np.ndarray]:
        """Return the penalty of a road for policies with a given preview.

        Args:
            heights: Heights of the road at every physics step [m].
            preview: Known road ahead [control steps].

        Returns:
            The penalty, and the slope (steps, n + 1) of the value of X_k due to the known road: ``X' V X + 2
                slope . X``.

        Raises:
            InputError: The preview is negative or too long.
        """
        if preview < 0:
            raise InputError(f"a preview of {preview} steps is none")
        d, n = self.news(heights), self.model.n
        steps = len(d)
        if preview == 0:
            seen = np.einsum("ki,kij->kj", d, self.M[:, :n])  # d' M, on (x, I)
            by_state = 2 * seen[:, :n] @ self.model.A
            by_current = 2 * (seen[:, :n] @ self.model.B + seen[:, n])
            constant = float(np.sum(seen[:, :n] * d)) - steps * self.value()
            slope = np.zeros((steps, n + 1))
        else:
            by_state, by_current, constant, slope = self._ahead(d, preview)
        # in the coordinates of the assembly, positions are not relative to the road
        lifted = float(heights[:: self.sub][:-1] @ (by_state @ self.model.lift))
        return Penalty(by_state, by_current, constant - lifted), slope

    def _ahead(self, d: np.ndarray, preview: int) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
        """Return slopes of the penalty by state and current, its constant, and the known part, for a preview of
        at least one step.

        The news of step m are known from step m - preview + 1 on, before the current of that step. Their
        effect on the value is propagated backwards: `slope[m]` is the slope of the value of (x, I) after step
        m - lag due to the news of step m.
        """
        n, steps = self.model.n, len(d)
        M, r, b = self.M, self.worth, self.b
        slope = M[:, :, :n].copy()
        own = np.einsum("kij,kj->ki", slope, d)  # (steps, n + 1)
        # of the news alone: d' (M - g g' / r) d minus its mean
        across = np.einsum("kij,i->kj", slope, b)
        left = M[:, :n, :n] - np.einsum("ki,kj->kij", across, across) / r[:, None, None]
        constant = float(np.einsum("ki,kij,kj->", d, left, d) - np.einsum("kij,ji->", left, self.W))
        # slope of the value of (x, I) after step j due to the known road of later steps
        known = np.zeros((steps, n + 1))
        for lag in range(1, min(preview, steps)):
            back = np.zeros_like(slope)
            back[lag:] = np.einsum("kij,kil->kjl", self.loop[1 : steps - lag + 1], slope[lag:])
            slope = back
            j = slice(0, steps - lag)  # steps whose law depends on the news of step j + lag
            new = np.einsum("kij,kj->ki", slope[lag:], d[lag:])
            old = own[j] + known[j]
            spread = np.einsum("kij,i->kj", slope[lag:], b)
            mean = np.einsum("ki,ij,kj->k", spread, self.W, spread)
            terms = 2 * np.einsum("ki,ki->k", d[j], new[:, :n])
            terms -= (2 * (old @ b) * (new @ b) + (new @ b) ** 2 - mean) / r[j]
            constant += float(terms.sum())
            known[j] += new
        # on (x, I) after step k, due to the news of step k + preview
        on = np.zeros((steps, n + 1))
        if preview < steps:
            last = np.einsum("kij,kil->kjl", self.loop[1 : steps - preview + 1], slope[preview:])
            on[: steps - preview] = 2 * np.einsum("kij,kj->ki", last, d[preview:])
        by_state = np.zeros((steps, n))
        by_state[1:] = on[:-1, :n]
        before = np.zeros_like(known)
        before[1:] = (known + 0.5 * on)[:-1]  # the state of rest at the start contributes nothing
        return by_state, on[:, n], constant, before


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
    def sentence(self) -> str:
        """Value of the ceiling and proven bound in words, as in the documentation."""
        what, who = "causal ceiling", "that does not see the road"
        if self.preview:
            what, who = (
                f"ceiling with {self.preview:g} s of road ahead",
                f"that sees {self.preview:g} s of road ahead",
            )
        proven = 100 * (self.proven.mean() / self.passive - 1.0)
        bound = "There is no proven bound"
        if math.isfinite(proven):
            error = 100 * _standard_error(self.proven) / self.passive
            bound = f"The proven bound, for a car without end stops, is {proven:+.1f} +- {error:.1f} %"
        return (
            f"The {what} is an estimate, not a proven bound: J {100 * self.change:+.1f} +- "
            f"{100 * self.standard_error / self.passive:.1f} % against passive. "
            f"No controller {who} is known to be better. {bound}."
        )

    @property
    def standard_error(self) -> float:
        """Standard error of `value` due to the choice of roads."""
        return _standard_error(self.roads)

    @property
    def change(self) -> float:
        """Change of J against the conventional passive car, as a fraction."""
        return self.value / self.passive - 1.0

    def to_dict(self) -> dict[str, Any]:
        """Return the ceiling as plain data.

        Returns:
            Values with their uncertainty.
        """
        return {
            "preview": {"value": self.preview, "unit": "s"},
            "roads": len(self.roads),
            "cost": self.value,
            "standard_error": self.standard_error,
            "passive": self.passive,
            "change": self.change,
            "change_standard_error": self.standard_error / self.passive,
            "proven_without_stops": float(self.proven.mean()) / self.passive - 1.0,
            "proven_standard_error": _standard_error(self.proven) / self.passive,
            "sentence": self.sentence,
        }


def _standard_error(values: np.ndarray) -> float:
    """Return the standard error of the mean over roads."""
    return float(values.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else math.nan


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
    X, total, steps = np.zeros((n, n)), 0.0, round(duration / control_step)
    for _ in range(steps):
        X = A @ X @ A.T + W
        total += float(weights @ np.einsum("ij,jk,ik->i", car.C, X, car.C))
    return total / steps


FILE = Path(__file__).parents[2] / "benchmark" / "bounds" / "ceiling.json"
#: first seed of roads that were not used for tuning
SEED = 600_000
ROADS = 16
FEWEST = 4  # smallest number of roads of a ceiling in a score


def ceiling(
    network: Network | str | Path = "quarter-car-isd",
    *,
    preview: float = 0.0,
    road: str | Road = "paper",
    speed: float = 20.0,
    duration: float = 20.0,
    episodes: int = ROADS,
    seed: int = SEED,
    cost: StageCost | None = None,
    settings: CeilingSettings | None = None,
    compute: bool = True,
    store: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> Ceiling | None:
    """Return the bound for controllers with a given preview; with preview 0 a causal bound for any measurement.

    Known roads are shipped or in the user's cache. Other roads are computed (about 15 s per road) and stored
    in the cache, or in `store`.

    Args:
        network: The plant.
        preview: Known road ahead [s].
        road: A rough road.
        speed: Speed [m/s].
        duration: Length of an episode [s].
        episodes: Number of roads.
        seed: Seed of the first road.
        cost: Stage cost; None for the environment's.
        settings: Weights of the penalty; None for the defaults.
        compute: Whether missing roads are computed.
        store: File of computed roads; None for the cache.
        progress: Called with the finished share, from 0 to 1.

    Returns:
        The ceiling; None without `compute` if fewer than `FEWEST` roads are known.

    Raises:
        InputError: The road is not rough, or the network has no motor.
    """
    network, ground, cost = Network.load(network), find_road(road), cost or StageCost()
    settings = settings or CeilingSettings()
    points = steps_ahead(preview, CONTROL_STEP)
    key = episode_key(
        network, ground, speed, duration, cost, preview=float(preview), settings=asdict(settings)
    )
    known = read(key, FILE)
    if not compute:  # all known consecutive roads
        count = next(i for i in range(len(known) + 1) if seed + i not in known)
        episodes = min(episodes, count)
        if episodes < FEWEST:
            return None
    wanted = range(seed, seed + episodes)
    missing = [s for s in wanted if s not in known]
    if missing:
        steps = round(duration / CONTROL_STEP)
        value = NewsValue(network, ground, speed, steps, cost, settings=settings)
        plain = NewsValue(network, ground, speed, steps, cost, settings=PROVEN)
        about: dict[str, Any] = {
            "network": network.name,
            "road": ground.name,
            "speed": speed,
            "duration": duration,
        }
        about |= {"preview": float(preview), "settings": asdict(settings)}
        for i, s in enumerate(missing):
            found = _one_road(network, ground, speed, duration, cost, value, plain, points, s)
            known[s] = {n: None if x is None else float(f"{x:.7g}") for n, x in found.items()}
            keep(store or FILE, store is not None, key, about, s, known[s])
            if progress is not None:
                progress((i + 1) / len(missing))
    proven = [known[s]["proven"] for s in wanted]
    return Ceiling(
        preview,
        np.array([known[s]["reached"] for s in wanted]),
        np.array([math.nan if x is None else x for x in proven]),
        passive_cost(network, ground, speed, duration, cost),
    )


def _one_road(
    network: Network,
    road: Road,
    speed: float,
    duration: float,
    cost: StageCost,
    value: NewsValue,
    plain: NewsValue,
    points: int,
    seed: int,
) -> dict[str, float | None]:
    from gymnasium.utils import seeding

    heights = road.heights(duration, speed=speed, rng=seeding.np_random(seed)[0])
    penalty, slope = value.penalty(heights, points)
    episode = Episode(network, heights, cost=cost, penalty=penalty)
    proven = Episode(network, heights, cost=cost, penalty=plain.penalty(heights, points)[0]).relaxation()
    tries = [episode.optimise(schedule) for schedule in SEARCH]
    first = min(episode.cost_of(episode.rollout(I)) for I in tries)
    for schedule in POLISH:
        tries.append(episode.optimise(schedule, stitch(episode, value, slope, tries)))
    best = min(episode.cost_of(episode.rollout(I)) for I in tries)
    return {"reached": best, "unstitched": first, "proven": proven}


#: starts of the search, and descents after each stitch
SEARCH = (*SCHEDULES, Schedule(((4.0, 3e-4), (1.0, 1e-4), (0.3, 1e-4), (0.0, 3e-5)), 15))
_GENTLE = Schedule(((1.0, 1e-4), (0.3, 1e-4), (0.0, 3e-5)), 15)
_STRONG = Schedule(((8.0, 1e-3), (4.0, 3e-4), (2.0, 1e-4), (1.0, 1e-4), (0.3, 1e-4), (0.0, 3e-5)), 15)
POLISH = (_GENTLE, _STRONG, _STRONG, _GENTLE, _STRONG)
WINDOW = 50  # length of the windows of a stitch [control steps]


def stitch(episode: Episode, value: NewsValue, slope: np.ndarray, tries: Sequence[np.ndarray]) -> np.ndarray:
    """Combine several local optima of a road piece by piece by dynamic programming.

    The loss of a solution in a step is its cost minus the penalty plus the change of the value function. A
    change from one solution to another costs about the value of their difference. Local optima differ in
    places, and a car forgets within a second.

    Args:
        episode: The road and the car.
        value: Value function of the linear car.
        slope: Slopes (steps, n + 1) of the value due to the known road.
        tries: Currents (steps,) of the solutions [A].

    Returns:
        Currents (steps,) [A] that follow one of `tries` at a time.
    """
    n, steps = value.model.n, episode.steps
    lost, states = [], []
    for currents in tries:
        path = episode.rollout(currents)
        above = path.z[:, :n] - np.outer(episode.heights[:: episode.sub][:-1], value.model.lift)
        X = np.column_stack([above, np.concatenate([[0.0], path.current[:-1]])])
        worth = np.einsum("ki,kij,kj->k", X, value.V, X) + 2 * np.sum(slope * X, axis=1)
        p = episode.penalty
        assert p is not None
        stage = path.outputs**2 @ episode.squares + episode.on_current * path.current**2
        stage -= np.sum(p.on_state * path.z[:, :n], axis=1) + p.on_current * path.current
        lost.append(stage + np.append(worth[1:], 0.0) - worth)
        states.append(X)
    many = len(tries)
    starts = range(0, steps, WINDOW)
    total, came = np.zeros(many), []
    for first in starts:
        # over[i, j]: from i to j at the start of this window
        over = np.zeros((many, many))
        for i in range(many):
            for j in range(many):
                change = states[i][first] - states[j][first]
                over[i, j] = change @ value.V[first] @ change
        way = total[:, None] + over
        came.append(np.argmin(way, axis=0))
        total = way.min(axis=0) + np.array([x[first : first + WINDOW].sum() for x in lost])
    out = np.empty(steps)
    now = int(np.argmin(total))
    for first, before in zip(reversed(starts), reversed(came), strict=True):
        out[first : first + WINDOW] = tries[now][first : first + WINDOW]
        now = int(before[now])
    return out


def known(
    network: Network | str | Path,
    road: str | Road = "paper",
    speed: float = 20.0,
    duration: float = 20.0,
    cost: StageCost | None = None,
    *,
    preview: float = 0.0,
) -> dict[str, Any] | None:
    """Return the ceiling of a score from known roads.

    Args:
        network: The plant.
        road: The road.
        speed: Speed [m/s].
        duration: Length of an episode [s].
        cost: Stage cost; None for the environment's.
        preview: Known road ahead [s].

    Returns:
        `Ceiling.to_dict`; None if too few roads are known.
    """
    try:
        found = ceiling(
            network, preview=preview, road=road, speed=speed, duration=duration, cost=cost, compute=False
        )
    except InputError:  # a road or a car without a ceiling
        return None
    return None if found is None else found.to_dict()


def command(
    preview: Annotated[
        list[float] | None,
        typer.Option(help="Road ahead that is known [s]; 0, none, unless given.", min=0.0),
    ] = None,
    road: Annotated[str, typer.Option(help="A rough road: paper, A ... H.")] = "paper",
    speed: Annotated[float, typer.Option(help="Speed [m/s].", min=0.1)] = 20.0,
    network: Annotated[
        str, typer.Option(help="The plant: a built-in network or a model file.")
    ] = "quarter-car-isd",
    episodes: Annotated[int, typer.Option(help="Number of roads; each takes some 15 s.", min=2)] = ROADS,
    duration: Annotated[float, typer.Option(help="Length of an episode [s].", min=0.1, max=600.0)] = 20.0,
    store: Annotated[
        Path | None, typer.Option("--store", help="Store computed roads in this file.", metavar="FILE")
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write the figures to this file.", metavar="FILE")
    ] = None,
) -> None:
    """Estimate the lowest cost of controllers that see a given length of road ahead, or none (causal ceiling).

    The ceiling is the result of a search, not a proven bound. The command also prints a proven, looser bound. Computed roads
    are stored and not computed again. `isd-gym score` quotes the stored ceilings.

    Example: isd-gym ceiling --preview 0 --preview 0.1
    """
    import json

    from isd_gym._commands.console import progress, tell
    from isd_gym._common.files import check_file, write_text

    if json_file is not None:
        check_file(json_file)
    found = []
    plant, ground = Network.load(network), find_road(road)
    for s in preview or [0.0]:
        with progress() as update:
            bound = ceiling(
                plant,
                preview=s,
                road=ground,
                speed=speed,
                duration=duration,
                episodes=episodes,
                store=store,
                progress=lambda share, s=s: update(f"{s:g} s ahead", share),  # type: ignore[misc]
            )
        assert bound is not None
        row = bound.to_dict()
        found.append(row)
        tell(
            f"{s:g} s ahead: J {row['cost']:.4f} +- {row['standard_error']:.4f} ({episodes} roads). {row['sentence']}"
        )
    if json_file is not None:
        write_text(json_file, json.dumps({"schema": "isd-ceiling/1", "ceilings": found}, indent=1) + "\n")
