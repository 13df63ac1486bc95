"""Report of a diagnosis: one page with its figures, to read, print and share."""

from __future__ import annotations

import json
import math
import re
import tempfile
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError, ReportError
from ..._common.files import check_folder, whole_folder, write_text
from ..._common.units import practical
from ...diagnosis._estimation.structure import offsets_of
from ...diagnosis._verdict.grades import grade, observed
from ...diagnosis._verdict.wording import is_gain, statements_of, unit_statements_of
from ...diagnosis.result import FOLDER, Effect
from ...physics import elements as el
from ...physics.network import Network
from ...physics.simulate import pace
from .charts import Axis, Chart, Dots, Item, Line, Marks, Panel, Rule, Span, decades, log_ticks, picture
from .forces import clouds, loops_of
from .plots import (
    BLUE,
    INK,
    MUTED,
    PALE,
    VERMILLION,
    Look,
    Picture,
    channel_text,
    density,
    number,
    page,
    percent,
    style,
    unit_text,
    units_text,
)
from .schematic import draw as sketch
from .schematic import place_parts

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from ..._common.arrays import Array
    from ...diagnosis import Contender, Diagnosis, Quantity, Trace
    from .forces import Curve, Loops


#: stages of a diagnosis: head of a column, and its meaning
STAGES = {
    "before": ("as given", "the nominal model"),
    "refit": ("refitted", "the nominal model with its parameters refitted within their stated uncertainty"),
    "after": ("with the effect", "the refitted model with the addition"),
    "candidate": (
        "with the best candidate",
        "the refitted model with the best candidate, which is not named",
    ),
    "noise_floor": ("noise", "the measurement noise, which limits every model"),
}
RELATIONS = {"<": "<", "<=": "≤", ">": ">", ">=": "≥"}
#: axes of an unnamed force
OVER = {"rate": "rate", "elongation": "travel", "both": "travel and rate"}


def write_report(diagnosis: Diagnosis, folder: str | Path, *, about: Mapping[str, str] | None = None) -> Path:
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
        diagnosis.save(place, report=False)
    try:
        _draw_report(diagnosis, folder, dict(about or {}))
    except Exception as error:  # a failing figure must not lose the results of a long computation
        raise ReportError("the report", error, f"the results are in '{folder}'") from error
    return folder / "report.html"


def _draw_report(diagnosis: Diagnosis, folder: Path, about: dict[str, str]) -> None:
    """Exchange the folder for a folder with the results, the page and its figures."""
    view = View(diagnosis)
    with style(), whole_folder(folder, *FOLDER) as place:
        diagnosis.save(place, report=False)
        pictures: dict[str, Picture] = {}
        for make in FIGURES:
            chart = make(view)
            if chart is not None:
                pictures[chart.name] = picture(chart, place)
        html = page(
            "diagnosis.html",
            d=diagnosis,
            view=view,
            pictures=pictures.values(),
            shown=pictures,
            about=about,
            stages=STAGES,
        )
        write_text(place / "report.html", html)


def signal_picture(diagnosis: Diagnosis) -> str:
    """Return the picture of measured and simulated signals of a diagnosis, as HTML for a notebook.

    Returns:
        An image with its caption; empty for a diagnosis without a simulated record.
    """
    try:
        chart = draw_time(View(diagnosis)) if diagnosis.traces else None
        if chart is None:
            return ""
        with style(), tempfile.TemporaryDirectory() as place:
            made = picture(chart, Path(place))
    except Exception as error:
        raise ReportError("the picture", error, "the tables are complete") from error
    shown = f'<img src="{made.data}" alt="{escape(made.alt)}" width="{made.width}">'
    return f"<figure>{shown}<figcaption>{escape(made.caption)}</figcaption></figure>"


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
    return all(np.isfinite(y).all() for curves in (trace.refit, trace.after) for y in curves.values())


