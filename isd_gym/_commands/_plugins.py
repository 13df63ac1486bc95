"""Commands of other packages: entry points `isd_gym.commands`."""

from __future__ import annotations

from .._common.plugins import COMMANDS, plugins
from ._app import FiniteCommand, app


def add_plugins() -> None:
    """Add the commands of other packages to the program. A command of the program keeps its name."""
    known = {command.name for command in app.registered_commands}
    for point in plugins(COMMANDS):
        if point.name not in known:
            app.command(name=point.name, cls=FiniteCommand)(point.load())
