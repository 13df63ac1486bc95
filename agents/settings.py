"""The tuned settings of training, one block per algorithm: everything that was chosen, and why.

Two things decide most of it. What one action of 5 ms changes is a thousandth of what the road does, so that the road
must not be noise: cars in groups on one road learn from how they differ (`ppo`, `sac`). And a critic's errors lead the
policy astray: PPO has none, SAC's looks over many steps, starts alone and learns faster than the policy. The simulation
runs at millions of steps a second, so that the learner is what costs: small networks, large batches. What was tried,
with figures: docs/guides/study.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from isd_gym.network import Network
from isd_gym.sensors import Sensors
from isd_gym.vehicle import Vehicle, vehicle

from .memory import Memory
from .policy import Head

CONTROL_STEP = 5e-3  # s, between the actions of a policy
#: RMS of each kind of signal on the paper's road, rounded, and of its change in one step, in SI units
SCALE = {
    "body_acceleration": (1.0, 0.25),
    "pitch_acceleration": (0.5, 0.12),
    "roll_acceleration": (0.8, 0.2),
    "suspension_travel": (0.01, 0.001),
    "suspension_travel_rate": (0.2, 0.06),
    "device_travel": (0.01, 0.0005),
    "device_travel_rate": (0.05, 0.012),
    "current": (2.5, 0.45),
}
#: the velocities of the body are leaky integrals of its accelerations: time constant [s], and scale over that of the acceleration
LEAK = (1.0, 0.07)


def memory_of(car: Vehicle) -> Memory:
    """Return what a policy remembers of a car's signals: first and second changes, and velocities of the body.

    Args:
        car: The car.
    """
    kinds = [signal.kind for signal in car.measured]
    scale, change = (tuple(SCALE[kind][k] for kind in kinds) for k in (0, 1))
    tau, share = LEAK
    leak = tuple((i, tau, share * scale[i]) for i in range(1 + len(car.axes)))
    return Memory(scale, change, order=2, leak=leak, step=CONTROL_STEP)


#: memory of a quarter car
MEMORY = memory_of(vehicle(Network.load("quarter-car-isd")))


def robust() -> tuple[dict[str, Any], Sensors]:
    """What ``--randomize`` varies: the ranges of the robust track, as the environment takes them, and its sensors."""
    from isd_gym.grid import Grid

    given = dict(Grid.load("robust").random)
    ranges = {name: tuple(span) for name, span in given["factors"].items()}
    return {**ranges, "speed": tuple(given["speed"]), "road": given["road"]}, Sensors(
        noise=tuple(given["noise"])
    )


@dataclass(frozen=True)
class Settings:
    """What is common to both algorithms."""

    steps: int  # control steps of all cars together
    cars: int
    memory: Memory | None = None  # `memory_of` the car unless given
    filter: bool = True  # the LQG's estimate and law among the features
    ahead: float = 0.0  # s of road ahead that the policy sees
    # increments of the current: exploration noise adds up to a smooth current instead of drowning in the drive's slew
    # (PPO from nothing for 3 minutes, passive J 0.874: increments 0.700, targets 0.892); a residual on the LQG's law
    # explores more, and was led astray by its critic (0.657 to 0.663 in 4 million steps)
    head: Head = field(default_factory=lambda: Head("increment"))
    reward_scale: float = 0.1
    reward_offset: float = 0.8  # near the mean, so that values are small; it changes no optimum
    # imitated at the start, see `warm`; None: from nothing; "law": the law of the memory's filter
    teacher: str | None = "mpc-friction"
    warm_steps: int = 2500  # of 64 cars
    warm_updates: int = 2500
    averaging: float = 0.97  # kept of the mean of the actor's weights at an update; the mean is the policy
    evaluations: int = 12  # over the whole training
    checkpoint_seconds: float = 60.0

    @property
    def rollout(self) -> int:
        """Control steps of all cars between updates: a training ends after a whole number of rollouts."""
        raise NotImplementedError


@dataclass(frozen=True)
class PPOSettings(Settings):
    steps: int = 24_000_000
    cars: int = 1024
    group: int = 8  # cars on one road, see `ppo`
    horizon: int = 320  # steps of each car between updates
    tail: int = 128  # of them at the end only to see what the others led to
    batch: int = 4096
    epochs: int = 2  # fresh roads cost less than another pass
    learning_rate: float = 4e-4  # falls linearly to a fiftieth
    gamma: float = 0.99  # half a second: what an action does is over by then
    clip_range: float = 0.2
    log_std: float = -0.9  # increments of 0.4 of the slew limit: nearly all of a good law is at either limit
    averaging: float = 0.98
    actor: tuple[int, ...] = (64, 64)

    @property
    def rollout(self) -> int:
        """Control steps of all cars between updates."""
        return self.cars * self.horizon

    def algorithm(self, seen: int, core: list[int]) -> dict[str, Any]:
        """Keyword arguments of `stable_baselines3.PPO`."""
        import torch

        from .ppo import GroupBuffer, PPOPolicy

        return dict(
            rollout_buffer_class=GroupBuffer,
            rollout_buffer_kwargs=dict(group=self.group, tail=self.tail),
            policy=PPOPolicy,
            n_steps=self.horizon,
            batch_size=self.batch,
            n_epochs=self.epochs,
            learning_rate=Falling(self.learning_rate),
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
class SACSettings(Settings):
    preview: float = 0.4  # s of road ahead that the critic knows
    warm_steps: int = 1500
    steps: int = 14_000_000
    evaluations: int = 8
    cars: int = 1024
    group: int = 8  # cars on one road, see `sac`
    batch: int = 2048
    averaging: float = 0.997
    buffer: int = 1_000_000
    every: int = 4  # steps of all cars between updates
    updates: int = 1
    delay: int = 2  # updates of the critic to one of the actor
    warm_up: int = 2048  # steps before the first update; SB3 acts at random in them
    critic_updates: int = 1000  # of the critic alone, at the start
    log_std: float = -1.4
    explore: float = 0.25  # share of steps at which a group explores
    exploration: float = 0.5  # besides the policy's own, which vanishes near the limits
    learning_rate: float = 2e-4
    critic_rate: float = 5.0  # of the critic, as a multiple
    n_steps: int = 128  # of the returns: 0.64 s, beyond which the critic's errors weigh little
    gamma: float = 0.985
    tau: float = 0.005
    entropy: float = 1e-4  # tuned by itself (SB3's auto) the temperature overshot and drowned the values
    actor: tuple[int, ...] = (64, 64)
    critic: tuple[int, ...] = (64,)

    @property
    def rollout(self) -> int:
        """Control steps of all cars between updates."""
        return self.cars * self.every

    @property
    def alone(self) -> int:
        """Control steps of all cars before the policy is trained: those of the critic alone."""
        return self.warm_up + self.rollout * -(-self.critic_updates // self.updates) if self.teacher else 0

    def algorithm(self, seen: int, core: list[int]) -> dict[str, Any]:
        """Keyword arguments of `sac.GroupSAC`."""
        from .sac import GroupReplayBuffer, SACPolicy

        return dict(
            policy=SACPolicy,
            group=self.group,
            explore=self.explore,
            exploration=self.exploration,
            delay=self.delay,
            replay_buffer_class=GroupReplayBuffer,
            replay_buffer_kwargs=dict(group=self.group, n_steps=self.n_steps, gamma=self.gamma),
            learning_rate=Falling(self.learning_rate),
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
class Falling:
    """A learning rate that falls linearly with progress, to a fiftieth."""

    start: float

    def __call__(self, remaining: float) -> float:
        return self.start * max(remaining, 0.02)


SETTINGS: dict[str, type[PPOSettings] | type[SACSettings]] = {"ppo": PPOSettings, "sac": SACSettings}


def with_preview(settings: PPOSettings | SACSettings, preview: float) -> PPOSettings | SACSettings:
    """The settings for `preview` [s] of road ahead: PPO looks twice as far, for what is seen pays later.

    J on the validation roads, 0.2 s, seed 0: 0.4100 with the settings without preview (best at half its steps, rising after it),
    0.4086 with these and still falling; `mpc-friction-preview` 0.4107.
    """
    settings = replace(settings, ahead=preview)
    return _far(settings) if preview else settings


def _far(settings: PPOSettings | SACSettings) -> PPOSettings | SACSettings:
    if isinstance(settings, PPOSettings):
        return replace(settings, gamma=0.995, tail=192, horizon=384)
    return settings


def tuned(algorithm: str, car: Vehicle, preview: float = 0.0) -> PPOSettings | SACSettings:
    """Return the tuned settings of an algorithm for a car.

    A car whose rear wheels follow its front wheels knows the road before the rear ones: PPO looks as far as with preview, and
    imitates the controller that knows it too.

    Args:
        algorithm: A name in `SETTINGS`.
        car: The car.
        preview: Road ahead that the policy sees [s].
    """
    settings = with_preview(SETTINGS[algorithm](), preview)
    if len(car.corners) > 1:
        # half car, J on the validation roads after 24 million steps: 0.6103 from the law of the estimate, 0.596 from this teacher
        settings = replace(_far(settings), teacher="mpc-wheelbase")
    return settings
