"""Entry points through which other packages offer policies and commands."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

POLICIES, COMMANDS = "isd_gym.policies", "isd_gym.commands"


def plugins(group: str, name: str | None = None) -> list[EntryPoint]:
    """Return the entry points of a group, sorted by name."""
    found = {p.name: p for p in entry_points(group=group)}
    return [found[key] for key in sorted(found) if name in (None, key)]
