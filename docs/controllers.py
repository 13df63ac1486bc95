"""Tables of the controllers' page: times, solvers and robustness, from the benchmarks' files."""

from __future__ import annotations

from typing import Any

from table import markdown, signed


def _power(value: float) -> str:
    return "below 1e-12" if value < 1e-12 else f"{value:.0e}".replace("e-0", "e-")


def times(found: dict[str, Any]) -> str:
    """Time per step of every controller on every road."""
    rows = []
    for label, row in found["steps"].items():
        drive, road = label.rsplit(", road ", 1)
        name, comma, rest = drive.partition(",")
        cells = [
            f"{row[clock][q]:.3f}"
            for clock in ("own", "cpu", "wall")
            for q in ("median", "p99_9")
        ]
        rows.append([f"`{name}`{comma}{rest}", road, *cells])
    heads = "controller | road | own: median | 99.9 % | cpu: median | 99.9 % | wall: median | 99.9 %"
    steps = next(iter(found["steps"].values()))["steps"]
    what = f"Milliseconds per step, {steps} steps of seed {found['seed']}, {found['replays']} replays; "
    what += f"{found['machine']}, a machine that was busy with other work."
    return f"{what}\n\n{markdown(heads, rows, 'lrrrrrrr')}"


def solvers(found: dict[str, Any]) -> str:
    """Time and errors of every solver on the recorded programs."""
    rows = []
    for label, case in found["programs"].items():
        what = f"{label}: {case['problems']} of {case['variables']} variables"
        for name, solver in case["solvers"].items():
            rows.append(
                [
                    what if name == "osqp" else "",
                    name,
                    *(f"{1e3 * solver['own'][q]:.0f}" for q in ("median", "p99_9")),
                    _power(solver["objective_error"]),
                    _power(solver["first_move_error"]["max"]),
                    _power(solver["limit_passed"]),
                    str(solver["failures"]),
                ]
            )
    heads = "programs | solver | µs, median | 99.9 % | error of the objective | of the first move [A] | limits passed by | failures"
    loop = found["closed_loop"]
    versions = ", ".join(f"{k} {v}" for k, v in found["versions"].items())
    costs = ", ".join(f"{k} {v['cost']:.4f}" for k, v in loop["solvers"].items())
    what = f"The programs of the drives above, in their order; least time of {found['replays']} replays, greatest errors; {versions}."
    closed = f"Cost J of `mpc` in closed loop, {loop['episodes']} roads of {loop['duration']:g} s: {costs}."
    return "\n\n".join([what, markdown(heads, rows, "lrrrrrrr"), closed])


def robustness(found: dict[str, Any]) -> str:
    """Change of J of every controller in every condition."""
    names = [row["policy"] for row in found["conditions"][0]["policies"]]
    rows, wrong, commands, fallbacks = [], 0, 0, 0
    for condition in found["conditions"]:
        by = {row["policy"]: row for row in condition["policies"]}
        changes = (signed(by[name]["cost"]["change"]) for name in names)
        rows.append([condition["name"], *changes])
        for row in by.values():
            counts = dict(row["commands"])
            commands += counts.pop("given")
            wrong += sum(counts.values())
            fallbacks += row["fallbacks"]
    heads = " | ".join(["", *(f"`{name}`" for name in names)])
    roads, seed = found["episodes"], found["seed"]
    what = f"Change of J against the conventional passive car [%]; {roads} roads of {found['duration']['value']:g} s, "
    what += f"seeds {seed} to {seed + roads - 1} (bump and pothole: one)."
    sums = f"Of {commands / 1e6:.1f} million commands, {wrong} were not finite, above 5 A or more than 0.5 A from the present current; "
    sums += f"{fallbacks} fallbacks."
    table = markdown(heads, rows, "l" + "r" * len(names))
    return "\n\n".join([what, table, sums])
