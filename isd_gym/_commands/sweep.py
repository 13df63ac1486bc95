"""`isd-gym sweep`: policies through a grid of conditions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from .._common.errors import plain
from ._columns import print_columns
from ._options import EngineOption, JobsOption
from .console import printer, progress, resumable


def command(
    grid: Annotated[
        str,
        typer.Argument(
            help="Grid of policies, conditions and roads: a TOML or JSON file, or the built-in robust."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            help="Folder of the results. Finished items in the folder are kept.",
            metavar="DIR",
        ),
    ],
    jobs: JobsOption = 1,
    which: Annotated[
        str | None,
        typer.Option(
            "--shard",
            help="Run every N-th item only: 0/8 ... 7/8 in an array of 8 jobs.",
            metavar="I/N",
        ),
    ] = None,
    engine: EngineOption = "local",
    address: Annotated[
        str | None,
        typer.Option(
            "--address", help="Address of the Ray cluster. Default: this machine."
        ),
    ] = None,
) -> None:
    """Drive policies through a grid of conditions, on many cores or machines.

    The same command continues an interrupted sweep. The table shows the change of J against the passive car for every
    condition, with a 95 % paired interval. The file is DIR/sweep.json. The exit status is 1 while
    items are missing.

    Example: isd-gym sweep grid.toml --out runs/sweep --jobs 2
    """
    from ..benchmark.sweep.conditions import check_policies, items_are, sweep
    from ..benchmark.sweep.grid import Grid

    made = Grid.load(grid)
    check_policies(made)
    with resumable(), progress() as update:
        merged, failed = sweep(
            made,
            out,
            jobs=jobs,
            which=which,
            engine=engine,
            address=address,
            progress=lambda done, every: update("items", done / every),
            say=lambda text: typer.echo(text, err=True),
        )
    _print(merged)
    if failed:
        typer.echo(f"{items_are(failed)} missing; the same line tries again", err=True)
        raise typer.Exit(1)
    if merged["missing"] and which is None:
        typer.echo(f"{items_are(merged['missing'])} missing", err=True)
        raise typer.Exit(1)


def _print(merged: Mapping[str, Any]) -> None:
    """Print the table of a merged sweep."""
    from rich.text import Text

    from ..benchmark.sweep.conditions import change_cell, items_are, rows

    names, lines = rows(merged)
    console = printer()
    # in a narrow console the interval goes on the line below
    room = 34 + sum(
        max((len(line[k + 1]) for line in lines), default=0) + 4
        for k in range(len(names))
    )
    gap = " [" if room <= console.width else "\n["
    if lines:
        console.print("change of J against passive [%]")
        print_columns(
            {"condition": [Text(plain(line[0], 60)) for line in lines]},
            {
                plain(name): [line[k].replace(" [", gap) for line in lines]
                for k, name in enumerate(names, 1)
            },
        )
    for row in merged["overall"][:1]:
        for rival, q in row["against"].items():
            console.print(
                f"{plain(row['policy'], 40)} against {plain(rival, 40)}: {change_cell(q, 'value', 2)} points of J",
                style="dim",
            )
    if merged["missing"]:
        typer.echo(f"{items_are(merged['missing'])} not there yet")
