"""`isd-gym export`: a model as an FMU for co-simulation."""

from __future__ import annotations

from collections.abc import Sized
from pathlib import Path
from typing import Annotated

import typer

from ._options import ModelArgument
from .console import tell


def command(
    model: ModelArgument,
    fmu: Annotated[
        Path,
        typer.Option(
            "--fmu", help="File to write. The name ends in .fmu.", metavar="FILE"
        ),
    ],
    step: Annotated[
        float, typer.Option(help="Largest physics step [s].", min=1e-6)
    ] = 1e-3,
) -> None:
    """Export a model as an FMU for co-simulation (FMI 2.0).

    The FMU calls the kernel of this package, so Python with isd_gym must be installed where it runs. Inputs, outputs and
    parameters keep their names and units.

    Example: isd-gym export quarter-car-isd --fmu car.fmu
    """
    from ..physics.fmu import export_fmu
    from ..physics.network import Network

    network = Network.load(model)
    export_fmu(network, fmu, step=step)

    def number_of(things: Sized, one: str) -> str:
        return f"{len(things)} {one}{'s' if len(things) != 1 else ''}"

    tell(
        f"{number_of(network.inputs, 'input')}, {number_of(network.outputs, 'output')} and "
        f"{number_of(network.parameters, 'parameter')} of {network.name} in {fmu}"
    )
