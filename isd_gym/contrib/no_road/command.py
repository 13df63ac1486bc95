"""`isd-gym diagnose --unmeasured`: identification without a measured road."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from isd_gym._commands.console import lines, write_json
from isd_gym._common.errors import plain

from .identification import MAX_SECONDS, identify
from .result import FOLDER

if TYPE_CHECKING:
    from pathlib import Path


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
    """Refit a model by its likelihood, without the measured road; write and print the result.

    Args:
        data: Files of the records.
        network: The model.
        road: Name of the input that was not measured.
        accept: Checks that the user accepts.
        options: How the files are read.
        max_seconds: Time limit [s]; None for the default.
        out: Folder of the result.
        json_file: File of the result as JSON; None for none.
    """
    from isd_gym._common.files import check_folder
    from isd_gym.contrib.records import outputs_of
    from isd_gym.records._loggers.record_reading import records_of

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
