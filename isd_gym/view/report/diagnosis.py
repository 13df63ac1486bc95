"""Report of a diagnosis: one page with its figures, to read, print and share."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError, ReportError
from ..._common.files import check_folder, whole_folder, write_text
from ..._common.units import practical
from ...diagnosis._estimation.structure import offsets_of
from ...diagnosis._verdict.grades import grade, observed
from ...diagnosis._verdict.wording import is_gain, statements_of
from ...diagnosis.result import FOLDER, Effect
from ...physics import elements as el
from ...physics.simulate import pace
from .charts import (
    Axis,
    Chart,
    Item,
    Line,
    Marks,
    Panel,
    Rule,
    Span,
    decades,
    log_ticks,
    picture,
)
from .forces import Curve, Loops, laws_of, measured_loops, missing_force
from .plots import (
    BLUE,
    INK,
    MUTED,
    PALE,
    VERMILLION,
    Look,
    Picture,
    caption,
    channel_text,
    density,
    number,
    page,
    style,
    unit_text,
    units_text,
)
from .schematic import draw as sketch
from .steps import draw_steps, force_axis, law_axis

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from ..._common.arrays import Array
    from ...diagnosis import Diagnosis, Quantity, Trace
    from ...physics.network import Network


#: stages of a diagnosis: head of a column, and its meaning
STAGES = {
    "before": ("as given", "the nominal model"),
    "refit": (
        "refitted",
        "the nominal model with its parameters refitted within their stated uncertainty",
    ),
    "after": ("with the effect", "the refitted model with the addition"),
    "candidate": (
        "with the best candidate",
        "the refitted model with the best candidate, which is not named",
    ),
    "noise_floor": ("noise", "the measurement noise, which limits every model"),
}
RELATIONS = {"<": "<", "<=": "≤", ">": ">", ">=": "≥"}
#: axes of an unnamed force


def write_report(
    diagnosis: Diagnosis, folder: str | Path, *, about: Mapping[str, str] | None = None
) -> Path:
    """Write ``diagnosis.json`` and ``model.json`` into a folder, then ``report.html`` and its figures as SVG.

    The results replace an earlier diagnosis in one step; the folder with the report replaces the results in
    one step.

    Args:
        diagnosis: The result.
        folder: A new or empty folder, or an earlier diagnosis.
        about: Lines for "how it was done", such as {"model": "rig.json"}.

    Returns:
        Path of the page.

    Raises:
        InputError: The folder holds other files, or cannot be written.
        ReportError: The report cannot be drawn; the results are in the folder.
    """
    folder = Path(folder)
    with whole_folder(folder, *FOLDER) as place:
        diagnosis.save(place)
    try:
        _draw_report(diagnosis, folder, dict(about or {}))
    except (
        Exception
    ) as error:  # a failing figure must not lose the results of a long computation
        raise ReportError(
            "the report", error, f"the results are in '{folder}'"
        ) from error
    return folder / "report.html"


def _draw_report(diagnosis: Diagnosis, folder: Path, about: dict[str, str]) -> None:
    """Exchange the folder for a folder with the results, the page and its figures."""
    view = View(diagnosis)
    with style(), whole_folder(folder, *FOLDER) as place:
        diagnosis.save(place)
        pictures: dict[str, Picture] = {}
        for make in FIGURES:
            chart = make(view)
            if chart is not None:
                pictures[chart.name] = picture(chart, place)
        write_text(place / "report.html", _html(view, pictures, about))


def _html(view: View, shown: Mapping[str, Picture], about: Mapping[str, str]) -> str:
    """Return the page with figures by name."""
    return page(
        "diagnosis.html",
        d=view.d,
        view=view,
        shown=shown,
        about=about,
        stages=STAGES,
        types=el.TYPES,
    )


def check_target(folder: str | Path) -> None:
    """Check before long work that `write_report` can write to a folder."""
    check_folder(folder, *FOLDER)


# ------------------------------------------------------------------------------------------------ what is shown


@dataclass(frozen=True)
class Scale:
    """Display scale of a channel."""

    factor: float  # displayed over SI value
    unit: str  # displayed unit


def _is_whole(trace: Trace) -> bool:
    """Return whether the refitted and the completed model simulate the record of a trace to its end."""
    return all(
        np.isfinite(y).all()
        for curves in (trace.refit, trace.after)
        for y in curves.values()
    )


class View:
    """A diagnosis prepared for a page: words, scales and the drawn records."""

    def __init__(self, diagnosis: Diagnosis) -> None:
        self.d = d = diagnosis
        self.named = bool(d.effects)
        # whether the new model differs from the given model
        completes = d.best_candidate is not None and d.best_candidate.completes
        self.changed = self.named or d.verdict == "ambiguous" or completes
        document = d.to_dict()
        told = statements_of(document)
        self.title = self.printed(told.title)
        self.finding, self.remarks, self.steps = (
            [self.printed(s) for s in part]
            for part in (told.finding, told.remarks, told.next_steps)
        )
        self.labels = {s: label for s, (label, _) in STAGES.items()}
        if d.verdict == "ambiguous":
            self.labels["after"] = "with the likeliest law"
        elif completes:
            self.labels["after"] = "with the best candidate"
        elif not self.named:
            self.labels["after"] = "with the force"
        elif len(d.effects) > 1:
            self.labels["after"] += "s"
        self.channels = list(d.gap.get("refit", {}))
        # a model that does not simulate a record has no curve there; a note of the result says so
        self.traces = [t for t in d.traces if _is_whole(t)]
        held = [t for t in self.traces if t.held_out] or self.traces
        self.trace: Trace | None = (
            max(held, key=lambda t: len(t.time)) if held else None
        )
        self.scales = {c: self._scale(c) for c in self.channels}
        self.order = sorted(self.channels, key=lambda c: -d.gap["refit"][c])
        # error by stage and channel
        self.errors = {
            s: d.gap[s] for s in STAGES if s in d.gap and (s != "after" or self.changed)
        }
        if (
            d.best_candidate is not None
            and not self.changed
            and is_gain(document["best_candidate"])
        ):
            noise = self.errors.pop("noise_floor")
            self.errors |= {
                "candidate": d.best_candidate.error["after"],
                "noise_floor": noise,
            }
        self.stages = list(self.errors)
        self.missing = missing_force(d, self.trace) if self.trace is not None else None
        self.remarks += list(dict.fromkeys(d.notes))
        self.spoken, self.observed = el.spoken, observed
        self.loops = measured_loops(d, self.trace) if self.trace is not None else []
        self.laws = laws_of(d, self.trace) if self.trace is not None else []

    def _scale(self, name: str) -> Scale:
        unit = self.d.units.get(name) or next(
            (c.unit for c in self.d.base.outputs if c.name == name), ""
        )
        peak = max(
            (
                float(np.abs(t.measured[name]).max())
                for t in self.traces
                if name in t.measured
            ),
            default=1.0,
        )
        if unit == "m" and peak < 0.5:
            return Scale(1e3, "mm")
        if unit == "N" and peak >= 5e3:
            return Scale(1e-3, "kN")
        return Scale(1.0, unit_text(unit))

    def drawings(self) -> list[tuple[str, str]]:
        """Return drawings of the network: as given, and with the result in colour."""
        known = {e.name for e in self.d.base.elements}
        # fitted offsets of sensors are no additions
        offsets = {
            e.name for c in self.d.model.outputs for e in offsets_of(self.d.model, c)
        }
        found = {e.name for e in self.d.model.elements} - known - offsets
        pairs: list[tuple[str, Network, set[str]]] = [
            ("The model as given", self.d.base, set())
        ]
        if self.changed:
            pairs.append(
                (
                    "The completed model, with the addition in colour",
                    self.d.model,
                    found,
                )
            )
        try:
            return [
                (title, sketch(n, found=marked).svg(inline=True))
                for title, n, marked in pairs
            ]
        except InputError:  # nothing between nodes
            return []

    def turns(self, pair: Sequence[str]) -> bool:
        """Return whether two nodes rotate relative to each other: torque over angle instead of force over travel."""
        return any(n in self.d.base.rotating for n in pair)

    def printed(self, sentence: str) -> str:
        """Return a sentence with units, numbers and channels in the style of the page."""
        text = re.sub(
            r"\b\d(\.\d+)?e[+-]\d\d\b",
            lambda m: number(float(m[0]), 4),
            units_text(sentence),
        )
        for c in self.d.gap.get("refit", {}):
            text = re.sub(
                rf"(?<!\w){re.escape(c)}(?!\w)",
                channel_text(c).replace("\\", r"\\"),
                text,
            )
        return re.sub(r"(?<=\d) %", "\u00a0%", text)

    @property
    def known(self) -> list[list[tuple[str, str, str]]]:
        """What is known of each named effect, or of the likeliest unnamed one: place, kind and law, each as text, grade and frequency."""
        named = [f for f in self.d.findings if f.named]
        rows = []
        for f in named or self.d.findings[:1]:
            stated = [
                ("place", self.place_text(f.place), f.place_probability),
                ("kind", channel_text(f.kind), f.kind_probability),
            ]
            if f.kind == "other":
                stated[1] = ("kind", "none of the library", f.kind_probability)
            else:
                for law in f.laws[:1]:
                    name = (
                        self.spoken(law.effect)
                        if law.effect in el.TYPES
                        else "none of the library"
                    )
                    stated.append(("law", name, law.probability))
            graded = [
                (level, text, share, grade(share)) for level, text, share in stated
            ]
            rows.append(
                [
                    (text, f"{name}, {share:.2f}", observed(level, name))
                    for level, text, share, name in graded
                ]
            )
        return rows

    @property
    def completion(self) -> str:
        """What `model.json` has in addition to the refitted model; '' where it has nothing."""
        d = self.d
        effects = [e.effect for e in d.effects]
        if not effects and d.best_candidate is not None and d.best_candidate.completes:
            effects = list(d.best_candidate.effects)
        if not effects and d.verdict == "ambiguous" and d.sets:
            effects = list(d.sets[0].effects)
        return " and ".join(self.spoken(e) for e in effects)

    @staticmethod
    def place_text(place: Sequence[str]) -> str:
        """Return a place in words: two nodes, a channel or motor, or an open place."""
        if not place:
            return "place open"
        return f"{place[0]} – {place[1]}" if len(place) == 2 else channel_text(place[0])

    def quantity(self, q: Any) -> str:
        """Return a value with a practical unit, such as ``296.6 N``, with the digits that its interval warrants."""
        factor, unit = practical(q.value, q.unit)
        value = factor * q.value
        low = factor * q.low
        high = factor * q.high
        return f"{_digits(value, low, high)}\u00a0{unit_text(unit)}".strip()

    @staticmethod
    def figure(value: float) -> str:
        """Return the value of a gate with at most three digits and without exponent, or a dash."""
        if not math.isfinite(value):
            return "–"
        return (f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}").replace(
            "-", "−"
        )

    def needed(self, g: Any) -> str:
        """Return the requirement of a gate, such as ``≥ 0.05``."""
        return f"{RELATIONS[g.relation]}\u00a0{self.figure(g.limit)}"

    def interval(self, q: Any) -> str:
        """Return the interval of a quantity in the unit of `quantity`."""
        factor, _ = practical(q.value, q.unit)
        low, high = factor * q.low, factor * q.high
        return f"{_digits(low, low, high)} to {_digits(high, low, high)}"

    def other(self, value: float, q: Any) -> str:
        """Return another value of a quantity, such as its prior, with the unit of the quantity."""
        factor, unit = practical(q.value, q.unit)
        return f"{number(factor * value, 4)}\u00a0{unit_text(unit)}".strip()

    def equation(self, e: Effect) -> str:
        """Return the equation of an effect."""
        # the equations in the code are ASCII
        text: str = getattr(el.TYPES.get(e.effect), "equation", "")
        for plain, mark in (
            ("F in ", "F ∈ "),
            ("^2", "²"),
            ("^3", "³"),
            (" - ", " − "),
        ):
            text = text.replace(plain, mark)
        return text

    def signature(self, e: Effect) -> str:
        """Return the characteristic that distinguishes an effect."""
        return getattr(el.TYPES.get(e.effect), "signature", "")

    def test(self, e: Effect) -> str:
        """Return a test that would confirm an effect, with the expected values; '' if a value is unknown."""
        words = {k: self.quantity(q) for k, q in e.parameters.items()}
        try:
            return el.TYPES[e.effect].test.format_map(words)
        except KeyError:
            return ""

    @property
    def first(self) -> str:
        """Name of the figure on the first screen."""
        return "steps" if self.d.places else "gap"

    @property
    def parameters(self) -> list[tuple[str, Any, float | None]]:
        """Base parameters: path, quantity, and relative standard deviation in the model file."""
        return [
            (path, q, self.d.base.uncertainty.get(path))
            for path, q in self.d.parameters.items()
        ]


def _digits(value: float, low: float, high: float) -> str:
    """Return a value to four digits, or to two digits of its interval's half width where these are more, at most six."""
    half = 0.5 * abs(high - low)
    size = max(abs(low), abs(high))
    if not (np.isfinite(half) and half > 0 and size > half * 1e-12):
        return number(value, 4)
    if not 1e-3 <= size < 1e6:
        return number(value, int(np.clip(np.floor(np.log10(size / half)) + 2, 2, 5)))
    first = math.floor(math.log10(size))
    places = min(max(1 - math.floor(math.log10(half)), 3 - first), 5 - first)
    # a value within a wide interval must not vanish: 14.66 is not 0
    if low < value < high and value != 0.0:
        places = max(places, 1 - math.floor(math.log10(abs(value))))
    return f"{round(value, places) + 0.0:.{max(0, places)}f}".replace("-", "−")


