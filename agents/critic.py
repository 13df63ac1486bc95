"""Policies for Stable-Baselines3 whose critic knows the road ahead, and whose actor does not.

How good the next second will be depends on the road that comes far more than on one action. The road does not depend on
the actions, so that a critic may know it without bias (an input-dependent baseline: Mao et al., ICLR 2019), and what
it explains is no longer noise in the gradient. The value of a linear car is quadratic: squares of linear combinations
are given to the critic. The actor sees the first `seen` columns, which are all that a car can measure.
"""

from __future__ import annotations

from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.sac.policies import Actor
from stable_baselines3.sac.policies import SACPolicy as _SACPolicy
from torch import nn


class Squares(nn.Module):
    """``[(W x + b)^2, hidden(x)]``: a quadratic form and a small network beside it."""

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.linear = nn.Linear(inputs, width)
        self.hidden = nn.Sequential(nn.Linear(inputs, width), nn.Tanh(), nn.Linear(width, width), nn.Tanh())
        self.width = 2 * width

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.cat([0.1 * self.linear(x).square(), self.hidden(x)], dim=1)


class _Two(nn.Module):
    """Actor's and critic's networks, as `ActorCriticPolicy` wants them."""

    def __init__(self, inputs: int, seen: int, actor: list[int], critic: int) -> None:
        super().__init__()
        self.seen = seen
        layers: list[nn.Module] = []
        for a, b in zip([seen, *actor], actor, strict=False):
            layers += [nn.Linear(a, b), nn.Tanh()]
        self.policy_net = nn.Sequential(*layers)
        self.value_net = Squares(inputs, critic)
        self.latent_dim_pi, self.latent_dim_vf = actor[-1], self.value_net.width

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.forward_actor(x), self.forward_critic(x)

    def forward_actor(self, x: torch.Tensor) -> torch.Tensor:
        return self.policy_net(x[:, : self.seen])

    def forward_critic(self, x: torch.Tensor) -> torch.Tensor:
        return self.value_net(x)


class PPOPolicy(ActorCriticPolicy):
    """`ActorCriticPolicy` with the critic above; net_arch: {"pi": [...], "vf": [width]}."""

    def __init__(self, *args: Any, seen: int, **kwargs: Any) -> None:
        self.seen = seen
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        arch: Any = self.net_arch
        self.mlp_extractor = _Two(self.features_dim, self.seen, arch["pi"], arch["vf"][0])  # type: ignore[assignment]

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "seen": self.seen}


class _First(BaseFeaturesExtractor):
    """The first columns."""

    def __init__(self, space: spaces.Box, seen: int) -> None:
        super().__init__(space, seen)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x[:, : self.features_dim]


class Quadratic(BaseFeaturesExtractor):
    """The columns and squares of linear combinations of them."""

    def __init__(self, space: spaces.Box, width: int) -> None:
        super().__init__(space, space.shape[0] + width)
        self.linear = nn.Linear(space.shape[0], width)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.cat([x, 0.1 * self.linear(x).square()], dim=1)


class SACPolicy(_SACPolicy):
    """SAC's policy with an actor that sees the first `seen` columns."""

    def __init__(self, *args: Any, seen: int, **kwargs: Any) -> None:
        self.seen = seen
        super().__init__(*args, **kwargs)

    def make_actor(self, features_extractor: BaseFeaturesExtractor | None = None) -> Actor:
        space = self.observation_space
        assert isinstance(space, spaces.Box)
        return super().make_actor(_First(space, self.seen))

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "seen": self.seen}
