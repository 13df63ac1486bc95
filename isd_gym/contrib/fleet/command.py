"""`isd-gym diagnose FOLDER`: every case of a folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from isd_gym._commands._diagnose_result import print_page
from isd_gym._commands.console import write_json
from isd_gym._common.errors import ReportError
from isd_gym.contrib.progress import counted, resumable, terminal_columns

from .cases import case_itself, check, fleet, write_page
from .cases import lines as told

__all__ = ["case_itself", "diagnose_fleet"]


def diagnose_fleet(
    folder: Path,
    out: Path,
    model: str | None,
    options: dict[str, Any],
    jobs: int,
    engine: str,
    json_file: Path | None,
) -> None:
    """Diagnose every case of a folder; write and print the table. Exit with status 1 where a case has no result.

    Args:
        folder: Folder of the cases.
        out: Folder of the results.
        model: Model of cases without one of their own; None for none.
        options: Options of every diagnosis: map, accept, seed, max_lag [s].
        jobs: Number of processes.
        engine: Engine that runs them.
        json_file: File of the merged result; None for none.
    """

    check(folder, out)
    with resumable(), counted("cases") as update:
        merged, outcome = fleet(
            folder,
            out,
            model,
            options=options,
            jobs=jobs,
            engine=engine,
            progress=update,
            say=lambda line: typer.echo(line, err=True),
        )
    write_json(json_file, merged)
    for line in told(merged, min(max(60, terminal_columns()), 140)):
        typer.echo(line)
    try:
        page: Path | ReportError = write_page(merged, out)
    except ReportError as error:
        page = error
    print_page(page, "page")
    if outcome.failed:
        raise typer.Exit(1)
