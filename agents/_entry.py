"""Entry point of trained policies for `isd-gym score`: a shipped policy, a policy folder or an archive of Stable-Baselines3."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isd_gym._common.errors import InputError
from isd_gym.benchmark.driving import Entry

from .policy import SHIPPED, Policy

if TYPE_CHECKING:
    from isd_gym.physics.cost import StageCost
    from isd_gym.physics.network import Network


def open_policy(
    name: str, model: Network, cost: StageCost, control_step: float, options: dict[str, Any]
) -> Entry | None:
    """Return a trained policy as an entry of a score.

    Args:
        name: Name of a shipped policy, a policy folder, or a .zip file.
        model: Network of the score.
        cost: Without effect.
        control_step: Control step [s].
        options: `preview` [s], which must agree with the policy's; `trained`, options of the training of an
            archive (`_convert.trained_options`).

    Returns:
        The entry; None for other names.

    Raises:
        InputError: The policy cannot be read, or does not fit the network, the control step or the preview.
    """
    path = Path(name)
    if path.suffix.lower() == ".zip":
        from ._convert import convert, trained_options

        given: dict[str, Any] = dict(trained_options(options["trained"]) if options.get("trained") else {})
        first = convert(path, network=model, **given)
        if "normalisation" in first.info and "normalize" not in given:
            print(f"{name}: normalised by '{first.info['normalisation']}' beside it", file=sys.stderr)
    elif name in names() or os.path.isdir(path) or path.name == "policy.json":
        first = Policy.load(path.parent if path.name == "policy.json" else path)
    else:
        return None
    if abs(control_step - first.memory.step) > 1e-9:
        raise InputError(f"policy '{name}' acts every {first.memory.step:g} s, not every {control_step:g} s")
    asked = options.get("preview")
    if asked is not None and first.preview and abs(asked - first.preview) > 1e-9:
        raise InputError(
            f"policy '{name}' was trained with {first.preview:g} s of road ahead, not {asked:g} s"
        )
    first.check(model)
    if (speed := options.get("speed")) is not None:
        first = first.at_speed(speed)
    return Entry(first.name, first.copy)


def names() -> list[str]:
    """Return the names of the shipped policies.

    Returns:
        Names, sorted.
    """
    return sorted(p.parent.name for p in SHIPPED.glob("*/policy.json"))


def about() -> dict[str, str]:
    """Return one-line descriptions of the shipped policies, from their files.

    Returns:
        Description by name.
    """
    import json

    out = {}
    for name in names():
        try:
            held = json.loads((SHIPPED / name / "policy.json").read_text(encoding="utf-8"))
            change = held["score"]["cost"]["change"]
            car = "" if held["env"]["id"] == "ISDSuspension-v0" else f" for {held['env']['id']}"
            out[name] = (
                f"shipped {held['algorithm'].upper()} policy{car}, cost J {100 * change:+.1f} % against passive when it was trained"
            )
        except (OSError, ValueError, KeyError, TypeError):
            out[name] = "shipped policy"
    return out


open_policy.about = about  # type: ignore[attr-defined]
open_policy.names = names  # type: ignore[attr-defined]
