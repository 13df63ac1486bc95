"""`isd-gym reproduce`: every table and figure of the paper recomputed beside the printed values, with a verdict.

Each section is a function of a `Study` (shared results) that returns a `Section` with tables, pictures and
sentences, in one file each. All numbers in sentences are computed; none is copied from an earlier run.
"""

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

    Writes DIR/index.html (one self-contained page), the figures as PNG and DIR/reproduction.json.

    Example: isd-gym reproduce --out reproduction
    """
    from .._common.files import check_folder
    from ._reproduce.page import plain, reproduce
    from ._reproduce.study import KIND, PARTS
    from .console import check_file, progress, warm_up, write_json

    check_file(json_file)
    check_folder(out, KIND, "reproduction.json", PARTS)
    with progress() as update:
        warm_up(update)
        result = reproduce(out, quick, update)
    write_json(json_file, plain(result))
    show(result)
    typer.echo(f"page: {out / 'index.html'}", err=True)


def show(result: dict[str, Any]) -> None:
    """Print the claims and the tables on the terminal.

    Args:
        result: Result of `reproduce`.
    """
    from rich import box
    from rich.table import Table as Rich

    from .console import printer

    console = printer()
    console.print(result["lead"])
    for table in result["tables"]:
        shown = Rich(title=table["title"] or table["section"], box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False,
                     show_lines=table["section"] == "The claims")  # fmt: skip
        words = max((len(c) for row in table["rows"] for c in row), default=0) > 40
        for i, head in enumerate(table["heads"]):
            shown.add_column(
                head, justify="left" if i == 0 or words else "right", overflow="fold"
            )
        for row in table["rows"]:
            shown.add_row(*row)
        console.print(shown)
