"""Entry points through which packages offer policies, commands and reference scores.

Installed packages announce entry points as usual. In a source tree, a zip archive or a worker's folder the
distribution is not installed; the table below, a copy of the one in pyproject.toml, then announces
`baselines` and `agents`.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, PackageNotFoundError, distribution, entry_points
from importlib.util import find_spec
from typing import Any

from .errors import InputError

POLICIES, COMMANDS, REFERENCES = "isd_gym.policies", "isd_gym.commands", "isd_gym.references"
#: parts of `isd_gym.contrib` that a command of the core reaches by name
WINGS = "isd_gym.wings"
OWN = {
    POLICIES: {
        "baselines": "isd_gym.baselines.entry:open_policy",
        "agents": "isd_gym.agents.entry:open_policy",
    },
    COMMANDS: {
        "train": "isd_gym.agents.cli:train",
        "convert": "isd_gym.contrib.exports.command:command",
        "export": "isd_gym.contrib.fmi.command:command",
        "plan": "isd_gym.contrib.forecast.command:command",
        "record": "isd_gym.contrib.minari.command:command",
        "sweep": "isd_gym.contrib.sweep.command:command",
        "reproduce": "isd_gym.contrib.reproduce:command",
        "ceiling": "isd_gym.contrib.ceilings.ceiling:command",
    },
    REFERENCES: {
        "clairvoyant": "isd_gym.contrib.ceilings.clairvoyant:reachable",
        "lq_front": "isd_gym.contrib.ceilings.bounds:lq_front",
        "wheelbase_bound": "isd_gym.contrib.ceilings.bounds:wheelbase_bound",
        "ceiling": "isd_gym.contrib.ceilings.ceiling:known",
    },
    WINGS: {
        "fleet": "isd_gym.contrib.fleet.command",
        "fmi": "isd_gym.contrib.fmi.command",
        "hub": "isd_gym.contrib.hub",
        "no_road": "isd_gym.contrib.no_road.command",
    },
}


def plugins(group: str, name: str | None = None) -> list[EntryPoint]:
    """Return the entry points of a group, sorted by name.

    Args:
        group: `POLICIES`, `COMMANDS`, `REFERENCES` or `WINGS`.
        name: Name of one entry point; None for all.

    Returns:
        Entry points, possibly none.
    """
    found = list(entry_points(group=group))
    try:
        distribution("isd-gym")
    except PackageNotFoundError:
        own = (EntryPoint(name, value, group) for name, value in OWN[group].items())
        found += [p for p in own if find_spec(".".join(p.module.split(".")[:2])) is not None]
    return sorted((p for p in found if name in (None, p.name)), key=lambda p: p.name)


def wing(name: str) -> Any:
    """Import a part of the package outside its core.

    Args:
        name: Name of an entry point `WINGS`.

    Returns:
        The module.

    Raises:
        InputError: The installation has no such part.
    """
    for point in plugins(WINGS, name):
        return point.load()
    raise InputError(f"this installation has no '{name}': it lacks isd_gym.contrib.{name}")
