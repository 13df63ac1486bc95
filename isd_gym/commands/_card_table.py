"""A track of a benchmark card on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..console import printer
from ..errors import InputError, plain
from ._score_bounds import known_ceilings


def print_track(card: Mapping[str, Any], name: str, scores: Sequence[Mapping[str, Any]] = ()) -> None:
    """Print a track, best first, and the comparisons of each submitted policy."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from ..benchmark.cards import ranking

    one = next(t for t in card["tracks"] if t["track"] == name)
    rows = ranking(card, name, scores, _ceilings(one))
    known = any(row["regret"] is not None for row in rows)
    console = printer()
    made = Table(
        box=box.SIMPLE_HEAD,
        title=Text(f"{card['environment']} of {card['date']}, {name}: change against passive [%]"),
        title_justify="left",
        pad_edge=False,
    )
    narrow = console.width < 98
    heads = ("accel-\neration", "travel", "tyre\nload") if narrow else ("acceleration", "travel", "tyre load")
    gap = "\n" if narrow else " "
    for head in ("", "policy", f"cost J{gap}(regret)" if known else "cost J", "change of J", *heads):
        # names may be folded, numbers are never cut
        words = head == "policy"
        made.add_column(head, justify="left" if words else "right", no_wrap=not words, overflow="fold")
    for place, row in enumerate(rows, 1):
        q = row["cost"]
        made.add_row(
            str(place),
            Text(plain(row["policy"], 40), style="bold" if row["submitted"] else ""),
            f"{q['value']:.4f}" + ("" if row["regret"] is None else f"{gap}({row['regret']:.4f})"),
            f"{100 * q['change']:+.1f}{gap}[{100 * q['low']:+.1f}, {100 * q['high']:+.1f}]"
            if q["change"]
            else "",
            *(
                f"{100 * row[k]['change']:+.1f}"
                for k in ("body_acceleration_rms", "suspension_travel_rms", "tyre_load_rms")
            ),
        )
    console.print(made)
    if known:
        console.print("Regret: J above the causal ceiling, the least J known for causal controllers.")
    for row in rows:
        for rival, q in row.get("against", {}).items():
            console.print(
                f"{plain(row['policy'], 40)} against {plain(rival, 40)}: {100 * q['change']:+.2f} % of J "
                f"[{100 * q['low']:+.2f}, {100 * q['high']:+.2f}]",
            )


def _no_ceiling(preview: float) -> None:
    return None


def _ceilings(one: Mapping[str, Any]) -> Callable[[float], Mapping[str, Any] | None]:
    """Return a function from preview [s] to the causal ceiling of a track, or None where no ceiling may stand beside the track."""
    from ..comparability import comparable
    from ..network import Network
    from ..road import road

    speed, duration = one["speed"]["value"], one["duration"]["value"]
    try:
        plant, ground = Network.load(one["network"]), road(one["road"])
    except InputError:  # of a file on another machine
        return _no_ceiling
    left_out = comparable(plant, ground, speed, one["episodes"], duration).ceiling
    return _no_ceiling if left_out else known_ceilings(plant, ground, speed, duration)
