"""Tables in Markdown: cells with units and signs, and the ranking of a card."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from isd_gym._common.seeds import named_roads
from isd_gym.benchmark import cards

if TYPE_CHECKING:
    from collections.abc import Sequence


def signed(share: float, digits: int = 1) -> str:
    """A share in per cent, with its sign and without the unit."""
    return f"{100 * share:+.{digits}f}".replace("-", "−")


def percent(share: float, digits: int = 1) -> str:
    """A share as a signed percentage."""
    return f"{signed(share, digits)} %"


def interval(quantity: dict[str, Any]) -> str:
    """The 95 % interval of a share, in per cent."""
    return f"[{signed(quantity['low'])}, {signed(quantity['high'])}]"


def change_of(quantity: dict[str, Any], key: str = "change") -> str:
    """A change against the passive car with its interval."""
    return f"{percent(quantity[key])} {interval(quantity)}"


def markdown(heads: str, rows: Sequence[Sequence[str]], align: str) -> str:
    """A Markdown table.

    Args:
        heads: heads of the columns, with " | " between them.
        rows: cells of each row.
        align: one letter for each column, l or r.
    """
    rule = "|".join({"l": "---", "r": "---:"}[letter] for letter in align)
    body = (f"| {' | '.join(row)} |" for row in rows)
    return "\n".join([f"| {heads} |", f"|{rule}|", *body])


def card_table(environment: str, name: str = "standard") -> str:
    """A track of a card, best policy first, with date, command and digest."""
    card = cards.load(environment)
    track = next(t for t in card["tracks"] if t["track"] == name)

    def cell(quantity: dict[str, Any], digits: int, scale: float = 1.0) -> str:
        text = f"{scale * quantity['value']:.{digits}f}"
        if quantity.get("change"):
            change = percent(quantity["change"])
            text += f"<br>{change} <small>{interval(quantity)}</small>"
        return text

    rows = []
    for place, row in enumerate(cards.ranking(card, name), 1):
        rows.append(
            [
                str(place),
                f"`{row['policy']}`",
                cell(row["cost"], 4),
                cell(row["body_acceleration_rms"], 3),
                cell(row["suspension_travel_rms"], 2, 1e3),
                cell(row["tyre_load_rms"], 0),
                f"{row['current_rms']['value']:.2f}",
            ]
        )
    heads = " | policy | cost J | acceleration [m/s²] | travel [mm] | tyre load [N] | current [A]"
    roads = f"{track['episodes']} × {track['duration']['value']:g} s, {named_roads(track['seed'], track['episodes'])}"
    what = f"`{environment}`, {name}: road `{track['road']}`, {track['speed']['value']:g} m/s, {roads}."
    what += (
        " RMS; below each, the change against `passive` with its 95 % paired interval."
    )
    made = f"Made by `{track['command']}` on {card['date']}, version {card['version']}; card {card['digest'][:16]}."
    return "\n\n".join([what, markdown(heads, rows, "rlrrrrr"), made])
