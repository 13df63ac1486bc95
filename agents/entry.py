"""Trained policies, offered to `isd-gym score`: a shipped name (ppo, sac), a policy folder, or a .zip."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from isd_gym.cost import StageCost
from isd_gym.network import Network
from isd_gym.scoring import Entry

SHIPPED = Path(__file__).parent / "policies"


def names() -> list[str]:
    """Names of the shipped policies."""
    return sorted(p.name for p in SHIPPED.iterdir() if p.is_dir()) if SHIPPED.is_dir() else []


def open_policy(
    name: str, model: Network, cost: StageCost, control_step: float, options: dict[str, Any]
) -> Entry | None:
    """The trained policy called `name` or lying there, or None."""
    path = SHIPPED / name if name in names() else Path(name)
    if not (path.is_dir() or path.suffix == ".zip"):
        return None
    from .policy import load

    loaded = load(path)
    return Entry(name, lambda: loaded.copy())


open_policy.names = names  # type: ignore[attr-defined]
