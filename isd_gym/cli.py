"""The command `isd-gym`. Heavy imports wait until a command needs them, so that --help answers at once."""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sized
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from .console import (
    ColumnsOption,
    MapOption,
    RenameOption,
    TrustOption,
    UnitOption,
    channel_names,
    check_channels,
    check_file,
    column_names,
    counted,
    lines,
    pairs,
    printer,
    progress,
    resumable,
    tell,
    warm_up,
    write_json,
)
from .errors import InputError, ReportError, plain, shown
from .plugins import COMMANDS, REFERENCES, plugins


class _Commands(TyperGroup):
    """A list of commands that says each in a whole sentence, over as many lines as it takes."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        rows = []
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            text = " ".join((command.help or "" if command else "").split("\n\n")[0].split())
            rows.append((name, text))
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def _offer(*names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Words for the shell to complete with, looked up only when it asks."""

    def words(incomplete: str) -> list[str]:
        return sorted(w for find in names for w in find() if w.startswith(incomplete))

    return words


def _policies() -> Iterable[str]:
    from .policies import available

    return available()


def _networks() -> Iterable[str]:
    from .network import builtin_networks

    return builtin_networks()


def _roads() -> Iterable[str]:
    return ("paper", "paper-printed", "flat", *"ABCDEFGH", "bump", "pothole", "sweep")


app = typer.Typer(
    name="isd-gym",
    cls=_Commands,
    help="A vehicle suspension with a hydraulic electric inerter: score and train controllers, simulate networks, "
    "and find the physics that a model lacks.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version
        from platform import platform, python_version

        typer.echo(f"isd-gym {version('isd-gym')}, Python {python_version()}, {platform()}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version, for a report."),
    ] = False,
) -> None: ...


JsonOption = Annotated[
    Path | None, typer.Option("--json", help="Write the figures to this file.", metavar="FILE")
]