class View:
    """A diagnosis prepared for a page: words, scales and the drawn records."""

    def __init__(self, diagnosis: Diagnosis) -> None:
        self.d = d = diagnosis
        self.named = bool(d.effects)
        # whether the new model differs from the given model
        completes = d.best_candidate is not None and d.best_candidate.completes
        self.changed = self.named or d.tabulated is not None or d.verdict == "ambiguous" or completes
        self.inside = isinstance(d.base, Network)
        document = d.to_dict()
        told = (statements_of if self.inside else unit_statements_of)(document)
        self.title = self.printed(told.title)
        self.finding, self.remarks, self.steps = (
            [self.printed(s) for s in part] for part in (told.finding, told.remarks, told.next_steps)
        )
        # whether several candidates cannot be told apart
        self.tied = d.verdict == "ambiguous" and d.reason != "kind_certain"
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
        self.trace: Trace | None = max(held, key=lambda t: len(t.time)) if held else None
        self.scales = {c: self._scale(c) for c in self.channels}
        self.order = sorted(self.channels, key=lambda c: -d.gap["refit"][c])
        # error by stage and channel
        self.errors = {s: d.gap[s] for s in STAGES if s in d.gap and (s != "after" or self.changed)}
        if d.best_candidate is not None and not self.changed and is_gain(document["best_candidate"]):
            noise = self.errors.pop("noise_floor")
            self.errors |= {"candidate": d.best_candidate.error["after"], "noise_floor": noise}
        self.stages = list(self.errors)
        self.clouds = clouds(d, self.trace) if self.trace is not None else []
        self.remarks += list(dict.fromkeys(d.notes))
        self.spoken, self.observed = el.spoken, observed
        self.loops = loops_of(d, self.trace, self.clouds) if self.trace is not None else []
        self.laws = list(d.laws)

    def _scale(self, name: str) -> Scale:
        unit = self.d.units.get(name) or next((c.unit for c in self.d.base.outputs if c.name == name), "")
        peak = max(
            (float(np.abs(t.measured[name]).max()) for t in self.traces if name in t.measured), default=1.0
        )
        if unit == "m" and peak < 0.5:
            return Scale(1e3, "mm")
        if unit == "N" and peak >= 5e3:
            return Scale(1e-3, "kN")
        return Scale(1.0, unit_text(unit))

    def drawings(self) -> list[tuple[str, str]]:
        """Return drawings of the network: as given, and with the result in colour."""
        if not isinstance(self.d.base, Network) or not isinstance(self.d.model, Network):
            return []
        known = {e.name for e in self.d.base.elements}
        # fitted offsets of sensors are no additions
        offsets = {e.name for c in self.d.model.outputs for e in offsets_of(self.d.model, c)}
        found = {e.name for e in self.d.model.elements} - known - offsets
        pairs: list[tuple[str, Network, set[str]]] = [("The model as given", self.d.base, set())]
        if self.changed:
            pairs.append(("The completed model, with the addition in colour", self.d.model, found))
        try:
            return [(title, sketch(n, found=marked).svg(inline=True)) for title, n, marked in pairs]
        except InputError:  # nothing between nodes
            return []

    def turns(self, pair: Sequence[str]) -> bool:
        """Return whether two nodes rotate relative to each other: torque over angle instead of force over travel."""
        return isinstance(self.d.base, Network) and any(n in self.d.base.rotating for n in pair)

    def lights(self, c: Contender) -> str:
        """Return the highlighted parts of the drawing for a rival."""
        if not isinstance(self.d.base, Network):
            return "[]"
        return json.dumps([part for where in c.where for part in place_parts(self.d.base, where)])

    def printed(self, sentence: str) -> str:
        """Return a sentence with units, numbers and channels in the style of the page."""
        text = re.sub(r"\b\d(\.\d+)?e[+-]\d\d\b", lambda m: number(float(m[0]), 4), units_text(sentence))
        for c in self.d.gap.get("refit", {}):
            text = re.sub(rf"(?<!\w){re.escape(c)}(?!\w)", channel_text(c).replace("\\", r"\\"), text)
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
                stated += [("law", self.spoken(law.effect), law.probability) for law in f.laws[:1]]
            graded = [(level, text, share, grade(share)) for level, text, share in stated]
            rows.append(
                [(text, f"{name}, {share:.2f}", observed(level, name)) for level, text, share, name in graded]
            )
        return rows

    @property
    def completion(self) -> str:
        """What `model.json` has in addition to the refitted model; '' where it has nothing."""
        d = self.d
        if d.tabulated is not None:
            return f"the {self.force_text.split()[0]} as a table"
        effects = [e.effect for e in d.effects]
        if not effects and d.best_candidate is not None and d.best_candidate.completes:
            effects = list(d.best_candidate.effects)
        if not effects and d.verdict == "ambiguous" and d.contenders:
            effects = list(d.contenders[0].effects)
        return " and ".join(self.spoken(e) for e in effects)

    @staticmethod
    def place_text(place: Sequence[str]) -> str:
        """Return a place in words: two nodes, a channel or motor, or an open place."""
        if not place:
            return "place open"
        return f"{place[0]} – {place[1]}" if len(place) == 2 else channel_text(place[0])

    @staticmethod
    def bar(share: float) -> str:
        """Return a probability as an inline bar with its value."""
        full, width = 60, 60 * min(max(share, 0.0), 1.0)
        return (
            f'<span class="whole"><svg width="{full}" height="10" role="img" aria-label="{share:.2f}"><rect width="{full}" height="10" style="fill:var(--pale)"/>'
            f'<rect width="{width:.1f}" height="10" style="fill:var(--accent)"/></svg> {share:.2f}</span>'
        )

    def effect_text(self, e: Any) -> str:
        """Return an effect in words, such as ``coulomb friction between piston and joint``."""
        if e.channel is not None:
            return f"{el.spoken(e.effect)} in {channel_text(e.channel)}"
        if not e.between:
            return el.spoken(e.effect)
        how = f", in series with {e.behind or 'what stands'}" if el.TYPES[e.effect].series else ""
        return f"{el.spoken(e.effect)}{how} between {e.between[0]} and {e.between[1]}"

    def contender_text(self, c: Any) -> str:
        """Return a rival in words."""
        parts = []
        for effect, where in zip(c.effects, c.where, strict=True):
            joined = " and ".join(channel_text(w) if len(where) == 1 else w for w in where)
            parts.append(f"{el.spoken(effect)} {'between' if len(where) == 2 else 'at'} {joined}")
        return ", with ".join(parts)

    def quantity(self, q: Any) -> str:
        """Return a value with a practical unit, such as ``296.6 N``, with the digits that its interval warrants."""
        factor, unit = practical(q.value, q.unit)
        value, low, high = factor * q.value, factor * q.low, factor * q.high
        return f"{_digits(value, low, high)}\u00a0{unit_text(unit)}".strip()

    @staticmethod
    def figure(value: float) -> str:
        """Return the value of a gate with at most three digits and without exponent, or a dash."""
        if not math.isfinite(value):
            return "–"
        return (f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}").replace("-", "−")

    def needed(self, g: Any) -> str:
        """Return the requirement of a gate, such as ``≥ 0.05``."""
        return f"{RELATIONS[g.relation]}\u00a0{self.figure(g.limit)}"

    @property
    def force_text(self) -> str:
        """Description of an unnamed force, such as ``force between body and wheel, as a table over travel``."""
        t = self.d.tabulated
        if t is None:
            return ""
        text = f"force between {t.between[0]} and {t.between[1]}, as a table over {OVER[t.over]}"
        return text.replace("force", "torque").replace("travel", "angle") if self.turns(t.between) else text

    @property
    def nearest_text(self) -> str:
        """Known laws nearest to an unnamed force, with the share of the force that each law explains."""
        near = self.d.tabulated.nearest if self.d.tabulated is not None else ()
        return ", ".join(f"{el.spoken(name)} ({percent(share, 0, sign=False)} of it)" for name, share in near)

    @property
    def shares_text(self) -> str:
        """Shares of a force over travel and rate that a single axis explains; '' for a force over one axis."""
        shares = self.d.tabulated.shares if self.d.tabulated is not None else ()
        return ", ".join(
            f"a function of {OVER[over]} alone gives {percent(x, 0, sign=False)} of it" for over, x in shares
        )

    @property
    def plane_title(self) -> str:
        """Title of the dots over the motion."""
        agrees = self.d.verdict in ("no_discrepancy", "parameters_only")
        return "Residual over the motion" if agrees else "Missing force over the motion"

    @property
    def bias_text(self) -> str:
        """Warning that the refitted parameters are biased, if an effect is missing that has no certain name; otherwise ''."""
        if self.d.verdict not in ("unknown_effect", "ambiguous") or self.refit_text:
            return ""
        return (
            "These estimates are biased by what is missing: the parameters of the refitted model compensate a part of the missing effect, "
            "and the true values may lie outside the intervals."
        )

    @property
    def refit_text(self) -> str:
        """Model of the parameters, if a force is missing that the refitted model lacks; otherwise ''."""
        if self.d.tabulated is not None:
            return "These are the parameters of the refitted model without the missing force. They are biased by what is missing: they compensate a part of that force."
        return ""

    def interval(self, q: Any) -> str:
        """Return the interval of a quantity in the unit of `quantity`."""
        factor, _ = practical(q.value, q.unit)
        low, high = factor * q.low, factor * q.high
        return f"{_digits(low, low, high)} to {_digits(high, low, high)}"

    def other(self, value: float, q: Any) -> str:
        """Return another value of a quantity, such as its prior, with the unit of the quantity.

        Args:
            value: The value [unit of the quantity].
            q: The quantity.
        """
        factor, unit = practical(q.value, q.unit)
        return f"{number(factor * value, 4)}\u00a0{unit_text(unit)}".strip()

    def equation(self, e: Effect) -> str:
        """Return the equation of an effect."""
        # the equations in the code are ASCII
        text: str = getattr(el.TYPES.get(e.effect), "equation", "")
        for plain, mark in (("F in ", "F ∈ "), ("^2", "²"), ("^3", "³"), (" - ", " − ")):
            text = text.replace(plain, mark)
        return text

    def source(self, e: Effect) -> str:
        """Return the source of an effect's law."""
        return getattr(el.TYPES.get(e.effect), "source", "")

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
        if self.trace is None or self.d.verdict in ("no_discrepancy", "parameters_only"):
            return "gap"
        if self.loops:
            return "loops"
        return "plane" if self.named else "time" if len(self.channels) <= FEW else "gap"

    @property
    def parameters(self) -> list[tuple[str, Any, float | None]]:
        """Base parameters: path, quantity, and relative standard deviation in the model file."""
        return [(path, q, self.d.base.uncertainty.get(path)) for path, q in self.d.parameters.items()]

    def odd(self, q: Any, sigma: float | None) -> bool:
        """Return whether a fitted parameter is outside of twice its stated uncertainty."""
        return bool(sigma and q.prior and abs(q.value / q.prior - 1.0) > 2.0 * sigma)


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
    if low < value < high and value != 0.0:  # a value within a wide interval must not vanish: 14.66 is not 0
        places = max(places, 1 - math.floor(math.log10(abs(value))))
    return f"{round(value, places) + 0.0:.{max(0, places)}f}".replace("-", "−")


