"""`isd-gym plan`: prediction and design of a test before a diagnosis."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from isd_gym._commands._options import (
    ColumnsOption,
    ElementsOption,
    MapOption,
    ModelArgument,
    RenameOption,
    SignOption,
    UnitOption,
    channel_names,
)
from isd_gym._commands.console import check_file, printer, progress
from isd_gym._common.errors import InputError, plain, shown

if TYPE_CHECKING:
    from isd_gym.physics.network import Network
    from isd_gym.records.data import Table

    from .planning import Rig
    from .result import Plan

AMOUNT = re.compile(r"([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(.*)")


def command(
    model: ModelArgument,
    data: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Records of the test: its inputs, and outputs for the noise if there are any. Without records the test is --excitation."
        ),
    ] = None,
    rename: RenameOption = None,
    unit: UnitOption = None,
    sign: SignOption = None,
    map_file: MapOption = None,
    columns: ColumnsOption = None,
    excitation: Annotated[
        str | None,
        typer.Option(help="Test without DATA: multisine, sweep, steps, triangle."),
    ] = None,
    limit: Annotated[
        list[str] | None,
        typer.Option(
            help="Largest value of an input on the rig, and its largest rate: road=15mm or road=15mm,0.4m/s, force=200N, current=4.",
            metavar="INPUT=REACH[,SPEED]",
        ),
    ] = None,
    band: Annotated[
        str | None, typer.Option(help="Frequency range of the rig [Hz].", metavar="LOW:HIGH")
    ] = None,
    length: Annotated[float | None, typer.Option(help="Length of the test [s].", min=1e-3)] = None,
    rate: Annotated[float | None, typer.Option(help="Sampling rate [Hz].", min=1e-3)] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            help="RMS noise of an output, in its unit. Default: from the model file or DATA, else 1 % of the output's standard deviation.",
            metavar="OUTPUT=VALUE",
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="Only hypotheses with this effect, node or channel. May be repeated.", metavar="WORD"
        ),
    ] = None,
    sensors: Annotated[bool, typer.Option(help="Also predict the gain of one more sensor.")] = True,
    design: Annotated[
        Path | None,
        typer.Option(
            help="Choose the most informative test within the limits, and write it to this file.",
            metavar="FILE.csv",
        ),
    ] = None,
    after: Annotated[
        Path | None,
        typer.Option(
            help="With --design: diagnosis.json of an undecided diagnosis. The test separates its candidates.",
            metavar="RESULT.json",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Write the plan (isd-plan/1) to this file.", metavar="FILE.json"),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option("--html", help="Write a page with a picture to this file.", metavar="FILE.html"),
    ] = None,
    elements: ElementsOption = None,
) -> None:
    """Predict which missing effects a test can show, and the smallest size at which each is named.

    Every effect of the library is simulated at every place under the test. The model and the closest other effects are
    refitted to the simulated records, and the criteria of isd-gym diagnose are applied, noise included. The table shows
    the smallest size of each effect that would be named, and the gain of one more sensor.

    With --design the test is chosen among multisines, sweeps, steps and triangles, within --limit, --band and --length or
    the range of DATA. With --after the test separates the candidates of an undecided diagnosis.

    Example: isd-gym plan car.json --limit road=15mm --html plan.html
    """
    from isd_gym.physics import elements as el
    from isd_gym.physics.network import Network
    from isd_gym.records._loggers import files_of

    from .workflow import plan as run

    for file in (design, out, html):
        check_file(file, model, after, *(f for word in data or () for f in files_of(word)), *elements or ())
    if after is not None:
        if design is None:
            raise InputError("--after wants --design FILE.csv: where the test that separates the rivals goes")
        _check_undecided(after)
    for file in elements or ():
        el.register_file(file)
    network = Network.load(model)
    named = channel_names(network, rename, unit, map_file, columns, sign)
    if any(named.values()) and not data:
        raise InputError("--rename, --unit, --sign, --columns and --map are for DATA, and there are none")
    if "by" in named:
        network = named["by"].measured(network)
    notes: list[str] = []
    tables = _tables(data or [], network, named, notes)
    own_noise = amounts(
        noise, {c.name: c.unit for c in network.outputs}, "--noise", "the model has no output"
    )
    options: dict[str, Any] = {"noise": own_noise, "only": only or (), "add_sensors": sensors}
    with progress() as update:
        options["progress"] = update
        if design is None and not any((limit, band, length, rate)):
            found = run(network, tables, excitation=excitation, notes=notes, **options)
        else:
            if tables and design is None:
                raise InputError(
                    "--limit, --band, --length and --rate are for a test that is made: not with DATA, or with --design"
                )
            bounds = (limit, band, length, rate)
            found = _made(network, tables, excitation, bounds, design, after, notes, options)
    _save(found, out, html)
    _print(found)


#: decided verdicts, in words
DECIDED = {
    "missing_effect": "the missing effect is named",
    "no_discrepancy": "nothing is missing",
    "parameters_only": "parameters explain the difference",
}


def _check_undecided(after: Path) -> None:
    """Raise `InputError` for a diagnosis without a question for another test."""
    from isd_gym._common.inputs import read_json

    data = read_json(after)
    verdict = data.get("verdict") if isinstance(data, dict) else None
    if isinstance(verdict, str) and verdict in DECIDED:
        raise InputError(f"{after}: nothing is left to decide: {DECIDED[verdict]} ({verdict})")


def _tables(data: list[Path], network: Network, named: dict[str, Any], notes: list[str]) -> list[Table]:
    """Return the records of DATA with the inputs of the model, and the outputs if complete."""
    from isd_gym._common.units import convert
    from isd_gym.contrib.records import inputs_of, outputs_of
    from isd_gym.records._loggers.record_reading import records_of
    from isd_gym.records.data import Table

    out = []
    for word in data:
        there = set(outputs_of(word, network, named.get("by"), named.get("rename"), named["columns"]))
        whole = all(c.name in there for c in network.outputs)
        wanted = (*network.inputs, *network.outputs) if whole else network.inputs
        for record in records_of(word, network, wanted, **named):
            if isinstance(record, Table):
                out.append(record)
                continue
            notes += record.notes
            time, inputs = inputs_of(record, network.inputs, notes)
            own = {c.name: convert(inputs[c.name], c.si, c.unit) for c in network.inputs}
            out.append(Table(time, own, record.name))
    return out


def _made(
    network: Network,
    data: list[Table],
    excitation: str | None,
    bounds: tuple[list[str] | None, str | None, float | None, float | None],
    design: Path | None,
    after: Path | None,
    notes: list[str],
    options: dict[str, Any],
) -> Plan:
    """Return the plan of a generated test, and write the test on request."""
    from .planning import Limits, infer_rig
    from .workflow import plan as run
    from .workflow import read_planned_record

    limit, band, length, rate = bounds
    records = [read_planned_record(table, network) for table in data]
    units = {c.name: c.si for c in network.inputs}
    own = {c.name: c.unit for c in network.inputs}
    reaches = [text.partition(",")[0] for text in limit or ()]
    values = amounts(reaches, units, "--limit", "the model has no input", own)
    speeds = [f"{t.partition('=')[0]}={t.partition(',')[2]}" for t in limit or () if "," in t]
    steep = amounts(speeds, {n: f"{u}/s" for n, u in units.items()}, "--limit", "the model has no input")
    rig = infer_rig(
        network,
        records,
        limits={name: Limits(value, steep.get(name, math.inf)) for name, value in values.items()},
        band=_band(band),
        length=length,
        rate=rate,
        notes=notes,
    )
    if design is None:
        return run(network, excitation=excitation, rig=rig, notes=notes, **options)
    if excitation is not None:
        raise InputError("--design chooses the excitation itself: leave --excitation away")
    return _designed(network, rig, records, design, after, notes, options)


def _designed(
    network: Network,
    rig: Rig,
    records: list[Any],
    design: Path,
    after: Path | None,
    notes: list[str],
    options: dict[str, Any],
) -> Plan:
    from .general_test import design_general_test, estimate_output_noise, read_rivals
    from .planning import design_test
    from .workflow import plan as run

    update = options["progress"]
    noise = estimate_output_noise(network, rig, options["noise"], records)
    if after is not None:
        chosen = design_test(network, read_rivals(network, after), rig, noise, progress=update)
    else:
        chosen = design_general_test(network, rig, noise, only=options["only"], progress=update)
    if chosen is None:
        raise InputError(
            "none of the tests within these limits can be simulated: smaller --limit, or another --band"
        )
    chosen.save(design, network)
    notes.append(chosen.sentence)
    typer.echo(f"{len(chosen.record)} samples in {design}")
    known = {c.name: float(s) for c, s in zip(network.outputs, noise, strict=True)}
    return run(network, excitation=chosen.excitation, rig=rig, notes=notes, **{**options, "noise": known})


def amounts(
    values: list[str] | None,
    units: Mapping[str, str],
    option: str,
    unknown: str,
    own: Mapping[str, str] | None = None,
) -> dict[str, float]:
    """Return the values of an option ``NAME=VALUE [unit]``.

    Args:
        values: Values of the option.
        units: Unit of the result by name.
        option: Name of the option, for messages.
        unknown: Description of an unknown name, for messages.
        own: Unit of a bare number by name; None for the unit of the result.

    Returns:
        Value by name.

    Raises:
        InputError: A name is unknown, or a value cannot be converted.
    """
    from isd_gym._common.units import convert

    out = {}
    for text in values or ():
        name, joined, amount = text.partition("=")
        found = AMOUNT.fullmatch(amount.strip())
        if not joined or found is None:
            raise InputError(
                f"{option} wants NAME=VALUE, such as {next(iter(units), 'name')}=1.5, not {shown(text)}"
            )
        if name not in units:
            raise InputError(f"{option}: {unknown} {shown(name)} (it has: {', '.join(units)})")
        try:
            number = float(found[1])
        except ValueError:
            raise InputError(f"{option}: {shown(amount)} is no number") from None
        try:
            out[name] = convert(number, found[2] or (own or units)[name], units[name])
        except InputError as error:
            raise InputError(f"{option} {name}: {error}") from None
    return out


def _band(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    parts = text.split(":")
    try:
        low, high = (float(p) for p in parts)
    except ValueError:
        raise InputError(f"--band wants LOW:HIGH in Hz, such as 0.5:15, not {shown(text)}") from None
    return low, high


def _save(found: Plan, out: Path | None, html: Path | None) -> None:
    if out is not None:
        found.save(out)
    if html is not None:
        from .page import write_plan

        write_plan(found, html)


# -------------------------------------------------------------------------------------------------------- printing


def _print(found: Plan) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from .page import size_of
    from .result import STATUS

    console = printer()
    console.print(f"Test: {plain(found.test, 300)}")
    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in ("effect", "smallest nameable size", "limited by"):
        made.add_column(head, overflow="fold")
    made.add_column("share of force", justify="right", no_wrap=True)
    for e in found.effects:
        share = "" if e.share is None or e.status != "named" else f"{100 * e.share:.0f} %"
        what = size_of(e, e.smallest) if e.status == "named" else STATUS[e.status]
        why = ", ".join(e.limited_by) if e.status == "named" else ", ".join(e.confused_with)
        made.add_row(Text(plain(e.label, 60)), Text(what), Text(plain(why, 90)), share)
    console.print(made)
    if found.sensors:
        more = Table(box=box.SIMPLE_HEAD, pad_edge=False)
        for head in ("additional sensor", "where", "noise"):
            more.add_column(head)
        more.add_column("more distinguishable", justify="right")
        more.add_column("distinguishable at", justify="right")
        for s in found.sensors[:8]:
            more.add_row(
                Text(plain(s.name, 40)),
                Text(plain(s.where, 40)),
                f"{s.noise:.3g} {s.unit}",
                str(s.told),
                f"1/{s.factor:.1f} of the size",
            )
        console.print(more)
    for note in found.notes:
        console.print(plain(note, 300), style="dim")
    console.print(plain(found.summary, 600))
