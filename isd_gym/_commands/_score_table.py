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
    interval = (
        f" [{100 * q['low']:+.1f}, {100 * q['high']:+.1f}]"
        if result.conditions.episodes > 1
        else ""
    )
    return f"{plain(best['policy'], 40)}: J {100 * q['change']:+.1f} %{interval} against passive."


#: part of a table: text of a row of the score by heading of the column
Part = dict[str, Callable[[Any], str]]


def _quantity(name: str, digits: int, scale: float = 1.0) -> Callable[[Any], str]:
    """Return the text of a quantity of a row."""
    return lambda row: f"{row[name]['value'] * scale:.{digits}f}"


class _Table:
    """The columns of a score, for a terminal of a width."""

    def __init__(self, result: Any, *, is_narrow: bool) -> None:
        self.result, self.is_narrow = result, is_narrow

    def changed(
        self, name: str, digits: int, scale: float = 1.0
    ) -> Callable[[Any], str]:
        """Return the text of a quantity of a row with its change and interval."""

        def text(row: Any) -> str:
            q = row[name]
            out = _quantity(name, digits, scale)(row)
            if q.get("change", 0.0) != 0.0:
                out += ("\n" if self.is_narrow else " ") + f"{100 * q['change']:+.1f} %"
                if self.result.conditions.episodes > 1:
                    out += f"\n[{100 * q['low']:+.1f}, {100 * q['high']:+.1f}]"
            return out

        return text

    def main(self) -> Part:
        return {
            "cost J": self.changed("cost", 3),
            "acceleration\nm/s²": self.changed("body_acceleration_rms", 3),
            "travel\nmm": self.changed("suspension_travel_rms", 2, 1e3),
            "tyre load\nN": self.changed("tyre_load_rms", 0),
        }

    def shares(self) -> Part:
        heads = {
            "share_of_reachable_gain": "of the gain\nreachable",
            "share_of_causal_gain": "of the causal\ngain",
            "share_of_lq_gain": "of the LQ\nbound's gain",
        }

        def share(name: str) -> Callable[[Any], str]:
            return lambda row: (
                "" if row[name] is None else f"{round(100 * row[name])} %"
            )

        told = {
            name
            for row in self.result.policies
            for name in heads
            if row.get(name) is not None
        }
        return {head: share(name) for name, head in heads.items() if name in told}

    def motion(self) -> Part:
        comfort = f", {plain(self.result.comfort)}" if self.result.comfort else ""
        return {
            f"W_k{comfort}\nm/s²": _quantity("weighted_acceleration_rms", 3),
            "peak acc.\nm/s²": _quantity("peak_body_acceleration", 2),
            "peak travel\nmm": _quantity("peak_suspension_travel", 1, 1e3),
            "current\nA": _quantity("current_rms", 2),
            "energy\nJ": _quantity("energy", 0),
        }

    def work(self) -> Part:
        return {
            "exceed-\nances": lambda row: str(sum(row["limit_violations"].values())),
            "fall-\nbacks": lambda row: str(row["fallbacks"]),
            "processor ms\nper step": lambda row: (
                f"{1e3 * row['control_time']['median']:.3f}"
            ),
            "\n99.9 %": lambda row: f"{1e3 * row['control_time']['p99_9']:.3f}",
        }

    def corners(self) -> list[Part]:
        from ..benchmark.scoring import corner_measures

        return [
            {
                f"{head}\n{unit}": self.changed(name, digits, scale)
                for name, (head, unit, digits, scale) in group.items()
            }
            for group in corner_measures(self.result.policies[0])
        ]

    def all(self) -> list[list[Part]]:
        """Return the parts of each table."""
        main = self.main()
        motion = self.motion()
        share = self.shares()
        work = self.work()
        if self.is_narrow:
            return [[main], [motion], [share, work], self.corners()]
        return [[main, share], [motion, work], self.corners()]


def _title(result: Any) -> str:
    drives = result.conditions
    ahead = sorted({row["preview"]["value"] for row in result.policies} - {0.0})
    sight = (
        f", {' and '.join(f'{s:g}' for s in ahead)} s of road ahead" if ahead else ""
    )
    interval = (
        ", 95 % interval" if drives.episodes > 1 else "; one episode has no interval"
    )
    return (
        f"{plain(result.plant.name)}, road {shown(drives.road.name)}, {drives.speed:g} m/s, {drives.episodes} x {drives.duration:g} s, "
        f"{result.drives}{sight}; RMS, change against passive{interval}"
    )


def print_score(result: Any, *, full: bool) -> None:
    """Print the table of a score and a sentence; with `full` all tables and the bounds."""
    from rich.text import Text

    console = printer()
    table = _Table(result, is_narrow=console.width < 106)
    console.print(_title(result))
    if result.model is not None:
        factors = ", ".join(
            f"{plain(name)} x {factor:.4g}" for name, factor in result.shift.items()
        )
        console.print(
            f"controllers have the model {plain(result.model.name)}; vehicle against it: {factors or 'other elements'}"
        )
    names = {"policy": [Text(plain(row["policy"], 40)) for row in result.policies]}
    for parts in table.all() if full else [[table.main()]]:
        columns = (
            {head: [say(row) for row in result.policies] for head, say in part.items()}
            for part in parts
        )
        print_columns(names, *columns)
    if not full:
        console.print(_sentence(result) + " More: --full.")
        return
    for line in result.references.values():
        if isinstance(line, str):
            console.print(plain(line, 400), style="dim")