# ------------------------------------------------------------------------------------------------- the figures

#: styles of the two models in all figures
MEASURED = Look(INK, "-", "", 1.6)
BEFORE = Look(VERMILLION, (0, (4, 1.5)), "D", 1.1)
AFTER = Look(BLUE, "-", "o", 1.0)
NOISE = Look(INK, (0, (1, 1.5)), "", 0.8)
WORST = "worst stretch"
STRETCH = 2.5  # length of the drawn stretches of a record [s]
PERIODS = 4  # periods of the motion in a loop
FEW = 2  # channels whose time histories fit on the first screen
MOST_SAMPLES = 360_000  # largest number of samples of records in a page (about 1 MB)


def draw_gap(view: View) -> Chart:
    """Return the chart of the held-out error of every channel at every stage."""
    looks = {
        "before": (Look(MUTED, "-", "s"), True, 6.5),
        "refit": (Look(VERMILLION, "-", "D"), True, 6.5),
        "after": (Look(BLUE, "-", "o"), False, 7.5),
        "candidate": (Look(BLUE, "-", "o"), True, 7.5),
        "noise_floor": (Look(INK, "-", "|"), False, 13.0),
    }
    values = {s: [max(100 * view.errors[s][c], 1e-3) for c in view.order] for s in view.stages}
    ends = [[f(values[s][k] for s in view.stages) for k in range(len(view.order))] for f in (min, max)]
    items: list[Item] = [
        Marks("", ends[0], range(len(view.order)), Look(PALE, "-", ""), (ends[0], ends[1]), bar=4.0)
    ]
    for stage in view.stages:
        look, hollow, size = looks[stage]
        label = view.labels[stage]
        notes = [
            f"{channel_text(c)}, {label}: {percent(view.errors[stage][c], 2, sign=False)}" for c in view.order
        ]
        items.append(
            Marks(label, values[stage], range(len(view.order)), look, notes=notes, open=hollow, size=size)
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
        {"all": [Panel(x, Axis(rows=tuple(map(channel_text, view.order))), tuple(items))]},
        size=(7.2, 0.95 + 0.42 * len(view.channels)),
    )


