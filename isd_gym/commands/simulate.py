"""`isd-gym simulate`: the outputs of a model for the inputs of a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from ..console import check_file, tell
from ..errors import InputError, plain, shown
from ._options import (
    ColumnsOption,
    FileRateOption,
    MapOption,
    ModelArgument,
    RenameOption,
    SignOption,
    UnitOption,
    channel_names,
)

if TYPE_CHECKING:
    from ..simulate import Interpolation


def command(
    model: ModelArgument,
    data: Annotated[
        Path,
        typer.Argument(
            help="Table with time and the model's inputs (CSV, Parquet, .mat, .mf4). Join files of several loggers by +: a.csv+b.mf4."
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", help="File to write. The suffix selects the format.", metavar="FILE")
    ],
    step: Annotated[float, typer.Option(help="Largest physics step [s].", min=1e-6)] = 1e-3,
    rename: RenameOption = None,
    unit: UnitOption = None,
    sign: SignOption = None,
    map_file: MapOption = None,
    columns: ColumnsOption = None,
    rate: FileRateOption = None,
    initial: Annotated[
        list[str] | None,
        typer.Option(
            help="Initial displacement or velocity of a node in SI units (body=0.01, body.velocity=0.2), or a JSON file. May be "
            "repeated. fit: fitted to the model's outputs in DATA.",
            metavar="NODE=VALUE|FILE|fit",
        ),
    ] = None,
    interpolation: Annotated[
        str,
        typer.Option(
            help="Displacements and forces between samples. auto: as in a diagnosis, a cubic spline and small physics steps where an "
            "output has fewer than 21 samples per period, straight lines elsewhere.",
            metavar="auto|linear|spline",
        ),
    ] = "auto",
) -> None:
    """Simulate a model with the inputs of a table, and write its outputs at the same times.

    Example: isd-gym simulate force-rig test.csv --out force.csv
    """
    import numpy as np

    from ..data import Table, write_table
    from ..loggers import files_of
    from ..loggers.record_reading import outputs_of, records_of
    from ..loggers.resampling import inputs_of
    from ..loggers.start import motions_at, motions_of, state_of
    from ..network import Network
    from ..simulate import simulate as run
    from ..units import convert

    check_file(out, model, *files_of(data))
    network = Network.load(model)
    named = channel_names(network, rename, unit, map_file, columns, sign, rate)
    by = named.get("by")
    fitted = initial == ["fit"]
    if initial and "fit" in initial and not fitted:
        raise InputError("--initial fit finds the motion of every node: leave out the other --initial values")
    measured = outputs_of(data, network, by, named.get("rename"), named["columns"], rate) if fitted else []
    wanted = (*network.inputs, *network.with_outputs(measured).outputs) if fitted else network.inputs
    pieces = records_of(data, network, wanted, **named)
    if len(pieces) > 1:
        notes = getattr(pieces[0], "notes", ())
        if not notes:
            raise InputError(f"{data}: holds {len(pieces)} runs side by side: simulate a file of each")
        raise InputError(
            f"{data}: there are gaps in time ({notes[0]}): cut the file there and simulate each piece"
        )
    table, start = pieces[0], None
    if fitted:
        from ..discrepancy.estimation.initial_state_fit import initial_state

        begun = initial_state(table, network, outputs=measured)
        table, start = Table(begun.time, dict(begun.inputs), str(data)), begun.state
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
        c.name: convert(np.asarray(table[c.name]), table.units.get(c.name) or c.unit, c.si)
        for c in network.inputs
    }
    if fitted and start is not None:
        motions = motions_at(network, start, si, table.step)
        text = "; ".join(f"{n} {m['displacement']:.4g}, {m['velocity']:.4g}/s" for n, m in motions.items())
        typer.echo(f"initial state fitted to {', '.join(measured)}, in SI: {text}", err=True)
    elif initial:
        start = state_of(network, motions_of(initial), si, table.step)
    outputs = run(
        network,
        table.time,
        table.columns,
        step=step,
        initial=start,
        interpolation=cast("Interpolation", interpolation),
    )
    for name, values in outputs.items():
        if not np.isfinite(values).all():
            at = table.time[int(np.argmin(np.isfinite(values)))]
            raise InputError(
                f"the model's output {shown(name)} is not finite from {at:g} s on: nothing is written"
            )
    units = {c.name: c.unit for c in network.outputs}
    write_table(out, Table(time=table.time, columns=outputs, source=network.name, units=units))
    tell(f"{len(table.time)} samples of {', '.join(outputs)} in {out}")
