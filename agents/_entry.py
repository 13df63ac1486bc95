"""Entry point of trained policies for `isd-gym score`: a shipped policy or a policy folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isd_gym._common.errors import InputError
from isd_gym.benchmark.driving import Entry
from isd_gym.benchmark.policies import available

from .policy import SHIPPED, Policy

if TYPE_CHECKING:
    from isd_gym.physics.cost import StageCost
    from isd_gym.physics.network import Network


def open_policy(
    name: str,
    model: Network,
    cost: StageCost,
    control_step: float,
    options: dict[str, Any],
) -> Entry | None:
    """Return a trained policy as an entry of a score."""
    path = Path(name)
    if path.name == "policy.json":
        path = path.parent
    elif not os.path.isfile(
        path / "policy.json"
    ):  # a known name counts before another folder of that name
        if name in names():
            path = SHIPPED / name
        elif not os.path.isdir(path) or name in available():
            return None
    policy = Policy.load(path)
    return entry_of(policy, name, model, control_step, options)


def entry_of(
    policy: Policy,
    name: str,
    model: Network,
    control_step: float,
    options: dict[str, Any],
) -> Entry:
    """Return the entry of a policy that fits the network, the control step and the preview of a score."""
    if abs(control_step - policy.memory.step) > 1e-9:
        raise InputError(
            f"policy '{name}' acts every {policy.memory.step:g} s, not every {control_step:g} s"
        )
    asked = options.get("preview")
    if asked is not None and policy.preview and abs(asked - policy.preview) > 1e-9:
        raise InputError(
            f"policy '{name}' was trained with {policy.preview:g} s of road ahead, not {asked:g} s"
        )
    policy.check(model)
    if (speed := options.get("speed")) is not None:
        policy = policy.at_speed(speed)
    return Entry(policy.name, policy.copy)


def names() -> list[str]:
    """Return the names of the shipped policies."""
    return sorted(p.parent.name for p in SHIPPED.glob("*/policy.json"))


def about() -> dict[str, str]:
    """Return one-line descriptions of the shipped policies, from their files."""
    import json

    out = {}
    for name in names():
        try:
            held = json.loads(
                (SHIPPED / name / "policy.json").read_text(encoding="utf-8")
            )
            change = held["score"]["cost"]["change"]
            car = (
                ""
                if held["env"]["id"] == "ISDSuspension-v0"
                else f" for {held['env']['id']}"
            )
            out[name] = (
                f"shipped {held['algorithm'].upper()} policy{car}, cost J {100 * change:+.1f} % against passive when it was trained"
            )
        except (OSError, ValueError, KeyError, TypeError):
            out[name] = "shipped policy"
    return out


open_policy.about = about  # type: ignore[attr-defined]