def _stretches(view: View, trace: Trace) -> dict[str, slice]:
    """Return the stretches of a record in which the refitted model errs most, and as much as usual."""
    c = view.order[0]
    step = float(trace.time[1] - trace.time[0])
    width = min(len(trace.time), max(10, round(STRETCH / step)))
    power = np.concatenate([[0.0], np.cumsum((trace.measured[c] - trace.refit[c]) ** 2)])
    within = power[width:] - power[:-width]
    usual = np.abs(within - np.median(within))
    starts = {WORST: int(np.argmax(within)), "typical stretch": int(np.argmin(usual))}
    return {name: slice(k, k + width) for name, k in starts.items()}


def _steady(axis: Axis, left: Sequence[np.ndarray], noise: float) -> Axis:
    """Return an axis that clips a peak of a few samples, as after a wrong initial state."""
    usual = max(noise, *(float(np.quantile(np.abs(r), 0.99)) for r in left))
    if max(float(np.abs(r).max()) for r in left) <= 3 * usual:
        return axis
    return replace(axis, low=-1.5 * usual, high=1.5 * usual)


@dataclass(frozen=True)
class Records:
    """The records that a chart over time shows."""

    traces: dict[str, Trace]  # records by the name in the chart; the record of the picture first
    every: dict[str, int]  # step between the drawn samples of each record

    @classmethod
    def of(cls, view: View, trace: Trace) -> Records:
        """Return the records of a diagnosis, thinned to the size of a page."""
        chosen = [trace, *(t for t in view.traces if t is not trace)][:8]
        each = 5 if view.changed else 3  # signals and residuals of a channel
        share = MOST_SAMPLES / (each * len(view.order) * len(chosen))
        names: dict[str, Trace] = {}
        for k, t in enumerate(chosen):
            name = f"{t.name} ({t.use})"
            names[f"{name}, {k + 1}" if name in names else name] = t
        return cls(names, {name: max(1, math.ceil(len(t.time) / share)) for name, t in names.items()})

    def head(self, name: str) -> str:
        """Return the beginning of a caption."""
        thinned, t = self.every[name], self.traces[name]
        note = f" One sample in {thinned} is drawn." if thinned > 1 else ""
        return f"Record “{t.name}” ({t.use}).{note}"


def _simulated(view: View, t: Trace) -> dict[str, tuple[dict[str, Array], Look]]:
    """Return the simulations that charts show, with their styles."""
    out = {"refitted model": (t.refit, BEFORE)}
    return out | ({"completed model": (t.after, AFTER)} if view.changed else {})


def _signal_axis(view: View, c: str) -> Axis:
    """Return the axis of a channel, its name in two lines."""
    return Axis(channel_text(c).replace(" ", "\n", 1), view.scales[c].unit or "–")


def _more(view: View, few: Sequence[str]) -> str:
    return (
        f" The picture shows the {len(few)} channels with the largest error."
        if len(few) < len(view.order)
        else ""
    )


