"""Training of PPO and SAC with Stable-Baselines3 on the batched car; a kill loses at most one checkpoint interval.

A run is a folder: `run.json` (the request), `checkpoint-<steps>/` (the learner, complete or absent),
`tensorboard/`, and `policy/`, the best policy so far as a policy folder.
"""

from __future__ import annotations

import json
import math
import os
import platform
import shlex
import time
import warnings
from contextlib import suppress
from dataclasses import replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError, how_to_install, shown
from isd_gym._common.files import claim_folder, write_text, writing
from isd_gym._common.inputs import read_json
from isd_gym.agents._memory import Memory
from isd_gym.agents.policy import Head, Policy
from isd_gym.baselines.controller import steps_ahead
from isd_gym.benchmark.policies import find, passive
from isd_gym.benchmark.scoring import Entry, drive, score
from isd_gym.env._sensors import Sensors
from isd_gym.env.registration import BY_CORNERS
from isd_gym.physics._batch import with_found_ranges
from isd_gym.physics._vehicle import vehicle
from isd_gym.physics.network import Network
from isd_gym.physics.road import road as find_road

from . import checkpoint
from .settings import CONTROL_STEP, SETTINGS, PPOSettings, SACSettings, from_nothing, robust, tuned

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

__all__ = [
    "train",
]


SCHEMA = "isd-training/1"
#: kind, mark and parts of the folder of a run
FOLDER = ("training run", "run.json", ("run.json", "checkpoint-*", ".checkpoint-*", "tensorboard", "policy"))
#: ending of the names of policies by number of corners
_ENDINGS = {1: "", 2: "-half-car", 4: "-full-car"}
#: validation roads, used neither in training (seeds from 2e6) nor in scores (seeds from 0)
VALIDATION_SEED, VALIDATION_EPISODES = 900_000, 64
SCORE_EPISODES = 32
#: shown beside the progress, where they exist: for quarter cars, and for cars with several corners
BASELINES = ("lqg", "mpc-friction")
CAR_BASELINES = ("lqg", "lqg-wheelbase")
#: their costs, for a process that trains several seeds
_REFERENCES: dict[str, dict[str, float]] = {}


def train(
    algorithm: str,
    out: str | Path,
    *,
    seed: int = 0,
    steps: int | None = None,
    network: str | Path | Mapping[str, Any] | Network = "quarter-car-isd",
    road: str = "paper",
    speed: float = 20.0,
    randomize: bool | Mapping[str, Any] | str | Path = False,
    preview: float = 0.0,
    sensors: Sensors | Mapping[str, Any] | str | None = None,
    settings: PPOSettings | SACSettings | None = None,
    unaided: bool = False,
    say: Callable[[str], None] = print,
    progress: Callable[[str, float], None] = lambda task, share: None,
) -> dict[str, Any]:
    """Train a policy in a folder, or continue the run in that folder; Ctrl-C saves the run first.

    The policy kept is the one of least cost on the validation roads.

    Args:
        algorithm: ppo or sac.
        out: Folder of the run.
        seed: Seed of the training.
        steps: Control steps of all cars together.
        network: Network of the car: a quarter, half or full car.
        road: Road of the training.
        speed: Speed [m/s].
        randomize: True for the cars, roads and sensors of the robust track (quarter cars), or ranges or the folder of a
            diagnosis as the environment takes them.
        preview: Road ahead that the policy of a quarter car sees [s].
        sensors: Imperfections of the sensors.
        settings: Settings of the algorithm; the tuned ones unless given.
        unaided: Whether to train without a teacher and without an estimate among the features.
        say: Function that is given lines of progress.
        progress: Function that is given a task and the finished share of that task.

    Returns:
        Report (`isd-training/1`): the policy's folder, its training and its score.

    Raises:
        InputError: A value is not valid, or the folder holds another run.
    """
    if not (find_spec("stable_baselines3") and find_spec("torch")):
        raise InputError(f"training needs Stable-Baselines3 and torch: {how_to_install('agents')}")
    if algorithm not in SETTINGS:
        raise InputError(f"algorithm must be one of {', '.join(SETTINGS)}, not {algorithm!r}")
    plant = Network.load(network)
    corners = len(vehicle(plant).corners)
    if corners not in _ENDINGS:
        raise InputError(f"network '{plant.name}' has {corners} corners: policies are trained for 1, 2 or 4")
    if preview and corners > 1:
        raise InputError(
            f"network '{plant.name}' has {corners} corners: its front wheels tell the road before the rear ones; leave the "
            "preview out"
        )
    if settings is None:
        settings = tuned(algorithm, vehicle(plant), preview)
    elif preview:
        settings = replace(settings, ahead=preview)
    if unaided:
        settings = from_nothing(settings)
    steps_ahead(preview, CONTROL_STEP)
    if steps is not None:
        if steps < 1:
            raise InputError(f"steps must be at least 1, not {steps}")
        if steps < settings.rollout:
            raise InputError(
                f"{steps} steps are less than one rollout of {settings.cars} cars: give {settings.rollout} or more"
            )
        settings = replace(settings, steps=steps)
        if isinstance(settings, SACSettings) and steps <= settings.alone:
            say(
                f"the critic learns alone for {settings.alone} steps: with {steps} the policy stays the imitation"
            )
    find_road(road)
    senses = Sensors.of(sensors)
    spread: dict[str, Any] | None
    if randomize is True:
        if corners > 1:
            raise InputError(
                f"network '{plant.name}' has {corners} corners, and the ranges of the robust track are those of a quarter car: "
                'give ranges to isd_gym.contrib.training.train.train, such as randomize={"body.mass": (0.8, 1.2)}'
            )
        spread, seen = robust()
        senses = seen if senses.perfect else senses
    else:
        spread = with_found_ranges(plant, randomize or None) or None
    run = Run(Path(out), algorithm, seed, plant, road, float(speed), spread, senses, settings, say, progress)
    return run.go()


