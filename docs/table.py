"""Write the benchmark's tables into the page from the card that is shipped: ``python docs/table.py``."""

from __future__ import annotations

import re
from pathlib import Path

from isd_gym.benchmark import _cards as cards
from isd_gym.contrib.hub.card_table import table

PAGE = Path(__file__).parent / "reference" / "benchmark.md"


def fill(page: str) -> str:
    """The page with every track of the card between its marks."""
    card = cards.load("ISDSuspension-v0")
    for track in card["tracks"]:
        start, end = f"<!-- {track['track']}: python docs/table.py -->", f"<!-- end of {track['track']} -->"
        text = f"{start}\n\n{table(card, track['track'])}\n\n{end}"
        page, count = re.subn(
            f"{re.escape(start)}.*?{re.escape(end)}", lambda _, t=text: t, page, flags=re.DOTALL
        )
        if count != 1:
            raise SystemExit(f"{PAGE.name}: no place for {track['track']}")
    return page


if __name__ == "__main__":
    PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
