"""Tuned settings of training, one class per algorithm, with the reasons.

Two facts decide most of the settings. First, an action of 5 ms has a thousandth of the road's effect, so that
the road must not be noise: groups of cars on one road learn from their differences (`ppo`, `sac`). Second,
errors of a critic mislead the policy: PPO has no critic; SAC's critic looks over many steps, starts alone and
learns faster than the policy. The simulation runs at millions of steps per second, so that the learner
dominates the time: networks are small and batches large. docs/explanation/study.md lists the trials with
figures.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, replace
from importlib import resources
from typing import Any

from isd_gym.agents._memory import Memory
from isd_gym.agents.policy import Head
from isd_gym.env._sensors import Sensors
from isd_gym.physics._vehicle import Vehicle, vehicle
from isd_gym.physics.network import Network

__all__ = [
    "PPOSettings",
    "SACSettings",
]


CONTROL_STEP = 5e-3  # s, between the actions of a policy
#: memory of a quarter car
MEMORY = Memory.of(vehicle(Network.load("quarter-car-isd")))


def robust() -> tuple[dict[str, Any], Sensors]:
    """Return the variations of ``--randomize``: those of the robust track.

    Returns:
        Ranges for the environment, and sensors.
    """
    grid = resources.files("isd_gym.benchmark") / "grids" / "robust.toml"
    given = tomllib.loads(grid.read_text(encoding="utf-8"))["random"]
    ranges = {name: tuple(span) for name, span in given["factors"].items()}
    ranges |= {"speed": tuple(given["speed"]), "road": given["road"]}
    return ranges, Sensors(noise=tuple(given["noise"]))


@dataclass(frozen=True)
class _Settings:
    """Settings of both algorithms.

    Attributes:
        steps: Control steps of all cars.
        cars: Number of cars.
        memory: Features of the observations; None for the history of the car.
        filter: Whether the LQG's estimate and law are among the features.
        ahead: Preview of the policy [s].
        head: Conversion of an output to a current.
        reward_scale: Factor on the reward.
        reward_offset: Offset of the reward, near the mean reward for small values; changes no optimum.
        teacher: Policy that is imitated at the start, see `warm`; "law" for the law of the memory's filter;
            None for no imitation.
        warm_steps: Control steps of 64 cars for the imitation.
        warm_updates: Updates of the imitation.
        averaging: Factor on the mean of the actor's weights per update; the mean is the policy.
        evaluations: Number of evaluations in a training.
        checkpoint_seconds: Interval between checkpoints [s].
    """

    steps: int
    cars: int
    memory: Memory | None = None
    filter: bool = True
    ahead: float = 0.0
    # increments of the current: exploration noise adds up to a smooth current instead of being lost in the
    # drive's slew limit (PPO without teacher for 3 minutes, passive J 0.874: increments 0.700, targets
    # 0.892); a residual on the LQG's law explores more, and was misled by its critic (0.657 to 0.663 in 4
    # million steps)
    head: Head = field(default_factory=lambda: Head("increment"))
    reward_scale: float = 0.1
    reward_offset: float = 0.8
    teacher: str | None = "mpc-friction"
    warm_steps: int = 2500
    warm_updates: int = 2500
    averaging: float = 0.97
    evaluations: int = 12
    checkpoint_seconds: float = 60.0

    @property
    def rollout(self) -> int:
        """Control steps of all cars between updates; a training ends after an integer number of rollouts."""
        raise NotImplementedError


@dataclass(frozen=True)
class PPOSettings(_Settings):
    """Settings of PPO, in addition to `_Settings`.

    Attributes:
        steps: Control steps of all cars.
        cars: Number of cars.
        group: Number of cars on one road, see `ppo`.
        horizon: Steps of each car between updates.
        tail: Last of these steps, which only complete the returns of earlier steps.
        batch: Number of samples per minibatch.
        epochs: Passes over a rollout; fresh roads cost less than another pass.
        learning_rate: Learning rate at the start, which falls linearly to a fiftieth.
        gamma: Discount factor: half a second, longer than the effect of an action.
        clip_range: Clipping of the probability ratio.
        log_std: Logarithm of the exploration's standard deviation: increments of 0.4 of the slew limit, since
            a good law is nearly always at one of the limits.
        averaging: Factor on the mean of the actor's weights per update.
        actor: Hidden units of the actor.
    """

    steps: int = 24_000_000
    cars: int = 1024
    group: int = 8
    horizon: int = 320
    tail: int = 128
    batch: int = 4096
    epochs: int = 2
    learning_rate: float = 4e-4
    gamma: float = 0.99
    clip_range: float = 0.2
    # increments of 0.4 of the slew limit: a good law is nearly always at one of the limits
    log_std: float = -0.9
    averaging: float = 0.98
    actor: tuple[int, ...] = (64, 64)

    @property
    def rollout(self) -> int:
        """Control steps of all cars between updates."""
        return self.cars * self.horizon

    def algorithm(self, seen: int, core: list[int]) -> dict[str, Any]:
        """Return the keyword arguments of `stable_baselines3.PPO`.

        Args:
            seen: Number of columns of the policy.
            core: Columns of the state.

        Returns:
            Value by argument.
        """
        import torch

        from .ppo import GroupBuffer, PPOPolicy

        return dict(
            rollout_buffer_class=GroupBuffer,
            rollout_buffer_kwargs=dict(group=self.group, tail=self.tail),
            policy=PPOPolicy,
            n_steps=self.horizon,
            batch_size=self.batch,
            n_epochs=self.epochs,
            learning_rate=_Falling(self.learning_rate),
            gamma=self.gamma,
            clip_range=self.clip_range,
            ent_coef=0.0,
            vf_coef=0.0,
            max_grad_norm=10.0,
            policy_kwargs=dict(
                net_arch=dict(pi=list(self.actor), vf=[]),
                activation_fn=torch.nn.Tanh,
                log_std_init=self.log_std,
                optimizer_kwargs=dict(eps=1e-6),
            ),
        )


@dataclass(frozen=True)
class SACSettings(_Settings):
    """Settings of SAC, in addition to `_Settings`.

    Attributes:
        preview: Preview of the critic [s].
        warm_steps: Control steps of 64 cars for the imitation.
        steps: Control steps of all cars.
        evaluations: Number of evaluations in a training.
        cars: Number of cars.
        group: Number of cars on one road, see `sac`.
        batch: Number of samples per update.
        averaging: Factor on the mean of the actor's weights per update.
        buffer: Number of stored transitions.
        every: Control steps of each car between updates.
        updates: Updates of the critic per update interval.
        delay: Updates of the critic per update of the actor.
        warm_up: Steps before the first update, with random actions of SB3.
        critic_updates: Updates of the critic alone at the start.
        log_std: Logarithm of the exploration's standard deviation at the start.
        explore: Share of steps at which a group explores.
        exploration: Noise in addition to the policy's exploration, which vanishes near the limits.
        learning_rate: Learning rate.
        critic_rate: Learning rate of the critic as a multiple of the actor's.
        n_steps: Steps of the returns: 0.64 s, beyond which the critic's errors have little weight.
        gamma: Discount factor.
        tau: Factor of the critic's moving average.
        entropy: Temperature; with automatic tuning (SB3's auto), the temperature overshot and dominated the
            values.
        actor: Hidden units of the actor.
        critic: Hidden units of the critic.
    """

    preview: float = 0.4
    warm_steps: int = 1500
    steps: int = 14_000_000
    evaluations: int = 8
    cars: int = 1024
    group: int = 8
    batch: int = 2048
    averaging: float = 0.997
    buffer: int = 1_000_000
    every: int = 4
    updates: int = 1
    delay: int = 2
    warm_up: int = 2048
    critic_updates: int = 1000
    log_std: float = -1.4
    explore: float = 0.25
    exploration: float = 0.5
    learning_rate: float = 2e-4
    critic_rate: float = 5.0
    n_steps: int = 128
    gamma: float = 0.985
    tau: float = 0.005
    # with automatic tuning (SB3's auto), the temperature overshot and dominated the values
    entropy: float = 1e-4
    actor: tuple[int, ...] = (64, 64)
    critic: tuple[int, ...] = (64,)

    @property
    def rollout(self) -> int:
        """Control steps of all cars between updates."""
        return self.cars * self.every

    @property
    def alone(self) -> int:
        """Control steps of all cars before the first training of the policy, for the critic alone."""
        return self.warm_up + self.rollout * -(-self.critic_updates // self.updates) if self.teacher else 0

    def algorithm(self, seen: int, core: list[int]) -> dict[str, Any]:
        """Return the keyword arguments of `sac.GroupSAC`.

        Args:
            seen: Number of columns of the policy.
            core: Columns of the state.

        Returns:
            Value by argument.
        """
        from .sac import GroupReplayBuffer, SACPolicy

        return dict(
            policy=SACPolicy,
            group=self.group,
            explore=self.explore,
            exploration=self.exploration,
            delay=self.delay,
            replay_buffer_class=GroupReplayBuffer,
            replay_buffer_kwargs=dict(group=self.group, n_steps=self.n_steps, gamma=self.gamma),
            learning_rate=_Falling(self.learning_rate),
            buffer_size=self.buffer,
            learning_starts=self.warm_up,
            batch_size=self.batch,
            tau=self.tau,
            gamma=self.gamma,
            train_freq=self.every,
            gradient_steps=self.updates,
            ent_coef=self.entropy,
            policy_kwargs=dict(
                seen=seen,
                core=core,
                critic_rate=self.critic_rate,
                net_arch=dict(pi=list(self.actor), qf=list(self.critic)),
            ),
        )


@dataclass(frozen=True)
class _Falling:
    """A learning rate that falls linearly with progress to a fiftieth.

    Attributes:
        start: Rate at the start.
    """

    start: float

    def __call__(self, remaining: float) -> float:
        return self.start * max(remaining, 0.02)


SETTINGS: dict[str, type[PPOSettings] | type[SACSettings]] = {"ppo": PPOSettings, "sac": SACSettings}


def with_preview(settings: PPOSettings | SACSettings, preview: float) -> PPOSettings | SACSettings:
    """Return the settings for a preview: PPO looks twice as far, since the previewed road has later effects.

    J on the validation roads, 0.2 s, seed 0: 0.4100 with the settings without preview (best at half its
    steps, rising after it), 0.4086 with these settings and still falling; `mpc-friction-preview` 0.4107.

    Args:
        settings: Settings without preview.
        preview: Known road ahead [s].

    Returns:
        The changed settings.
    """
    settings = replace(settings, ahead=preview)
    return _far(settings) if preview else settings


def from_nothing(settings: PPOSettings | SACSettings) -> PPOSettings | SACSettings:
    """Return the settings without knowledge of a model: no teacher, and no estimate among the features.

    Args:
        settings: Settings of an algorithm.

    Returns:
        The changed settings.
    """
    return replace(settings, teacher=None, filter=False)


def _far(settings: PPOSettings | SACSettings) -> PPOSettings | SACSettings:
    if isinstance(settings, PPOSettings):
        return replace(settings, gamma=0.995, tail=192, horizon=384)
    return settings


def tuned(algorithm: str, car: Vehicle, preview: float = 0.0) -> PPOSettings | SACSettings:
    """Return the tuned settings of an algorithm for a car.

    In a car with following rear wheels, the road before the rear wheels is known: PPO looks as far as with
    preview, and imitates the controller with the same knowledge.

    Args:
        algorithm: A name in `SETTINGS`.
        car: The car.
        preview: Previewed road of the policy [s].

    Returns:
        Settings of the algorithm.
    """
    settings = with_preview(SETTINGS[algorithm](), preview)
    if len(car.corners) > 1:
        # half car, J on the validation roads after 24 million steps: 0.6103 from the law of the estimate, 0.596 from this teacher
        settings = replace(_far(settings), teacher="mpc-wheelbase")
    return settings