# ------------------------------------------------------------------------------------------------- the figures

#: styles of the two models in all figures
MEASURED = Look(INK, "-", "", 1.6)
BEFORE = Look(VERMILLION, (0, (4, 1.5)), "D", 1.1)
AFTER = Look(BLUE, "-", "o", 1.0)
WORST = "worst stretch"
STRETCH = 2.5  # length of the drawn stretches of a record [s]
PERIODS = 4  # periods of the motion in a loop
MOST_CHANNELS = 5  # channels of a picture over time
MOST_LOOPS = 3  # forces of a picture of loops


def draw_gap(view: View) -> Chart:
    """Return the chart of the held-out error of every channel at every stage."""
    looks = {
        "before": (Look(MUTED, "-", "s"), True, 6.5),
        "refit": (Look(VERMILLION, "-", "D"), True, 6.5),
        "after": (Look(BLUE, "-", "o"), False, 7.5),
        "candidate": (Look(BLUE, "-", "o"), True, 7.5),
        "noise_floor": (Look(INK, "-", "|"), False, 13.0),
    }
    values = {
        s: [max(100 * view.errors[s][c], 1e-3) for c in view.order] for s in view.stages
    }
    ends = [
        [f(values[s][k] for s in view.stages) for k in range(len(view.order))]
        for f in (min, max)
    ]
    items: list[Item] = [
        Marks(
            "",
            ends[0],
            range(len(view.order)),
            Look(PALE, "-", ""),
            (ends[0], ends[1]),
            bar=4.0,
        )
    ]
    for stage in view.stages:
        look, hollow, size = looks[stage]
        label = view.labels[stage]
        items.append(
            Marks(
                label,
                values[stage],
                range(len(view.order)),
                look,
                open=hollow,
                size=size,
            )
        )
    low, high = min(ends[0]) / 1.12, 1.12 * max(ends[1])
    x = Axis(
        "RMS error, relative to the signal's deviation",
        log=True, low=low, high=high, ticks=log_ticks(low, high, "{:g} %"),
    )  # fmt: skip
    return Chart(
        "gap",
        "The gap",
        "Held-out error of every channel before, refitted, after, and the noise",
        "Simulation error on held-out data. The scale is logarithmic.",
        {
            "all": [
                Panel(x, Axis(rows=tuple(map(channel_text, view.order))), tuple(items))
            ]
        },
        size=(7.2, 0.95 + 0.42 * len(view.channels)),
    )


