"""Sweeps: the items of a `Grid` done by `engine`, merged to paired intervals (`isd-sweep/1`)."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from .console import counted, printer, resumable
from .engine import Outcome, Task, shard, stored
from .engine import run as run_tasks
from .errors import InputError
from .files import claim_folder, write_text
from .grid import SCHEMA, Condition, Grid, belongings
from .inputs import is_number
from .network import Network

RESAMPLES = 4000
#: kind, mark and parts of the folder of a sweep
FOLDER = ("sweep", None, ("items", "sweep.json", "sweep.md"))
COMMANDS = ("given", "not_finite", "above_limit", "above_slew")


def drive_item(
    policy: str,
    seed: int,
    episodes: int,
    duration: float,
    condition: dict[str, Any],
    files: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """One item of a sweep: what `isd_gym.scoring.measures` says of each episode, the fallbacks, and a count of the commands.

    No signals: it is small. `files`: digests of what the grid's machine read; `InputError` where this one has others.
    """
    from .cost import StageCost
    from .policies import find
    from .scoring import drive, measures

    for name, digest in (files or {}).items():
        if belongings([name]).get(name) != digest:
            raise InputError(f"'{name}' is not here, or another than when the grid was read")
    c = Condition(**condition)
    plant = c.plant()
    ahead: dict[str, Any] = {} if c.preview is None else {"preview": c.preview}
    entry = find(policy, plant, model=Network.load(c.model or c.network), speed=c.speed, **ahead)
    counts: Counter[str] = Counter()
    run = drive(
        _watched(entry, counts),
        plant,
        road=c.road,
        speed=c.speed,
        episodes=episodes,
        seed=seed,
        duration=duration,
        sensors=c.sensors,
        timed=0,
    )
    found = measures(run, StageCost.of(None, run.car.axes, len(run.car.corners)))
    return {
        "measures": {name: [float(v) for v in values] for name, (values, _) in found.items()},
        "units": {name: unit for name, (_, unit) in found.items()},
        "fallbacks": run.fallbacks,
        "commands": {name: counts[name] for name in COMMANDS},
    }


def _watched(entry: Any, counts: Counter[str]) -> Any:
    """The same policy, its commands counted: how many, and how many were not finite or not what Table 5 allows."""
    from .batch import CURRENT_LIMIT, SLEW_LIMIT
    from .driving import Entry

    def make() -> Any:
        controller: Any = entry.make()
        name = "act_batch" if hasattr(controller, "act_batch") else "act"
        act = getattr(controller, name)

        def watched(observation: np.ndarray) -> Any:
            command = act(observation)
            present = np.atleast_2d(observation)[:, 5]
            wanted = np.broadcast_to(command, present.shape)
            counts["given"] += len(wanted)
            counts["not_finite"] += int(np.sum(~np.isfinite(wanted)))
            counts["above_limit"] += int(np.sum(np.abs(wanted) > CURRENT_LIMIT + 1e-6))
            counts["above_slew"] += int(np.sum(np.abs(wanted - present) > SLEW_LIMIT + 1e-6))
            return command

        setattr(controller, name, watched)
        return controller

    return Entry(entry.name, make, entry.network)


def _sound(task: Task, result: Any) -> bool:
    """Whether `result` is what `drive_item` gives; a file of another version, or of somebody's own, is not."""
    from .scoring import MEASURES

    episodes, commands = task.arguments["episodes"], result["commands"]
    return (
        result["units"] == MEASURES
        and result["measures"].keys() == MEASURES.keys()
        and all(len(v) == episodes and all(map(is_number, v)) for v in result["measures"].values())
        and all(isinstance(n, int) for n in (result["fallbacks"], *(commands[k] for k in COMMANDS)))
    )


def merge(grid: Grid, results: Mapping[str, Any]) -> dict[str, Any]:
    """What is there of a sweep (results by the tasks' keys) as `isd-sweep/1`: every quantity with its paired change.

    A policy some of whose items are missing is left out of its condition and counted in `missing`. `overall`: see there.
    """
    from .scoring import compare

    conditions, missing = [], 0
    for condition in grid.conditions:
        rows: list[dict[str, Any]] = []
        ground: dict[str, np.ndarray] = {}
        for policy in grid.driven:
            keys = [t.key for t in grid.items(condition, policy)]
            parts = [results[k] for k in keys if k in results]
            missing += len(keys) - len(parts)
            if len(parts) < len(keys) or (policy != "passive" and not ground):
                continue
            own = {n: np.concatenate([p["measures"][n] for p in parts]) for n in parts[0]["measures"]}
            ground = ground or own
            row: dict[str, Any] = {"policy": policy}
            for name, values in own.items():
                row[name] = compare(name, values, ground[name], parts[0]["units"][name])
            row["fallbacks"] = sum(p["fallbacks"] for p in parts)
            row["commands"] = {n: sum(p["commands"][n] for p in parts) for n in COMMANDS}
            if policy in grid.policies:
                rows.append(row)
        conditions.append({"name": condition.name, **condition.to_dict(), "policies": rows})
    return {
        "schema": SCHEMA,
        "episodes": grid.episodes,
        "seed": grid.seed,
        "duration": {"value": grid.duration, "unit": "s"},
        "conditions": conditions,
        "overall": overall(conditions, grid.policies),
        "missing": missing,
    }


