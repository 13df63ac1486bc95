"""The program `isd-gym`: one module per command, with the function `command`. Private modules hold what commands share.

Heavy imports wait until a command runs, so that ``--help`` answers at once.
"""

from __future__ import annotations

from . import (
    card,
    convert,
    diagnose,
    export,
    inspect,
    networks,
    policies,
    reproduce,
    score,
    show,
    simulate,
    sweep,
    train,
    warm,
)
from ._app import FiniteCommand, SeveralValuesCommand, app
from ._main import main

__all__ = ["app", "main"]

for _name, _command in (
    ("score", score.command),
    ("show", show.command),
    ("policies", policies.command),
    ("card", card.command),
    ("networks", networks.command),
    ("diagnose", diagnose.command),
    ("inspect", inspect.command),
    ("simulate", simulate.command),
    ("sweep", sweep.command),
    ("train", train.command),
    ("convert", convert.command),
    ("export", export.command),
    ("reproduce", reproduce.command),
    ("warm", warm.command),
):
    app.command(
        name=_name, cls=SeveralValuesCommand if _name == "diagnose" else FiniteCommand
    )(_command)
