"""Stable-Baselines3's SAC with a critic that learns how the cars of a group differ, and next to nothing else.

The gradient of a deterministic part of the policy is the critic's slope by the action, and one step of 5 ms changes
a value by a thousandth of what the road does. Cars of a group drive on the same road; the critic is fitted to
the temporal differences less their mean over the group, so that the road is no noise. What a value has in common for
all cars of a road stays open, and no gradient of the actor depends on it.
"""

from __future__ import annotations

from typing import Any

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.utils import polyak_update
from stable_baselines3.sac.policies import Actor
from stable_baselines3.sac.policies import SACPolicy as _SACPolicy
from torch import nn

from .critic import Bilinear, First


class Critic(nn.Module):
    """Action values (cars, 1) of observations and actions: `Bilinear`, the action being one more column of the state."""

    def __init__(self, inputs: int, seen: int, core: list[int], width: int) -> None:
        super().__init__()
        self.body = Bilinear(inputs + 1, seen + 1, [0, *(c + 1 for c in core)], width)
        self.out = nn.Linear(self.body.width, 1)
        self.optimizer: Any = None

    def forward(self, observations: torch.Tensor, actions: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return (self.out(self.body(torch.cat([actions, observations], dim=1))),)

    def set_training_mode(self, mode: bool) -> None:
        self.train(mode)


class SACPolicy(_SACPolicy):
    """SAC's policy with an actor that sees the first `seen` columns, and the critic above."""

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
        return Critic(inputs, self.seen, core, arch["qf"][0])

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        from .critic import Adam

        groups = [{"params": list(self.critic.parameters()), "factor": self.critic_rate}]
        self.critic.optimizer = Adam(groups, lr=lr_schedule(1))

    def _get_constructor_parameters(self) -> dict[str, Any]:
        own = dict(seen=self.seen, core=self.core, critic_rate=self.critic_rate)
        return {**super()._get_constructor_parameters(), **own}


class GroupSAC(SAC):
    """SAC whose critic is fitted to what differs within a group of `group` cars."""

    def __init__(self, *args: Any, group: int = 1, **kwargs: Any) -> None:
        self.group = group
        super().__init__(*args, **kwargs)

    def common(self, error: torch.Tensor) -> torch.Tensor:
        """The error (rows, 1) less its mean over the group."""
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
            loss.backward()
            critic.optimizer.step()
            if moves:
                actions, log_prob = actor.action_log_prob(data.observations)
                actor_loss = alpha * log_prob.mean() - critic(data.observations, actions)[0].mean()
                actor.optimizer.zero_grad()
                actor_loss.backward()
                actor.optimizer.step()
            polyak_update(critic.parameters(), target.parameters(), self.tau)
        self._n_updates += gradient_steps
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/entropy", -float(log_prob.mean().detach()))
        self.logger.record("train/critic_loss", float(loss.detach()))