def draw_time(view: View) -> Chart | None:
    """Return the chart of all records over time: the stretch with the largest error, and a typical stretch; None without records."""
    if view.trace is None:
        return None
    few = view.order[:5]
    records = Records.of(view, view.trace)
    choices, captions = {}, {}
    for name, t in records.traces.items():
        every, panels = slice(None, None, records.every[name]), []
        stretches = _stretches(view, t)
        for c in view.order:
            k = view.scales[c].factor
            says = {"measured": (t.measured, MEASURED), **_simulated(view, t)}
            for title, cut in stretches.items():
                # the worst stretch is a view of the whole record, the typical one is a part of the record
                drawn = every if title == WORST else slice(cut.start, cut.stop, every.step)
                # the measured signal first: its broader line remains visible under the others
                lines = [Line(n, t.time[drawn], k * y[c][drawn], look) for n, (y, look) in says.items()]
                low, high = (f(float(f(k * y[c][cut])) for y, _ in says.values()) for f in (min, max))
                room = 0.05 * (high - low) or 1.0
                y_axis = replace(_signal_axis(view, c), low=low - room, high=high + room)
                x_axis = Axis("time", "s", low=float(t.time[cut][0]), high=float(t.time[cut][-1]))
                panels.append(Panel(x_axis, y_axis, tuple(lines), title=title, link=title))
        length = float(np.ptp(t.time[next(iter(stretches.values()))]))
        choices[name] = panels
        captions[name] = (
            f"{records.head(name)} The worst stretch: the {length:.3g} s in which the refitted model errs most in "
            f"{channel_text(view.order[0])}. The typical stretch: as long, with the median error.{_more(view, few)}"
        )
    return Chart(
        "time",
        "In time",
        "Measured and simulated signals over time: the stretch with the largest error, and a typical stretch",
        next(iter(captions.values())),
        choices,
        columns=2,
        size=(7.6, 1.65 * len(few) + 0.7),
        still=2 * len(few),
        captions=captions,
    )


def draw_residuals(view: View) -> Chart | None:
    """Return the chart of the residuals of all records; None without records."""
    if view.trace is None:
        return None
    few = view.order[:5]
    records = Records.of(view, view.trace)
    choices, captions = {}, {}
    for name, t in records.traces.items():
        every, panels = slice(None, None, records.every[name]), []
        spans = [Span(float(t.time[cut][0]), float(t.time[cut][-1])) for cut in _stretches(view, t).values()]
        for c in view.order:
            k = view.scales[c].factor
            rest = {n: (k * (t.measured[c] - y[c]), look) for n, (y, look) in _simulated(view, t).items()}
            noise = 2 * k * view.d.gap["noise_floor"][c] * float(np.std(t.measured[c]))
            items: list[Item] = [
                Line(n, t.time[every], r[every], replace(look, line="-", width=0.7, marker=""))
                for n, (r, look) in rest.items()
            ]
            items += [*(Rule("y", y, look=NOISE) for y in (-noise, noise)), *spans]
            x_axis = Axis("time", "s", low=float(t.time[0]), high=float(t.time[-1]))
            y_axis = _steady(_signal_axis(view, c), [r for r, _ in rest.values()], noise)
            panels.append(Panel(x_axis, y_axis, tuple(items), link="time"))
        choices[name] = panels
        captions[name] = (
            f"{records.head(name)} Dotted: twice the noise. Shaded: the stretches of the figure above. Peaks of a few samples may "
            f"exceed the axis.{_more(view, few)}"
        )
    return Chart(
        "residuals",
        "Residuals",
        "Measured minus simulated signals over time",
        next(iter(captions.values())),
        choices,
        size=(7.6, 1.1 * len(few) + 0.7),
        still=len(few),
        captions=captions,
    )


def draw_loops(view: View) -> Chart | None:
    """Return the chart of the force at the place of the finding over velocity and over travel; None without a force or its motion."""
    return _loops_chart(view, "loops", view.loops[:1])


def draw_other_loops(view: View) -> Chart | None:
    """Return the chart of the other forces over velocity and over travel; None without other forces."""
    return _loops_chart(view, "other_loops", view.loops[1:4])


def _loops_chart(view: View, name: str, forces: Sequence[Loops]) -> Chart | None:
    """Return loops in the measurement, the model as given, and the completed (or refitted) model."""
    trace = view.trace
    if trace is None or not forces:
        return None
    new, look = ("completed model", AFTER) if view.changed else ("refitted model", BEFORE)
    choices = {}
    for title, stretch in _stretches(view, trace).items():
        panels = []
        for loops in forces:
            own = _cycles(loops, stretch, float(trace.time[1] - trace.time[0]))
            curves = {
                "measured": (loops.measured, replace(MEASURED, width=2.6)),
                "model as given": (loops.nominal, Look(MUTED, (0, (4, 1.5)), "", 1.1)),
                new: (loops.new, replace(look, line="-", marker="", width=1.2)),
            }
            shown = {n: (c.part(own), style) for n, (c, style) in curves.items() if c is not None}
            panels += _loop_panels(view, loops, shown)
        choices[title] = panels
    rebuilt = [f"{x.pair[0]} and {x.pair[1]}" for x in forces if not x.is_measured]
    note = (
        f" No channel measures the force between {' or '.join(rebuilt)}: “measured” is the simulated force plus the force that the "
        "residuals require."
        if rebuilt
        else ""
    )
    return Chart(
        name,
        "Other forces over velocity and travel"
        if name == "other_loops"
        else "Force over velocity and travel",
        "Loops of the force over velocity and over travel, measured and simulated",
        f"Force, positive in tension, over the motion of its terminals: about {PERIODS} periods from the stretch of the record "
        f"“{trace.name}” ({trace.use}).{note}",
        choices,
        columns=2,
        size=(7.4, 2.5 * len(forces) + 0.4),
    )


