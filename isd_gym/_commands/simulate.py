"""`isd-gym simulate`: the outputs of a model for the inputs of a table."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._common.errors import InputError, plain, shown
from ._options import (
    ColumnsOption,
    FileRateOption,
    JsonOption,
    MapOption,
    ModelArgument,
    RenameOption,
    SignOption,
    UnitOption,
    channel_names,
    check_records,
    option,
)
from .console import check_file, printer, tell, write_json

if TYPE_CHECKING:
    from ..diagnosis.simulation._record_fits import PredictionErrors
    from ..physics.network import Network


def command(
    model: ModelArgument,
    data: Annotated[
        list[Path],
        typer.Argument(
            help="Table with time and the model's inputs (CSV, Excel, Parquet, .mat, .mf4, .tdms), or several with --compare. Join files of "
            "several loggers by +: a.csv+b.mf4."
        ),
    ],
    out: Annotated[
        Path | None,
        option("--out FILE", "File to write. The suffix selects the format."),
    ] = None,
    compare: Annotated[
        bool,
        option(
            "--compare",
            "Print the errors of the model's outputs on DATA. The initial state of each record and free offsets are fitted, "
            "parameters stay.",
        ),
    ] = False,
    step: Annotated[
        float, option("--step", "Largest physics step [s].", min=1e-6)
    ] = 1e-3,
    rename: RenameOption = None,
    unit: UnitOption = None,
    sign: SignOption = None,
    map_file: MapOption = None,
    columns: ColumnsOption = None,
    rate: FileRateOption = None,
    initial: Annotated[
        list[str] | None,
        option(
            "--initial NODE=VALUE|fit",
            "Initial displacement or velocity of a node in SI units (body=0.01, body.velocity=0.2). May be "
            "repeated. fit: fitted to the model's outputs in DATA.",
        ),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Simulate a model with the inputs of a table, and write its outputs at the same times.

    With --compare, print how far the model is from measured outputs: the test of a found model on records of another day.

    Example: isd-gym simulate force-rig test.csv --out force.csv

    Example: isd-gym simulate found/model.json new1.csv new2.csv --compare
    """
    from ..physics.network import Network

    check_file(json_file, model, *data)
    network = Network.load(model)
    named = channel_names(network, rename, unit, map_file, columns, sign, rate)
    if compare:
        if out or initial:
            raise InputError(
                "--compare writes no simulation: leave out --out and --initial"
            )
        _compare(network, data, named, json_file)
        return
    if out is None:
        raise InputError(
            "--out FILE is missing: name the file to write, or give --compare"
        )
    if len(data) > 1 or json_file:
        raise InputError(
            "one DATA with --out; several DATA and --json go with --compare"
        )
    _write(network, model, data[0], out, step, named, rate, initial)


def _compare(
    network: Network,
    data: list[Path],
    named: dict[str, Any],
    json_file: Path | None,
) -> None:
    """Print the errors of a model on records, and write them to the file of --json."""
    from ..diagnosis.simulation._record_fits import prediction_errors
    from ..records.loggers.record_reading import records_of

    check_records(data, [])
    if "by" in named:
        network = named["by"].measured(network)
    wanted = (*network.inputs, *network.outputs)
    records = [r for f in data for r in records_of(f, network, wanted, **named)]
    found = prediction_errors(records, network)
    for note in found.notes:
        typer.echo(plain(note, 400), err=True)
    _print_errors(found)
    write_json(json_file, asdict(found))


