"""Tables of a score on the terminal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .._common.errors import plain, shown
from ._columns import print_columns
from .console import printer


def _sentence(result: Any) -> str:
    """Return one sentence about the policy with the smallest cost."""
    rows = [row for row in result.policies if row["policy"] != "passive"]
    if not rows:
        return "Passive alone: name a policy beside it."
    best = min(rows, key=lambda row: row["cost"]["value"])
    q = best["cost"]
    if "change" not in q:
        return f"{plain(best['policy'], 40)} has the smallest cost."
    interval = f" [{100 * q['low']:+.1f}, {100 * q['high']:+.1f}]" if result.episodes > 1 else ""
    return f"{plain(best['policy'], 40)}: J {100 * q['change']:+.1f} %{interval} against passive."


def print_score(result: Any, *, full: bool) -> None:
    """Print the table of a score and a sentence; with `full` all tables, the paper's tables and the bounds."""
    from rich.text import Text

    from ..benchmark.scoring import PAPER, corner_measures

    console = printer()
    narrow = console.width < 106

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
        f"{result.drives}{sight}; RMS, change against passive{interval}"
    )
    console.print(title)
    if result.model is not None:
        factors = ", ".join(f"{plain(name)} x {factor:.4g}" for name, factor in result.shift.items())
        console.print(
            f"controllers have the model {plain(result.model.name)}; vehicle against it: {factors or 'other elements'}"
        )
    names = {"policy": [Text(plain(row["policy"], 40)) for row in result.policies]}
    tables: list[Any] = [(main,)]
    if full:
        tables = [(main,), (motion,), (share, work)] if narrow else [(main, share), (motion, work)]
        tables.append(corners)
    for parts in tables:
        print_columns(
            names,
            *({head: [say(row) for row in result.policies] for head, say in part.items()} for part in parts),
        )
    if not full:
        console.print(_sentence(result) + " More: --full.")
        return
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
