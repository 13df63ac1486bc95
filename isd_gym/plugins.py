"""What packages above this one offer it, by entry points: policies, commands, references for a score.

Installed packages announce theirs as ever. Where this distribution is not installed (a source tree on the path, a zip, a
worker's folder) nobody announces its own `baselines` and `agents`: then the table below, pyproject.toml's, does.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, PackageNotFoundError, distribution, entry_points
from importlib.util import find_spec

POLICIES, COMMANDS, REFERENCES = "isd_gym.policies", "isd_gym.commands", "isd_gym.references"
OWN = {
    POLICIES: {"baselines": "baselines.entry:open_policy", "agents": "agents.entry:open_policy"},
    COMMANDS: {
        "train": "agents.cli:train",
        "convert": "agents.cli:convert",
        "reproduce": "baselines.reproduce:command",
        "ceiling": "baselines.ceiling:command",
    },
    REFERENCES: {
        "clairvoyant": "baselines.clairvoyant:reachable",
        "lq_front": "baselines.bounds:lq_front",
        "wheelbase_bound": "baselines.bounds:wheelbase_bound",
        "ceiling": "baselines.ceiling:known",
    },
}


def plugins(group: str, name: str | None = None) -> list[EntryPoint]:
    """Entry points of a group, all or those of a name, in the order of their names."""
    found = list(entry_points(group=group))
    try:
        distribution("isd-gym")
    except PackageNotFoundError:
        own = (EntryPoint(name, value, group) for name, value in OWN[group].items())
        found += [p for p in own if find_spec(p.module.partition(".")[0]) is not None]
    return sorted((p for p in found if name in (None, p.name)), key=lambda p: p.name)