def _cycles(loops: Loops, stretch: slice, step: float) -> slice:
    """Return some periods of the motion in the middle of a stretch of the record."""
    period = 2 * math.pi * pace(loops.measured.rate, step) / step
    count, whole = len(loops.measured.travel), stretch.stop - stretch.start
    width = min(count, max(10, min(whole, round(PERIODS * period))))
    start = (stretch.start + stretch.stop - width) // 2 - loops.samples.start
    start = min(max(start, 0), count - width)
    return slice(start, start + width)


def _loop_panels(view: View, loops: Loops, curves: Mapping[str, tuple[Curve, Look]]) -> list[Panel]:
    """Return the panels of a force over rate and over travel."""
    turns = view.turns(loops.pair)
    unit = "N·m" if turns else "N"
    top = max(float(np.abs(c.force).max()) for c, _ in curves.values())
    scale, unit = (1e-3, f"k{unit}") if top >= 1e4 else (1.0, unit)
    y = Axis(channel_text(loops.name), unit)
    panels = []
    for kind in ("rate", "travel"):
        factor, x = _law_axis(kind, turns)
        x = replace(x, label=f"{x.label} of {loops.pair[0]}–{loops.pair[1]}")
        items = [Line(n, factor * getattr(c, kind), scale * c.force, look) for n, (c, look) in curves.items()]
        panels.append(Panel(x, y, (Rule("x", 0.0), Rule("y", 0.0), *items)))
    return panels


def draw_spectra(view: View) -> Chart | None:
    """Return the chart of the spectra of signal and residuals, averaged over the held-out records (or all records).

    Returns:
        The chart; None without records.
    """
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
    places = {p.channel: p for p in view.d.where}
    seconds = min(8.0, min(len(t.time) for t in used) * step)
    panels = []
    for c in shown:
        unit = view.scales[c]

        def mean(signal: Callable[[Trace], Array], scale: float = unit.factor) -> tuple[Array, Array]:
            found = [density(scale * signal(t), step, seconds) for t in used]
            return found[0][0], np.mean([p for _, p in found], axis=0)

        f, p = mean(lambda t, c=c: t.measured[c])  # type: ignore[misc]
        keep = (f >= 0.2) & (f <= min(60.0, 0.45 / step))
        keep = keep if keep.sum() > 4 else f > 0
        _, old = mean(lambda t, c=c: t.measured[c] - t.refit[c])  # type: ignore[misc]
        curves = [("measured", p, Look(MUTED, "-", "", 1.4)), ("residual of the refitted model", old, BEFORE)]
        if view.changed:
            _, new = mean(lambda t, c=c: t.measured[c] - t.after[c])  # type: ignore[misc]
            curves.append(("residual of the completed model", new, AFTER))
        items: list[Item] = [Line(n, f[keep], y[keep], replace(look, marker="")) for n, y, look in curves]
        top = float(p[keep].max())
        least = min(float(y[keep].min()) for _, y, _ in curves[1:])
        low, high = max(0.5 * least, 1e-8 * top), 3 * max(top, float(old[keep].max()))
        items += [Span(max(a, float(f[keep][0])), b) for a, b in (places[c].bands_hz if c in places else ())]
        x = Axis("frequency", "Hz", log=True, ticks=log_ticks(float(f[keep][0]), float(f[keep][-1])))
        density_unit = f"({unit.unit})²/Hz" if "/" in unit.unit else f"{unit.unit}²/Hz"
        y_axis = Axis("density", density_unit, log=True, low=low, high=high, ticks=decades(low, high))
        panels.append(Panel(x, y_axis, tuple(items), title=channel_text(c), link="frequency"))
    over = (
        f"the record “{view.trace.name}” ({view.trace.use})"
        if len(used) == 1
        else f"{len(used)} records ({view.trace.use}), averaged: {', '.join(t.name for t in used)}"
    )
    shade = (
        " Grey bands hold most of the refitted model's excess error in the fitted records."
        if any(p.bands_hz for p in view.d.where)
        else ""
    )
    return Chart(
        "spectra",
        "In frequency",
        "Spectra of the measurements and of the residuals",
        f"Power spectral densities of {over} (Welch, Hann windows of {seconds:.3g} s).{shade}",
        {"all": panels},
        columns=columns,
        size=((5.2, 6.8, 8.2)[columns - 1], 2.1 * rows + 0.55),
        align=False,
    )


def _law_axis(kind: str, turns: bool) -> tuple[float, Axis]:
    if turns:
        return 1.0, Axis("angular velocity", "rad/s") if kind == "rate" else Axis("angle", "rad")
    return (1.0, Axis("velocity", "m/s")) if kind == "rate" else (1e3, Axis("travel", "mm"))


def _force_axis(label: str, turns: bool, low: float, high: float) -> Axis:
    label, unit = (label.replace("force", "torque"), "N·m") if turns else (label, "N")
    return Axis(label, unit, low=low, high=high)


