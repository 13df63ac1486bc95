"""The clairvoyant optimum: the least cost of an episode whose whole road is known in advance.

The stage cost is minimised over the currents of one episode (4000 in 20 s), through the real kernel with
projected friction, end stop and every other law, under |I| <= 5 A and |dI| <= 0.5 A per control step.

**Reached value** (`Clairvoyant.value`). Differential dynamic programming (Gauss-Newton) over the control
steps, with the state (x, memory of the laws, current) and the input dI. The limits are primal-dual log
barriers, lowered to zero. The Jacobians are differences through the kernel, so that any network is possible.
Friction makes the problem non-smooth and non-convex: the projection ``f = clip(-v / g, F)`` is first softened
(larger g: a steep damper below a small velocity) and then hardened step by step to the real projection. The
resulting currents are rolled out: the value is reached, and hence an upper bound of the optimum. Other
schedules and starts end within about 0.5 %.

**Proven bound** (`Clairvoyant.lower`). Let the friction be any force within its level, like a second
actuator, and remove the end stops. The real friction is one of the choices, and the problem becomes convex.
Its Lagrange dual, evaluated exactly by one Riccati sweep, is a lower bound for the car without end stops.
(With end stops the bound is not proven, since a stop may push in the right direction. The reached values with
and without stops differ by at most 0.6 %, seeds 0-3.) Without friction and stops, the two methods agree
within 0.05 %, which checks both.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym._common.files import write_text
from isd_gym._common.seeds import generators
from isd_gym.physics import elements as el
from isd_gym.physics._kernel.layout import CLOSED
from isd_gym.physics._vehicle import CURRENT_LIMIT, SLEW_LIMIT, vehicle
from isd_gym.physics.cost import StageCost
from isd_gym.physics.network import Network
from isd_gym.physics.road import Road
from isd_gym.physics.road import road as find_road
from isd_gym.physics.simulate import PHYSICS_STEP, Plant, discretise

from . import relaxed
from .descent import ALPHAS, PIECE, Car, Compiled, Objective, Plan, Slopes, backward, compiled
from .descent import Path as Rollout

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

CONTROL_STEP = 5e-3  # s
SLACK = 1e-9  # distance of the currents from the limits [A]


class Episode:
    """One road and one car, prepared for rollouts of any currents.

    Args:
        network: The plant.
        heights: Heights of the road at every physics step [m].
        cost: Stage cost.
        control_step: Control step [s].
        slew_limit: Largest change of current per control step [A].
        current_limit: Largest current [A].
        penalty: Charge for the knowledge of the road, see `ceiling`; part of the minimised cost.

    Raises:
        InputError: The network has no motor or no ideal drive, or the heights are invalid.
    """

    def __init__(
        self,
        network: Network,
        heights: np.ndarray,
        *,
        cost: StageCost,
        control_step: float = CONTROL_STEP,
        slew_limit: float = SLEW_LIMIT,
        current_limit: float = CURRENT_LIMIT,
        penalty: Penalty | None = None,
    ) -> None:
        for e in network.elements:
            if e.place == "element":
                raise InputError(f"element '{e.name}': the clairvoyant optimum needs an ideal drive")
        if not any(isinstance(e, el.Motor) for e in network.elements):
            raise InputError(f"network '{network.name}' has no motor")
        self.network, self.cost, self.control_step = network, cost, control_step
        self.sub = round(control_step / PHYSICS_STEP)
        heights = np.asarray(heights, float)
        self.steps, rest = divmod(len(heights) - 1, self.sub)
        if rest or self.steps < 1 or not np.all(np.isfinite(heights)):
            raise InputError(
                f"heights must be finite, one every {PHYSICS_STEP:g} s, a whole number of control steps and one more"
            )
        self.heights = heights
        bare = Network(
            network.name,
            network.masses,
            tuple(e for e in network.elements if e.place != "channel"),
            network.inputs,
        )
        wanted = ("body_acceleration", "suspension_travel", "tyre_load")
        extra = [c for c in vehicle(network).channels if c.name in wanted]
        self.single = Plant(bare, PHYSICS_STEP, extra=extra)
        self.rows = np.array([*range(self.single.n), *self.single.memory], np.int64)
        self.nz = len(self.rows)
        self.many = Plant(bare, PHYSICS_STEP, lanes=self.nz + 2, extra=extra)
        h = PHYSICS_STEP
        rate = np.diff(heights, prepend=heights[0]) / h
        columns = {"r": heights, "v": rate, "alpha": np.diff(rate, prepend=0.0) / h}
        self.road = np.zeros((len(heights), max(len(self.single.labels), 1), 1))
        for j, (part, _) in enumerate(self.single.labels):
            self.road[:, j, 0] = columns[part]
        a, l, f, i = cost.quadratic
        self.squares, self.on_current = np.array([a, l, f]), i
        self.slew, self.most = slew_limit - SLACK, current_limit - SLACK
        self.penalty = penalty

    @property
    def _compiled(self) -> Compiled:
        return compiled(self.single.at)

    def _car(self, plant: Plant, mats: np.ndarray) -> Car:
        return Car(
            mats=mats,
            ints=plant.ints,
            start=self.single.state(),
            road=self.road,
            rows=self.rows,
            substeps=self.sub,
            currents=max(1, len(plant.currents)),
            outputs=plant.n_outputs,
        )

    def _objective(self, barrier: float = 0.0, limited: bool = True) -> Objective:
        slope_z, slope_i = np.zeros((self.steps, self.nz)), np.zeros(self.steps)
        if self.penalty is not None:
            slope_z[:, : self.single.n] = -self.penalty.on_state
            slope_i[:] = -self.penalty.on_current
        slew, most = (self.slew, self.most) if limited else (1e9, 1e9)
        return Objective(self.squares, self.on_current, slope_z, slope_i, slew, most, barrier)

    def cost_of(self, path: Rollout) -> float:
        """Return the mean stage cost of a rollout minus the mean penalty.

        Args:
            path: The rollout.

        Returns:
            Mean cost [-].
        """
        cost = path.outputs**2 @ self.squares + self.on_current * path.current**2
        charged = 0.0
        if self.penalty is not None:
            p = self.penalty
            charged = p.constant + np.sum(p.on_state * path.z[:, : self.single.n])
            charged += float(p.on_current @ path.current)
        return float((cost.sum() - charged) / self.steps)

    def rollout(self, currents: np.ndarray) -> Rollout:
        """Roll out the real car.

        Args:
            currents: Currents (steps,) [A], not limited.

        Returns:
            The rollout.
        """
        currents = np.asarray(currents, float)
        car, nothing = self._car(self.single, self.single.mats), self._plan(currents)
        return self._roll(car, self._objective(limited=False), nothing, (0.0,))[0]

    def _plan(self, currents: np.ndarray) -> Plan:
        """Return the plan that keeps to `currents`."""
        N, n = self.steps, self.nz + 1
        return Plan(
            z=np.zeros((N, self.nz)),
            current=currents,
            feedforward=np.zeros(N),
            feedback=np.zeros((N, n)),
            values=np.zeros((N, n, n)),
            slopes=np.zeros((N, n)),
        )

    def _roll(
        self, car: Car, objective: Objective, plan: Plan, alphas: Sequence[float]
    ) -> tuple[Rollout, np.ndarray]:
        N = self.steps
        path = Rollout(np.zeros((N, self.nz)), np.zeros((N, len(car.start))), np.zeros(N), np.zeros((N, 3)))
        chosen = np.zeros(-(-N // PIECE))
        self._compiled.rollout(car, objective, plan, np.array(alphas), path, chosen)
        return path, chosen

    def descend(
        self,
        currents: np.ndarray,
        *,
        softness: float,
        barrier: float,
        iterations: int,
        tolerance: float = 1e-4,
    ) -> np.ndarray:
        """Run differential dynamic programming at one softness of the friction and one barrier.

        Args:
            currents: Start (steps,) [A], strictly inside the limits.
            softness: Softness of the friction [-]; 0 for the real friction.
            barrier: Weight of the log barriers [-].
            iterations: Largest number of sweeps.
            tolerance: Relative improvement below which the descent ends.

        Returns:
            Currents (steps,) [A].
        """
        one = self._car(self.single, softened(self.single, softness))
        many = self._car(self.many, softened(self.many, softness))
        objective, N = self._objective(barrier), self.steps
        slopes = Slopes(np.zeros((N, self.nz, self.nz + 1)), np.zeros((N, 3, self.nz + 1)))

        def slack(I: np.ndarray) -> np.ndarray:
            d = np.diff(I, prepend=0.0)
            return np.stack([self.slew - d, self.slew + d, self.most - I, self.most + I], axis=1)

        def merit(path: Rollout) -> float:
            inside = slack(path.current)
            if inside.min() <= 0:
                return np.inf
            return self.cost_of(path) - barrier * float(np.sum(np.log(inside))) / N

        path, _ = self._roll(one, objective, self._plan(np.array(currents, float)), (0.0,))
        best = merit(path)
        caution = np.zeros(-(-N // PIECE))
        inside = slack(path.current)
        duals = barrier / inside
        failed = 0
        for _ in range(iterations):
            if not failed:
                self._compiled.jacobian(many, path, 1e-7, slopes)
            plan = self._plan(path.current)._replace(z=path.z)
            while not backward(slopes, path, objective, duals, caution, plan):
                caution = np.maximum(4 * caution, 1e-2)
            tried, chosen = self._roll(one, objective, plan, ALPHAS)
            new = merit(tried)
            if new < best:
                gained, failed = best - new, 0
                path, best = tried, new
                s0, inside = inside, slack(path.current)
                duals = np.maximum(barrier / s0 - duals / s0 * (inside - s0), 0.005 * duals)
                duals = np.clip(duals, 0.01 * barrier / inside, 100 * barrier / inside)
                caution = np.where(
                    chosen >= 1.0, caution / 4, np.where(chosen < 0.3, np.maximum(4 * caution, 0.03), caution)
                )
                caution[caution < 1e-3] = 0.0
                if gained < tolerance * abs(best):
                    break
            else:
                failed += 1
                caution = np.maximum(5 * caution, 0.03)
                if failed > 6:
                    break
        return path.current

    def optimise(self, schedule: Schedule, initial: np.ndarray | None = None) -> np.ndarray:
        """Run the descents of a schedule.

        Args:
            schedule: Stages of softness and barrier.
            initial: Start (steps,) [A]; None for zero current.

        Returns:
            Currents (steps,) [A].
        """
        I = np.zeros(self.steps) if initial is None else self._inside(initial)
        for softness, barrier in schedule.stages:
            I = self.descend(I, softness=softness, barrier=barrier, iterations=schedule.iterations)
        return I

    def _inside(self, currents: np.ndarray) -> np.ndarray:
        """Return currents slightly inside all limits."""
        out, last = np.empty(self.steps), 0.0
        slew, most = 0.98 * self.slew, 0.98 * self.most
        for k, target in enumerate(np.asarray(currents, float)):
            last = min(max(target, last - slew, -most), last + slew, most)
            out[k] = last
        return out

    def relaxation(self) -> float | None:
        """Return a proven lower bound of the cost of the car without end stops (see `relaxed`).

        Returns:
            Mean cost [-]; None for cars with laws other than one friction and stops.
        """
        asm = self.single.assemblies[0]
        dry = [j for j, e in enumerate(asm.laws) if e.bound is not None]
        if len(dry) > 1 or any(e.bound is None and not isinstance(e, el.BumpStop) for e in asm.laws):
            return None
        part = discretise(asm, PHYSICS_STEP, self.single.u_columns)
        Ad, U0, U1, B, _, G1 = part.blocks[:6]
        OX, OU, OC, OF = part.outputs
        level = 0.0
        if dry:
            e: Any = asm.laws[dry[0]]
            level = max(float(getattr(e, "static_level", 0.0) or 0.0), float(e.level))
        u = self.road[:, :, 0]
        slope_x = np.zeros((self.steps, len(Ad)))
        if self.penalty is not None:
            slope_x -= self.penalty.on_state
        car = relaxed.LinearCar(
            A=Ad,
            B=np.ascontiguousarray(B[:, 0]),
            G=G1[:, dry[0]] * level if dry else np.zeros(len(Ad)),
            W=u[:-1] @ U0.T + u[1:] @ U1.T,
            C=OX[-3:].copy(),
            CI=OC[-3:, 0].copy(),
            CF=OF[-3:, dry[0]] * level if dry else np.zeros(3),
            YW=u[self.sub :: self.sub] @ OU[-3:].T,
            squares=self.squares,
            current=self.on_current,
            slope_x=slope_x,
            substeps=self.sub,
        )
        on_current = np.zeros(self.steps) if self.penalty is None else -self.penalty.on_current
        found = relaxed.bound(car, self.slew + SLACK, self.most + SLACK, on_current)
        constant = 0.0 if self.penalty is None else self.penalty.constant
        return None if found is None else (found - constant) / self.steps


def softened(plant: Plant, softness: float) -> np.ndarray:
    """Return the numbers of a plant with dry friction that is viscous below ``softness * |g| * level``; g is the rate per
    force of the friction.

    Args:
        plant: The plant.
        softness: Factor [-].

    Returns:
        Numbers in the shape of `Plant.mats`.
    """
    at, mats = plant.at, plant.mats.copy()
    numbers = mats if mats.ndim == 2 else mats.transpose(1, 0, 2)
    for j in range(at.smooth, at.laws):
        own = at.gains + j * at.rows + at.states + j
        with np.errstate(divide="ignore", invalid="ignore"):
            # the contribution of the stop to the yielding of its friction is unchanged
            give, stopped = (k + CLOSED * (j - at.smooth) for k in (at.give, at.give_stopped))
            through = np.where(numbers[stopped] > 0, -1.0 / numbers[stopped] - numbers[own], 0.0)
            numbers[own] *= 1.0 + softness
            yields = -(numbers[own] + through)
            numbers[give] = np.where(numbers[own] < 0, -1.0 / numbers[own], 0.0)
            numbers[stopped] = np.where(yields > 0, 1.0 / yields, 0.0)
    return mats


@dataclass(frozen=True)
class Penalty:
    """Deduction from the summed cost of an episode: ``constant + sum_k on_state[k] . x[k] + on_current[k] I[k]``.

    x (n,) are the network's states at the start of control step k, and I [A] is the current of the step.

    Attributes:
        on_state: Slopes (steps, n).
        on_current: Slopes (steps,) [1/A].
        constant: Constant [-].
    """

    on_state: np.ndarray
    on_current: np.ndarray
    constant: float


@dataclass(frozen=True)
class Schedule:
    """Stages of a descent.

    Attributes:
        stages: Softness of the friction [-] and barrier [-] of each stage.
        iterations: Sweeps per stage.
    """

    stages: tuple[tuple[float, float], ...]
    iterations: int

    @classmethod
    def of(cls, factor: float, power: float, iterations: int) -> Schedule:
        """Return a schedule with geometrically decreasing softness.

        Args:
            factor: Ratio of softness between stages.
            power: Exponent of the barrier over the softness.
            iterations: Sweeps per stage.

        Returns:
            The schedule.
        """
        top, softness, stages = 40.0, 40.0, []
        while softness > 0.3:
            stages.append((softness, max(1e-2 * (softness / top) ** power, 3e-5)))
            softness /= factor
        return cls((*stages, (0.0, 3e-5)), iterations)


#: tried in this order; the local optima differ by about 0.3 %
SCHEDULES = (Schedule.of(2.0, 1.0, 15), Schedule.of(2.0, 1.5, 15), Schedule.of(1.4, 1.5, 8))


@dataclass(frozen=True)
class Clairvoyant:
    """Result of the optimisation of one road.

    Attributes:
        currents: Best currents (steps,) [A].
        value: Reached mean cost [-].
        lower: Lower bound [-], proven for the car without end stops; None if not computed.
        rms: RMS (3,) of body acceleration [m/s^2], suspension travel [m] and dynamic tyre load [N] at the
            ends of control steps.
        starts: Costs of all starts [-].
    """

    currents: np.ndarray
    value: float
    lower: float | None
    rms: np.ndarray
    starts: tuple[float, ...]

    @property
    def gap(self) -> float | None:
        """Difference between reached value and bound, relative to the reached value."""
        return None if self.lower is None else 1.0 - self.lower / self.value


def clairvoyant(
    network: Network | str | Path = "quarter-car-isd",
    *,
    heights: np.ndarray | None = None,
    seed: int | None = None,
    scoring: int | None = None,
    road: str | Road = "paper",
    speed: float = 20.0,
    duration: float = 20.0,
    cost: StageCost | None = None,
    control_step: float = CONTROL_STEP,
    slew_limit: float = SLEW_LIMIT,
    starts: int = 1,
    initial: Sequence[np.ndarray] = (),
    bound: bool = True,
) -> Clairvoyant:
    """Return the best currents for one road that is known in advance.

    Args:
        network: The plant.
        heights: Heights of the road [m] at 0, 1 ms, ...; None for the road of `seed`.
        seed: Seed of an environment's road; None for `heights` or `scoring`.
        scoring: Index of a scoring road; None for `heights` or `seed`.
        road: The road of `seed` or `scoring`.
        speed: Speed [m/s].
        duration: Length of the episode [s].
        cost: Stage cost; None for the environment's.
        control_step: Control step [s].
        slew_limit: Largest change of current per control step [A].
        starts: Number of schedules to try, at most 3.
        initial: Currents (steps,) of other controllers as further starts [A].
        bound: Whether the lower bound is computed.

    Returns:
        Currents, cost and bound.

    Raises:
        InputError: The network has no motor, the drive has a lag or delay, or the arguments do not define a
            road and a start.
    """
    network = Network.load(network)
    if sum(given is not None for given in (heights, seed, scoring)) != 1:
        raise InputError("give either heights, a seed or a scoring road")
    if heights is None:
        rng = generators(seed, scoring or 0, 1)[0]
        heights = find_road(road).heights(duration, speed=speed, rng=rng)
    episode = Episode(
        network, heights, cost=cost or StageCost(), control_step=control_step, slew_limit=slew_limit
    )
    tries = [episode.optimise(schedule) for schedule in SCHEDULES[:starts]]
    # a given start keeps its pattern of sticking: the first friction is only slightly soft
    tries += [episode.optimise(Schedule(((2.0, 1e-4), (0.5, 1e-4), (0.0, 3e-5)), 15), I) for I in initial]
    if not tries:
        raise InputError(
            "nothing to start from: starts must be at least 1 where no initial currents are given"
        )
    paths = [episode.rollout(I) for I in tries]
    costs = [episode.cost_of(path) for path in paths]
    best = int(np.argmin(costs))
    rms = np.sqrt(np.mean(paths[best].outputs ** 2, axis=0))
    return Clairvoyant(tries[best], costs[best], episode.relaxation() if bound else None, rms, tuple(costs))


# ------------------------------------------------------------------------------------- values that are known


def episode_key(
    network: Network, road: Road, speed: float, duration: float, cost: StageCost, **more: Any
) -> str:
    """Return a key of everything except the seed on which the values of a road depend.

    Args:
        network: The plant.
        road: The road.
        speed: Speed [m/s].
        duration: Length of the episode [s].
        cost: Stage cost.
        more: Further values.

    Returns:
        16 hexadecimal digits.
    """
    model = network.to_dict()
    car = {k: model[k] for k in ("masses", "elements", "inputs")}
    ground: list[Any] = [road.roughness, road.cutoff, road.over_time, road.shift]
    ground += [None if x is None else np.asarray(x).tolist() for x in (road.abscissa, road.profile)]
    text = json.dumps(
        [car, ground, speed, duration, cost.quadratic, *([more] if more else [])], sort_keys=True
    )
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _cached(shipped: Path) -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "isd_gym" / shipped.name


def _held(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return {}


def read(key: str, shipped: Path) -> dict[int, dict[str, Any]]:
    """Return the known figures of episodes, shipped or from the user's cache.

    Args:
        key: Key of `episode_key`.
        shipped: Shipped file.

    Returns:
        Figures by seed.
    """
    out: dict[int, dict[str, Any]] = {}
    for path in (_cached(shipped), shipped):
        out |= {int(seed): found for seed, found in _held(path).get(key, {}).get("seeds", {}).items()}
    return out


def keep(
    path: Path, exactly: bool, key: str, about: dict[str, Any], seed: int, figures: dict[str, Any]
) -> None:
    """Store the figures of a seed.

    Args:
        path: Shipped file, or the exact file.
        exactly: Whether `path` is written, instead of the user's cache of the same name.
        key: Key of `episode_key`.
        about: Description of the conditions, for people.
        seed: Seed of the road.
        figures: Values of the road.
    """
    path = path if exactly else _cached(path)
    data = _held(path)
    data.setdefault(key, {**about, "seeds": {}})["seeds"][str(seed)] = figures
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(data, indent=1) + "\n")
    except (OSError, InputError):
        pass  # an unwritable cache only costs time


FILE = Path(__file__).parents[2] / "benchmark" / "bounds" / "clairvoyant.json"


def reference(
    network: Network | str | Path = "quarter-car-isd",
    road: str | Road = "paper",
    speed: float = 20.0,
    episodes: int = 32,
    seed: int | None = None,
    duration: float = 20.0,
    cost: StageCost | None = None,
    *,
    compute: bool = False,
    starts: int = 2,
    store: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, np.ndarray] | None:
    """Return the known figures of consecutive episodes.

    Args:
        network: The plant.
        road: The road.
        speed: Speed [m/s].
        episodes: Number of episodes.
        seed: Seed of episode 0; None for the scoring roads.
        duration: Length of an episode [s].
        cost: Stage cost; None for the environment's.
        compute: Whether missing figures are computed (about 10 s per episode and start).
        starts: Number of schedules to try.
        store: File of computed figures; None for the user's cache.
        progress: Called with the finished share, from 0 to 1.

    Returns:
        Arrays (episodes,): `value` (least known cost), `lower` (proven; NaN without a bound), and RMS of
            `acceleration` [m/s^2], `travel` [m] and `tyre_load` [N] at that cost. None if an episode is
            unknown.
    """
    network, ground, cost = Network.load(network), find_road(road), cost or StageCost()
    stream = {"stream": "scoring"} if seed is None else {}
    key = episode_key(network, ground, speed, duration, cost, **stream)
    known = read(key, FILE)
    begin = seed or 0
    wanted = range(begin, begin + episodes)
    if not compute and any(s not in known for s in wanted):
        return None
    for i, s in enumerate(wanted):
        if s not in known:
            found = clairvoyant(
                network,
                seed=None if seed is None else s,
                scoring=s if seed is None else None,
                road=ground,
                speed=speed,
                duration=duration,
                cost=cost,
                starts=starts,
            )
            figures = (found.value, found.lower, *found.rms)
            known[s] = {
                n: None if x is None else float(f"{x:.6g}") for n, x in zip(FIGURES, figures, strict=True)
            }
            about = {
                "network": network.name,
                "road": ground.name,
                "speed": speed,
                "duration": duration,
            } | stream
            keep(store or FILE, store is not None, key, about, s, known[s])
        if progress is not None:
            progress((i + 1) / episodes)
    return {n: np.array([math.nan if known[s][n] is None else known[s][n] for s in wanted]) for n in FIGURES}


FIGURES = ("value", "lower", "acceleration", "travel", "tyre_load")


def reachable(
    network: Network | str | Path,
    road: str | Road = "paper",
    speed: float = 20.0,
    episodes: int = 32,
    seed: int | None = None,
    duration: float = 20.0,
    cost: StageCost | None = None,
) -> dict[str, np.ndarray] | None:
    """Return the known figures of consecutive episodes for a score (see `reference`).

    Args:
        network: The plant.
        road: The road.
        speed: Speed [m/s].
        episodes: Number of episodes.
        seed: Seed of episode 0; None for the scoring roads.
        duration: Length of an episode [s].
        cost: Stage cost; None for the environment's.

    Returns:
        Arrays (episodes,): `value` (least known cost), `lower` (proven), and RMS of body_acceleration
            [m/s^2], suspension_travel [m] and tyre_load [N] at that cost. None if an episode is unknown.
    """
    found = reference(network, road, speed, episodes, seed, duration, cost)
    if found is None:
        return None
    names = {"acceleration": "body_acceleration", "travel": "suspension_travel"}
    return {names.get(name, name): values for name, values in found.items()}


def main() -> None:
    """``python -m isd_gym.contrib.ceilings.clairvoyant``: compute the missing figures of the shipped file (delete the file to restart)."""

    def say(share: float) -> None:
        print(f"{100 * share:.0f} %", flush=True)

    reference(compute=True, store=FILE, progress=say)


if __name__ == "__main__":
    main()