class _SeveralValues(TyperCommand):
    """An option that may be repeated also takes several values at once: ``--validate a.csv b.csv``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        several = {o for p in self.params if getattr(p, "multiple", False) for o in p.opts}
        out: list[str] = []
        option = ""
        for i, arg in enumerate(args):
            if arg == "--":
                out += args[i:]
                break
            name, joined, _ = arg.partition("=")
            if arg.startswith("-"):
                option = name if name in several else ""
                fresh = bool(option) and not joined  # its first value follows as it is
            elif option:
                if not fresh:
                    out.append(option)
                fresh = False
            out.append(arg)
        return super().parse_args(ctx, out)


def _check_records(data: list[Path], validate: list[Path]) -> None:
    """No record counts twice, and none is judged by that took part in fitting."""
    from .loggers import files_of

    seen: set[Path] = set()
    fitted = [f for word in data for f in files_of(word)]
    held = [f for word in validate for f in files_of(word)]
    for file in (*fitted, *held):
        if (own := file.resolve()) in seen:
            both = file in held and own in {f.resolve() for f in fitted}
            raise InputError(
                f"{file}: is among the records to fit; --validate wants others"
                if both
                else f"{file}: is named twice"
            )
        seen.add(own)


@app.command()
def score(
    policies: Annotated[
        list[str],
        typer.Argument(
            help="passive, isd-passive, skyhook, lqg, mpc, ... (isd-gym policies lists them), or a policy's folder or .zip.",
            autocompletion=_offer(_policies),
        ),
    ],
    road: Annotated[
        str,
        typer.Option(
            help="paper, paper-printed, flat, A ... H, bump, pothole, sweep, C+bump, a CSV file, or with --map what a logger measured.",
            autocompletion=_offer(_roads),
        ),
    ] = "paper",
    map_file: MapOption = None,
    speed: Annotated[float, typer.Option(help="Speed [m/s].", min=0.1)] = 20.0,
    episodes: Annotated[int, typer.Option(help="Roads to drive, the same for all.", min=1)] = 32,
    seed: Annotated[int, typer.Option(help="Episode i has the road of seed + i.", min=0)] = 0,
    duration: Annotated[float, typer.Option(help="Length of an episode [s].", min=0.005)] = 20.0,
    preview: Annotated[
        float | None,
        typer.Option(
            help="Road ahead [s] that policies with a preview see (mpc-friction-preview, ...).", min=0.0
        ),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(
            help="Pair with the references of a benchmark card without driving them: ISDSuspension-v0, or a file.",
            metavar="CARD",
        ),
    ] = None,
    sensors: Annotated[
        str,
        typer.Option(
            help="Imperfections of the sensors, joined by commas: noise=1, delay=1 (control steps), road_error=0.001 (m), road_lag=0.01 (s), road_range=3 (m)."
        ),
    ] = "",
    network: Annotated[
        str,
        typer.Option(help="The plant: a built-in network or a model file.", autocompletion=_offer(_networks)),
    ] = "quarter-car-isd",
    model: Annotated[str | None, typer.Option(help="The controllers' model; the plant unless given.")] = None,
    point: Annotated[
        str | None,
        typer.Option(
            help="Point of the body at which ISO 2631-1 is evaluated; the driver unless given, if the network has one."
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="Write plots and a page to this folder.", metavar="DIR")
    ] = None,
    trust_zip: TrustOption = False,
    json_file: JsonOption = None,
) -> None:
    """Score policies on the same roads, paired, against the conventional passive car.

    Prints RMS of body acceleration, suspension travel and dynamic tyre load with the change against passive and its
    95 % interval, and the cost J; of a half or full car also pitch and roll acceleration, and each corner. The paper's tables and the bounds follow where their conditions hold: they belong to
    means over random roads, which 32 x 20 s give.

    Example: isd-gym score passive isd-passive mpc
    """
    from .loggers import ChannelMap
    from .loggers.records import road_of
    from .network import Network
    from .policies import find, passive
    from .road import road as find_road
    from .scoring import score as run
    from .scoring import unscored
    from .sensors import Sensors

    check_file(json_file, network, model, road)
    senses = Sensors.of(sensors)
    if report is not None:
        from .report import check_report

        check_report(report)
    plant = Network.load(network)
    ground = find_road(road) if map_file is None else road_of(road, plant, ChannelMap.load(map_file))
    belief = Network.load(model) if model else None
    ahead: dict[str, Any] = {} if preview is None else {"preview": preview}
    entries = [
        find(name, plant, model=belief, speed=speed, trust_zip=trust_zip, **ahead) for name in policies
    ]
    drives: dict[str, Any] = {
        "road": ground,
        "speed": speed,
        "episodes": episodes,
        "seed": seed,
        "duration": duration,
        "sensors": senses,
    }
    card = track = None
    if against is not None:
        from . import cards

        card = cards.load(against)
        track = cards.match(unscored(entries, plant, **drives).to_dict(), card)["track"]
    ceilings = _ceilings(plant, ground, speed, duration)
    known = _reachable(plant, ground, speed, episodes, seed, duration)
    with progress() as update:
        warm_up(update)
        result = run(
            entries,
            plant,
            reference=passive(plant),
            point=point,
            clairvoyant=None if known is None else known["value"],
            ceiling=ceilings,
            progress=update,
            **drives,
        )
    result.references |= _references(result, known, ceilings)
    made = result.to_dict() | {"command": " ".join(["isd-gym", *sys.argv[1:]])}
    write_json(json_file, made)
    if report is not None:
        from .report import score_report

        page = score_report(result, report)
        typer.echo(f"report: {page}", err=True)
    _print_score(result)
    if card is not None and track is not None:
        cards.show(card, track, [made])


def _reachable(
    plant: Any, road: Any, speed: float, episodes: int, seed: int, duration: float
) -> dict[str, Any] | None:
    """Least known cost of these very episodes, its proven bound and RMS of the signals; None where it is not known."""
    for point in plugins(REFERENCES, "clairvoyant"):
        return point.load()(plant, road, speed, episodes, seed, duration)
    return None


def _ceilings(
    plant: Any, road: Any, speed: float, duration: float
) -> Callable[[float], dict[str, Any] | None]:
    """What bounds controllers with a preview of so many seconds, where it is known."""
    points = list(plugins(REFERENCES, "ceiling"))

    def find(preview: float) -> dict[str, Any] | None:
        for point in points:
            return point.load()(plant, road, speed, duration, preview=preview)
        return None

    return functools.cache(find)


def _references(
    result: Any, known: dict[str, Any] | None, ceilings: Callable[[float], dict[str, Any] | None]
) -> dict[str, Any]:
    """Bounds beside a score, a line each, and a line about what is left out.

    Args:
        result: The score.
        known: What is known of the clairvoyant optimum on these roads.
        ceilings: The ceiling for a preview [s], where it is known.
    """
    lines: dict[str, Any] = {}
    allowed = result.comparable
    not_computed = "not computed for these conditions"
    if known is None or allowed.clairvoyant:
        allowed = replace(allowed, clairvoyant=allowed.clairvoyant or not_computed)
    else:
        lines |= _optimum(result, known)
    if not allowed.lq_bound and (line := _wheelbase_bound(result) or _lq_bound(result)):
        lines["causal_bound"] = line
    if not allowed.ceiling:
        found = {s: ceilings(s) for s in sorted({row["preview"]["value"] for row in result.policies})}
        lines |= {f"ceiling_{s:g}": bound["sentence"] for s, bound in found.items() if bound is not None}
        if not any(found.values()):
            allowed = replace(allowed, ceiling=not_computed)
    if allowed.left_out:
        lines["left_out"] = allowed.left_out
    return lines


def _optimum(result: Any, known: dict[str, Any]) -> dict[str, Any]:
    """The clairvoyant optimum in a line, and its place on the trade-off: changes of RMS against passive, over all episodes."""
    import numpy as np

    own = result.runs["passive"]
    cost, least, proven = (float(v.mean()) for v in (own.cost(result.cost), known["value"], known["lower"]))
    line = (
        f"Clairvoyant optimum, these very roads known in advance (searched): cost J {least:.3f} "
        f"({100 * (least / cost - 1):+.1f} %)"
    )
    if np.isfinite(proven):
        line += f"; proven, without end stops: not below {proven:.3f} ({100 * (proven / cost - 1):+.1f} %)"
    line += "."
    changes = {
        f"{n}_change": float(np.sqrt(np.mean(known[n] ** 2) / np.mean(getattr(own, n) ** 2)) - 1)
        for n in ("body_acceleration", "suspension_travel", "tyre_load")
    }
    return {"clairvoyant": line, "clairvoyant_point": changes}


def _wheelbase_bound(result: Any) -> str | None:
    """The linear-quadratic bound of a car with two axles; every policy is given its share of that gain (`share_of_lq_gain`)."""
    if not result.plant.bodies:
        return None
    for point in plugins(REFERENCES, "wheelbase_bound"):
        try:
            bound = point.load()(result.plant, speed=result.speed, road=result.ground, cost=result.cost)
        except InputError:  # a road or a car for which there is no such bound
            continue
        for row in result.policies:
            row["share_of_lq_gain"] = row["cost"]["change"] / bound.change + 0.0
        return (
            "LQ bound with the rear road known from the front (any force, full state, no friction, no limits; the mean over "
            f"roads): cost J {100 * bound.change:+.1f} % at best; {100 * bound.blind_change:+.1f} % for a controller that "
            "takes the rear road for a new one."
        )
    return None


def _lq_bound(result: Any) -> str | None:
    """The causal linear-quadratic bound beside the best policy that does not see the road ahead."""
    blind = [row for row in result.policies if not row["preview"]["value"]]
    if not blind:
        return None
    best = min(blind, key=lambda row: row["cost"]["value"])
    rows = [best[f"{k}_rms"] for k in ("body_acceleration", "suspension_travel", "tyre_load")]
    changes = [row.get("change") for row in rows]
    if best["policy"] == "passive" or None in changes:
        return None
    for point in plugins(REFERENCES, "lq_front"):
        try:
            front = point.load()(
                changes[2], [changes[1]], network=result.plant, speed=result.speed, road=result.ground
            )
        except InputError:  # a car for which there is no such bound
            continue
        if len(front):
            a, l, f = (f"{100 * c:+.1f} %" for c in changes)
            low, high = (100 * rows[0][k] for k in ("low", "high"))
            return (
                f"Causal LQ bound (any force, full state, no friction, no limits; the mean over roads): at the travel ({l}) "
                f"and tyre load ({f}) of {best['policy']}, acceleration {100 * front[0, 1]:+.1f} % at best; "
                f"{best['policy']}: {a} [{low:+.1f}, {high:+.1f}]"
            )
    return None


def _print_score(result: Any) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from .scoring import PAPER, corner_measures

    console = printer()
    narrow = console.width < 106

    def table(*heads: str) -> Table:
        made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
        for i, head in enumerate(heads):
            # names may be folded, figures never cut
            made.add_column(head, justify="left" if i == 0 else "right", no_wrap=i > 0, overflow="fold")
        return made

    def cell(q: dict[str, Any], digits: int, scale: float = 1.0) -> str:
        text = f"{q['value'] * scale:.{digits}f}"
        if "change" in q and q["change"] != 0.0:
            text += f"{chr(10) if narrow else ' '}{100 * q['change']:+.1f} %"
            if result.episodes > 1:
                text += f"\n[{100 * q['low']:+.1f}, {100 * q['high']:+.1f}]"
        return text

    main: dict[str, Callable[[Any], str]] = {
        "cost J": lambda r: cell(r["cost"], 3),
        "acceleration\nm/s²": lambda r: cell(r["body_acceleration_rms"], 3),
        "travel\nmm": lambda r: cell(r["suspension_travel_rms"], 2, 1e3),
        "tyre load\nN": lambda r: cell(r["tyre_load_rms"], 0),
    }
    share: dict[str, Callable[[Any], str]] = {}
    if any(row["share_of_reachable_gain"] is not None for row in result.policies):
        share["of the gain\nreachable"] = lambda r: f"{round(100 * r['share_of_reachable_gain'])} %"
    if any(row["share_of_causal_gain"] is not None for row in result.policies):
        share["of the causal\ngain"] = lambda r: (
            "" if r["share_of_causal_gain"] is None else f"{round(100 * r['share_of_causal_gain'])} %"
        )
    if any("share_of_lq_gain" in row for row in result.policies):
        share["of the LQ\nbound's gain"] = lambda r: f"{round(100 * r['share_of_lq_gain'])} %"
    motion: dict[str, Callable[[Any], str]] = {
        (f"W_k, {plain(result.comfort)}" if result.comfort else "W_k") + "\nm/s²": lambda r: (
            f"{r['weighted_acceleration_rms']['value']:.3f}"
        ),
        "peak acc.\nm/s²": lambda r: f"{r['peak_body_acceleration']['value']:.2f}",
        "peak travel\nmm": lambda r: f"{1e3 * r['peak_suspension_travel']['value']:.1f}",
        "current\nA": lambda r: f"{r['current_rms']['value']:.2f}",
        "energy\nJ": lambda r: f"{r['energy']['value']:.0f}",
    }
    work: dict[str, Callable[[Any], str]] = {
        "exceed-\nances": lambda r: str(sum(r["limit_violations"].values())),
        "fall-\nbacks": lambda r: str(r["fallbacks"]),
        "processor ms\nper step": lambda r: f"{1e3 * r['control_time']['median']:.3f}",
        "\n99.9 %": lambda r: f"{1e3 * r['control_time']['p99_9']:.3f}",
    }
    corners: list[dict[str, Callable[[Any], str]]] = [
        {
            head: lambda r, name=name, digits=digits, scale=scale: cell(r[name], digits, scale)  # type: ignore[misc]
            for name, (head, digits, scale) in group.items()
        }
        for group in corner_measures(result.policies[0])
    ]
    ahead = sorted({row["preview"]["value"] for row in result.policies} - {0.0})
    sight = f", {' and '.join(f'{s:g}' for s in ahead)} s of road ahead" if ahead else ""
    interval = ", 95 % interval" if result.episodes > 1 else "; one episode has no interval"
    title = (
        f"{plain(result.network)}, road {shown(result.road)}, {result.speed:g} m/s, {result.episodes} x {result.duration:g} s, "
        f"seeds {result.seed} to {result.seed + result.episodes - 1}{sight}; RMS, change against passive{interval}"
    )
    groups = [main, motion, share | work] if narrow else [main | share, motion | work]
    groups += corners
    console.print(title)
    for group in groups:
        made = table("policy", *group)
        for row in result.policies:
            made.add_row(Text(plain(row["policy"], 40)), *(say(row) for say in group.values()))
        console.print(made)
    for name, (before, after) in PAPER.items() if not result.comparable.tables else ():
        parts = [
            f"{what} {b * s:.{d}f} -> {a * s:.{d}f} ({100 * (a / b - 1):+.1f} %)"
            for what, b, a, s, d in zip(
                ("acceleration", "travel [mm]", "tyre load"),
                before,
                after,
                (1, 1e3, 1),
                (3, 2, 0),
                strict=True,
            )
        ]
        console.print(f"The paper's {name}: " + ", ".join(parts), style="dim")
    for line in (r for r in result.references.values() if isinstance(r, str)):
        console.print(plain(line, 400), style="dim")


@app.command()
def simulate(
    model: Annotated[
        str,
        typer.Argument(
            help="A model file (isd-model/1) or a built-in network.", autocompletion=_offer(_networks)
        ),
    ],
    data: Annotated[
        Path,
        typer.Argument(
            help="A table with time and the model's inputs (CSV, Parquet, .mat, .mf4), or several loggers' files: a.csv+b.mf4."
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", help="The file to write; its suffix is its format.", metavar="FILE")
    ],
    step: Annotated[float, typer.Option(help="Largest physics step [s].", min=1e-6)] = 1e-3,
    rename: RenameOption = None,
    unit: UnitOption = None,
    map_file: MapOption = None,
    columns: ColumnsOption = None,
    initial: Annotated[
        list[str] | None,
        typer.Option(
            help="Initial positions and velocities of nodes, in SI: body=0.01, body.velocity=0.2, or a JSON file; may be repeated. "
            "fit: fitted to the model's outputs in DATA.",
            metavar="NODE=VALUE|FILE|fit",
        ),
    ] = None,
) -> None:
    """Simulate a model for the inputs of a table; writes its outputs at the same times.

    Example: isd-gym simulate force-rig test.csv --out force.csv
    """
    import numpy as np

    from .data import Table, write_table
    from .loggers import files_of
    from .loggers.grid import inputs_of
    from .loggers.records import outputs_of, records_of
    from .loggers.start import motions_at, motions_of, state_of
    from .network import Network
    from .simulate import simulate as run
    from .units import convert

    check_file(out, model, *files_of(data))
    network = Network.load(model)
    named = channel_names(network, rename, unit, map_file, columns)
    by = named.get("by")
    fitted = initial == ["fit"]
    if initial and "fit" in initial and not fitted:
        raise InputError("--initial fit finds how every node stands and moves: leave the others away")
    measured = outputs_of(data, network, by, named.get("rename"), named["columns"]) if fitted else []
    wanted = (*network.inputs, *network.with_outputs(measured).outputs) if fitted else network.inputs
    pieces = records_of(data, network, wanted, **named)
    if len(pieces) > 1:
        raise InputError(f"{data}: there are gaps in time ({pieces[0].notes[0]}): simulate a piece at a time")  # type: ignore[union-attr]
    table, start = pieces[0], None
    if fitted:
        from .discrepancy.estimation.initial_state_fit import initial_state

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
    outputs = run(network, table.time, table.columns, step=step, initial=start)
    for name, values in outputs.items():
        if not np.isfinite(values).all():
            at = table.time[int(np.argmin(np.isfinite(values)))]
            raise InputError(
                f"the model's output {shown(name)} is not finite from {at:g} s on: nothing is written"
            )
    units = {c.name: c.unit for c in network.outputs}
    write_table(out, Table(time=table.time, columns=outputs, source=network.name, units=units))
    tell(f"{len(table.time)} samples of {', '.join(outputs)} in {out}")


@app.command(cls=_SeveralValues)
def diagnose(
    data: Annotated[
        list[Path],
        typer.Argument(
            help="Measured records: CSV, Parquet, .mat, .mf4, with time and the model's channels; several loggers' files of "
            "one run joined by +: body.csv+wheel.mf4."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder for the result.", metavar="DIR")],
    model: Annotated[
        str | None,
        typer.Option(
            help="The model as you believe it: a file, a built-in network, or a unit for co-simulation (.fmu). Required, except "
            "for a folder of cases with a model.json each.",
            autocompletion=_offer(_networks),
        ),
    ] = None,
    validate: Annotated[
        list[Path] | None,
        typer.Option(
            help="Records to choose and judge by, one or several; without them some of DATA are held out.",
            metavar="DATA...",
        ),
    ] = None,
    rename: RenameOption = None,
    unit: UnitOption = None,
    map_file: MapOption = None,
    columns: ColumnsOption = None,
    accept: Annotated[
        list[str] | None,
        typer.Option(
            help="A check of the data that only warns: held, jumps, magnitude, length, silent, copies, all.",
            metavar="CHECK",
        ),
    ] = None,
    elements: Annotated[
        list[Path] | None,
        typer.Option(help="A Python file of yours that registers elements: it is run.", metavar="FILE.py"),
    ] = None,
    uncertain: Annotated[
        list[str] | None,
        typer.Option(
            help="Relative standard deviation of a parameter, which is then refitted; overrides the model file.",
            metavar="PARAMETER=SHARE",
        ),
    ] = None,
    trust_fmu: Annotated[
        bool, typer.Option("--trust-fmu", help="Run the compiled code in an .fmu, with your rights.")
    ] = False,
    cut: Annotated[
        str | None,
        typer.Option(
            help="No road measured: a node with an accelerometer, whose motion drives everything above it; everything below "
            "(tyre, road) is left out.",
            metavar="NODE",
        ),
    ] = None,
    unmeasured: Annotated[
        str | None,
        typer.Option(
            help="No road measured: the input that nobody measured, taken as white in velocity in the likelihood of a linear "
            'model. A model file says so with "measured": false.',
            metavar="INPUT",
        ),
    ] = None,
    max_seconds: Annotated[
        float,
        typer.Option(help="With --unmeasured: limit of processor time [s].", min=1.0, metavar="SECONDS"),
    ] = 120.0,
    max_lag: Annotated[
        float, typer.Option(help="Largest offset between the clocks of two loggers [s].", min=0.0)
    ] = 0.5,
    jobs: Annotated[int, typer.Option(help="Processes of this machine, for a folder of cases.", min=1)] = 1,
    engine: Annotated[
        str,
        typer.Option(
            "--engine", help="Where a folder of cases is diagnosed: local, or ray for a Ray cluster."
        ),
    ] = "local",
    seed: Annotated[int, typer.Option(help="Seed of the resampling that gives the confidence.", min=0)] = 0,
    json_file: JsonOption = None,
) -> None:
    """Find where a model and measurements disagree, and which physical effect is missing.

    Writes DIR/diagnosis.json, DIR/model.json (the model with what was found), DIR/report.html and its figures. Without
    --validate whole records of DATA are held out to judge by, or the last third of a single one. An .fmu is compared and
    its parameters refitted (DIR/parameters.ssv); it shows no inside, so no effect and no place is named. A folder with
    records, validation*.csv to judge by and model.json is one case. A folder of cases (a folder each,
    VEHICLE_2024-05-01) is diagnosed case by case and goes on where it stopped: DIR/fleet.html.

    Without a measured road, --cut compares what stands above a node with an accelerometer, and --unmeasured refits the
    model by its likelihood (DIR/unmeasured.json, DIR/model.json).

    Example: isd-gym diagnose test1.csv test2.csv --model rig.json --out found

    Without a road: isd-gym diagnose drive.csv --model car.json --cut wheel --out found
    """
    from . import elements as el
    from .discrepancy import SearchSettings
    from .discrepancy import diagnose as run
    from .loggers.records import records_of
    from .network import Network
    from .network import cut as cut_at
    from .report import check_target

    check_file(json_file)
    if len(data) == 1 and data[0].is_dir() and not validate:
        from .fleet import case_itself

        case = case_itself(data[0], model)
        if case is not None:  # a folder that holds one case
            data, validate = [*map(Path, case.data)], [*map(Path, case.validate)]
            model = model or case.model
    if len(data) == 1 and data[0].is_dir():
        if validate or rename or unit or columns or elements or cut or unmeasured or uncertain:
            raise InputError(
                "a folder of cases takes --model, --map, --accept, --max-lag, --seed, --jobs and --engine only"
            )
        steps = {"map": map_file and str(map_file), "accept": accept or [], "seed": seed, "max_lag": max_lag}
        _diagnose_fleet(data[0], out, model, steps, jobs, engine, json_file)
        return
    if model is None:
        raise InputError("--model says which model the records are compared with")
    shares = _shares(uncertain)
    _check_records(data, validate or [])
    about = {
        "Model": model,
        "Data": ", ".join(map(str, data)),
        **({"Validation": ", ".join(map(str, validate))} if validate else {}),
    }
    if Path(model).suffix.lower() == ".fmu":
        for option, given in (
            ("--elements", elements),
            ("--cut", cut),
            ("--unmeasured", unmeasured),
            ("--map", map_file),
        ):
            if given:
                raise InputError(f"{option} wants a network (isd-model/1): an FMU shows no inside")
        check_target(out)
        named = {
            "rename": pairs(rename, "--rename", "COLUMN=CHANNEL"),
            "units": pairs(unit, "--unit", "CHANNEL=UNIT"),
            "header": column_names(columns),
        }
        result = _diagnose_unit(model, trust_fmu, data, validate or [], accept or [], named, shares)
        _print_diagnosis(result, json_file, _report(result, out, about))
        return
    for file in elements or ():
        el.register_file(file)
    network = Network.load(model)
    if shares:
        network = replace(network, uncertainty={**network.uncertainty, **shares})
    options = channel_names(network, rename, unit, map_file, columns)
    if "by" in options:
        network = options["by"].measured(network)
    unmeasured = unmeasured or next((c.name for c in network.inputs if not c.measured and cut is None), None)
    if unmeasured is not None:
        check_channels([unmeasured], [c.name for c in network.inputs], "--unmeasured")
        if cut is not None:
            raise InputError("--cut leaves the road out, --unmeasured takes it as noise: one of them")
        files = [*data, *(validate or [])]
        _identify(files, network, unmeasured, accept or [], options, max_seconds, out, json_file)
        return
    check_target(out)
    part = network if cut is None else cut_at(network, cut)
    wanted = (*part.inputs, *part.outputs)
    with lines() as say:
        fitted, held = (
            [r for f in files for r in records_of(f, network, wanted, **options)]
            for files in (data, validate or [])
        )
        result = run(
            fitted,
            network,
            validate=held,
            accept=accept or (),
            progress=say,
            seed=seed,
            cut=cut,
            settings=SearchSettings(max_lag=max_lag),
        )
        say("writing the report")
        page = _report(result, out, about | {"Seed": str(seed)})
    _print_diagnosis(result, json_file, page)


def _identify(
    data: list[Path],
    network: Any,
    road: str,
    accept: list[str],
    options: dict[str, Any],
    max_seconds: float,
    out: Path,
    json_file: Path | None,
) -> None:
    """A model without its road, in the likelihood."""
    from .discrepancy.unknown_input import FOLDER, identify
    from .files import check_folder
    from .loggers.records import outputs_of, records_of

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
        found = identify(records, network, road=road, accept=accept, max_seconds=max_seconds)
    found.save(out)
    write_json(json_file, found.to_dict())
    for line in found.lines():
        typer.echo(line)


def _diagnose_fleet(
    folder: Path,
    out: Path,
    model: str | None,
    options: dict[str, Any],
    jobs: int,
    engine: str,
    json_file: Path | None,
) -> None:
    """Every case of a folder; the table over all. The exit status is 1 where one has no result."""
    from .fleet import check, fleet, write_page
    from .fleet import lines as told

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
    for line in told(merged, min(max(60, _columns()), 140)):
        typer.echo(line)
    try:
        page: Path | ReportError = write_page(merged, out)
    except ReportError as error:
        page = error
    _print_page(page, "page")
    if outcome.failed:
        raise typer.Exit(1)


def _columns() -> int:
    import shutil

    return shutil.get_terminal_size((80, 24)).columns if sys.stdout.isatty() else 80


def _shares(uncertain: list[str] | None) -> dict[str, float]:
    """The values of --uncertain as numbers."""
    out = {}
    for name, text in pairs(uncertain, "--uncertain", "PARAMETER=SHARE").items():
        try:
            out[name] = float(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
        except ValueError:
            raise InputError(f"--uncertain {name}: wants a share such as 0.05, not {shown(text)}") from None
    return out


def _diagnose_unit(
    model: str,
    trust: bool,
    data: list[Any],
    validate: list[Any],
    accept: list[str],
    named: dict[str, Any],
    shares: dict[str, float],
) -> Any:
    """The diagnosis of a unit for co-simulation, with the warning that its code asks for."""
    from .cosimulation import WHY_TRUST, Unit
    from .data import read_table
    from .discrepancy import diagnose_unit

    if trust and os.path.exists(model):
        typer.echo(f"isd-gym: warning: {model}: {WHY_TRUST}", err=True)
    with lines() as say, Unit(model, trust=trust) as unit:
        known = [p.name for p in (*unit.model.inputs, *unit.model.outputs)]
        check_channels(named["rename"].values(), ["time", *known], "--rename")
        data, validate = ([read_table(f, **named) for f in files] for files in (data, validate))
        return diagnose_unit(data, unit, validate=validate, accept=accept, uncertainty=shares, progress=say)


def _report(result: Any, out: Path, about: dict[str, str]) -> Path | ReportError:
    """Write the results and the report; return its page, or why it could not be drawn."""
    from .report import write_report

    try:
        return write_report(result, out, about=about)
    except ReportError as error:
        return error


def _print_page(page: Path | ReportError, what: str) -> None:
    """The last line of a command: where its page is, or why there is none, which makes the exit status 1."""
    if isinstance(page, ReportError):
        typer.echo(f"isd-gym: {page}", err=True)
        raise typer.Exit(1)
    typer.echo(f"{what}: {page}", err=True)


def _print_diagnosis(result: Any, json_file: Path | None, page: Path | ReportError) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    console = printer()
    console.print(result.summary)
    for lag in getattr(result, "lags", ()):
        console.print(plain(str(lag), 200))
    stages = [s for s in ("before", "refit", "after", "noise_floor") if s in result.gap]
    console.print("\nRMS error on held-out data, relative to the measured signal's deviation:")
    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    made.add_column("channel", no_wrap=True)
    for stage in stages:
        made.add_column(stage.replace("_", " "), justify="right", no_wrap=True)
    for channel in result.gap["refit"]:
        made.add_row(Text(plain(channel, 40)), *(f"{100 * result.gap[s][channel]:.1f} %" for s in stages))
    console.print(made)
    if result.closed is not None and result.closed >= 0:
        console.print(f"{100 * result.closed:.1f} % of the gap that can be closed is closed.")
    write_json(json_file, result.to_dict())
    _print_page(page, "report")


@app.command()
def show(
    policy: Annotated[
        str, typer.Argument(help="A policy, named as for score.", autocompletion=_offer(_policies))
    ],
    against: Annotated[
        str | None, typer.Option(help="A second policy beside the first, on the same road.", metavar="POLICY")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Write a film instead of opening a window: .mp4 or .gif.", metavar="FILE"),
    ] = None,
    road: Annotated[
        str,
        typer.Option(
            help="paper, paper-printed, flat, A ... H, bump, pothole, sweep, a CSV file, C+bump.",
            autocompletion=_offer(_roads),
        ),
    ] = "paper",
    speed: Annotated[float, typer.Option(help="Speed [m/s].", min=0.1)] = 20.0,
    seconds: Annotated[float, typer.Option(help="How long to drive [s].", min=0.1)] = 10.0,
    seed: Annotated[int, typer.Option(help="Seed of the road, as in score.", min=0)] = 0,
    preview: Annotated[
        float | None,
        typer.Option(
            help="Road ahead [s] that policies with a preview see (mpc-friction-preview, ...).", min=0.0
        ),
    ] = None,
    network: Annotated[
        str,
        typer.Option(help="The plant: a built-in network or a model file.", autocompletion=_offer(_networks)),
    ] = "quarter-car-isd",
    trust_zip: TrustOption = False,
) -> None:
    """Watch a policy drive, alone or beside another, live or as a film.

    Half and full cars (--network half-car-isd) are shown from the side, full cars also from behind.

    Example: isd-gym show mpc --against passive --out mpc.mp4
    """
    from .network import Network
    from .policies import find
    from .road import road as find_road
    from .show import check_window, film, live

    check_file(out)
    if out is not None and out.suffix.lower() not in (".mp4", ".gif"):
        raise InputError(f"cannot write a film to '{out}': end the name in .mp4 or .gif")
    plant = Network.load(network)
    ahead: dict[str, Any] = {} if preview is None else {"preview": preview}
    if plant.bodies:
        ahead["speed"] = speed
    names = [name for name in (policy, against) if name is not None]
    entries = [find(name, plant, speed=speed, trust_zip=trust_zip, **ahead) for name in names]
    drive: dict[str, Any] = {"road": find_road(road), "speed": speed, "seconds": seconds, "seed": seed}
    if out is None:
        check_window()
        with progress() as update:
            warm_up(update)
        live(entries, plant, **drive)
        return
    with progress() as update:
        warm_up(update)
        film(entries, plant, out, progress=lambda share: update("filming", share), **drive)
    typer.echo(f"{seconds:g} s of {' and '.join(e.name for e in entries)} in {out}")


@app.command()
def export(
    model: Annotated[
        str,
        typer.Argument(
            help="A model file (isd-model/1) or a built-in network.", autocompletion=_offer(_networks)
        ),
    ],
    fmu: Annotated[
        Path, typer.Option("--fmu", help="The file to write; its name ends in .fmu.", metavar="FILE")
    ],
    step: Annotated[float, typer.Option(help="Largest physics step [s].", min=1e-6)] = 1e-3,
) -> None:
    """Export a model as an FMU for co-simulation (FMI 2.0).

    The unit calls this package's kernel: it runs where Python finds isd_gym. Inputs, outputs and parameters keep their
    names and units.

    Example: isd-gym export quarter-car-isd --fmu car.fmu
    """
    from .fmu import export_fmu
    from .network import Network

    network = Network.load(model)
    export_fmu(network, fmu, step=step)

    def number_of(things: Sized, one: str) -> str:
        return f"{len(things)} {one}{'s' if len(things) != 1 else ''}"

    tell(
        f"{number_of(network.inputs, 'input')}, {number_of(network.outputs, 'output')} and "
        f"{number_of(network.parameters, 'parameter')} of {network.name} in {fmu}"
    )


@app.command()
def policies(json_file: JsonOption = None) -> None:
    """List what can be scored and shown by name.

    A trained policy's folder or .zip can be scored and shown, too, as can the policies of other packages.

    Example: isd-gym policies
    """
    from .policies import available

    known = available()
    write_json(json_file, {"policies": known})
    _list(known)


def _list(rows: Mapping[str, str]) -> None:
    """Names and what they are, in as many lines as the terminal's width takes."""
    from rich.table import Table

    made = Table.grid(padding=(0, 2))
    made.add_column(no_wrap=True)
    made.add_column()
    for name, text in rows.items():
        made.add_row(name, text)
    printer().print(made)