def _stretches(view: View, trace: Trace) -> dict[str, slice]:
    """Return the stretches of a record in which the refitted model errs most, and as much as usual."""
    c = view.order[0]
    step = float(trace.time[1] - trace.time[0])
    width = min(len(trace.time), max(10, round(STRETCH / step)))
    power = np.concatenate(
        [[0.0], np.cumsum((trace.measured[c] - trace.refit[c]) ** 2)]
    )
    within = power[width:] - power[:-width]
    usual = np.abs(within - np.median(within))
    starts = {WORST: int(np.argmax(within)), "typical stretch": int(np.argmin(usual))}
    return {name: slice(k, k + width) for name, k in starts.items()}


def _records(view: View) -> dict[str, Trace]:
    """Return the records that a chart over time shows, by their name in the chart; the record of the picture first."""
    chosen = [view.trace, *(t for t in view.traces if t is not view.trace)][:8]
    out: dict[str, Trace] = {}
    for k, t in enumerate(t for t in chosen if t is not None):
        name = f"{t.name} ({t.use})"
        out[f"{name}, {k + 1}" if name in out else name] = t
    return out


def _simulated(view: View, t: Trace) -> dict[str, tuple[dict[str, Array], Look]]:
    """Return the simulations that charts show, with their styles."""
    out = {"refitted model": (t.refit, BEFORE)}
    return out | ({"completed model": (t.after, AFTER)} if view.changed else {})


