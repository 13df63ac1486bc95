"""Warm start: the learner first imitates a baseline, and its critic learns the baseline's value.

Without a teacher, the learners of Stable-Baselines3 need most of their steps to find the linear-quadratic
law. The teacher has the same observation as the policy, drives with added noise, and is not used afterwards:
a trained policy is only a network.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

if TYPE_CHECKING:
    from collections.abc import Callable

    from isd_gym.agents.policy import Head
    from isd_gym.benchmark.driving import Entry

    from .settings import PPOSettings, SACSettings

FORGET = 200  # steps at the start of an episode, from rest, with little information
NOISE = 0.5  # noise relative to the demonstrated increments, so that recovery is demonstrated, too


def _demonstrate(
    env: Any,
    entry: Entry,
    steps: int,
    gamma: float,
    rng: np.random.Generator,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, torch.Tensor]:
    """Return a shuffled demonstration of a teacher over a number of control steps.

    Tensors of n samples: `features` (n, width); `wanted` (n, currents), the teacher's actions in [-1, 1]; `done`
    (n, currents), the actions with noise; `value` (n, 1), the discounted scaled future rewards.
    """
    teacher: Any = entry.make()
    teacher.reset_batch(env.num_envs)
    features = env.reset()
    seen, wanted, done, rewards = [], [], [], []
    for k in range(steps):
        if k % 50 == 0:
            progress(k / steps)
        present = env.present
        commanded = np.asarray(teacher.act_batch(env.observations), np.float32)
        share = _share(env.head, commanded.reshape(present.shape), present)
        noisy = np.clip(share + NOISE * rng.standard_normal(share.shape, np.float32), -1.0, 1.0)
        seen.append(features)
        wanted.append(share)
        done.append(noisy)
        features, reward, _, _ = env.step(noisy)
        rewards.append(reward)
    value = np.zeros((steps, env.num_envs, 1), np.float32)
    tail = np.zeros(env.num_envs, np.float32)
    for k in range(steps - 1, -1, -1):
        tail = rewards[k] + np.float32(gamma) * tail
        value[k, :, 0] = tail
    # the last values lack rewards beyond the end: a few time constants are omitted
    last = steps - min(round(4 / (1 - gamma)), steps // 2)
    kept = slice(min(FORGET, last // 2), last)
    arrays = dict(features=np.array(seen), wanted=np.array(wanted), done=np.array(done), value=value)
    flat = {k: v[kept].reshape(-1, v.shape[-1]) for k, v in arrays.items()}
    order = rng.permutation(len(flat["value"]))
    return {k: torch.from_numpy(np.ascontiguousarray(v[order])) for k, v in flat.items()}


def _share(head: Head, current: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Return the output in [-1, 1] that commands given currents (count, currents) [A], as nearly as possible; zero for a residual."""
    if head.mode == "residual":
        return np.zeros_like(current)
    if head.mode == "target":
        return np.clip(current / np.float32(head.limit), -1.0, 1.0)
    return np.clip((current - present) / np.float32(head.slew), -1.0, 1.0)


def warm_start(
    model: Any,
    env: Any,
    entry: Entry,
    settings: PPOSettings | SACSettings,
    seed: int,
    progress: Callable[[float], None] = lambda share: None,
) -> None:
    """Fit actor and critic of a learner to a teacher's demonstration.

    Args:
        model: PPO or SAC of Stable-Baselines3.
        env: Training environment (`Remember`).
        entry: The teacher.
        settings: Settings of the algorithm.
        seed: Seed of the noise.
        progress: Called with the finished share.
    """
    rng = np.random.default_rng(seed)
    env.seed(seed)
    data = _demonstrate(
        env, entry, settings.warm_steps, settings.gamma, rng, lambda share: progress(0.5 * share)
    )
    policy = model.policy
    sac = hasattr(policy, "critic")
    parameters = [*policy.actor.parameters(), *policy.critic.parameters()] if sac else [*policy.parameters()]
    if sac:
        with torch.no_grad():
            policy.actor.log_std.weight.zero_()
            policy.actor.log_std.bias.fill_(settings.log_std)
    optimizer = torch.optim.Adam(parameters, 2e-3)
    for k in range(settings.warm_updates):
        if k % 20 == 0:
            progress(0.5 + 0.5 * k / settings.warm_updates)
        for group in optimizer.param_groups:
            group["lr"] = 2e-3 * (1 - k / settings.warm_updates) + 1e-5
        rows = torch.from_numpy(rng.integers(len(data["value"]), size=2048))
        x, wanted, done, value = (data[key][rows] for key in ("features", "wanted", "done", "value"))
        if sac:
            share = torch.tanh(policy.actor.mu(policy.actor.latent_pi(x[:, : env.seen])))
            values = policy.critic(x, done)
        else:
            mean = policy.action_net(policy.mlp_extractor.forward_actor(x))
            share, values = mean.clamp(-1.0, 1.0) + 0.01 * mean, ()
        loss = ((share - wanted) ** 2).mean() + sum(((v - value) ** 2).mean() for v in values)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    progress(1.0)
    if sac:
        policy.critic_target.load_state_dict(policy.critic.state_dict())
