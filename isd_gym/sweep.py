"""Public path of `isd_gym.benchmark.sweep`: sweeps over a grid of conditions; stored items name this module."""

from .benchmark.sweep import (
    COMMANDS,
    FOLDER,
    RESAMPLES,
    change_cell,
    check_policies,
    drive_item,
    items_are,
    merge,
    overall,
    rows,
    sweep,
    table,
)

__all__ = [
    "COMMANDS",
    "FOLDER",
    "RESAMPLES",
    "change_cell",
    "check_policies",
    "drive_item",
    "items_are",
    "merge",
    "overall",
    "rows",
    "sweep",
    "table",
]
