"""`isd-gym inspect`: files of loggers, and which column is which channel of a model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .._common.errors import InputError, shown
from ._options import (
    ColumnsOption,
    FileRateOption,
    JsonOption,
    MapOption,
    RenameOption,
    SignOption,
    check_channels,
    column_names,
    option,
    pairs,
    signs_of,
)
from .console import check_file, terminal_columns, write_json

FilesArgument = Annotated[
    list[Path],
    typer.Argument(
        help="Files of one run, one per logger: CSV, Excel, Parquet, .mat, .mf4, .tdms.",
        metavar="FILE...",
    ),
]
ChannelModelOption = Annotated[
    str | None,
    option(
        "--model",
        "Model with the channels to find: a model file or a built-in network.",
    ),
]
MapTargetOption = Annotated[
    Path | None,
    option(
        "--out FILE", "Write the column found for each channel to this file, for --map."
    ),
]
ColumnUnitOption = Annotated[
    list[str] | None, option("--unit COLUMN=UNIT", "Unit of a column. May be repeated.")
]


def command(
    data: FilesArgument,
    model: ChannelModelOption = None,
    out: MapTargetOption = None,
    rename: RenameOption = None,
    unit: ColumnUnitOption = None,
    sign: SignOption = None,
    map_file: MapOption = None,
    stamps: Annotated[
        str | None, option("--stamps COLUMN", "Column with the time.")
    ] = None,
    columns: ColumnsOption = None,
    rate: FileRateOption = None,
    json_file: JsonOption = None,
) -> None:
    """List columns, units, rates, gaps and oddities of loggers' files, and find the column of each channel of a model.

    Pass the file of --out to --map of diagnose or simulate. Read it first: each channel has a probability and its reasons.

    Example: isd-gym inspect body.csv wheel.mf4 --model car.json --out map.json
    """
    from ..physics.network import Network
    from ..records.inspection.map_file import save_map
    from ..records.inspection.report import inspect, lines
    from ..records.loggers import ChannelMap, Column
    from ..records.loggers.mapping import files_of

    files = [file for word in data for file in files_of(word)]
    for target in (out, json_file):
        check_file(target, model, *files)
    if out is not None and model is None:
        raise InputError(
            "--out wants --model: it writes the column of each of the model's channels"
        )
    given: dict[str, str] = {}
    for word in unit or []:
        name, joined, value = word.rpartition("=")
        if not (name and joined and value):
            raise InputError(f"--unit wants COLUMN=UNIT, not {shown(word)}")
        from .._common.units import convert

        convert(1.0, value, value)
        given[name] = value
    network = None if model is None else Network.load(model)
    turned, by = signs_of(sign), None
    renamed = pairs(rename, "--rename", "COLUMN=CHANNEL")
    if (turned or renamed or map_file) and network is None:
        raise InputError(
            "--rename, --sign and --map want --model: they are about its channels"
        )
    if network is not None:
        known = [c.name for c in (*network.inputs, *network.outputs)]
        check_channels(renamed.values(), ["time", *known], "--rename")
        check_channels(turned, known, "--sign")
        if map_file is not None and (renamed or turned):
            raise InputError(
                "--map replaces --rename and --sign: write their values into the map"
            )
        if map_file is not None:
            by = ChannelMap.load(map_file)
            by.check(network)
            turned = {name: column.sign for name, column in by.channels.items()}
        elif renamed:
            stamps = stamps or next(
                (c for c, name in renamed.items() if name == "time"), None
            )
            by = ChannelMap(
                {name: Column(c) for c, name in renamed.items() if name != "time"},
                source="--rename",
            )
            given = {
                next((c for c, n in renamed.items() if n == k), k): u
                for k, u in given.items()
            }
    found = inspect(
        files,
        network,
        units=given,
        stamps=stamps,
        columns=column_names(columns),
        rate=rate,
        by=by,
        signs=turned,
    )
    for line in lines(found, max(60, min(terminal_columns(), 140))):
        typer.echo(line)
    write_json(json_file, found.to_dict())
    if out is not None and found.suggestion is not None:
        made = found.suggestion
        save_map(found.map(str(model)), out)
        doubt = [n for n, (_, sure) in made.channels.items() if sure < 0.9]
        typer.echo(
            f"map: {out}" + (f" (look at {', '.join(doubt)})" if doubt else ""),
            err=True,
        )
