"""`isd-gym reproduce`: every table and figure of the paper recomputed beside the printed values, with a verdict."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    out: Annotated[
        Path,
        typer.Option(
            "--out", help="Folder of the page and its figures.", metavar="DIR"
        ),
    ],
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Few and short episodes: a look in a minute."),
    ] = False,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", help="Write the figures to this file.", metavar="FILE"),
    ] = None,
) -> None:
    """Compare every table and figure of the paper with computed values, and list the claims that hold.

    Writes DIR/index.html (one self-contained page), the figures as SVG and DIR/reproduction.json.

    Example: isd-gym reproduce --out reproduction
    """
    from ._reproduce.page import check_target, reproduce
    from .console import check_file, progress, warm_up, write_json

    check_file(json_file)
    check_target(out)
    with progress() as update:
        warm_up(update)
        result = reproduce(out, quick, update)
    write_json(json_file, result)
    show(result)
    typer.echo(f"page: {out / 'index.html'}", err=True)


def show(result: dict[str, Any]) -> None:
    """Print the claims and the table of cars on the terminal.

    Args:
        result: Result of `reproduce`.
    """
    from rich import box
    from rich.table import Table

    from ._reproduce.page import CAR_HEADS, CLAIM_HEADS
    from .console import printer

    claims = [list(claim.values()) for claim in result["claims"]]
    for heads, rows in (CLAIM_HEADS, claims), (CAR_HEADS, result["cars"]):
        shown = Table(*heads, box=box.SIMPLE_HEAD, pad_edge=False, show_lines=True)
        for row in rows:
            shown.add_row(*row)
        printer().print(shown)
