"""SAC of Stable-Baselines3 with a critic that learns little more than the differences between the cars of a group.

The gradient of a deterministic part of the policy is the critic's slope by the action, and a step of 5 ms
changes a value by a thousandth of the road's effect. Cars of a group drive on the same road. The critic is
fitted to the temporal differences minus their mean over the group, so that the road adds no noise. The common
value of all cars of a road stays undetermined; no gradient of the actor depends on it. The critic knows the
road ahead, which no action changes (Mao et al., ICLR 2019). The actor sees the first `seen` columns, the
measurable ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.utils import polyak_update
from stable_baselines3.sac.policies import Actor
from stable_baselines3.sac.policies import SACPolicy as _SACPolicy
from torch import nn

if TYPE_CHECKING:
    from gymnasium import spaces
    from stable_baselines3.common.vec_env import VecNormalize


class Bilinear(nn.Module):
    """Features ``[s s', s (W r), hidden(x)]``: products of the state's columns s with each other and with the road ahead r.

    The future cost of a linear car is a sum of these products, so that the critic is nearly linear in its
    parameters.

    Args:
        inputs: Number of columns.
        seen: Number of columns before the road ahead.
        core: Columns of the state.
        width: Number of hidden units.
    """

    def __init__(self, inputs: int, seen: int, core: list[int], width: int) -> None:
        super().__init__()
        self.seen, self.core, k = seen, core, len(core)
        one, other = torch.triu_indices(k, k)
        # products of columns by matrices, faster than gathered columns
        self.one: torch.Tensor
        self.other: torch.Tensor
        self.register_buffer("one", torch.eye(k)[:, one], persistent=False)
        self.register_buffer("other", 0.3 * torch.eye(k)[:, other], persistent=False)
        self.cross = nn.Linear(max(inputs - seen, 1), k)
        self.road = inputs > seen
        self.hidden = nn.Sequential(nn.Linear(inputs, width), nn.Tanh())
        self.width = k * (k + 1) // 2 + 2 * k + width

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        s = x[:, self.core]
        road = x[:, self.seen :] if self.road else torch.zeros_like(x[:, :1])
        return torch.cat([(s @ self.one) * (s @ self.other), s, s * self.cross(road), self.hidden(x)], dim=1)


class Adam(torch.optim.Adam):
    """Adam with an optional `factor` on the learning rate per parameter group; Stable-Baselines3 sets one rate for all groups."""

    def step(self, closure: Any = None) -> Any:
        rates = [group["lr"] for group in self.param_groups]
        for group in self.param_groups:
            group["lr"] *= group.get("factor", 1.0)
        out = super().step(closure)
        for group, rate in zip(self.param_groups, rates, strict=True):
            group["lr"] = rate
        return out


class First(BaseFeaturesExtractor):
    """The first columns.

    Args:
        space: Observation space.
        seen: Number of columns.
    """

    def __init__(self, space: spaces.Box, seen: int) -> None:
        super().__init__(space, seen)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x[:, : self.features_dim]


class Critic(nn.Module):
    """Action values (cars, 1) of observations and actions: `Bilinear` with the actions as additional columns of the state.

    The term ``a f(s) + a^2 g(s)`` is added, summed over the actions, with a network of the actor's size: the
    actor learns from the slope by the action a alone, which must therefore be as flexible a function as the
    actor.

    Args:
        inputs: Number of columns.
        seen: Number of columns of the actor.
        core: Columns of the state.
        width: Number of hidden units.
        actions: Number of actions.
    """

    def __init__(self, inputs: int, seen: int, core: list[int], width: int, actions: int = 1) -> None:
        super().__init__()
        self.seen, self.actions = seen, actions
        columns = [*range(actions), *(c + actions for c in core)]
        self.body = Bilinear(inputs + actions, seen + actions, columns, width)
        self.out = nn.Linear(self.body.width, 1)
        last = nn.Linear(width, 2 * actions)
        layers = (nn.Linear(seen, width), nn.Tanh(), nn.Linear(width, width), nn.Tanh(), last)
        self.slope = nn.Sequential(*layers)
        self.optimizer: Any = None

    def forward(self, observations: torch.Tensor, actions: torch.Tensor) -> tuple[torch.Tensor, ...]:
        slope = self.slope(observations[:, : self.seen])
        own = actions * slope[:, : self.actions] + actions.square() * slope[:, self.actions :]
        if self.actions > 1:
            own = own.sum(dim=1, keepdim=True)
        return (0.1 * own + self.out(self.body(torch.cat([actions, observations], dim=1))),)

    def set_training_mode(self, mode: bool) -> None:
        self.train(mode)


class SACPolicy(_SACPolicy):
    """SAC's policy with an actor on the first `seen` columns, and `Critic` as critic.

    Args:
        args: Arguments of Stable-Baselines3's policy.
        seen: Number of columns of the actor.
        core: Columns of the state; None for all seen columns.
        critic_rate: Learning rate of the critic as a multiple of the actor's.
        kwargs: Arguments of Stable-Baselines3's policy by name.
    """

    def __init__(
        self, *args: Any, seen: int, core: list[int] | None = None, critic_rate: float = 1.0, **kwargs: Any
    ) -> None:
        self.seen, self.core, self.critic_rate = seen, list(core or []), critic_rate
        super().__init__(*args, **kwargs)

    def make_actor(self, features_extractor: Any = None) -> Actor:
        return super().make_actor(First(self.observation_space, self.seen))  # type: ignore[arg-type]

    def make_critic(self, features_extractor: Any = None) -> Any:
        arch: Any = self.net_arch
        (inputs,) = self.observation_space.shape  # type: ignore[misc]
        core = self.core or list(range(self.seen))
        (actions,) = self.action_space.shape  # type: ignore[misc]
        return Critic(inputs, self.seen, core, arch["qf"][0], actions)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        groups = [{"params": list(self.critic.parameters()), "factor": self.critic_rate}]
        self.critic.optimizer = Adam(groups, lr=lr_schedule(1))
        self.critic_target.requires_grad_(False)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        own = dict(seen=self.seen, core=self.core, critic_rate=self.critic_rate)
        return {**super()._get_constructor_parameters(), **own}


class GroupReplayBuffer(ReplayBuffer):
    """Replay buffer that samples whole groups of consecutive cars on the same road at the same time, with returns over `n_steps`.

    Args:
        args: Arguments of `ReplayBuffer`.
        group: Number of consecutive cars on one road.
        n_steps: Number of steps of a return.
        gamma: Discount factor.
        kwargs: Arguments of `ReplayBuffer` by name.
    """

    def __init__(
        self, *args: Any, group: int = 1, n_steps: int = 1, gamma: float = 1.0, **kwargs: Any
    ) -> None:
        self.group, self.n_steps, self.gamma = group, n_steps, gamma
        super().__init__(*args, **kwargs)
        #: exploration of each group (steps, groups); windows begin at exploration steps
        self.explored = np.ones((self.buffer_size, self.n_envs // group), bool)

    def sample(self, batch_size: int, env: VecNormalize | None = None) -> ReplayBufferSamples:
        # episodes end by time alone; `discounts` (rows, 1) are the factors on the values after the steps
        count = max(batch_size // self.group, 1)
        held = self.buffer_size if self.full else self.pos
        steps = min(self.n_steps, held)
        # the newest transitions begin no whole window
        begin = (np.arange(held - steps + 1) + (self.pos if self.full else 0)) % self.buffer_size
        known = np.flatnonzero(self.explored[begin])
        if not len(known):  # no exploration so early
            known = np.arange(len(begin) * self.explored.shape[1])
        chosen = known[np.random.randint(len(known), size=count)]  # noqa: NPY002 (seeded by SB3)
        start, group = np.divmod(chosen, self.explored.shape[1])
        window = (begin[start][:, None] + np.arange(steps)) % self.buffer_size

        def see(array: np.ndarray) -> np.ndarray:  # (groups, steps, cars)
            return array.reshape(len(array), -1, self.group)[window, group[:, None]]

        reward, lived = see(self.rewards), np.full(len(group) * self.group, steps)
        ends = see(self.dones)
        if ends.any():  # the value at the end of an episode is that of its last state
            running = np.cumprod(1.0 - ends, axis=1)
            reward[:, 1:] *= running[:, :-1]
            lived = 1 + running[:, :-1].sum(axis=1).astype(int).ravel()
        discounts = np.float32(self.gamma) ** np.arange(steps, dtype=np.float32)
        reward = np.einsum("gkc,k->gc", reward, discounts).ravel()
        rows = np.repeat(window[:, 0], self.group)
        cars = (group[:, None] * self.group + np.arange(self.group)).ravel()
        last = (rows + lived - 1) % self.buffer_size
        discount = np.float32(self.gamma) ** lived.astype(np.float32)
        data = (
            self.observations[rows, cars],
            self.actions[rows, cars],
            self.next_observations[last, cars],
            np.zeros((len(rows), 1), np.float32),
            reward[:, None],
            discount[:, None],
        )
        return ReplayBufferSamples(*(torch.from_numpy(d) for d in data))


class GroupSAC(SAC):
    """SAC with a critic that is fitted to the differences within a group of cars.

    A group explores at a random share `explore` of its steps, and is learned from at these steps alone: the
    actions in between add no noise to the returns.

    Args:
        args: Arguments of `SAC`.
        group: Number of consecutive cars on one road.
        explore: Share of steps at which a group explores.
        exploration: Standard deviation of noise on the actions in addition to the policy's, which vanishes
            near the limits.
        delay: Number of critic updates per actor update.
        kwargs: Arguments of `SAC` by name.
    """

    def __init__(
        self,
        *args: Any,
        group: int = 1,
        explore: float = 1.0,
        exploration: float = 0.0,
        delay: int = 1,
        **kwargs: Any,
    ) -> None:
        self.group, self.explore, self.exploration, self.delay = group, explore, exploration, delay
        super().__init__(*args, **kwargs)

    def _sample_action(
        self, learning_starts: int, *args: Any, **kwargs: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        buffer: Any = self.replay_buffer
        if self.num_timesteps < learning_starts:
            buffer.explored[buffer.pos] = True
            return super()._sample_action(learning_starts, *args, **kwargs)
        groups = np.random.random(buffer.explored.shape[1]) < self.explore  # noqa: NPY002 (seeded by SB3)
        buffer.explored[buffer.pos] = groups
        seen: Any = self._last_obs
        actions, _ = self.predict(seen, deterministic=True)
        cars = np.repeat(groups, self.group)
        if cars.any():
            own, _ = self.predict(seen[cars], deterministic=False)
            noise = np.random.standard_normal(own.shape).astype(np.float32)  # noqa: NPY002
            actions[cars] = np.clip(own + np.float32(self.exploration) * noise, -1.0, 1.0)
        return actions, actions

    def common(self, error: torch.Tensor) -> torch.Tensor:
        """Return an error minus its mean over the group.

        Args:
            error: Errors (rows, 1).

        Returns:
            Errors (rows, 1).
        """
        if self.group == 1:
            return error
        grouped = error.reshape(-1, self.group)
        return (grouped - grouped.mean(dim=1, keepdim=True)).reshape(-1, 1)

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        actor, critic, target = self.actor, self.critic, self.critic_target
        self._update_learning_rate([actor.optimizer, critic.optimizer])
        moves = next(actor.parameters()).requires_grad
        loss = torch.zeros(())
        for _ in range(gradient_steps):
            data = self.replay_buffer.sample(batch_size)  # type: ignore[union-attr]
            alpha = self.ent_coef_tensor
            with torch.no_grad():
                actions, log_prob = actor.action_log_prob(data.next_observations)
                value = target(data.next_observations, actions)[0] - alpha * log_prob[:, None]
                wanted = data.rewards + data.discounts * value
            loss = self.common(critic(data.observations, data.actions)[0] - wanted).square().mean()
            critic.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            critic.optimizer.step()
            self._n_updates += 1
            if moves and self._n_updates % self.delay == 0:
                critic.requires_grad_(False)
                actions, log_prob = actor.action_log_prob(data.observations)
                # not the slope of the averaged critic, whose lag makes the actor oscillate
                actor_loss = alpha * log_prob.mean() - critic(data.observations, actions)[0].mean()
                actor.optimizer.zero_grad()
                actor_loss.backward()
                actor.optimizer.step()
                critic.requires_grad_(True)
            polyak_update(critic.parameters(), target.parameters(), self.tau)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/entropy", -float(log_prob.mean().detach()))
        self.logger.record("train/critic_loss", float(loss.detach()))
