"""Entry points through which packages offer policies, commands and readers of files.

Installed packages announce entry points as usual. The table below, a copy of the one in pyproject.toml, counts
where the distribution is not installed (a source tree, a zip archive, a worker's folder), or is an older one.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any

from .errors import InputError

POLICIES, COMMANDS = "isd_gym.policies", "isd_gym.commands"
#: formats of tables by suffix
READERS = "isd_gym.readers"
#: parts of `isd_gym.contrib` that the core reaches by name
WINGS = "isd_gym.wings"
OWN = {
    POLICIES: {
        "baselines": "isd_gym.baselines._entry:open_policy",
        "agents": "isd_gym.agents._entry:open_policy",
        "archives": "isd_gym.contrib.exports.archives:open_policy",
    },
    COMMANDS: {
        "train": "isd_gym.contrib.training.command:train",
        "convert": "isd_gym.contrib.exports.command:command",
        "export": "isd_gym.contrib.fmi.command:command",
        "inspect": "isd_gym.contrib.inspection.command:command",
        "record": "isd_gym.contrib.minari.command:command",
        "simulate": "isd_gym.contrib.simulation.command:command",
        "sweep": "isd_gym.contrib.sweep.command:command",
        "reproduce": "isd_gym.contrib.reproduce:command",
        "warm": "isd_gym.contrib.warming.command:command",
    },
    READERS: {
        "lvm": "isd_gym.contrib.bench_files.entry:lvm",
        "mat73": "isd_gym.contrib.bench_files.entry:mat73",
        "tdms": "isd_gym.contrib.bench_files.entry:tdms",
        "uff": "isd_gym.contrib.bench_files.entry:uff",
        "unv": "isd_gym.contrib.bench_files.entry:uff",
        "xlsx": "isd_gym.contrib.bench_files.entry:xlsx",
    },
    WINGS: {
        "bench_files": "isd_gym.contrib.bench_files.writing",
        "own_controllers": "isd_gym.contrib.own_controllers",
    },
}


def plugins(group: str, name: str | None = None) -> list[EntryPoint]:
    """Return the entry points of a group, sorted by name."""
    found = {
        p.name: p
        for p in (EntryPoint(own, value, group) for own, value in OWN[group].items())
        if find_spec(".".join(p.module.split(".")[:2])) is not None
    }
    found |= {p.name: p for p in entry_points(group=group) if p.name not in found}
    return [found[key] for key in sorted(found) if name in (None, key)]


def find_wing(name: str) -> Any:
    """Import a part of the package outside its core; None where the installation lacks the part."""
    return next((point.load() for point in plugins(WINGS, name)), None)


def wing(name: str) -> Any:
    """Import a part of the package outside its core."""
    if (found := find_wing(name)) is None:
        raise InputError(f"this installation has no '{name}': it lacks isd_gym.contrib.{name}")
    return found
