"""Sweeps: the items of a `Grid` run by `items`, merged to paired intervals (`isd-sweep/1`)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError
from ..._common.files import claim_folder, write_text
from ...physics.network import Network
from ...physics.road import road as find_road
from .grid import SCHEMA, Condition, Grid, belongings
from .items import key_of, run, shard, stored

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence


RESAMPLES = 4000
#: kind, mark and parts of the folder of a sweep
FOLDER = ("sweep", None, ("items", "sweep.json"))


def drive_item(
    policy: str,
    seed: int | None,
    first: int,
    episodes: int,
    duration: float,
    condition: dict[str, Any],
    files: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Run one item of a sweep.

    Args:
        policy: Name of the policy.
        seed: Seed of road 0; None for the scoring roads.
        first: Index of the first road.
        episodes: Number of roads.
        duration: Length of a road [s].
        condition: The condition, as plain data.
        files: Digests of the files that the grid's machine read.

    Returns:
        `isd_gym.benchmark.scoring.measures` of each episode, and number of fallbacks; no signals, to keep files small.

    Raises:
        InputError: A file is missing or differs on this machine.
    """
    from ...physics.cost import StageCost
    from ..policies import find
    from ..scoring import Conditions, drive, measures

    for name, digest in (files or {}).items():
        if belongings([name]).get(name) != digest:
            raise InputError(
                f"'{name}' is not here, or another than when the grid was read"
            )
    c = Condition(**condition)
    plant = c.plant()
    ahead: dict[str, Any] = {} if c.preview is None else {"preview": c.preview}
    entry = find(
        policy, plant, model=Network.load(c.model or c.network), speed=c.speed, **ahead
    )
    drives = Conditions(find_road(c.road), c.speed, episodes, seed, duration, c.sensors)
    driven = drive(entry, plant, drives, first=first, timed=0)
    found = measures(
        driven, StageCost.of(None, driven.car.axes, len(driven.car.corners))
    )
    return {
        "measures": {
            name: [float(v) for v in values] for name, (values, _) in found.items()
        },
        "units": {name: unit for name, (_, unit) in found.items()},
        "fallbacks": driven.fallbacks,
    }


def merge(grid: Grid, results: Mapping[str, Any]) -> dict[str, Any]:
    """Return the results of a sweep (`isd-sweep/1`): every quantity with its paired change.

    A policy with missing items is left out of its condition and counted in `missing`. `overall` compares the
    policies over all conditions.

    Args:
        grid: The grid.
        results: Result by key of an item.

    Returns:
        Plain data.
    """
    from ..scoring import compare

    conditions, missing = [], 0
    for condition in grid.conditions:
        rows: list[dict[str, Any]] = []
        ground: dict[str, np.ndarray] = {}
        for policy in grid.driven:
            keys = [key_of(item) for item in grid.items(condition, policy)]
            parts = [results[k] for k in keys if k in results]
            missing += len(keys) - len(parts)
            if len(parts) < len(keys) or (policy != "passive" and not ground):
                continue
            own = {
                n: np.concatenate([np.array(p["measures"][n], float) for p in parts])
                for n in parts[0]["measures"]
            }
            ground = ground or own
            row: dict[str, Any] = {"policy": policy}
            for name, values in own.items():
                row[name] = compare(name, values, ground[name], parts[0]["units"][name])
            row["fallbacks"] = sum(p["fallbacks"] for p in parts)
            if policy in grid.policies:
                rows.append(row)
        conditions.append(
            {"name": condition.name, **condition.to_dict(), "policies": rows}
        )
    return {
        "schema": SCHEMA,
        "episodes": grid.episodes,
        "seed": grid.seed,
        "duration": {"value": grid.duration, "unit": "s"},
        "conditions": conditions,
        "overall": overall(conditions, grid.policies),
        "missing": missing,
    }