class Run:
    """A training run and its folder.

    Args:
        out: Folder of the run.
        algorithm: 'ppo' or 'sac'.
        seed: Seed of all random draws.
        plant: The network.
        road: Road.
        speed: Speed [m/s].
        spread: Ranges for the environment; None for a single car.
        sensors: Imperfections of the sensors.
        settings: Settings of the algorithm.
        say: Called with lines for the user.
        progress: Called with a task and its finished share.
    """

    def __init__(
        self,
        out: Path,
        algorithm: str,
        seed: int,
        plant: Network,
        road: str,
        speed: float,
        spread: dict[str, Any] | None,
        sensors: Sensors,
        settings: PPOSettings | SACSettings,
        say: Callable[[str], None],
        progress: Callable[[str, float], None] = lambda task, share: None,
    ) -> None:
        self.out, self.algorithm, self.seed, self.plant = out, algorithm, seed, plant
        self.road, self.speed, self.spread, self.settings, self.say = road, speed, spread, settings, say
        self.progress, self.sensors = progress, sensors
        self.car = vehicle(plant)
        self.memory = self._memory()
        self.asked = {
            "schema": SCHEMA,
            "algorithm": algorithm,
            "seed": seed,
            "road": road,
            "speed": speed,
            "randomize": json.loads(json.dumps(spread)),
            "sensors": sensors.to_dict(),
            "settings": describe(settings),
            "network": plant.to_dict(),
        }
        #: for varied cars: cost of each validation road without current (episodes,)
        self._idle: np.ndarray | None = None
        #: running mean of the actor's weights
        self.average: dict[str, np.ndarray] = {}
        #: content of a checkpoint besides the learner
        self.state: dict[str, Any] = {"seconds": 0.0, "environment_seconds": 0.0, "curve": []}

    @property
    def name(self) -> str:
        """Name of the policy."""
        ahead = self.settings.ahead
        name = f"{self.algorithm}-preview-{ahead:g}" if ahead else self.algorithm
        name += _ENDINGS[len(self.car.corners)]
        return f"{name}-robust" if self.spread else name

    @property
    def _noise(self) -> float:
        """Sensor noise that an estimate should assume: a quarter of the maximum, see `mpc-robust`."""
        noise = self.sensors.noise
        return 0.25 * noise[1] if isinstance(noise, tuple) else 0.5 * noise

    def _memory(self) -> Memory:
        """Return the memory of the settings, with the filter of this network on request and if possible."""
        s = self.settings
        memory = s.memory or Memory.of(self.car, speed=self.speed)
        memory = replace(memory, ahead=steps_ahead(s.ahead, memory.step))
        if not s.filter:
            return memory
        try:
            if len(self.car.corners) > 1:
                from .wheelbase import car_filter

                known, echo = car_filter(self.plant, self.speed, memory.step, self._noise)
                return replace(memory, filter=known, echo=echo, late=())  # the echo is the road ahead
            from .estimate import lqg_filter

            return replace(memory, filter=lqg_filter(self.plant, memory.step, s.ahead, self._noise))
        except (InputError, ImportError) as error:
            self.say(f"no filter for this network, the policy sees signals and changes alone: {error}")
            return memory

    # ------------------------------------------------------------------------------------- the folder

    def _claim(self) -> Path | None:
        """Claim the folder for this run, and return its newest checkpoint, if any."""
        note = self.out / FOLDER[1]
        if note.exists():
            noted = read_json(note, f"'{note}' cannot be read; train into another folder")
            if not (isinstance(noted, dict) and isinstance(noted.get("settings"), dict)):
                raise InputError(f"'{note}' describes no training run; train into another folder")
            noted.setdefault("sensors", {})
            for key in ("algorithm", "seed", "road", "speed", "randomize", "sensors", "network"):
                if noted.get(key) != self.asked[key]:
                    what = "" if key == "network" else f": {shown(noted.get(key))}, not {self.asked[key]}"
                    raise InputError(
                        f"'{self.out}' holds a run with another {key}{what}; train into another folder"
                    )
            same = {k: v for k, v in noted["settings"].items() if k != "steps"}
            if same != {k: v for k, v in self.asked["settings"].items() if k != "steps"}:
                raise InputError(f"'{self.out}' holds a run with other settings; train into another folder")
        write_text(note, json.dumps(self.asked, indent=1) + "\n")
        return checkpoint.newest(self.out)

    def save(self, model: Any) -> None:
        """Write a checkpoint atomically, then remove older checkpoints.

        Args:
            model: The learner.
        """
        checkpoint.write(self.out, model, self.average, self.state)

    # -------------------------------------------------------------------------------------- training

    def _environment(self, cars: int) -> Any:
        from isd_gym.sb3 import make_vec_env

        from .environment import Remember

        s = self.settings
        critic = s.preview if isinstance(s, SACSettings) else 0.0
        preview = max(s.ahead, critic)
        inner = make_vec_env(
            "ISDSuspension-v0",
            cars,
            rescale=False,
            stagger=True,
            network=self.plant,
            road=self.road,
            speed=self.speed,
            randomize=self.spread,
            sensors=self.sensors,
            observation="preview" if preview else "measured",
            preview=preview or None,
        )
        group = s.group if cars == s.cars else 1
        points = round(critic / self.memory.step)
        return Remember(
            inner, self.memory, s.head, s.reward_scale, s.reward_offset, group, points, even=bool(self.spread)
        )

    def go(self) -> dict[str, Any]:
        """Train, and score the best policy; other processes cannot use the folder meanwhile.

        Returns:
            The report (`isd-training/1`).

        Raises:
            InputError: The folder holds another run, or is in use.
        """
        with checkpoint.held(claim_folder(self.out, *FOLDER), FOLDER[0]):
            return self._go()

    def _go(self) -> dict[str, Any]:
        import torch
        from stable_baselines3 import PPO

        from .sac import GroupSAC

        s = self.settings
        there = self._claim()
        self.progress("preparing", 0.0)
        torch.set_num_threads(1)  # small networks lose more to threads than they gain
        env = self._environment(s.cars)
        kind: Any = {"ppo": PPO, "sac": GroupSAC}[self.algorithm]
        tensorboard = str(self.out / "tensorboard") if find_spec("tensorboard") else None
        # fresh roads: seeds from the seed and the number of steps, never a repeated road
        done = checkpoint.steps(there) if there else 0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # SB3 warns of batch sizes that do not divide a rollout
            model = kind(
                env=env,
                seed=self._seed(done),
                device="cpu",
                tensorboard_log=tensorboard,
                **s.algorithm(env.seen, env.core),
            )
        if there is not None:
            self.average, self.state = checkpoint.read(there, model)
            self.say(f"resuming '{self.out}' at {done / 1e6:.2f} of {s.steps / 1e6:.2f} million steps")
            _check_finite(model)
        if "references" not in self.state:
            self.state["references"] = self._references()
        if there is None and s.teacher is not None:
            self._imitate(model)
        self.progress("preparing", 1.0)
        known = ", ".join(f"{name} {j:.4f}" for name, j in self.state["references"].items())
        self.say(f"J on the validation roads: {known}")
        if model.num_timesteps < s.steps:
            try:
                with writing(self.out / "tensorboard", self.out):
                    model.learn(
                        s.steps - model.num_timesteps,
                        callback=_callback(self, env),
                        reset_num_timesteps=False,
                        tb_log_name=self.algorithm,
                        log_interval=1 if self.algorithm == "ppo" else 50,
                    )
                self.progress("training", 1.0)
            except ValueError:  # torch refuses what is not finite
                _check_finite(model)
                raise
            except KeyboardInterrupt:
                self.save(model)
                done = min(model.num_timesteps / s.steps, 1.0)
                self.say(f"saved at {100 * done:.1f} %; this goes on from there:  {self.command(self.out)}")
                raise
            self.follow(model, s.averaging)
            self.look(model, env)
            self.save(model)
        env.close()
        return self._finish()

    def _rival(self, name: str) -> Entry:
        """Return a baseline with the same preview."""
        if self.settings.ahead > 0:
            return find(f"{name}-preview", self.plant, preview=self.settings.ahead)
        if self.spread and name == "mpc-friction":
            name = "mpc-robust"
        return find(name, self.plant, speed=self.speed)

    def _imitate(self, model: Any) -> None:
        """Start from the teacher, if it exists for this network."""
        from .imitation import warm_start

        begin = time.perf_counter()
        try:
            entry = self._law() if self.settings.teacher == "law" else self._rival(str(self.settings.teacher))
        except (InputError, ImportError) as error:
            self.say(f"no teacher, training starts from nothing: {error}")
            return
        self.say(f"imitating {entry.name}")
        env = self._environment(64)
        told = f"imitating {entry.name}"
        warm_start(
            model,
            env,
            entry,
            self.settings,
            self._seed(0) + 1_000_000,
            lambda share: self.progress(told, share),
        )
        env.close()
        self.state["seconds"] += time.perf_counter() - begin

    def _law(self) -> Entry:
        """Return the law of the memory's filter as a policy."""
        if self.memory.filter is None:
            raise InputError("the memory has no filter, and so no law")
        signals = len(self.car.measured)
        layer = (np.zeros((len(self.car.driven), self.memory.width(signals))), np.zeros(len(self.car.driven)))
        policy = Policy([layer], memory=self.memory, head=Head("residual"), name="law", network=self.plant)
        return Entry("the law of the estimate", policy.copy)

    def _seed(self, done: int) -> int:
        return 2_000_000 + (self.seed * 1_000_003 + done) % 4_000_000_000

    def follow(self, model: Any, keep: float) -> None:
        """Move the running mean of the actor's weights towards the present weights.

        Near the optimum, updates are mostly noise, which a mean over updates removes.

        Args:
            model: The learner.
            keep: Factor on the mean [-].
        """
        for name, value in model.policy.state_dict().items():
            if name.startswith(checkpoint.ACTOR):
                now = value.detach().numpy()
                old = self.average.get(name)
                self.average[name] = now.copy() if old is None else keep * old + np.float32(1 - keep) * now

    def export(self, model: Any) -> Policy:
        """Return the deterministic policy of the averaged weights.

        Args:
            model: The learner.

        Returns:
            The policy.
        """
        from isd_gym.agents._actors import build

        return build(
            self.average,
            activation="tanh" if self.algorithm == "ppo" else "relu",
            memory=self.memory,
            head=self.settings.head,
            name=self.name,
            network=self.plant,
        )

    def cost(self, entry: Entry) -> float:
        """Return the mean cost J on the validation roads; for varied cars, the mean of J relative to the same
        car without current.

        Args:
            entry: The policy.

        Returns:
            Mean cost [-].
        """
        costs = self._costs(entry)
        if not self.spread:
            return float(costs.mean())
        if self._idle is None:
            self._idle = self._costs(find("isd-passive", self.plant))
        return float((costs / self._idle).mean())

    def _costs(self, entry: Entry) -> np.ndarray:
        from isd_gym.physics.cost import StageCost

        run = drive(
            entry,
            self.plant,
            road=self.road,
            speed=self.speed,
            randomize=self.spread,
            sensors=self.sensors,
            episodes=VALIDATION_EPISODES,
            seed=VALIDATION_SEED,
            timed=0,
        )
        return run.cost(StageCost.of(None, self.car.axes, len(self.car.corners)))

    def _references(self) -> dict[str, float]:
        """Return the costs of the passive car and of available baselines on the validation roads, computed once per process."""
        same = [self.asked[k] for k in ("network", "road", "speed", "randomize", "sensors")]
        names = BASELINES if len(self.car.corners) == 1 else CAR_BASELINES
        key = json.dumps([same, self.settings.ahead, VALIDATION_EPISODES, names], sort_keys=True)
        if key in _REFERENCES:
            return dict(_REFERENCES[key])
        # for varied cars, the same cars without current: the conventional car has no such parameters
        idle = find("isd-passive", self.plant) if self.spread else passive(self.plant)
        out = {idle.name: self.cost(idle)}
        if not out[idle.name] > 0:
            raise InputError(f"road {shown(self.road)} does not move the car: there is nothing to learn")
        for name in names:
            try:
                rival = self._rival(name)
                out[rival.name] = self.cost(rival)
            except (InputError, ImportError):
                continue  # the baseline has no model of the network, or is not installed
        _REFERENCES[key] = dict(out)
        return out

    def look(self, model: Any, env: Any) -> None:
        """Score the present policy on the validation roads, keep it if it is the best, and report in one line.

        Args:
            model: The learner.
            env: Training environment.
        """
        policy = self.export(model)
        j = self.cost(Entry(self.algorithm, policy.copy))
        curve = self.state["curve"]
        best = min((row["cost"] for row in curve), default=math.inf)
        curve.append(
            {
                "steps": int(model.num_timesteps),
                "seconds": round(self.state["seconds"], 1),
                "cost": round(j, 6),
            }
        )
        if j < best:
            self._describe(policy).save(self.out / "policy")
        idle = next(iter(self.state["references"].values()))
        self.say(
            f"{100 * min(model.num_timesteps / self.settings.steps, 1.0):5.1f} %  {model.num_timesteps / 1e6:6.2f} M steps"
            f"  {self.state['seconds']:5.0f} s  J {j:.4f} ({100 * (j / idle - 1):+.1f} %)  best {min(j, best):.4f}"
        )
        model.logger.record("score/cost", j)
        model.logger.record("score/change", j / idle - 1)

    def command(self, out: Path | str = "DIR") -> str:
        """Return the command line of this run, or the difference from possible command lines.

        Args:
            out: Folder in the command line.

        Returns:
            One line.
        """
        s, usual = self.settings, tuned(self.algorithm, self.car, self.settings.ahead)
        is_unaided = s.teacher is None and not s.filter
        if is_unaided:
            usual = from_nothing(usual)
        own_ranges = bool(self.spread) and self.spread != robust()[0]  # such as those of a diagnosis
        if own_ranges or describe(replace(s, steps=usual.steps)) != describe(usual):
            return "isd_gym.contrib.training.train.train with the settings below"
        words = [f"isd-gym train {self.algorithm} --out {shlex.quote(str(out))} --seed {self.seed}"]
        if is_unaided:
            words.append("--from-nothing")
        if s.steps != usual.steps:
            words.append(f"--steps {s.steps}")
        if self.plant != Network.load("quarter-car-isd"):
            words.append(f"--network {self.plant.name}")
        if self.road != "paper":
            words.append(f"--road {self.road}")
        if self.speed != 20.0:
            words.append(f"--speed {self.speed:g}")
        if self.spread:
            words.append("--randomize")
        usual_sensors = robust()[1] if self.spread else Sensors()
        if self.sensors != usual_sensors:
            values = {
                k: ":".join(map(str, v)) if isinstance(v, list) else v
                for k, v in self.sensors.to_dict().items()
            }
            words.append("--sensors " + ",".join(f"{k}={v}" for k, v in values.items()))
        if self.settings.ahead:
            words.append(f"--preview {self.settings.ahead:g}")
        return " ".join(words)

    def _describe(self, policy: Policy, scored: dict[str, Any] | None = None) -> Policy:
        policy.info = {
            "algorithm": self.algorithm,
            "env": {
                "id": BY_CORNERS[len(self.car.corners)],
                "road": self.road,
                "speed": {"value": self.speed, "unit": "m/s"},
                "randomize": self.asked["randomize"],
                "sensors": self.asked["sensors"],
                "preview": {"value": self.settings.ahead, "unit": "s"},
            },
            "training": {
                "command": self.command(),
                "seed": self.seed,
                "settings": self.asked["settings"],
                "seconds": round(self.state["seconds"], 1),
                "environment_share": round(
                    self.state["environment_seconds"] / max(self.state["seconds"], 1e-9), 4
                ),
                "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, one thread",
                "versions": versions(),
                "references": self.state["references"],
                "curve": self.state["curve"],
            },
            "score": scored,
        }
        return policy

    def _finish(self) -> dict[str, Any]:
        """Score the best policy on unused roads, and complete its folder."""
        policy = Policy.load(self.out / "policy")
        result = score(
            [Entry(policy.name, policy.copy)],
            self.plant,
            reference=passive(self.plant),
            road=self.road,
            speed=self.speed,
            episodes=SCORE_EPISODES,
            sensors=None if self.spread else self.sensors,
        )
        row = next(r for r in result.policies if r["policy"] == policy.name)
        row = {"road": result.road, "episodes": result.episodes, "seed": result.seed, **row}
        self._describe(policy, row).save(self.out / "policy")
        j = row["cost"]
        self.say(
            f"cost J {j['value']:.4f}, {100 * j['change']:+.1f} % against passive "
            f"[{100 * j['low']:+.1f}, {100 * j['high']:+.1f}] on {SCORE_EPISODES} held-out roads; "
            f"policy in '{self.out / 'policy'}'"
        )
        return {
            "schema": SCHEMA,
            "algorithm": self.algorithm,
            "policy": str(self.out / "policy"),
            **policy.info,
        }