def overall(conditions: Sequence[Mapping[str, Any]], policies: Sequence[str]) -> list[dict[str, Any]]:
    """Policies over all conditions, best first; each condition counts the same, whatever its road.

    Policies with a result in every condition have the mean `change` of J, the `worst` condition, and the mean difference of the
    changes `against` each other policy. Intervals of 95 % come from conditions drawn with replacement, the same draws for all.
    """
    by = [{row["policy"]: row["cost"].get("change") for row in c["policies"]} for c in conditions]
    whole = [p for p in policies if p != "passive" and all(c.get(p) is not None for c in by)]
    if len(conditions) < 2 or not whole:
        return []
    changes = {p: np.array([c[p] for c in by]) for p in whole}
    draws = np.random.default_rng(0).integers(len(by), size=(RESAMPLES, len(by)))

    def mean(values: np.ndarray) -> dict[str, float]:
        low, high = np.quantile(values[draws].mean(axis=1), [0.025, 0.975])
        return {"value": float(values.mean()), "low": float(low), "high": float(high)}

    rows = []
    for p in sorted(whole, key=lambda p: float(changes[p].mean())):
        k = int(np.argmax(changes[p]))
        worst = {"condition": conditions[k]["name"], "change": float(changes[p][k])}
        against = {q: mean(changes[p] - changes[q]) for q in whole if q != p}
        rows.append({"policy": p, "change": mean(changes[p]), "worst": worst, "against": against})
    return rows


def check_policies(grid: Grid) -> None:
    """Raise `InputError` for a policy of the grid that opens in none of its conditions: before long work, not after it."""
    from .policies import find

    for policy in grid.policies:
        why = None
        for c in grid.conditions:
            ahead: dict[str, Any] = {} if c.preview is None else {"preview": c.preview}
            try:
                find(policy, c.plant(), model=Network.load(c.model or c.network), **ahead)
                break
            except InputError as error:
                why = why or error
        else:
            raise why or InputError("the grid has no conditions")