def overall(
    conditions: Sequence[Mapping[str, Any]], policies: Sequence[str]
) -> list[dict[str, Any]]:
    """Compare policies over all conditions, best first; all conditions have equal weight.

    Policies with a result in every condition get the mean `change` of J, the `worst` condition, and the mean
    difference of the changes `against` each other policy. Intervals of 95 % come from a bootstrap over
    conditions with common draws.

    Args:
        conditions: Results by condition.
        policies: Names of policies.

    Returns:
        One entry per policy.
    """
    by = [
        {row["policy"]: row["cost"].get("change") for row in c["policies"]}
        for c in conditions
    ]
    whole = [
        p for p in policies if p != "passive" and all(c.get(p) is not None for c in by)
    ]
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
        rows.append(
            {
                "policy": p,
                "change": mean(changes[p]),
                "worst": worst,
                "against": against,
            }
        )
    return rows


def check_policies(grid: Grid) -> None:
    """Check before long work that every policy of a grid opens in at least one condition.

    Args:
        grid: The grid.

    Raises:
        InputError: A policy opens in none of the conditions.
    """
    from ..policies import find

    for policy in grid.policies:
        why = None
        for c in grid.conditions:
            ahead: dict[str, Any] = {} if c.preview is None else {"preview": c.preview}
            try:
                find(
                    policy, c.plant(), model=Network.load(c.model or c.network), **ahead
                )
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
) -> tuple[dict[str, Any], int]:
    """Run the unfinished items of a grid.

    Items are files in ``out/items``; the merged sweep is ``out/sweep.json``.

    Args:
        grid: The grid.
        out: Folder of the results.
        jobs: Number of processes.
        which: Shard "i/n"; None for all items.
        engine: 'local' or 'ray', see `items.run`.
        address: Address of a Ray cluster.
        progress: Called with the numbers of finished and of all items.
        say: Called with lines for the user.

    Returns:
        Merged sweep (`isd-sweep/1`), and the number of failed items.

    Raises:
        InputError: The folder cannot be written, or an argument is invalid.
    """
    items = grid.all_items()
    mine = shard(items, which)
    folder = claim_folder(out, *FOLDER) / "items"
    failed = run(
        drive_item,
        mine,
        folder,
        jobs=jobs,
        engine=engine,
        address=address,
        progress=progress,
        say=say,
    )
    merged = merge(grid, stored(items, folder))
    write_text(
        Path(out) / "sweep.json", json.dumps(merged, indent=1, allow_nan=False) + "\n"
    )
    return merged, len(failed)


def items_are(count: int) -> str:
    """Return the subject and verb of a sentence on a number of items.

    Args:
        count: Number of items.

    Returns:
        Text such as '2 items are'.
    """
    return f"{count} item is" if count == 1 else f"{count} items are"


def change_cell(
    q: Mapping[str, Any] | None, key: str = "change", digits: int = 1
) -> str:
    """Return a change with its interval in percent.

    Args:
        q: Quantity of a merged sweep; None for an empty cell.
        key: Key of the change.
        digits: Number of decimals.

    Returns:
        Text such as '-12.3 [-13.0, -11.6]'.
    """
    if q is None or key not in q:
        return ""
    text = f"{100 * q[key]:+.{digits}f}"
    same = q["low"] == q["high"]  # a single episode has no interval
    return (
        text
        if same
        else f"{text} [{100 * q['low']:+.{digits}f}, {100 * q['high']:+.{digits}f}]"
    )


def rows(merged: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return the table of a merged sweep: names of policies, and rows of texts with the change of J [%] per condition.

    Args:
        merged: The merged sweep.

    Returns:
        Names, and rows.
    """
    names = list(
        dict.fromkeys(
            row["policy"] for c in merged["conditions"] for row in c["policies"]
        )
    )
    names = [n for n in names if n != "passive"]
    out = []
    for c in merged["conditions"]:
        by = {row["policy"]: row["cost"] for row in c["policies"]}
        if any(name in by for name in names):  # skips conditions without results
            out.append([c["name"], *(change_cell(by.get(name)) for name in names)])
    by = {row["policy"]: row for row in merged["overall"]}
    if by:
        out.append(
            [
                f"all {len(merged['conditions'])}",
                *(
                    change_cell(by[n]["change"], "value") if n in by else ""
                    for n in names
                ),
            ]
        )
        out.append(
            [
                "the worst",
                *(
                    f"{100 * by[n]['worst']['change']:+.1f}" if n in by else ""
                    for n in names
                ),
            ]
        )
    return names, out
