"""Page of a score, to explore on screen and to print."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.files import check_folder, whole_folder, write_text
from ..._common.seeds import road_name
from .charts import Axis, Chart, Item, Line, Marks, Panel, Rule, decades, picture
from .plots import (
    INK,
    LOOKS,
    Look,
    caption,
    density,
    looks,
    page,
    percent,
    style,
)

if TYPE_CHECKING:
    from ...benchmark.scoring import Score

SCORE_KIND = "score report"
SCORE_PARTS = ("index.html", "score.json", "*.svg")
#: column of the table -> heading, unit, scale, decimals
COLUMNS = {
    "cost": ("cost J", "", 1.0, 3),
    "body_acceleration_rms": ("body acceleration", "m/s²", 1.0, 3),
    "suspension_travel_rms": ("travel", "mm", 1e3, 2),
    "tyre_load_rms": ("tyre load", "N", 1.0, 0),
}
#: kind of signal -> heading, unit, scale
SIGNALS = {
    "body_acceleration": ("body acceleration", "m/s²", 1.0),
    "pitch_acceleration": ("pitch acceleration", "rad/s²", 1.0),
    "roll_acceleration": ("roll acceleration", "rad/s²", 1.0),
    "suspension_travel": ("suspension travel", "mm", 1e3),
    "tyre_load": ("dynamic tyre load", "kN", 1e-3),
    "current": ("motor current", "A", 1.0),
}
WELCH = 8.0  # window of the spectra [s]


def score_report(score: Score, folder: str | Path) -> Path:
    """Write the page of a score: ``index.html`` (self-contained), its figures as SVG, and ``score.json``.

    The folder is written atomically; an earlier report is replaced.

    Args:
        score: The score.
        folder: A new or empty folder, or an earlier report.

    Returns:
        Path of the page.

    Raises:
        InputError: The folder holds other files, or cannot be written.
    """
    folder = Path(folder)
    shown = Shown(score)
    with style(), whole_folder(folder, SCORE_KIND, "score.json", SCORE_PARTS) as place:
        charts = (make(shown) for make in (trade_off, histories, spectra))
        pictures = [picture(chart, place) for chart in charts if chart is not None]
        write_text(
            place / "score.json",
            json.dumps(score.to_dict(), indent=1, allow_nan=False) + "\n",
        )
        write_text(
            place / "index.html",
            page("score.html", shown=shown, score=score, pictures=pictures),
        )
    return folder / "index.html"


def check_report(folder: str | Path) -> None:
    """Check before long work that `score_report` can write to a folder."""
    check_folder(folder, SCORE_KIND, "score.json", SCORE_PARTS)


class Shown:
    """A score prepared for drawing: the style of each policy, and the reference."""

    def __init__(self, score: Score) -> None:
        self.score = score
        self.reference = score.reference
        self.rows = {row["policy"]: row for row in score.policies}
        self.names = [self.reference, *(n for n in score.runs if n != self.reference)]
        self.looks = looks(self.names)
        self.runs = score.runs
        self.step = score.runs[self.reference].control_step
        self.car = score.runs[self.reference].car
        self.costs = {n: run.cost(score.cost) for n, run in self.runs.items()}
        self.best = min(self.names, key=lambda n: self.costs[n].mean())

    @property
    def signals(self) -> dict[str, tuple[str, str, float]]:
        """Signals of the body and of each corner by name: heading, unit, scale."""
        out = {}
        for kind, (head, unit, scale) in SIGNALS.items():
            for name, corner in {
                c.named(kind): c.name for c in self.car.corners
            }.items():
                if name in self.runs[self.reference].signals:
                    words = f"{corner.replace('_', ' ')} {head.removeprefix('suspension ').removeprefix('dynamic ')}"
                    out[name] = (words if corner else head, unit, scale)
            if kind in self.runs[self.reference].signals:
                out[kind] = (head, unit, scale)
        return out

    @property
    def corner_tables(self) -> list[dict[str, tuple[str, str, int, float]]]:
        """Tables of axes and corners: heading, unit, decimals and scale by measure; none of a quarter car."""
        from ...benchmark.scoring import corner_measures

        return corner_measures(self.score.policies[0])

    @property
    def cost_words(self) -> str:
        """Sentence on the stage cost."""
        return caption(
            "cost",
            cost=self.score.cost,
            axes=self.car.axes,
            corners=len(self.car.corners),
        )

    @property
    def bounds(self) -> list[str]:
        """Sentences on the bounds of these conditions."""
        told = self.score.references
        named = (
            ("clairvoyant", "causal_bound") if self.score.comfort else ("clairvoyant",)
        )
        return [
            text
            for key, text in told.items()
            if key.startswith("ceiling_") or key in named
        ]

    @property
    def left_out(self) -> str:
        """Omitted bounds and published figures with the reasons; '' if nothing is omitted."""
        told = self.score.references.get("left_out")
        return told or self.score.comparable.left_out or ""

    def few(self, count: int) -> tuple[list[str], str]:
        """Return the reference and the best policies, since many curves are unreadable."""
        others = sorted(
            (n for n in self.names if n != self.reference),
            key=lambda n: self.costs[n].mean(),
        )
        kept = [n for n in self.names if n == self.reference or n in others[:count]]
        gone = [n for n in self.names if n not in kept]
        return kept, f" Not in the picture: {', '.join(gone)}." if gone else ""

    @property
    def level(self) -> list[str]:
        """Policies that are indistinguishable from the best: the 95 % paired interval of the difference in cost includes zero."""
        if self.score.conditions.episodes < 2:
            return []
        draws = np.random.default_rng(0).integers(
            self.score.conditions.episodes, size=(2000, self.score.conditions.episodes)
        )
        out = []
        for name in self.names:
            if name not in (self.best, self.reference):
                gap = (self.costs[name] - self.costs[self.best])[draws].mean(axis=1)
                if np.quantile(gap, 0.025) <= 0.0:
                    out.append(name)
        return out

    def interval(self, q: dict[str, Any]) -> str:
        """Return the 95 % interval of a change, such as ``[−24.3, −21.9] %``; '' without an interval."""
        if (
            self.score.conditions.episodes < 2
            or q.get("low") is None
            or q["low"] == q["high"] == 0.0
        ):
            return ""
        return f"[{percent(q['low'])[:-2]}, {percent(q['high'])[:-2]}]"

    @property
    def headline(self) -> str:
        """Main result of the score, in a sentence."""
        return caption(
            "headline", shown=self, heads={k: COLUMNS[k][0] for k in list(COLUMNS)[1:]}
        )


def histories(shown: Shown) -> Chart:
    """Return the chart of four seconds around the reference's worst moment: the best policy in a median episode, and in the hardest."""
    base = shown.runs[shown.reference]
    order = np.argsort(shown.costs[shown.reference])
    middle = int(order[len(order) // 2])
    hardest = int(order[-1])
    steps = len(base.body_acceleration)
    width = min(steps, round(4.0 / shown.step))
    few, left_out = shown.few(1)
    signals = shown.signals
    moved = [
        k
        for k in signals
        if not k.startswith("current")
        or any(np.any(r.signals.get(k, 0)) for r in shown.runs.values())
    ]
    time = shown.step * np.arange(steps, dtype=np.float64)

    def panels(episode: int) -> list[Panel]:
        loads = [np.abs(load[:, episode]) for load in base.of("tyre_load")]
        peak = int(np.argmax(np.max(loads, axis=0)))
        first = max(0, min(peak - width // 2, steps - width))
        begin = float(time[first])
        end = float(time[first]) + width * shown.step
        window = Axis("time", "s", low=begin, high=end)
        out = []
        for key in moved:
            head, unit, scale = signals[key]
            lines = []
            for name in few:
                own = shown.runs[name].signals.get(key)
                if own is None or (key.startswith("current") and not np.any(own)):
                    continue
                values = own[first : first + width, episode] * scale
                lines.append(
                    Line(name, time[first : first + width], values, shown.looks[name])
                )
            inside = [np.abs(i.y).max() for i in lines]
            top = 1.08 * max([*inside, 1e-9])
            words = head.replace(" ", "\n", 1)
            out.append(
                Panel(
                    window,
                    Axis(words, unit, low=-top, high=top),
                    (*lines, Rule("y", 0.0)),
                    link="time",
                )
            )
        return out

    pictures = {f"the median by the cost of {shown.reference}": middle}
    if hardest != middle:
        pictures[f"the hardest for {shown.reference}"] = hardest
    choices, captions = {}, {}
    for about, episode in pictures.items():
        road = road_name(shown.score.conditions.seed, episode)
        choices[f"{road}: {about}"] = panels(episode)
        captions[f"{road}: {about}"] = caption(
            "histories",
            road=road,
            about=about,
            seconds=width * shown.step,
            left_out=left_out,
        )
    return Chart(
        "histories",
        "In time",
        "Signals of one episode over time",
        next(iter(captions.values())),
        choices,
        size=(7.2, 1.35 * len(moved) + 0.5),
        captions=captions,
    )


def spectra(shown: Shown) -> Chart | None:
    """Return the chart of the power spectral densities, and of their ratios to the reference; None for short or constant signals."""
    from ...benchmark.scoring import frequency_weighting

    units = {
        "body_acceleration": "(m/s²)²/Hz",
        "suspension_travel": "mm²/Hz",
        "tyre_load": "N²/Hz",
    }
    for axis in shown.car.axes:
        units[f"{axis}_acceleration"] = "(rad/s²)²/Hz"
    scales = dict.fromkeys(units, 1.0) | {"suspension_travel": 1e3}
    if not all(np.any(shown.runs[shown.reference].of(key)) for key in units):
        return None  # no motion
    few, left_out = shown.few(3)
    marks = tuple((t, f"{t:g}") for t in (0.5, 1, 2, 5, 10, 20, 50))
    x = Axis("frequency", "Hz", log=True, low=0.4, high=50.0, ticks=marks)
    halves = (
        (0.125, "⅛"),
        (0.25, "¼"),
        (0.5, "½"),
        (1.0, "1"),
        (2.0, "2"),
        (4.0, "4"),
        (8.0, "8"),
    )
    top, below = [], []
    for key, unit in units.items():
        density_of = {
            n: density(
                scales[key] * np.hstack(shown.runs[n].of(key)), shown.step, WELCH
            )
            for n in few
        }
        f, base = density_of[shown.reference]
        keep = (f >= 0.4) & (f <= 50.0)
        if not keep.any():
            return None  # too short for a spectrum
        lines, ratios = [], []
        for name in few:
            p = density_of[name][1]
            lines.append(Line(name, f[keep], p[keep], shown.looks[name]))
            ratios.append(Line(name, f[keep], (p / base)[keep], shown.looks[name]))
        seen = np.concatenate([i.y for i in lines])
        least = base[keep & (f < 25.0)].min()
        most = seen.max()
        low = max(0.5 * least, 1e-6 * most)
        high = 2 * most
        title = SIGNALS[key][0]
        extra: tuple[Item, ...] = ()
        if key == "body_acceleration":  # drawn from the axis to a decade above
            w = low * 10 ** (0.25 * np.log10(high / low) * frequency_weighting(f[keep]))
            extra = (
                Line(
                    "W_k: sensitivity of a seated person",
                    f[keep],
                    w,
                    LOOKS[0],
                    fill=True,
                ),
            )
        y = Axis(
            "density", unit, log=True, low=low, high=high, ticks=decades(low, high)
        )
        top.append(Panel(x, y, (*lines, *extra), title=title, link=key))
        y = Axis(
            f"ratio to {shown.reference}", log=True, low=0.125, high=8.0, ticks=halves
        )
        below.append(Panel(x, y, (*ratios, Rule("y", 1.0)), link=key))
    window = min(WELCH, len(shown.runs[shown.reference].body_acceleration) * shown.step)
    return Chart(
        "spectra",
        "In frequency",
        "Power spectral densities over frequency",
        caption("score_spectra", shown=shown, window=window, left_out=left_out),
        {"all episodes": [*top, *below]},
        columns=len(units),
        size=(2.8 * len(units), 4.8),
    )


def trade_off(shown: Shown) -> Chart:
    """Return the chart of acceleration over travel, as changes against the reference, with labels of the tyre load."""
    marks = [*_policy_marks(shown), *_optimum_marks(shown)]
    xs = [0.0, *(m.x[0] for m in marks)]
    ys = [0.0, *(m.y[0] for m in marks)]
    from ...benchmark.ceilings import fronts

    curves = fronts(shown.score)
    lines = []
    for (tyre, curve), dashes in zip(curves, ("-", (0, (5, 2))), strict=False):
        label = f"causal bound at tyre load {percent(tyre, 0)}"
        lines.append(
            Line(
                label, 100 * curve[:, 0], 100 * curve[:, 1], Look(INK, dashes, "", 1.1)
            )
        )
    left = min(-22.0, min(xs) - 6)
    right = max(6.0, max(xs) + 6)
    bottom = min(-26.0, min(ys) - 4)
    top = max(5.0, max(ys) + 5)
    panel = Panel(
        Axis(
            f"change of suspension travel against {shown.reference}",
            "%",
            low=left,
            high=right,
        ),
        Axis("change of body acceleration", "%", low=bottom, high=top),
        (Rule("x", 0.0), Rule("y", 0.0), *marks, *lines),
    )
    return Chart(
        "trade_off",
        "The trade-off",
        "Change of acceleration over change of travel, by policy",
        caption("trade_off", score=shown.score, has_bound=bool(curves)),
        {"all": [panel]},
        size=(7.2, 4.6),
    )


def _mark(
    name: str,
    travel: float,
    acceleration: float,
    tyre: float | None,
    look: Look,
    **style: Any,
) -> Marks:
    """Return the point of a policy, from its changes as fractions."""
    text = name if tyre is None else f"{name}, tyre {percent(tyre)}"
    return Marks(text, [100 * travel], [100 * acceleration], look, **style)


def _policy_marks(shown: Shown) -> list[Marks]:
    """Return the points of the policies of a score, with intervals."""
    marks = []
    for name in shown.names:
        look = shown.looks[name]
        row = shown.rows.get(name)
        if row is None or name == shown.reference:
            marks.append(_mark(name, 0.0, 0.0, None, look))
            continue
        a, l, t = (row[k] for k in list(COLUMNS)[1:])
        if "change" not in a or "change" not in l:
            continue
        spans: dict[str, Any] = {}
        if shown.interval(a) and shown.interval(l):
            spans = {
                f"{k}_interval": ([100 * q["low"]], [100 * q["high"]])
                for k, q in (("x", l), ("y", a))
            }
        tyre = t.get("change")
        marks.append(_mark(name, l["change"], a["change"], tyre, look, **spans))
    return marks


def _optimum_marks(shown: Shown) -> list[Marks]:
    """Return the point of the clairvoyant optimum, where it is known."""
    marks = []
    if known := shown.score.references.get("clairvoyant_point"):
        a, l, t = (
            known[f"{k}_change"]
            for k in ("body_acceleration", "suspension_travel", "tyre_load")
        )
        marks.append(
            _mark("clairvoyant", l, a, t, Look(INK, "-", "o"), open=True, size=8.0)
        )
    return marks
