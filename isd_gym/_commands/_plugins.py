"""Commands of other packages: entry points `isd_gym.commands`."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path

from .._common.plugins import COMMANDS, plugins
from ._app import FiniteCommand, app

#: names of the commands that are plugins
_added: set[str] = set()


def add_plugins() -> None:
    """Add the commands of other packages (train, reproduce, ...) to the program. A command of the program keeps its name."""
    typed = os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS")  # a shell that completes
    words = typed.split()[1:] if typed else sys.argv[1:]
    wanted = next((a for a in words if not a.startswith("-")), None)
    own = {command.name for command in app.registered_commands} - _added
    for point in plugins(COMMANDS):
        if point.name in own:
            continue
        _added.add(point.name)
        # a command that does not run is not imported: --help and "did you mean" need its name and first sentence alone
        app.command(name=point.name, cls=FiniteCommand)(
            point.load() if point.name == wanted else _mention(point)
        )


def _mention(point: EntryPoint) -> Callable[[], None]:
    """Return a stand-in with the docstring of a command, read from the source without an import."""
    import ast
    from importlib.util import find_spec

    def stand_in() -> None: ...

    package, *parts = point.module.split(".")
    try:
        spec = find_spec(package)  # a top-level package: no code of it runs
        folder = Path(((spec and spec.submodule_search_locations) or [""])[0])
        module = folder.joinpath(*parts)
        source = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
        tree = ast.parse(source.read_text(encoding="utf-8"))
        found = [f for f in tree.body if isinstance(f, ast.FunctionDef) and f.name == point.attr]
        stand_in.__doc__ = ast.get_docstring(found[0])
    except (OSError, ValueError, SyntaxError, IndexError):
        stand_in.__doc__ = f"Of {point.module}."
    return stand_in