@app.command()
def networks(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Print this one as JSON: a built-in network or a model file.",
            autocompletion=_offer(_networks),
        ),
    ] = None,
    draw: Annotated[
        Path | None,
        typer.Option("--draw", help="Draw it instead of printing it: .svg, .png or .pdf.", metavar="FILE"),
    ] = None,
) -> None:
    """List the built-in networks, print one to start your own from, or draw one.

    A drawing has the nodes, the elements with their values, and the inputs and outputs.

    Example: isd-gym networks quarter-car-isd --draw car.svg
    """
    from .network import Network, builtin_networks

    if draw is not None:
        from .report.schematic import check_suffix
        from .report.schematic import draw as sketch

        if name is None:
            raise InputError("--draw wants a network: isd-gym networks NAME --draw FILE")
        check_file(draw, name)
        check_suffix(draw)
        sketch(Network.load(name)).save(draw)
        typer.echo(f"{name} drawn to {draw}")
        return
    if name is not None:
        typer.echo(Network.load(name).dumps(), nl=False)
        return
    _list({built: Network.load(built).description for built in builtin_networks()})


def _plug_in() -> None:
    """Commands of the packages above this one (train, reproduce, ...): entry points `isd_gym.commands`."""
    typed = os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS")  # a shell that completes
    words = typed.split()[1:] if typed else sys.argv[1:]
    wanted = next((a for a in words if not a.startswith("-")), None)
    for point in plugins(COMMANDS):
        # imported only when it is to run; --help and "did you mean" need its name and first sentence alone
        app.command(name=point.name)(point.load() if point.name == wanted else _mention(point))


