"""A track of a benchmark card on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..console import printer
from ..errors import plain


def print_track(card: Mapping[str, Any], name: str, scores: Sequence[Mapping[str, Any]] = ()) -> None:
    """Print a track, best first, and the comparisons of each submitted policy."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from ..benchmark.cards import ranking

    rows = ranking(card, name, scores)
    console = printer()
    made = Table(
        box=box.SIMPLE_HEAD,
        title=Text(f"{card['environment']} of {card['date']}, {name}: change against passive [%]"),
        title_justify="left",
        pad_edge=False,
    )
    narrow = console.width < 98
    heads = ("accel-\neration", "travel", "tyre\nload") if narrow else ("acceleration", "travel", "tyre load")
    for head in ("", "policy", "cost J", "change of J", *heads):
        # names may be folded, numbers are never cut
        words = head == "policy"
        made.add_column(head, justify="left" if words else "right", no_wrap=not words, overflow="fold")
    for place, row in enumerate(rows, 1):
        q = row["cost"]
        made.add_row(
            str(place),
            Text(plain(row["policy"], 40), style="bold" if row["submitted"] else ""),
            f"{q['value']:.4f}",
            f"{100 * q['change']:+.1f}{chr(10) if narrow else ' '}[{100 * q['low']:+.1f}, {100 * q['high']:+.1f}]"
            if q["change"]
            else "",
            *(
                f"{100 * row[k]['change']:+.1f}"
                for k in ("body_acceleration_rms", "suspension_travel_rms", "tyre_load_rms")
            ),
        )
    console.print(made)
    for row in rows:
        for rival, q in row.get("against", {}).items():
            console.print(
                f"{plain(row['policy'], 40)} against {plain(rival, 40)}: {100 * q['change']:+.2f} % of J "
                f"[{100 * q['low']:+.2f}, {100 * q['high']:+.2f}]",
            )
