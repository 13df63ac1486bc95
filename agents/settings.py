"""The tuned settings of training, one block per algorithm: everything that was chosen, and why.

Time scales decide most of it. A body oscillates about once a second, the wheel eleven times, the controller acts
two hundred times a second: the discount looks about a second ahead, returns are bootstrapped early, and the policy sees
changes over the last steps. The simulation runs at millions of steps a second, so that the learner is what costs:
small networks, large batches.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from .memory import Memory
from .policy import Head

#: RMS of each signal on the paper's road, rounded: body acceleration [m/s^2], travel [m], its rate [m/s], device travel [m],
#: its rate [m/s], current [A]; and of its change in one step
SCALE = (1.0, 0.01, 0.2, 0.01, 0.05, 2.5)
CHANGE = (0.25, 0.001, 0.06, 0.0005, 0.012, 0.45)
#: second changes of the signals, and the body's absolute velocity as a leaky integral (1 s) of its acceleration
MEMORY = Memory(SCALE, CHANGE, order=2, leak=((0, 1.0, 0.07),))

#: ranges of ``--randomize``: what differs between cars of one series, loads, ageing, roads and speeds
RANDOMIZE: dict[str, Any] = {
    "body.mass": (0.8, 1.3),
    "seal.level": (0.5, 1.5),
    "motor.thrust_constant": (0.85, 1.15),
    "speed": (10.0, 35.0),
    "road": ["A", "B", "C", "paper"],
}


@dataclass(frozen=True)
class Settings:
    """What is common to both algorithms."""

    steps: int  # control steps of all cars together
    cars: int
    preview: float = 0.4  # s of road that the critic knows, see `critic`
    memory: Memory = MEMORY
    # increments of the current: exploration noise adds up to a smooth current instead of drowning in the drive's slew
    # (PPO from nothing for 3 minutes, passive J 0.874: increments 0.700, targets 0.892)
    head: Head = field(default_factory=lambda: Head("increment"))
    reward_scale: float = 0.1
    reward_offset: float = 0.8  # near the mean, so that values are small; it changes no optimum
    teacher: str | None = "lqg"  # imitated at the start, see `warm`; None: from nothing
    warm_steps: int = 2000  # of 64 cars
    warm_updates: int = 2000
    averaging: float = 0.97  # kept of the mean of the actor's weights at an update; the mean is the policy
    evaluations: int = 40  # over the whole training
    checkpoint_seconds: float = 60.0


@dataclass(frozen=True)
class PPOSettings(Settings):
    steps: int = 30_000_000
    cars: int = 512
    horizon: int = 64  # steps of each car between updates
    batch: int = 8192
    epochs: int = 2  # fresh roads cost less than another pass
    learning_rate: float = 1e-3  # falls linearly to a fiftieth
    gamma: float = 0.995
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    log_std: float = -1.4  # increments of 0.25 of the slew limit: nearly all of a good law is at either limit
    actor: tuple[int, ...] = (64, 64)
    critic: tuple[int, ...] = (64,)

    def algorithm(self, seen: int) -> dict[str, Any]:
        """Keyword arguments of `stable_baselines3.PPO`."""
        import torch

        from .critic import PPOPolicy

        return dict(
            policy=PPOPolicy,
            n_steps=self.horizon,
            batch_size=self.batch,
            n_epochs=self.epochs,
            learning_rate=Falling(self.learning_rate),
            gamma=self.gamma,
            gae_lambda=self.gae_lambda,
            clip_range=self.clip_range,
            ent_coef=0.0,
            policy_kwargs=dict(
                seen=seen,
                net_arch=dict(pi=list(self.actor), vf=list(self.critic)),
                activation_fn=torch.nn.Tanh,
                log_std_init=self.log_std,
            ),
        )


@dataclass(frozen=True)
class SACSettings(Settings):
    steps: int = 4_000_000
    cars: int = 64
    batch: int = 512
    averaging: float = 0.999
    buffer: int = 500_000
    updates: int = 1  # a step of all cars
    warm_up: int = 4096
    critic_updates: int = 2000  # of the critic alone, at the start
    n_steps: int = 5  # of the returns: 25 ms, half a period of the wheel's hop passes in two
    log_std: float = -1.0
    learning_rate: float = 1e-3
    gamma: float = 0.99
    tau: float = 0.01
    entropy: str | float = "auto_0.001"
    actor: tuple[int, ...] = (64, 64)
    critic: tuple[int, ...] = (64, 64)

    def algorithm(self, seen: int) -> dict[str, Any]:
        """Keyword arguments of `stable_baselines3.SAC`."""
        from .critic import Quadratic, SACPolicy

        return dict(
            policy=SACPolicy,
            learning_rate=Falling(self.learning_rate),
            buffer_size=self.buffer,
            learning_starts=self.warm_up,
            batch_size=self.batch,
            tau=self.tau,
            gamma=self.gamma,
            train_freq=1,
            gradient_steps=self.updates,
            ent_coef=self.entropy,
            n_steps=self.n_steps,
            policy_kwargs=dict(
                seen=seen,
                net_arch=dict(pi=list(self.actor), qf=list(self.critic)),
                features_extractor_class=Quadratic,
                features_extractor_kwargs=dict(width=64),
            ),
        )


@dataclass(frozen=True)
class Falling:
    """A learning rate that falls linearly with progress, to a fiftieth."""

    start: float

    def __call__(self, remaining: float) -> float:
        return self.start * max(remaining, 0.02)


SETTINGS: dict[str, type[PPOSettings] | type[SACSettings]] = {"ppo": PPOSettings, "sac": SACSettings}