def draw_time(view: View) -> Chart | None:
    """Return the chart of all records over time: the stretch with the largest error, and a typical stretch; None without records."""
    if view.trace is None:
        return None
    few = min(len(view.order), MOST_CHANNELS)
    choices, captions = {}, {}
    for record, t in _records(view).items():
        stretches = _stretches(view, t)
        choices[record] = _signal_panels(view, t, stretches)
        length = float(np.ptp(t.time[next(iter(stretches.values()))]))
        captions[record] = caption("time", view=view, t=t, length=length, few=few)
    return Chart(
        "time",
        "In time",
        "Measured and simulated signals over time: the stretch with the largest error, and a typical stretch",
        next(iter(captions.values())),
        choices,
        columns=2,
        size=(7.6, 1.65 * few + 0.7),
        still=2 * few,
        captions=captions,
    )


def _signal_panels(view: View, t: Trace, stretches: Mapping[str, slice]) -> list[Panel]:
    panels = []
    for c in view.order:
        k = view.scales[c].factor
        # the measured signal first: its broader line remains visible under the others
        says = {"measured": (t.measured, MEASURED), **_simulated(view, t)}
        for title, cut in stretches.items():
            # the worst stretch is a view of the whole record, the typical one is a part of the record
            drawn = slice(None) if title == WORST else cut
            lines = [
                Line(n, t.time[drawn], k * y[c][drawn], look)
                for n, (y, look) in says.items()
            ]
            low, high = (
                f(float(f(k * y[c][cut])) for y, _ in says.values()) for f in (min, max)
            )
            room = 0.05 * (high - low) or 1.0
            y_axis = Axis(
                channel_text(c).replace(" ", "\n", 1),
                view.scales[c].unit or "–",
                low=low - room,
                high=high + room,
            )
            x_axis = Axis(
                "time", "s", low=float(t.time[cut][0]), high=float(t.time[cut][-1])
            )
            panels.append(Panel(x_axis, y_axis, tuple(lines), title=title, link=title))
    return panels


