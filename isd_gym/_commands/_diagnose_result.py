"""Results of a diagnosis: the files, and the summary on the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from .._common.errors import ReportError, plain
from .console import printer, write_json


def write_result(result: Any, out: Path, about: dict[str, str]) -> Path | ReportError:
    """Write results and report to `out`. Return the page, or the error where the page could not be drawn."""
    from ..view.report import write_report

    try:
        return write_report(result, out, about=about)
    except ReportError as error:
        return error


def print_page(page: Path | ReportError, what: str) -> None:
    """Print the path of the page. Without a page, print the error and exit with status 1."""
    if isinstance(page, ReportError):
        typer.echo(f"isd-gym: {page}", err=True)
        raise typer.Exit(1)
    typer.echo(f"{what}: {page}", err=True)


def print_diagnosis(
    result: Any, json_file: Path | None, page: Path | ReportError
) -> None:
    """Print summary, clock lags and remaining errors of a diagnosis; write its JSON file."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    console = printer()
    console.print(result.summary)
    for lag in getattr(result, "lags", ()):
        console.print(plain(str(lag), 200))
    stages = [s for s in ("before", "refit", "after", "noise_floor") if s in result.gap]
    console.print(
        "\nRMS error on held-out data, relative to the measured signal's deviation:"
    )
    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    made.add_column("channel", no_wrap=True)
    for stage in stages:
        made.add_column(stage.replace("_", " "), justify="right", no_wrap=True)
    for channel in result.gap["refit"]:
        made.add_row(
            Text(plain(channel, 40)),
            *(f"{100 * result.gap[s][channel]:.1f} %" for s in stages),
        )
    console.print(made)
    if result.closed is not None and result.closed >= 0:
        console.print(
            f"{100 * result.closed:.1f} % of the squared error beyond noise is removed."
        )
    write_json(json_file, result.to_dict())
    print_page(page, "report")
