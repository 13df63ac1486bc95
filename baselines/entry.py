"""The baselines, offered to `isd-gym score` by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from isd_gym.driving import Entry

if TYPE_CHECKING:
    from isd_gym.cost import StageCost
    from isd_gym.network import Network


def open_policy(
    name: str, model: Network, cost: StageCost, control_step: float, options: dict[str, Any]
) -> Entry | None:
    """The baseline called `name`, or None.

    The option `preview` [s] is for those that look at the road ahead, `speed` [m/s] for those that know the rear road.
    """
    from . import CONTROLLERS, make

    if name not in CONTROLLERS:
        return None
    for option, ending in (("preview", "-preview"), ("speed", "-wheelbase")):
        if not name.endswith(ending):
            options = {k: v for k, v in options.items() if k != option}
    return Entry(name, lambda: make(name, model=model, cost=cost, control_step=control_step, **options))


def names() -> list[str]:
    from . import CONTROLLERS

    return sorted(CONTROLLERS)


def about() -> dict[str, str]:
    """What each of them is, in a line."""
    from . import ABOUT, CONTROLLERS

    return {name: ABOUT.get(name, "") for name in CONTROLLERS}


open_policy.about = about  # type: ignore[attr-defined]
open_policy.names = names  # type: ignore[attr-defined]