def draw_loops(view: View) -> Chart | None:
    """Return the chart of the measured forces over velocity and travel: measured, as given, and completed (or refitted); None without such a force."""
    trace, forces = view.trace, view.loops[:MOST_LOOPS]
    if trace is None or not forces:
        return None
    new, look = ("refitted model", BEFORE)
    if view.changed:
        new, look = ("completed model", AFTER)
    choices = {}
    for stretch_name, stretch in _stretches(view, trace).items():
        panels = []
        for loops in forces:
            own = _cycles(loops, stretch, float(trace.time[1] - trace.time[0]))
            curves = {
                "measured": (loops.measured, replace(MEASURED, width=2.6)),
                "model as given": (loops.nominal, Look(MUTED, (0, (4, 1.5)), "", 1.1)),
                new: (loops.new, replace(look, line="-", marker="", width=1.2)),
            }
            shown = {
                n: (c.part(own), style)
                for n, (c, style) in curves.items()
                if c is not None
            }
            panels += _loop_panels(view, loops, shown)
        choices[stretch_name] = panels
    return Chart(
        "loops",
        "Force over velocity and travel",
        "Loops of the force over velocity and over travel, measured and simulated",
        caption("loops", t=trace, periods=PERIODS),
        choices,
        columns=2,
        size=(7.4, 2.5 * len(forces) + 0.4),
    )


def _cycles(loops: Loops, stretch: slice, step: float) -> slice:
    """Return some periods of the motion in the middle of a stretch of the record."""
    period = 2 * math.pi * pace(loops.measured.rate, step) / step
    count = len(loops.measured.travel)
    whole = stretch.stop - stretch.start
    width = min(count, max(10, min(whole, round(PERIODS * period))))
    start = (stretch.start + stretch.stop - width) // 2
    start = min(max(start, 0), count - width)
    return slice(start, start + width)


