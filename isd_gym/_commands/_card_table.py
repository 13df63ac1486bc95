"""A track of a benchmark card on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from .._common.errors import plain
from ._columns import print_columns
from .console import printer

if TYPE_CHECKING:
    pass


def print_track(
    card: Mapping[str, Any], name: str, scores: Sequence[Mapping[str, Any]] = ()
) -> None:
    """Print a track, best first, and the comparisons of each submitted policy."""
    from rich.text import Text

    from ..benchmark.cards import ranking

    rows = ranking(card, name, scores)
    console = printer()
    gap = "\n" if console.width < 98 else " "

    def change(q: Mapping[str, Any]) -> str:
        if not q.get("change"):
            return ""
        return f"{100 * q['change']:+.1f}{gap}[{100 * q['low']:+.1f}, {100 * q['high']:+.1f}]"

    console.print(
        f"{card['environment']} of {card['date']}, {name}: change against passive [%]"
    )
    print_columns(
        {
            "": [f"{place:2}" for place in range(1, len(rows) + 1)],
            "policy": [
                Text(plain(r["policy"], 40), style="bold" if r["submitted"] else "")
                for r in rows
            ],
        },
        {
            head: [f"{100 * r[key]['value']:.2f}" if key in r else "" for r in rows]
            for head, key in (
                ("beyond 80 mm\n% of time", "travel_exceedance"),
                ("wheel lifts\n% of time", "wheel_lift"),
            )
            if any(key in r for r in rows)
        },
        {
            "cost J": [f"{r['cost']['value']:.4f}" for r in rows],
            "change of J": [change(r["cost"]) for r in rows],
        },
        {
            head: [
                f"{100 * r[key]['change']:+.1f}" if "change" in r[key] else ""
                for r in rows
            ]
            for head, key in (
                ("accel-\neration", "body_acceleration_rms"),
                ("travel", "suspension_travel_rms"),
                ("tyre\nload", "tyre_load_rms"),
            )
        },
    )
    for row in rows:
        for rival, q in row.get("against", {}).items():
            if "change" not in q:
                continue
            console.print(
                f"{plain(row['policy'], 40)} against {plain(rival, 40)}: {100 * q['change']:+.2f} % of J "
                f"[{100 * q['low']:+.2f}, {100 * q['high']:+.2f}]",
            )
