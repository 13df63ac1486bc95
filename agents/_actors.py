"""Policies from the weights of Stable-Baselines3."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from isd_gym.agents.policy import Head, Policy

from isd_gym._common.errors import InputError, shown

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from isd_gym.agents._memory import Memory


def actor_layers(
    state: Mapping[str, np.ndarray],
) -> tuple[str, list[tuple[np.ndarray, np.ndarray]]]:
    """Return the layers of the deterministic actor in a state dict of Stable-Baselines3."""
    if "action_net.weight" in state:
        kind = "ppo"
        hidden = "mlp_extractor.policy_net."
        last = "action_net"
    elif "actor.mu.weight" in state:
        kind = "sac"
        hidden = "actor.latent_pi."
        last = "actor.mu"
    elif "actor.mu.0.weight" in state:
        kind, hidden, last = "td3", "actor.mu.", ""
    else:
        raise InputError("no MlpPolicy of PPO, SAC or TD3")
    if any(
        "features_extractor" in key and not key.startswith("critic") for key in state
    ):
        raise InputError(
            "its features extractor has weights of its own; only the flat MlpPolicy can be converted"
        )
    if any("lstm" in key for key in state):
        raise InputError(
            "its policy is recurrent; only the flat MlpPolicy can be converted"
        )
    if kind == "td3" and any(key.startswith("actor.latent_pi.") for key in state):
        raise InputError(
            "its SAC explores with gSDE, whose clipped mean is not supported; train without use_sde"
        )
    inner = [
        k.removeprefix(hidden).removesuffix(".weight")
        for k in state
        if k.startswith(hidden) and k.endswith(".weight")
    ]
    if not all(i.isascii() and i.isdecimal() and len(i) < 4 for i in inner):
        raise InputError("its layers are not numbered")
    names = [f"{hidden}{i}" for i in sorted(inner, key=int)] + ([last] if last else [])
    for name in (f"{n}.{part}" for n in names for part in ("weight", "bias")):
        if name not in state:
            raise InputError(f"{shown(name)} is missing")
    return kind, [(state[f"{n}.weight"], state[f"{n}.bias"]) for n in names]


def build(
    state: Mapping[str, np.ndarray],
    *,
    activation: str,
    memory: Memory,
    head: Head,
    high: float = 1.0,
    **options: Any,
) -> Policy:
    """Return the policy of a state dict of Stable-Baselines3."""
    kind, layers = actor_layers(state)
    if any(value.dtype.kind != "f" for layer in layers for value in layer):
        raise InputError("weights that are no floats")
    # PPO's mean is in the unit of the action, that of SAC and TD3 in [-1, 1]
    if kind == "ppo" and high != 1.0:
        layers[-1] = (layers[-1][0] / high, layers[-1][1] / high)
    return Policy(
        layers,
        memory=memory,
        head=head,
        activation=activation,
        output="clip" if kind == "ppo" else "tanh",
        **options,
    )