def _loop_panels(
    view: View, loops: Loops, curves: Mapping[str, tuple[Curve, Look]]
) -> list[Panel]:
    """Return the panels of a force over rate and over travel."""
    turns = view.turns(loops.pair)
    unit = "N·m" if turns else "N"
    top = max(float(np.abs(c.force).max()) for c, _ in curves.values())
    scale, unit = (1e-3, f"k{unit}") if top >= 1e4 else (1.0, unit)
    y = Axis(channel_text(loops.name), unit)
    panels = []
    for kind in ("rate", "travel"):
        factor, x = law_axis(kind, turns)
        x = replace(x, label=f"{x.label} of {loops.pair[0]}–{loops.pair[1]}")
        items = [
            Line(n, factor * getattr(c, kind), scale * c.force, look)
            for n, (c, look) in curves.items()
        ]
        panels.append(Panel(x, y, (Rule("x", 0.0), Rule("y", 0.0), *items)))
    return panels


def draw_spectra(view: View) -> Chart | None:
    """Return the chart of the spectra of signal and residuals, averaged over the held-out records (or all); None without records."""
    if view.trace is None:
        return None
    step = float(view.trace.time[1] - view.trace.time[0])
    used = [
        t
        for t in view.traces
        if t.held_out == view.trace.held_out
        and abs(float(t.time[1] - t.time[0]) / step - 1) < 1e-6
        and 2 * len(t.time) >= len(view.trace.time)
    ]
    shown = view.order[:6]
    columns = 2 if len(shown) in (2, 4) else min(3, len(shown))
    rows = -(-len(shown) // columns)
    seconds = min(8.0, min(len(t.time) for t in used) * step)
    panels = []
    for c in shown:
        unit = view.scales[c]

        def mean(
            signal: Callable[[Trace], Array], scale: float = unit.factor
        ) -> tuple[Array, Array]:
            found = [density(scale * signal(t), step, seconds) for t in used]
            return found[0][0], np.mean([p for _, p in found], axis=0)

        f, p = mean(lambda t, c=c: t.measured[c])  # type: ignore[misc]
        keep = (f >= 0.2) & (f <= min(60.0, 0.45 / step))
        keep = keep if keep.sum() > 4 else f > 0
        _, old = mean(lambda t, c=c: t.measured[c] - t.refit[c])  # type: ignore[misc]
        curves = [
            ("measured", p, Look(MUTED, "-", "", 1.4)),
            ("residual of the refitted model", old, BEFORE),
        ]
        if view.changed:
            _, new = mean(lambda t, c=c: t.measured[c] - t.after[c])  # type: ignore[misc]
            curves.append(("residual of the completed model", new, AFTER))
        items: list[Item] = [
            Line(n, f[keep], y[keep], replace(look, marker="")) for n, y, look in curves
        ]
        top = float(p[keep].max())
        least = min(float(y[keep].min()) for _, y, _ in curves[1:])
        low = max(0.5 * least, 1e-8 * top)
        high = 3 * max(top, float(old[keep].max()))
        items += [
            Span(max(place.band_hz[0], float(f[keep][0])), place.band_hz[1])
            for place in view.d.where
            if place.channel == c and place.band_hz is not None
        ]
        x = Axis(
            "frequency",
            "Hz",
            log=True,
            ticks=log_ticks(float(f[keep][0]), float(f[keep][-1])),
        )
        density_unit = f"({unit.unit})²/Hz" if "/" in unit.unit else f"{unit.unit}²/Hz"
        y_axis = Axis(
            "density",
            density_unit,
            log=True,
            low=low,
            high=high,
            ticks=decades(low, high),
        )
        panels.append(
            Panel(x, y_axis, tuple(items), title=channel_text(c), link="frequency")
        )
    return Chart(
        "spectra",
        "In frequency",
        "Spectra of the measurements and of the residuals",
        caption("spectra", view=view, used=used, seconds=seconds),
        {"all": panels},
        columns=columns,
        size=((5.2, 6.8, 8.2)[columns - 1], 2.1 * rows + 0.55),
    )


def draw_law(view: View) -> Chart | None:
    """Return the chart of every identified law with its interval, and the distribution of the measured motion; None without a law."""
    d = view.d
    laws = [
        (law, e) for law in view.laws for e in d.effects if e.element == law.element
    ]
    if not laws:
        return None
    columns = min(3, len(laws))
    panels = []
    for law, e in laws[:3]:
        turns = view.turns(e.between or ())
        factor, axis = law_axis(law.kind, turns)
        x = factor * law.axis
        count, edges = np.histogram(
            factor * law.visited, bins=40, range=(float(x[0]), float(x[-1]))
        )
        least = float(np.min(law.low))
        most = float(np.max(law.high))
        room = 0.05 * (most - least) or 1.0
        low, high = least - room, most + room
        index = np.clip(np.digitize(x, edges) - 1, 0, len(count) - 1)
        size = low + 0.22 * (high - low) * count[index] / max(count.max(), 1)
        text = axis.label
        if el.TYPES[e.effect].series:
            text = f"its own {text}"
        elif e.between:
            text = f"{text} of {e.between[0]}–{e.between[1]}"
        items = (
            Line(
                "law", x, law.force, Look(BLUE, "-", "", 1.6), band=(law.low, law.high)
            ),
            Line(
                "distribution of the samples", x, size, Look(MUTED, "-", ""), fill=True
            ),
            Rule("x", 0.0),
            Rule("y", 0.0),
        )
        title = el.spoken(e.effect) if len(laws) > 1 else ""
        panels.append(
            Panel(
                replace(axis, label=text, low=float(x[0]), high=float(x[-1])),
                force_axis("force", turns, low, high),
                items,
                title=title,
            )
        )
    return Chart(
        "law",
        "The law that was found",
        "Force over travel or rate with its interval",
        caption("law"),
        {"all": panels},
        columns=columns,
        size=((4.8, 6.2, 8.2)[columns - 1], 2.9),
    )


def learned(q: Quantity, sigma: float | None) -> bool:
    """Return whether the measurements determine a parameter: the interval is narrower than the stated uncertainty."""
    if not sigma or not q.prior:
        return True
    return (q.high - q.low) < 0.8 * 4 * sigma * abs(q.prior)


def draw_parameters(view: View) -> Chart | None:
    """Return the chart of prior and fitted base parameters, as deviations from the prior; None without parameters."""
    rows = [
        (path, q, sigma)
        for path, q, sigma in view.parameters
        if q.prior and np.isfinite([q.low, q.high]).all()
    ]
    if not rows:
        return None
    items: list[Item] = [Rule("x", 0.0)]
    stated = [(k, 200 * sigma) for k, (_, _, sigma) in enumerate(rows) if sigma]
    if stated:
        at = [k for k, _ in stated]
        spans = ([-s for _, s in stated], [s for _, s in stated])
        items.append(
            Marks(
                "stated: two standard deviations either way",
                [0.0] * len(at),
                at,
                Look(PALE, "-", ""),
                spans,
                bar=9.0,
            )
        )
    groups: tuple[tuple[str, Look, bool, bool], ...] = (
        ("estimate with 95 % interval", Look(BLUE, "-", "o"), True, False),
        ("not determined by these data", Look(MUTED, "-", "o"), False, True),
    )
    for label, look, seen, hollow in groups:
        own = [
            (k, path, q)
            for k, (path, q, sigma) in enumerate(rows)
            if learned(q, sigma) == seen
        ]
        if not own:
            continue
        x, low, high = (
            [100 * (getattr(q, key) / q.prior - 1) for _, _, q in own]
            for key in ("value", "low", "high")
        )
        spans = (
            [min(p) for p in zip(low, high, strict=True)],
            [max(p) for p in zip(low, high, strict=True)],
        )
        items.append(
            Marks(
                label,
                x,
                [k for k, _, _ in own],
                look,
                spans,
                open=hollow,
                size=4.5,
                bar=2.2,
            )
        )
    return Chart(
        "parameters",
        "Parameters",
        "Base parameters found, relative to their prior",
        caption("parameters", view=view),
        {
            "all": [
                Panel(
                    Axis("deviation from the model as given", "%"),
                    Axis(rows=tuple(path for path, _, _ in rows)),
                    tuple(items),
                )
            ]
        },
        size=(7.2, 0.9 + 0.27 * len(rows)),
    )


FIGURES: Sequence[Callable[[View], Chart | None]] = (
    draw_steps,
    draw_loops,
    draw_gap,
    draw_time,
    draw_spectra,
    draw_law,
    draw_parameters,
)