def _mention(point: EntryPoint) -> Callable[[], None]:
    """A stand-in for a command with its docstring, read from the source without importing what the command needs."""
    import ast
    from importlib.util import find_spec

    def stand_in() -> None: ...

    package, *parts = point.module.split(".")
    try:
        spec = find_spec(package)  # of a package at the top: nothing is run
        folder = Path(((spec and spec.submodule_search_locations) or [""])[0])
        module = folder.joinpath(*parts)
        source = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
        tree = ast.parse(source.read_text(encoding="utf-8"))
        found = [f for f in tree.body if isinstance(f, ast.FunctionDef) and f.name == point.attr]
        stand_in.__doc__ = ast.get_docstring(found[0])
    except (OSError, ValueError, SyntaxError, IndexError):
        stand_in.__doc__ = f"Of {point.module}."
    return stand_in


def main() -> None:
    """Run the command line; bad input is one line on stderr and exit status 2, Ctrl-C one and 130."""
    stopped = _listen()
    try:
        _plug_in()
        code = app(prog_name="isd-gym", standalone_mode=False)
        sys.stdout.flush()
    except InputError as error:
        typer.echo(f"isd-gym: {error}", err=True)
        code = 2
    except KeyboardInterrupt:
        code = 130
    except OSError as error:
        code = 130 if stopped else _broken(error)
    except Exception as error:
        if stopped:  # what a compiler says whose callback was broken off
            code = 130
        elif "cannot cache function" in str(
            error
        ):  # a program that was installed read-only, by a user without a home
            typer.echo(
                "isd-gym: nowhere to keep the compiled kernel: set NUMBA_CACHE_DIR to a folder that can be written",
                err=True,
            )
            code = 2
        elif hasattr(error, "format_message"):  # of the parser of the command line, whichever typer brings
            code = _explain(error)
        else:
            raise
    if code == 130:
        typer.echo("isd-gym: stopped", err=True)
    sys.exit(code)


