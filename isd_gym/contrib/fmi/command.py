"""`isd-gym export`: a model as an FMU for co-simulation; `isd-gym diagnose --model FILE.fmu`: the diagnosis of an FMU."""

from __future__ import annotations

import os
from collections.abc import Sized
from pathlib import Path
from typing import Annotated, Any

import typer

from isd_gym._commands._options import ModelArgument, check_channels
from isd_gym._commands.console import lines, tell


def command(
    model: ModelArgument,
    fmu: Annotated[Path, typer.Option("--fmu", help="File to write. The name ends in .fmu.", metavar="FILE")],
    step: Annotated[float, typer.Option(help="Largest physics step [s].", min=1e-6)] = 1e-3,
) -> None:
    """Export a model as an FMU for co-simulation (FMI 2.0).

    The FMU calls the kernel of this package, so Python with isd_gym must be installed where it runs. Inputs, outputs and
    parameters keep their names and units.

    Example: isd-gym export quarter-car-isd --fmu car.fmu
    """
    from isd_gym.physics.network import Network

    from .export import export_fmu

    network = Network.load(model)
    export_fmu(network, fmu, step=step)

    def number_of(things: Sized, one: str) -> str:
        return f"{len(things)} {one}{'s' if len(things) != 1 else ''}"

    tell(
        f"{number_of(network.inputs, 'input')}, {number_of(network.outputs, 'output')} and "
        f"{number_of(network.parameters, 'parameter')} of {network.name} in {fmu}"
    )


def diagnose_unit(
    model: str,
    trust: bool,
    data: list[Any],
    validate: list[Any],
    accept: list[str],
    named: dict[str, Any],
    shares: dict[str, float],
) -> Any:
    """Return the diagnosis of an FMU. Warn that compiled code runs.

    Args:
        model: File of the FMU.
        trust: Whether its compiled code may run.
        data: Files of the records.
        validate: Files of the held-out records.
        accept: Checks that the user accepts.
        named: How the files are read: columns, units, signs.
        shares: Relative uncertainty of parameters by name.

    Returns:
        The diagnosis.
    """
    from isd_gym.records.data import read_table

    from .cosimulation import WHY_TRUST, Unit
    from .identification import diagnose_unit

    if trust and os.path.exists(model):
        typer.echo(f"isd-gym: warning: {model}: {WHY_TRUST}", err=True)
    with lines() as say, Unit(model, trust=trust) as fmu:
        known = [p.name for p in (*fmu.model.inputs, *fmu.model.outputs)]
        check_channels(named["rename"].values(), ["time", *known], "--rename")
        data, validate = ([read_table(f, **named) for f in files] for files in (data, validate))
        return diagnose_unit(data, fmu, validate=validate, accept=accept, uncertainty=shares, progress=say)
