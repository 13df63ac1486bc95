"""Write the tables of the controllers' page from the benchmarks' files: ``python docs/controllers.py``."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "explanation" / "baselines.md"
SOURCES = {"times": "mpc.json", "solvers": "mpc.json", "robustness": "robustness.json"}


def _table(heads: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(heads) + " |", "|---" + "|---:" * (len(heads) - 1) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def _signed(share: float) -> str:
    return f"{100 * share:+.1f}".replace("-", "−")


def _power(value: float) -> str:
    return "below 1e-12" if value < 1e-12 else f"{value:.0e}".replace("e-0", "e-")


def times(found: dict[str, Any]) -> str:
    heads = [
        "controller",
        "road",
        "own: median",
        "99.9 %",
        "cpu: median",
        "99.9 %",
        "wall: median",
        "99.9 %",
    ]
    rows = []
    for label, row in found["steps"].items():
        name, road = label.rsplit(", road ", 1)
        cells = [
            f"{row[k][q]:.3f}"
            for k in ("own", "cpu", "wall")
            for q in ("median", "p99_9")
        ]
        rows.append(
            [f"`{name.split(',')[0]}`{name[len(name.split(',')[0]) :]}", road, *cells]
        )
    what = (
        f"Milliseconds per step, {next(iter(found['steps'].values()))['steps']} steps of seed {found['seed']}, {found['replays']} replays; "
        f"{found['machine']}, a machine that was busy with other work."
    )
    return what + "\n\n" + _table(heads, rows)


def solvers(found: dict[str, Any]) -> str:
    heads = ["programs", "solver", "µs, median", "99.9 %", "error of the objective", "of the first move [A]", "limits passed by", "failures"]  # fmt: skip
    rows = []
    for label, case in found["programs"].items():
        for name, s in case["solvers"].items():
            rows.append(
                [
                    f"{label}: {case['problems']} of {case['variables']} variables"
                    if name == "osqp"
                    else "",
                    name,
                    *(f"{1e3 * s['own'][q]:.0f}" for q in ("median", "p99_9")),
                    _power(s["objective_error"]),
                    _power(s["first_move_error"]["max"]),
                    _power(s["limit_passed"]),
                    str(s["failures"]),
                ]
            )
    loop = found["closed_loop"]
    versions = ", ".join(f"{k} {v}" for k, v in found["versions"].items())
    costs = ", ".join(f"{k} {v['cost']:.4f}" for k, v in loop["solvers"].items())
    return (
        f"The programs of the drives above, in their order; least time of {found['replays']} replays, greatest errors; {versions}.\n\n"
        + _table(heads, rows)
        + f"\n\nCost J of `mpc` in closed loop, {loop['episodes']} roads of {loop['duration']:g} s: {costs}."
    )


def robustness(found: dict[str, Any]) -> str:
    names = [row["policy"] for row in found["conditions"][0]["policies"]]
    rows, wrong, commands, fallbacks = [], 0, 0, 0
    for condition in found["conditions"]:
        by = {row["policy"]: row for row in condition["policies"]}
        rows.append(
            [condition["name"], *(_signed(by[n]["cost"]["change"]) for n in names)]
        )
        for row in by.values():
            counts = dict(row["commands"])
            commands += counts.pop("given")
            wrong += sum(counts.values())
            fallbacks += row["fallbacks"]
    return (
        f"Change of J against the conventional passive car [%]; {found['episodes']} roads of {found['duration']['value']:g} s, seeds "
        f"{found['seed']} to {found['seed'] + found['episodes'] - 1} (bump and pothole: one).\n\n"
        + _table(["", *(f"`{n}`" for n in names)], rows)
        + f"\n\nOf {commands / 1e6:.1f} million commands, {wrong} were not finite, above 5 A or more than 0.5 A from the present current; "
        f"{fallbacks} fallbacks."
    )


def fill(page: str, folder: Path = ROOT / "benchmarks") -> str:
    """The page with every table between its marks."""
    for name, source in SOURCES.items():
        found = json.loads((folder / source).read_text(encoding="utf-8"))
        start, end = (
            f"<!-- {name}: python docs/controllers.py -->",
            f"<!-- end of {name} -->",
        )
        text = f"{start}\n\n{globals()[name](found)}\n\n{end}"
        page, count = re.subn(
            f"{re.escape(start)}.*?{re.escape(end)}",
            lambda _, t=text: t,
            page,
            flags=re.DOTALL,
        )
        if count != 1:
            raise SystemExit(f"{PAGE.name}: no place for {name}")
    return page


if __name__ == "__main__":
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
