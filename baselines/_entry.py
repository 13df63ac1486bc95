"""Entry point of the baselines for `isd-gym score`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from isd_gym.benchmark.driving import Entry

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
    """Return a baseline as an entry of a score."""
    from . import CONTROLLERS, make

    if name not in CONTROLLERS:
        return None
    for option, endings in (
        ("preview", ("-preview",)),
        ("speed", ("-wheelbase", "-preview")),
    ):
        if not name.endswith(endings):
            options = {k: v for k, v in options.items() if k != option}
    return Entry(
        name,
        lambda: make(
            name, model=model, cost=cost, control_step=control_step, **options
        ),
    )


def about() -> dict[str, str]:
    """Return one-line descriptions of the baselines."""
    from . import ABOUT, CONTROLLERS

    return {name: ABOUT.get(name, "") for name in CONTROLLERS}


open_policy.about = about  # type: ignore[attr-defined]
