"""Sweeps: the items of a `Grid` done by `engine`, merged to paired intervals (`isd-sweep/1`)."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .engine import Outcome, Task, shard, stored
from .engine import run as run_tasks
from .errors import InputError
from .files import claim_folder, write_text
from .grid import SCHEMA, Condition, Grid, belongings
from .inputs import is_number
from .network import Network

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

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


def items_are(count: int) -> str:
    return f"{count} item is" if count == 1 else f"{count} items are"


def change_cell(q: Mapping[str, Any] | None, key: str = "change", digits: int = 1) -> str:
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
            out.append([c["name"], *(change_cell(by.get(name)) for name in names)])
    by = {row["policy"]: row for row in merged["overall"]}
    if by:
        out.append(
            [
                f"all {len(merged['conditions'])}",
                *(change_cell(by[n]["change"], "value") if n in by else "" for n in names),
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
        text += ["", f"{items_are(merged['missing'])} missing."]
    return "\n".join(text) + "\n"