def sweep(
    grid: Grid,
    out: str | Path,
    *,
    jobs: int = 1,
    which: str | None = None,
    engine: str = "local",
    address: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> tuple[dict[str, Any], Outcome]:
    """Do what is left of a grid (or of shard `which` of it, "i/n") in folder `out`; the merged sweep, and what came of the items.

    Items are files in ``out/items``; the merged sweep is ``out/sweep.json``, and for reading ``out/sweep.md``, as far as there
    are items.
    """
    tasks = grid.tasks()
    mine = shard(tasks, which)
    folder = claim_folder(out, *FOLDER) / "items"
    outcome = run_tasks(
        mine,
        folder,
        jobs=jobs,
        engine=engine,
        address=address,
        progress=progress,
        say=say,
        sound=_sound,
    )
    merged = merge(grid, stored(tasks, folder, _sound))
    write_text(Path(out) / "sweep.json", json.dumps(merged, indent=1, allow_nan=False) + "\n")
    write_text(Path(out) / "sweep.md", table(merged))
    return merged, outcome


def _items(count: int) -> str:
    return f"{count} item is" if count == 1 else f"{count} items are"


def _cell(q: Mapping[str, Any] | None, key: str = "change", digits: int = 1) -> str:
    if q is None or key not in q:
        return ""
    text = f"{100 * q[key]:+.{digits}f}"
    same = q["low"] == q["high"]  # one episode has no interval
    return text if same else f"{text} [{100 * q['low']:+.{digits}f}, {100 * q['high']:+.{digits}f}]"


def rows(merged: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """The table of a merged sweep: its policies, and a row of texts for each condition and for all, change of J [%]."""
    names = list(dict.fromkeys(row["policy"] for c in merged["conditions"] for row in c["policies"]))
    names = [n for n in names if n != "passive"]
    out = []
    for c in merged["conditions"]:
        by = {row["policy"]: row["cost"] for row in c["policies"]}
        if any(name in by for name in names):  # else nothing of it is done yet
            out.append([c["name"], *(_cell(by.get(name)) for name in names)])
    by = {row["policy"]: row for row in merged["overall"]}
    if by:
        out.append(
            [
                f"all {len(merged['conditions'])}",
                *(_cell(by[n]["change"], "value") if n in by else "" for n in names),
            ]
        )
        out.append(
            ["the worst", *(f"{100 * by[n]['worst']['change']:+.1f}" if n in by else "" for n in names)]
        )
    return names, out


def table(merged: Mapping[str, Any]) -> str:
    """The merged sweep as Markdown."""
    names, lines = rows(merged)
    seeds = f"seeds {merged['seed']} to {merged['seed'] + merged['episodes'] - 1}"
    text = [
        f"Change of J against the conventional passive car [%], 95 % paired intervals; {merged['episodes']} roads of "
        f"{merged['duration']['value']:g} s, {seeds}.",
        "",
        "| " + " | ".join(["condition", *(f"`{n}`" for n in names)]) + " |",
        "|---" + "|---:" * len(names) + "|",
        *("| " + " | ".join(line).replace("-", "−") + " |" for line in lines),
    ]
    if merged["missing"]:
        text += ["", f"{_items(merged['missing'])} missing."]
    return "\n".join(text) + "\n"


def command(
    grid: Annotated[
        str,
        typer.Argument(
            help="The grid: policies, conditions, roads (TOML or JSON), or a built-in one: robust."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option("--out", help="Folder of the results; what is in it is not done again.", metavar="DIR"),
    ],
    jobs: Annotated[int, typer.Option("--jobs", help="Processes of this machine.", min=1)] = 1,
    which: Annotated[
        str | None,
        typer.Option(
            "--shard", help="Run only every N-th item: 0/8 ... 7/8 in an array of 8 jobs.", metavar="I/N"
        ),
    ] = None,
    engine: Annotated[
        str, typer.Option("--engine", help="Where the items run: local, or ray for a Ray cluster.")
    ] = "local",
    address: Annotated[
        str | None,
        typer.Option("--address", help="Address of the Ray cluster; the one of this machine unless given."),
    ] = None,
) -> None:
    """Drive policies through a grid of conditions, on many cores or machines; called again it goes on where it stopped.

    Prints the change of J against the passive car of every condition with its 95 % paired interval, and writes it to
    DIR/sweep.json and DIR/sweep.md. The exit status is 1 where something is missing.

    Example: isd-gym sweep grid.toml --out runs/sweep --jobs 2
    """
    made = Grid.load(grid)
    check_policies(made)
    with resumable(), counted("items") as progress:
        merged, outcome = sweep(
            made,
            out,
            jobs=jobs,
            which=which,
            engine=engine,
            address=address,
            progress=progress,
            say=lambda text: typer.echo(text, err=True),
        )
    _print(merged)
    if outcome.failed:
        typer.echo(f"{_items(len(outcome.failed))} missing; the same line tries again", err=True)
        raise typer.Exit(1)
    if merged["missing"] and which is None:
        typer.echo(f"{_items(merged['missing'])} missing", err=True)
        raise typer.Exit(1)


def _print(merged: Mapping[str, Any]) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from .errors import plain

    names, lines = rows(merged)
    console = printer()
    # a figure is never cut: in a narrow console the interval goes on the line below the figure
    wide = [max((len(line[k + 1]) for line in lines), default=0) for k in range(len(names))]
    room = 34 + sum(w + 4 for w in wide) <= console.width
    made = Table(box=box.SIMPLE_HEAD, title="change of J against passive [%]", title_justify="left")
    made.add_column("condition", overflow="fold")
    for name in names:
        made.add_column(Text(plain(name, 40)), justify="right", overflow="fold")
    for first, *cells in lines:
        made.add_row(Text(plain(first, 60)), *(Text(c if room else c.replace(" [", "\n[")) for c in cells))
    if lines:
        console.print(made)
    for row in merged["overall"][:1]:
        for rival, q in row["against"].items():
            console.print(
                f"{plain(row['policy'], 40)} against {plain(rival, 40)}: {_cell(q, 'value', 2)} points of J",
                style="dim",
            )
    if merged["missing"]:
        typer.echo(f"{_items(merged['missing'])} not there yet")


def warm() -> None:
    """Compile the kernel of simulations, policies and environments, once, into the cache of this machine (or NUMBA_CACHE_DIR).

    On a fresh node the first step otherwise costs tens of seconds, in every worker at once.

    Example: isd-gym warm
    """
    import time

    from .policies import find
    from .scoring import drive
    from .simulate import simulate

    def ready(what: str, begin: float) -> None:
        typer.echo(f"{what}: ready after {time.perf_counter() - begin:.1f} s")

    plant = Network.load("quarter-car-isd")
    # the kernel with every law: what a model of one's own asks for, and the diagnosis
    more = plant.with_element(
        {"name": "more", "type": "cubic_stiffness", "between": ["body", "wheel"], "stiffness": 1.0}
    )
    times = np.linspace(0.0, 0.05, 51)
    for what, network in (("simulation", plant), ("simulation with every law", more)):
        begin = time.perf_counter()
        simulate(network, times, {c.name: 0.0 * times for c in network.inputs})
        for episodes in (1, 2):
            drive(find("passive", network), network, episodes=episodes, duration=0.05)
        ready(what, begin)
    for name in ("lqg-preview", "mpc-friction", "mpc"):
        begin = time.perf_counter()
        for episodes in (1, 2):
            drive(
                find(name, plant),
                plant,
                episodes=episodes,
                duration=0.05,
                sensors=Condition(noise=1.0, road_error=1e-3).sensors,
            )
        ready(name, begin)
