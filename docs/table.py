"""Write the benchmark's table into the page: ``python docs/table.py score.json`` (of `isd-gym score --json`)."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

PAGE = Path(__file__).parent / "benchmark.md"
START, END = "<!-- table: python docs/table.py score.json -->", "<!-- end of table -->"


def cell(quantity: dict, digits: int, scale: float = 1.0) -> str:
    text = f"{scale * quantity['value']:.{digits}f}"
    if quantity.get("change") and quantity["low"] != quantity["high"]:
        low, high = (f"{100 * quantity[k]:+.1f}" for k in ("low", "high"))
        text += f"<br>{100 * quantity['change']:+.1f} % <small>[{low}, {high}]</small>"
    return text.replace("-", "−")


def table(score: dict) -> str:
    shares = any(row["share_of_reachable_gain"] is not None for row in score["policies"])
    heads = [
        "policy",
        "cost J",
        "acceleration [m/s²]",
        "travel [mm]",
        "tyre load [N]",
        "current [A]",
        "ms per step",
    ]
    heads += ["of the gain reachable"] if shares else []
    causal = any(row.get("share_of_causal_gain") is not None for row in score["policies"])
    heads += ["of the causal gain"] if causal else []
    lines = ["| " + " | ".join(heads) + " |", "|---" + "|---:" * (len(heads) - 1) + "|"]
    for row in sorted(score["policies"], key=lambda r: -r["cost"]["value"]):
        cells = [
            f"`{row['policy']}`",
            cell(row["cost"], 3),
            cell(row["body_acceleration_rms"], 3),
            cell(row["suspension_travel_rms"], 2, 1e3),
            cell(row["tyre_load_rms"], 0),
            f"{row['current_rms']['value']:.2f}",
            f"{1e3 * row['control_time']['median']:.2f}",
        ]
        share = row["share_of_reachable_gain"]
        cells += ["" if share is None else f"{100 * share:.0f} %"] if shares else []
        share = row.get("share_of_causal_gain")
        cells += ["" if share is None else f"{100 * share:.0f} %"] if causal else []
        lines.append("| " + " | ".join(cells) + " |")
    speed, duration = score["speed"]["value"], score["duration"]["value"]
    what = (
        f"Plant `{score['network']}`, road `{score['road']}`, {speed:g} m/s, {score['episodes']} × {duration:g} s, "
        f"seeds {score['seed']} to {score['seed'] + score['episodes'] - 1}. RMS; below each, the change against `passive` with its "
        "95 % paired interval."
    )
    notes = [f"- {line}" for line in score.get("references", {}).values() if isinstance(line, str)]
    return "\n".join([what, "", *lines, *(["", *notes] if notes else [])])


def fill(page: str, score: dict) -> str:
    """The page with the table of `score` between its marks."""
    return re.sub(
        f"{re.escape(START)}.*?{re.escape(END)}",
        lambda _: f"{START}\n\n{table(score)}\n\n{END}",
        page,
        flags=re.DOTALL,
    )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python docs/table.py score.json")
    PAGE.write_text(
        fill(PAGE.read_text(encoding="utf-8"), json.loads(Path(sys.argv[1]).read_text())), encoding="utf-8"
    )