def _broken(error: OSError) -> int:
    """A reader that has gone is no news; a full disk, a file that may not be read is one line."""
    if not isinstance(error, BrokenPipeError):
        name = f": '{error.filename}'" if error.filename else ""
        typer.echo(f"isd-gym: {plain(f'{error.strerror or error}{name}', 400)}", err=True)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nothing more can be told there
    return 1


def _listen() -> list[int]:
    """Ctrl-C, also where a compiler's callback swallows it; the list holds something once it was pressed."""
    import signal
    import threading
    from _thread import interrupt_main

    stopped: list[int] = []
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return stopped  # ignored, as in the background of a shell

    def stop(number: int, frame: Any) -> None:
        stopped.append(number)
        raise KeyboardInterrupt

    def repeat() -> None:
        if hasattr(signal, "pthread_kill"):  # wakes what sleeps or waits, too
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        else:
            interrupt_main()

    usual = sys.unraisablehook

    def swallowed(unraisable: Any) -> None:
        if not stopped:
            usual(unraisable)
        elif isinstance(unraisable.exc_value, KeyboardInterrupt):
            again = threading.Timer(0.2, repeat)  # out of the callback
            again.daemon = True
            again.start()

    signal.signal(signal.SIGINT, stop)
    sys.unraisablehook = swallowed
    return stopped


def _explain(error: Any) -> int:
    """What is wrong with a command line, in one line; the help where nothing was asked for."""
    context, text = getattr(error, "ctx", None), " ".join(error.format_message().split())
    if not sys.argv[1:]:
        error.show()
    else:
        known = {c.name or getattr(c.callback, "__name__", "") for c in app.registered_commands}
        path = " ".join(["isd-gym", *(a for a in sys.argv[1:2] if a in known)])
        path = context.command_path if context is not None else path
        typer.echo(f"{path}: {plain(text, 400)} (see {path} --help)", err=True)
    return int(error.exit_code)


if __name__ == "__main__":
    main()