def _check_finite(model: Any) -> None:
    """Raise `InputError` for a learner that diverged: its weights, or its actions at rest, are not finite."""
    import torch

    told = list(model.policy.parameters())
    with torch.no_grad(), suppress(ValueError):  # torch refuses a distribution that is not finite
        told.append(model.policy(torch.zeros(1, *model.observation_space.shape))[0])
        if all(bool(torch.isfinite(numbers).all()) for numbers in told):
            return
    raise InputError(
        f"the learner's numbers are not finite after {model.num_timesteps} steps: train into another folder"
    )


SHOW_EVERY = 0.2  # interval between progress reports [s]


def _callback(run: Run, env: Any) -> Any:
    from stable_baselines3.common.callbacks import BaseCallback

    class Watch(BaseCallback):
        """Evaluates, saves and measures time between rollouts; evaluation time is not training time."""

        def _on_training_start(self) -> None:
            self.clock, self.env_clock = time.perf_counter(), env.seconds
            self.saved, self.shown = time.perf_counter(), 0.0
            self.rounds = 0 if not run.average else 1_000_000
            curve = run.state["curve"]
            self.due = curve[-1]["steps"] + self._every() if curve else 0

        def _every(self) -> int:
            return max(run.settings.steps // run.settings.evaluations, 1)

        def _tick(self) -> None:
            now = time.perf_counter()
            run.state["seconds"] += now - self.clock
            run.state["environment_seconds"] += env.seconds - self.env_clock
            self.clock, self.env_clock = now, env.seconds

        def _on_rollout_start(self) -> None:
            _check_finite(self.model)
            # the first updates have less weight, so that the start does not dominate the mean
            self.rounds += 1
            run.follow(self.model, min(run.settings.averaging, self.rounds / (self.rounds + 9)))
            if isinstance(run.settings, SACSettings) and run.settings.teacher is not None:
                # the critic learns the value of the imitated policy before the actor follows the critic
                model: Any = self.model
                model.actor.requires_grad_(model._n_updates >= run.settings.critic_updates)
            if self.model.num_timesteps >= self.due:
                self._tick()
                run.look(self.model, env)
                self.due += self._every()
                self.clock = time.perf_counter()
            if time.perf_counter() - self.saved > run.settings.checkpoint_seconds:
                self._tick()
                run.save(self.model)
                self.saved = time.perf_counter()

        def _on_training_end(self) -> None:
            self._tick()

        def _on_step(self) -> bool:
            if (now := time.perf_counter()) - self.shown > SHOW_EVERY:
                self.shown = now
                run.progress("training", min(self.model.num_timesteps / run.settings.steps, 1.0))
            return True

    return Watch()


def describe(settings: PPOSettings | SACSettings) -> dict[str, Any]:
    """Return settings as plain data.

    Args:
        settings: Settings of an algorithm.

    Returns:
        Value by name.
    """
    from dataclasses import asdict

    return json.loads(json.dumps(asdict(settings)))


def versions() -> dict[str, str]:
    """Return the versions of the packages that made a policy.

    Returns:
        Version by package.
    """
    names = ("isd-gym", "stable-baselines3", "torch", "gymnasium", "numpy")
    out = {}
    for name in names:
        try:
            out[name] = version(name)
        except Exception:  # an installation without metadata
            continue
    return out
