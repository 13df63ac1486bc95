"""Diagnoses beside that of one network: without a measured road, of a folder of cases, of an FMU."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import typer

from ..console import counted, lines, resumable, terminal_columns, write_json
from ..errors import ReportError, plain
from ._diagnose_result import print_page
from ._options import check_channels


def identify_without_road(
    data: list[Path],
    network: Any,
    road: str,
    accept: list[str],
    options: dict[str, Any],
    max_seconds: float | None,
    out: Path,
    json_file: Path | None,
) -> None:
    """Refit a model by its likelihood, without the measured road; write and print the result."""
    from ..discrepancy.unknown_input import FOLDER, MAX_SECONDS, identify
    from ..files import check_folder
    from ..loggers.record_reading import outputs_of, records_of

    check_folder(out, *FOLDER)
    logged = set.intersection(
        *(
            set(outputs_of(f, network, options.get("by"), options.get("rename"), options["columns"]))
            for f in data
        )
    )
    absent = [c.name for c in network.outputs if c.name not in logged]
    if absent and logged:
        typer.echo(f"not in the records, left out: {', '.join(plain(n, 40) for n in absent)}", err=True)
        network = network.with_outputs(logged)
    wanted = [c for c in (*network.inputs, *network.outputs) if c.name != road]
    with lines() as say:
        records = [r for f in data for r in records_of(f, network, wanted, **options)]
        say(f"{len(records)} record(s) without {plain(road, 40)}: refitting the model in the likelihood")
        found = identify(
            records,
            network,
            road=road,
            accept=accept,
            max_seconds=max_seconds or MAX_SECONDS,
        )
    found.save(out)
    write_json(json_file, found.to_dict())
    for line in found.lines():
        typer.echo(line)


def diagnose_fleet(
    folder: Path,
    out: Path,
    model: str | None,
    options: dict[str, Any],
    jobs: int,
    engine: str,
    json_file: Path | None,
) -> None:
    """Diagnose every case of a folder; write and print the table. Exit with status 1 where a case has no result."""
    from ..fleet import check, fleet, write_page
    from ..fleet import lines as told

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


def diagnose_unit(
    model: str,
    trust: bool,
    data: list[Any],
    validate: list[Any],
    accept: list[str],
    named: dict[str, Any],
    shares: dict[str, float],
) -> Any:
    """Return the diagnosis of an FMU. Warn that compiled code runs."""
    from ..data import read_table
    from ..discrepancy import diagnose_unit
    from ..fmi.cosimulation import WHY_TRUST, Unit

    if trust and os.path.exists(model):
        typer.echo(f"isd-gym: warning: {model}: {WHY_TRUST}", err=True)
    with lines() as say, Unit(model, trust=trust) as fmu:
        known = [p.name for p in (*fmu.model.inputs, *fmu.model.outputs)]
        check_channels(named["rename"].values(), ["time", *known], "--rename")
        data, validate = ([read_table(f, **named) for f in files] for files in (data, validate))
        return diagnose_unit(data, fmu, validate=validate, accept=accept, uncertainty=shares, progress=say)