def draw_plane(view: View) -> Chart | None:
    """Return the chart of the missing force over motion, before and after, or of a channel's residual over its motion.

    Returns:
        The chart; None without records.
    """
    if not view.clouds:
        return _draw_channel_plane(view)
    panels = []
    for cloud in view.clouds:
        law = cloud.law
        kind = law.kind if law is not None else "rate"
        over = {"rate": cloud.rate, "travel": cloud.travel}
        if cloud.after is not None:
            parts = [
                (kind, cloud.before, "missing in the refitted model", VERMILLION),
                (kind, cloud.after, "missing in the completed model", BLUE),
            ]
        else:
            parts = [
                (k, cloud.before, f"missing in the refitted model, over {k}", VERMILLION)
                for k in ("rate", "travel")
            ]
        top = float(np.quantile(np.abs(cloud.before), 0.98)) * 1.25
        if law is not None:
            top = max(top, 1.15 * float(np.abs(law.force).max()))
        for k, (axis_kind, force, title, colour) in enumerate(parts):
            turns = view.turns(cloud.pair)
            factor, x = _law_axis(axis_kind, turns)
            x = replace(x, label=f"{x.label} of {cloud.pair[0]}–{cloud.pair[1]}")
            items, x = _dots(x, factor * over[axis_kind], force, colour)
            if law is not None and k == 0:
                look = Look(BLUE, "-", "", 1.6)
                items.append(Line("added law", factor * law.axis, law.force, look, band=(law.low, law.high)))
            y = _force_axis("missing force", turns, -top, top)
            panels.append(Panel(x, y, tuple(items), title=title))
    drawn = any(cloud.law is not None for cloud in view.clouds)
    where = "no law is assumed"
    if drawn:
        where = (
            "the reconstruction does not use the law. The added law is the force of the completed model minus the force of the "
            "refitted model between these nodes, so that law and dots are the same quantity"
        )
    assert view.trace is not None
    return Chart(
        "plane",
        view.plane_title,
        "The missing force, or residual, over travel or rate, before and after",
        "Each dot is the force that the model lacks at one sample. The force is reconstructed from the residuals of all channels of "
        f"the record “{view.trace.name}” ({view.trace.use}) through the linear model; {where}. The limited resolution of the sensors "
        "smooths corners. Up to 2 % of the dots lie outside the axis.",
        {"all": panels},
        columns=2,
        size=(7.4, 2.9 * len(view.clouds) + 0.4),
    )


def _trend(x: Array, y: Array, bins: int = 24) -> tuple[Array, Array]:
    """Return means of x and medians of y in bins of x with enough samples; the medians are robust to outliers."""
    edges = np.linspace(float(np.quantile(x, 0.002)), float(np.quantile(x, 0.998)), bins + 1)
    index = np.digitize(x, edges) - 1
    pick = [k for k in range(bins) if np.sum(index == k) >= 10]
    return np.array([x[index == k].mean() for k in pick]), np.array([np.median(y[index == k]) for k in pick])


def _draw_channel_plane(view: View) -> Chart | None:
    """Return the chart of a channel's residual over motion, current or signal, for a diagnosis without a force."""
    trace = view.trace
    if trace is None or view.d.verdict == "no_discrepancy":
        return None
    channel = next((e.channel for e in view.d.effects if e.channel), None) or view.order[0]
    unit = view.scales[channel]
    if view.named:
        x, axis = _abscissa(view, trace, channel)
        parts = [
            (trace.refit, x, axis, "refitted model", VERMILLION),
            (trace.after, x, axis, "completed model", BLUE),
        ]
    else:
        (d, travel), (v, rate) = _motion_axes(view, trace, channel)
        parts = [
            (trace.refit, d, travel, "refitted model, over travel", VERMILLION),
            (trace.refit, v, rate, "refitted model, over rate", VERMILLION),
        ]
    rest = [unit.factor * (trace.measured[channel] - says[channel]) for says, *_ in parts]
    top = 1.08 * max(float(np.abs(r).max()) for r in rest) or 1.0
    y = Axis(f"measured minus simulated\n{channel_text(channel)}", unit.unit or "–", low=-top, high=top)
    panels = []
    for r, (_, x, axis, title, colour) in zip(rest, parts, strict=True):
        items, axis = _dots(axis, x, r, colour)
        panels.append(Panel(axis, y, tuple(items), title=title))
    return Chart(
        "plane",
        view.plane_title,
        "The missing force, or residual, over travel or rate, before and after",
        f"Residual (measured minus simulated) of {channel_text(channel)} on the record “{trace.name}”, sample by sample.",
        {"all": panels},
        columns=2,
        size=(7.4, 3.2),
    )