def _print_errors(found: PredictionErrors) -> None:
    """Print the errors of a model as a table."""
    from rich import box
    from rich.table import Table as Grid
    from rich.text import Text

    made = Grid(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in ("record", "channel"):
        made.add_column(head, overflow="fold")
    for head in ("RMS error", "of deviation", "noise"):
        made.add_column(head, justify="right", no_wrap=True)
    last = ""
    for row in found.errors:
        made.add_row(
            Text(plain(row.record, 30) if row.record != last else ""),
            Text(plain(row.channel, 40)),
            f"{row.rms:.4g} {row.unit}",
            f"{100 * row.nrmse:.1f} %",
            "unknown" if row.noise is None else f"{100 * row.noise:.1f} %",
        )
        last = row.record
    console = printer()
    console.print(
        f"Errors of model '{plain(found.model, 60)}' with its own parameters; initial states and free offsets are fitted:"
    )
    console.print(made)


def _write(
    network: Network,
    model: str,
    data: Path,
    out: Path,
    step: float,
    named: dict[str, Any],
    rate: float | None,
    initial: list[str] | None,
) -> None:
    """Simulate the inputs of a table and write the outputs."""
    import numpy as np

    from .._common.units import convert
    from ..diagnosis.simulation._motions import motions_at, motions_of, state_of
    from ..physics.simulate import simulate as run
    from ..records.data import Table, write_table
    from ..records.loggers import files_of
    from ..records.loggers.grid import inputs_of, outputs_of
    from ..records.loggers.record_reading import records_of

    check_file(out, model, *files_of(data))
    by = named.get("by")
    fitted = initial == ["fit"]
    if initial and "fit" in initial and not fitted:
        raise InputError(
            "--initial fit finds the motion of every node: leave out the other --initial values"
        )
    measured = (
        outputs_of(data, network, by, named.get("rename"), named["columns"], rate)
        if fitted
        else []
    )
    wanted = (
        (*network.inputs, *network.with_outputs(measured).outputs)
        if fitted
        else network.inputs
    )
    pieces = records_of(data, network, wanted, **named)
    if len(pieces) > 1:
        notes = getattr(pieces[0], "notes", ())
        if not notes:
            raise InputError(
                f"{data}: holds {len(pieces)} runs side by side: simulate a file of each"
            )
        raise InputError(
            f"{data}: there are gaps in time ({notes[0]}): cut the file there and simulate each piece"
        )
    table, start = pieces[0], None
    if fitted:
        from ..diagnosis.simulation._record_fits import initial_state

        begun = initial_state(table, network, outputs=measured)
        table = Table(begun.time, dict(begun.inputs), str(data))
        start = begun.state
        for note in (*begun.notes, *map(str, begun.lags)):
            typer.echo(plain(note, 400), err=True)
    elif not isinstance(table, Table):
        notes = list(table.notes)
        time, inputs = inputs_of(table, network.inputs, notes)
        own = {c.name: convert(inputs[c.name], c.si, c.unit) for c in network.inputs}
        table = Table(time, own, table.name)
        for note in notes:
            typer.echo(note, err=True)
    si = {
        c.name: convert(
            np.asarray(table[c.name]), table.units.get(c.name) or c.unit, c.si
        )
        for c in network.inputs
    }
    if fitted and start is not None:
        motions = motions_at(network, start, si, table.step)
        text = "; ".join(
            f"{n} {m['displacement']:.4g}, {m['velocity']:.4g}/s"
            for n, m in motions.items()
        )
        typer.echo(
            f"initial state fitted to {', '.join(measured)}, in SI: {text}", err=True
        )
    elif initial:
        start = state_of(network, motions_of(initial), si, table.step)
    outputs = run(
        network,
        table.time,
        table.columns,
        step=step,
        initial=start,
        interpolation="auto",
    )
    for name, values in outputs.items():
        if not np.isfinite(values).all():
            at = table.time[int(np.argmin(np.isfinite(values)))]
            raise InputError(
                f"the model's output {shown(name)} is not finite from {at:g} s on: nothing is written"
            )
    units = {c.name: c.unit for c in network.outputs}
    write_table(
        out, Table(time=table.time, columns=outputs, source=network.name, units=units)
    )
    tell(f"{len(table.time)} samples of {', '.join(outputs)} in {out}")
