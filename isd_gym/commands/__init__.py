"""The program `isd-gym`: one module per command, with the function `command`. Private modules hold what commands share.

Heavy imports wait until a command runs, so that ``--help`` answers at once.
"""

from __future__ import annotations

from . import (
    card,
    diagnose,
    export,
    inspect,
    networks,
    plan,
    policies,
    record,
    score,
    show,
    simulate,
    sweep,
    warm,
)
from ._app import SeveralValuesCommand, app
from ._main import main

__all__ = ["app", "main"]

app.command(name="score")(score.command)
app.command(name="show")(show.command)
app.command(name="policies")(policies.command)
app.command(name="card")(card.command)
app.command(name="sweep")(sweep.command)
app.command(name="record")(record.command)
app.command(name="networks")(networks.command)
app.command(name="simulate")(simulate.command)
app.command(name="export")(export.command)
app.command(name="inspect")(inspect.command)
app.command(name="diagnose", cls=SeveralValuesCommand)(diagnose.command)
app.command(name="plan")(plan.command)
app.command(name="warm")(warm.command)
