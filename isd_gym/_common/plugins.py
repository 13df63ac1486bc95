"""Entry points through which other packages offer policies."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

POLICIES = "isd_gym.policies"


def plugins(group: str) -> list[EntryPoint]:
    """Return the entry points of a group, sorted by name."""
    found = {p.name: p for p in entry_points(group=group)}
    return [found[key] for key in sorted(found)]
