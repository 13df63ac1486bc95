"""`isd-gym networks`: the built-in networks, as a list, as JSON or as a drawing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .._common.errors import InputError
from ._options import complete, network_names, option
from .console import check_file, print_names


def command(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Network to print as JSON: a built-in network or a model file.",
            autocompletion=complete(network_names),
        ),
    ] = None,
    draw: Annotated[
        Path | None, option("--draw FILE", "Draw the network to this file (.svg).")
    ] = None,
    elements: Annotated[
        bool,
        option(
            "--elements",
            "List the element types: law, parameters with units, and options.",
        ),
    ] = False,
) -> None:
    """List the built-in networks, print one as a start for your own, or draw one.

    The drawing shows nodes, elements with their values, inputs and outputs.

    Example: isd-gym networks quarter-car-isd --draw car.svg
    """
    from ..physics.network import Network, builtin_networks

    if elements:
        print_names(_element_types())
        return
    if draw is not None:
        from ..view.report.schematic import check_suffix
        from ..view.report.schematic import draw as sketch

        if name is None:
            raise InputError(
                "--draw wants a network: isd-gym networks NAME --draw FILE"
            )
        check_file(draw, name)
        check_suffix(draw)
        sketch(Network.load(name)).save(draw)
        typer.echo(f"{name} drawn to {draw}")
        return
    if name is not None:
        typer.echo(Network.load(name).dumps(), nl=False)
        return
    print_names(
        {built: Network.load(built).description for built in builtin_networks()}
    )


def _element_types() -> dict[str, str]:
    """Return law, parameters and options of every element type."""
    from ..physics.elements import TYPES, parameter_fields

    out = {}
    for name, kind in TYPES.items():
        parameters = [
            f"{f.name} [{f.metadata['unit']}]" for f in parameter_fields(kind)
        ]
        options = [
            f"{key} ({' or '.join(allowed)})" for key, allowed in kind.choices.items()
        ]
        out[name] = f"{kind.equation}; {', '.join([*parameters, *options])}"
    return out
