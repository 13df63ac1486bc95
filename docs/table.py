"""Write the benchmark's tables into the page from the card that is shipped: ``python docs/table.py``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isd_gym._common.markdown import markdown
from isd_gym._common.seeds import named_roads
from isd_gym.benchmark import cards
from isd_gym.benchmark.cards import ranking

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

PAGE = Path(__file__).parent / "reference" / "benchmark.md"


def table(
    card: Mapping[str, Any], name: str, scores: Sequence[Mapping[str, Any]] = ()
) -> str:
    """Return a track as Markdown, best policy first, with date, command and digest."""
    one = next(t for t in card["tracks"] if t["track"] == name)

    def cell(q: Mapping[str, Any], digits: int, scale: float = 1.0) -> str:
        text = f"{scale * q['value']:.{digits}f}"
        if q.get("change"):
            text += f"<br>{100 * q['change']:+.1f} % <small>[{100 * q['low']:+.1f}, {100 * q['high']:+.1f}]</small>"
        return text.replace("-", "−")

    heads = [
        "",
        "policy",
        "cost J",
        "acceleration [m/s²]",
        "travel [mm]",
        "tyre load [N]",
        "current [A]",
    ]
    lines = [
        "| " + " | ".join(heads) + " |",
        "|---:|---" + "|---:" * (len(heads) - 2) + "|",
    ]
    for place, row in enumerate(ranking(card, name, scores), 1):
        cells = [
            str(place),
            markdown(row["policy"], code=True),
            cell(row["cost"], 4),
            cell(row["body_acceleration_rms"], 3),
            cell(row["suspension_travel_rms"], 2, 1e3),
            cell(row["tyre_load_rms"], 0),
            f"{row['current_rms']['value']:.2f}",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    what = (
        f"{markdown(card['environment'], code=True)}, {markdown(one['track'])}: road {markdown(one['road'], code=True)}, {one['speed']['value']:g} m/s, {one['episodes']} × "
        f"{one['duration']['value']:g} s, {named_roads(one['seed'], one['episodes'])}. RMS; below each, the change "
        "against `passive` with its 95 % paired interval."
    )
    command, date, version = (
        markdown(x, 400, code=code)
        for x, code in (
            (one["command"], True),
            (card["date"], False),
            (card["version"], False),
        )
    )
    made = (
        f"Made by {command} on {date}, version {version}; card {card['digest'][:16]}."
    )
    return "\n".join([what, "", *lines, "", made])


def fill(page: str) -> str:
    """The page with every track of the card between its marks."""
    card = cards.load("ISDSuspension-v0")
    for track in card["tracks"]:
        start, end = (
            f"<!-- {track['track']}: python docs/table.py -->",
            f"<!-- end of {track['track']} -->",
        )
        text = f"{start}\n\n{table(card, track['track'])}\n\n{end}"
        page, count = re.subn(
            f"{re.escape(start)}.*?{re.escape(end)}",
            lambda _, t=text: t,
            page,
            flags=re.DOTALL,
        )
        if count != 1:
            raise SystemExit(f"{PAGE.name}: no place for {track['track']}")
    return page


if __name__ == "__main__":
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
