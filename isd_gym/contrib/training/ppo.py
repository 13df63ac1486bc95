"""Parts of PPO for Stable-Baselines3: advantages relative to a group of cars, and no critic.

The reward of the next second depends on the coming road far more than on one action. Cars of a group drive on
the same road with separate exploration, so that the common effect of the road cancels in their difference (a
group's mean as baseline, as in GRPO: Shao et al., 2024, here at every step). The rewards of the other cars do
not depend on a car's own actions, so that the gradient is unbiased. A critic was worse than none: near the
optimum its errors, small relative to the values, exceeded the remaining gradient, and had another direction
(docs/explanation/study.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import RolloutBufferSamples

from isd_gym._common.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Generator


class PPOPolicy(ActorCriticPolicy):
    """`ActorCriticPolicy` with zero values, which stay zero if the loss excludes values."""

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        for parameter in self.value_net.parameters():
            torch.nn.init.zeros_(parameter)


class GroupBuffer(RolloutBuffer):
    """Rollout buffer whose advantages are discounted future rewards minus their mean over the cars on the same road.

    The last `tail` steps of a rollout only complete the returns of earlier steps, and are not learned from.

    Args:
        args: Arguments of `RolloutBuffer`.
        group: Number of consecutive cars on one road.
        tail: Number of steps at the end of a rollout.
        kwargs: Arguments of `RolloutBuffer` by name.

    Raises:
        InputError: The tail is negative or not shorter than the rollout.
    """

    def __init__(self, *args: Any, group: int = 1, tail: int = 0, **kwargs: Any) -> None:
        self.group, self.tail = group, tail
        super().__init__(*args, **kwargs)
        if not 0 <= tail < self.buffer_size:
            raise InputError(
                f"the tail of {tail} steps must be shorter than the horizon of {self.buffer_size}"
            )

    def compute_returns_and_advantage(self, last_values: torch.Tensor, dones: np.ndarray) -> None:
        # no critic: `last_values` has no effect
        grouped = self.rewards.reshape(self.buffer_size, -1, self.group)
        relative = (grouped - grouped.mean(axis=2, keepdims=True)).reshape(self.rewards.shape)
        follows = np.append(self.episode_starts[1:], dones[None].astype(np.float32), axis=0)
        keep = np.float32(self.gamma) * (1.0 - follows)
        ahead = np.zeros(self.n_envs, np.float32)
        for k in range(self.buffer_size - 1, -1, -1):
            self.advantages[k] = ahead = relative[k] + keep[k] * ahead
        self.returns = self.advantages

    def get(self, batch_size: int | None = None) -> Generator[RolloutBufferSamples, None, None]:
        # whole groups: contiguous rows are faster than single rows
        steps = self.buffer_size - self.tail
        total = steps * self.n_envs // self.group
        data = (self.observations, self.actions, self.values, self.log_probs, self.advantages, self.returns)
        blocks = [array[:steps].reshape(total, self.group, *array.shape[2:]) for array in data]
        order = np.random.permutation(total)  # noqa: NPY002 (seeded by SB3)
        count = max((batch_size or total * self.group) // self.group, 1)
        for begin in range(0, total, count):
            chosen = order[begin : begin + count]
            rows = [block[chosen].reshape(-1, *block.shape[2:]) for block in blocks]
            yield RolloutBufferSamples(*(torch.from_numpy(r) for r in rows))