def _dots(axis: Axis, x: Array, y: Array, colour: str) -> tuple[list[Item], Axis]:
    """Return a cloud, its median along x, and an axis without the outer two thousandths of x."""
    thin = max(1, len(x) // 2500)
    middle, mean = _trend(x, y)
    low, high = (float(q) for q in np.quantile(x, [0.001, 0.999]))
    margin = 0.05 * (high - low) or 1.0
    items: list[Item] = [
        Rule("y", 0.0),
        Dots("", x[::thin], y[::thin], Look(colour, "-", ".")),
        Line("median of the dots", middle, mean, Look(INK, "-", "o", 1.0)),
    ]
    return items, replace(axis, low=low - margin, high=high + margin)


def _abscissa(view: View, trace: Trace, channel: str) -> tuple[Array, Axis]:
    """Return the signal on which the residual of a motor or sensor effect depends."""
    step = float(trace.time[1] - trace.time[0])
    unit = view.scales[channel]
    late = any(e.effect in ("sensor_delay", "actuator_delay", "actuator_lag") for e in view.d.effects)
    current = next((c.name for c in view.d.base.inputs if c.quantity == "current"), None)
    if current is not None and not any(e.channel for e in view.d.effects):
        values = np.asarray(trace.inputs[current])
        if late:
            return np.gradient(values, step), Axis(f"rate of {channel_text(current)}", "A/s")
        return values, Axis(channel_text(current), "A")
    values = unit.factor * trace.after[channel]
    if late:
        return np.gradient(values, step), Axis(f"rate of {channel_text(channel)}", f"{unit.unit}/s")
    return values, Axis(f"{channel_text(channel)} as simulated", unit.unit or "–")


def _motion_axes(view: View, trace: Trace, channel: str) -> tuple[tuple[Array, Axis], tuple[Array, Axis]]:
    """Return travel and rate as abscissae of a residual: of a measured displacement, a moved node, or the channel itself."""
    step = float(trace.time[1] - trace.time[0])
    quantity = {c.name: c.quantity for c in view.d.base.outputs}
    moved = next((c.name for c in view.d.base.inputs if c.quantity == "displacement"), None)
    own = next((c for c in (channel, *view.order) if quantity.get(c) == "displacement"), None)
    if own is None and moved is not None:
        x, factor, unit, name = np.asarray(trace.inputs[moved]), 1e3, "mm", moved
    else:
        name = own or channel
        x, factor, unit = trace.refit[name], view.scales[name].factor, view.scales[name].unit
    text = channel_text(name)
    return (factor * x, Axis(text, unit)), (
        factor * np.gradient(x, step),
        Axis(f"rate of {text}", f"{unit}/s"),
    )


def draw_law(view: View) -> Chart | None:
    """Return the chart of every identified law with its interval, and the distribution of the measured motion; None without a law."""
    d = view.d
    effects = list(d.effects)
    if d.tabulated is not None:  # an unnamed law is drawn like a named law
        t = d.tabulated
        effects.append(Effect("tabulated_force", t.between, None, 0.0, {}, t.element))
    laws = [(law, e) for law in view.laws for e in effects if e.element == law.element]
    if not laws:
        return None
    columns = min(3, len(laws))
    panels = []
    for law, e in laws[:3]:
        turns = view.turns(e.between or ())
        factor, axis = _law_axis(law.kind, turns)
        x = factor * law.axis
        count, edges = np.histogram(factor * law.visited, bins=40, range=(float(x[0]), float(x[-1])))
        least, most = float(np.min(law.low)), float(np.max(law.high))
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
            Line("law", x, law.force, Look(BLUE, "-", "", 1.6), band=(law.low, law.high)),
            Line("distribution of the samples", x, size, Look(MUTED, "-", ""), fill=True),
            Rule("x", 0.0),
            Rule("y", 0.0),
        )
        title = el.spoken(e.effect) if len(laws) > 1 else ""
        panels.append(
            Panel(
                replace(axis, label=text, low=float(x[0]), high=float(x[-1])),
                _force_axis("force", turns, low, high),
                items,
                title=title,
            )
        )
    return Chart(
        "law",
        "The law that was found",
        "Force over travel or rate with its interval",
        "Force with its 95 % interval, positive in tension. The law is valid only within the measured range."
        + (
            ""
            if d.tabulated is None or d.tabulated.over != "both"
            else " The force also depends on the rate; the curve is the force at zero rate."
        ),
        {"all": panels},
        columns=columns,
        size=((4.8, 6.2, 8.2)[columns - 1], 2.9),
        align=False,
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
        own = [(k, path, q) for k, (path, q, sigma) in enumerate(rows) if learned(q, sigma) == seen]
        if not own:
            continue
        x, low, high = (
            [100 * (getattr(q, key) / q.prior - 1) for _, _, q in own] for key in ("value", "low", "high")
        )
        notes = [
            f"{path}: {view.quantity(q)}, 95 % {view.interval(q)}, as given {number(q.prior, 4)}"
            for _, path, q in own
        ]
        spans = ([min(p) for p in zip(low, high, strict=True)], [max(p) for p in zip(low, high, strict=True)])
        items.append(
            Marks(label, x, [k for k, _, _ in own], look, spans, notes=notes, open=hollow, size=4.5, bar=2.2)
        )
    together = (
        ", together with the effect that was found"
        if view.named
        else ", without the missing force"
        if view.changed
        else ""
    )
    return Chart(
        "parameters",
        "Parameters",
        "Base parameters found, relative to their prior",
        f"Pale: stated uncertainty of the nominal model (95 %). Blue: estimate from the measurements{together}. Grey and open: the "
        "measurements do not determine this parameter, so its interval is the stated one.",
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
    draw_loops,
    draw_other_loops,
    draw_gap,
    draw_time,
    draw_residuals,
    draw_spectra,
    draw_plane,
    draw_law,
    draw_parameters,
)
