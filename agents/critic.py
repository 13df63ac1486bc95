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


class Bilinear(nn.Module):
    """``[s s', s (W r), hidden(x)]``: products of the state's columns s, with each other and with the road ahead r.

    What a linear car's future costs is a sum of just these, so that the critic is nearly linear in what it learns.
    """

    def __init__(self, inputs: int, seen: int, core: list[int], width: int) -> None:
        super().__init__()
        self.seen, self.core, k = seen, core, len(core)
        self.register_buffer("pairs", torch.triu_indices(k, k), persistent=False)
        self.cross = nn.Linear(max(inputs - seen, 1), k)
        self.road = inputs > seen
        self.hidden = nn.Sequential(nn.Linear(inputs, width), nn.Tanh())
        self.width = k * (k + 1) // 2 + 2 * k + width

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        s = x[:, self.core]
        road = x[:, self.seen :] if self.road else torch.zeros_like(x[:, :1])
        pairs: Any = self.pairs
        return torch.cat(
            [0.3 * s[:, pairs[0]] * s[:, pairs[1]], s, s * self.cross(road), self.hidden(x)], dim=1
        )


class Adam(torch.optim.Adam):
    """Adam whose parameter groups may have a `factor` on the learning rate, which Stable-Baselines3 sets for all alike."""

    def step(self, closure: Any = None) -> Any:
        rates = [group["lr"] for group in self.param_groups]
        for group in self.param_groups:
            group["lr"] *= group.get("factor", 1.0)
        out = super().step(closure)
        for group, rate in zip(self.param_groups, rates, strict=True):
            group["lr"] = rate
        return out


class _Two(nn.Module):
    """Actor's and critic's networks, as `ActorCriticPolicy` wants them."""

    def __init__(self, inputs: int, seen: int, core: list[int], actor: list[int], critic: int) -> None:
        super().__init__()
        self.seen = seen
        layers: list[nn.Module] = []
        for a, b in zip([seen, *actor], actor, strict=False):
            layers += [nn.Linear(a, b), nn.Tanh()]
        self.policy_net = nn.Sequential(*layers)
        self.value_net = Bilinear(inputs, seen, core, critic) if core else Squares(inputs, critic)
        self.latent_dim_pi, self.latent_dim_vf = actor[-1], self.value_net.width

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.forward_actor(x), self.forward_critic(x)

    def forward_actor(self, x: torch.Tensor) -> torch.Tensor:
        return self.policy_net(x[:, : self.seen])

    def forward_critic(self, x: torch.Tensor) -> torch.Tensor:
        return self.value_net(x)


class PPOPolicy(ActorCriticPolicy):
    """`ActorCriticPolicy` with the critic above; net_arch: {"pi": [...], "vf": [width]}."""

    def __init__(
        self, *args: Any, seen: int, core: list[int] | None = None, critic_rate: float = 1.0, **kwargs: Any
    ) -> None:
        self.seen, self.core, self.critic_rate = seen, list(core or []), critic_rate
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        arch: Any = self.net_arch
        self.mlp_extractor = _Two(self.features_dim, self.seen, self.core, arch["pi"], arch["vf"][0])  # type: ignore[assignment]

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        critic = [*self.mlp_extractor.value_net.parameters(), *self.value_net.parameters()]
        own = {id(p) for p in critic}
        actor = [p for p in self.parameters() if id(p) not in own]
        groups: list[dict[str, Any]] = [{"params": actor}, {"params": critic, "factor": self.critic_rate}]
        self.optimizer = Adam(groups, lr=lr_schedule(1), eps=1e-6)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        own = dict(seen=self.seen, core=self.core, critic_rate=self.critic_rate)
        return {**super()._get_constructor_parameters(), **own}


class First(BaseFeaturesExtractor):
    """The first columns."""

    def __init__(self, space: spaces.Box, seen: int) -> None:
        super().__init__(space, seen)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x[:, : self.features_dim]
