"""Entry points through which packages offer policies, commands and reference scores.

Installed packages announce entry points as usual. In a source tree, a zip archive or a worker's folder the
distribution is not installed; the table below, a copy of the one in pyproject.toml, then announces
`baselines` and `agents`.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, PackageNotFoundError, distribution, entry_points
from importlib.util import find_spec

POLICIES, COMMANDS, REFERENCES = "isd_gym.policies", "isd_gym.commands", "isd_gym.references"
OWN = {
    POLICIES: {
        "baselines": "isd_gym.baselines.entry:open_policy",
        "agents": "isd_gym.agents.entry:open_policy",
    },
    COMMANDS: {
        "train": "isd_gym.agents.cli:train",
        "convert": "isd_gym.agents.cli:convert",
        "reproduce": "isd_gym.baselines.reproduce:command",
        "ceiling": "isd_gym.baselines.ceiling:command",
    },
    REFERENCES: {
        "clairvoyant": "isd_gym.baselines.clairvoyant:reachable",
        "lq_front": "isd_gym.baselines.bounds:lq_front",
        "wheelbase_bound": "isd_gym.baselines.bounds:wheelbase_bound",
        "ceiling": "isd_gym.baselines.ceiling:known",
    },
}


def plugins(group: str, name: str | None = None) -> list[EntryPoint]:
    """Return the entry points of a group, sorted by name.

    Args:
        group: `POLICIES`, `COMMANDS` or `REFERENCES`.
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
