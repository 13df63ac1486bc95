"""Figures in one style, and the page of a score: what a vehicle engineer asks to see.

Colours are those of Okabe and Ito (Color Universal Design, 2008); every line also has a dash pattern or a marker of
its own, so that a page printed in black tells the same story. No figure touches matplotlib's global state.
"""

from __future__ import annotations

import base64
import json
import math
import platform
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata, resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .files import check_folder, whole_folder, write_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .scoring import Score

INK, MUTED, PALE = "#262b30", "#606870", "#dfe3e7"
BLACK, BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY = (
    "#262b30", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9",
)  # fmt: skip
DPI = 160

STYLE: dict[str, Any] = {
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "grid.color": PALE,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
    "lines.linewidth": 1.3,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.handlelength": 2.8,
    "legend.fontsize": 9.0,
    "savefig.dpi": DPI,
}


@dataclass(frozen=True)
class Look:
    """How one of several things is drawn: no two share a colour, a line or a marker."""

    colour: str
    line: Any
    marker: str
    width: float = 1.3


#: the thing that others are compared with comes first
LOOKS = (
    Look(BLACK, (0, (1.2, 1.2)), "s", 1.2),
    Look(BLUE, "-", "o", 1.4),
    Look(VERMILLION, (0, (5.5, 1.6)), "D", 1.4),
    Look(GREEN, (0, (6, 1.5, 1.2, 1.5)), "^", 1.4),
    Look(PURPLE, (0, (3, 1.2)), "v", 1.3),
    Look(ORANGE, (0, (6, 1.2, 1.2, 1.2, 1.2, 1.2)), "P", 1.3),
    Look(SKY, (0, (9, 2)), "X", 1.3),
)


def looks(names: Sequence[str]) -> dict[str, Look]:
    """A look for each name, in order; after seven they repeat."""
    return {name: LOOKS[i % len(LOOKS)] for i, name in enumerate(names)}


@contextmanager
def style() -> Iterator[None]:
    """Figures made and saved inside are in the project's style."""
    from matplotlib import rc_context

    with rc_context(STYLE):  # type: ignore[arg-type]
        yield


def figure(width: float = 7.2, height: float = 4.0) -> Figure:
    """An empty figure [inch] that no global list of figures holds on to."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=(width, height))
    FigureCanvasAgg(fig)
    return fig


def save(fig: Figure, path: Path) -> Path:
    """Write `fig` as PNG, the same bytes for the same figure."""
    fig.savefig(path, format="png", dpi=DPI, metadata={"Software": None})
    return path


def pixels(fig: Figure) -> int:
    """Width of a figure on a page [CSS pixel]."""
    return round(122 * fig.get_size_inches()[0])


def embedded(path: Path) -> str:
    """A PNG as a data URI, for a page that stands alone."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode("ascii")


@dataclass(frozen=True)
class Picture:
    """A figure on a page: file `name` in the folder, `alt` for who cannot see it, `caption` (HTML allowed)."""

    name: str
    title: str
    alt: str
    caption: str
    data: str
    width: int  # [CSS pixel] at which its text is as large as the page's small print


def number(value: float | None, digits: int = 3) -> str:
    """`value` to so many significant digits, with a true minus sign, without an exponent where one can do without."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    size = abs(value)
    if 1e-4 <= size < 1e6:
        places = max(0, digits - 1 - math.floor(math.log10(size)))
        text = f"{value:.{places}f}"
    else:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        text = f"{mantissa}·10{str(int(exponent)).translate(_RAISED)}"
    return text.replace("-", "−")


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def percent(share: float | None, digits: int = 1, *, sign: bool = True) -> str:
    """A fraction as percent: ``−12.3 %``."""
    if share is None or not math.isfinite(share):
        return "–"
    value = round(100 * share, digits) + 0.0
    return f"{value:{'+' if sign and value else ''}.{digits}f}\u00a0%".replace("-", "−")


def unit_text(unit: str) -> str:
    """A unit as one prints it: ``m/s^2`` -> m/s², ``-`` -> nothing."""
    if unit in ("", "-"):
        return ""
    return unit.replace("^2", "²").replace("^3", "³").replace("N s", "N·s").replace("deg", "°")


def channel_text(name: str) -> str:
    """The name of a channel as one reads it."""
    return name.replace("_", " ")


def sentence(text: str) -> str:
    """The text with a capital first letter; the rest as it is (Hz stays Hz)."""
    return text[:1].upper() + text[1:]


def page(template: str, **context: Any) -> str:
    """The HTML of one of the package's templates; all values are escaped."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    folder = resources.files("isd_gym") / "templates"
    env = Environment(
        loader=FunctionLoader(lambda name: (folder / name).read_text(encoding="utf-8")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    env.globals.update(
        number=number,
        sentence=sentence,
        percent=percent,
        unit=unit_text,
        channel=channel_text,
        versions=versions(),
        zip=zip,
    )
    return env.get_template(template).render(**context)


def versions() -> list[tuple[str, str]]:
    """What a result hangs on: this package, Python and the numerical libraries."""
    out = [("Python", platform.python_version())]
    for name in ("isd-gym", "numpy", "scipy", "numba"):
        try:
            out.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            continue
    return out


# --------------------------------------------------------------------------------------------------- a score


def score_report(score: Score, folder: str | Path) -> Path:
    """Write ``index.html`` (one file that opens anywhere), its figures as PNG, and ``score.json`` into `folder`.

    The folder appears whole or not at all; an earlier report is replaced. Returns the path of the page. Raises
    `InputError` where `folder` holds anything else.
    """
    folder = Path(folder)
    shown = Shown(score)
    with style(), whole_folder(folder, SCORE_KIND, "score.json", SCORE_PARTS) as place:
        pictures = []
        for draw, name, title, alt in (
            (
                trade_off,
                "trade_off",
                "The trade-off",
                "Change of acceleration over change of travel, by policy",
            ),
            (histories, "histories", "In time", "Signals of one episode over time"),
            (spectra, "spectra", "In frequency", "Power spectral densities over frequency"),
            (distribution, "episodes", "Episode by episode", "Paired changes of every episode, by policy"),
            (limits, "limits", "The limits", "Share of time above a value, by policy"),
        ):
            fig = figure()
            caption = draw(fig, shown)
            if not caption:
                continue
            data = embedded(save(fig, place / f"{name}.png"))
            pictures.append(Picture(f"{name}.png", title, alt, caption, data, pixels(fig)))
        write_text(place / "score.json", json.dumps(score.to_dict(), indent=1, allow_nan=False) + "\n")
        write_text(place / "index.html", page("score.html", shown=shown, score=score, pictures=pictures))
    return folder / "index.html"


def check_report(folder: str | Path) -> None:
    """Raise `InputError` where `score_report` would not write: before long work, not after it."""
    check_folder(folder, SCORE_KIND, "score.json", SCORE_PARTS)


SCORE_KIND = "score report"
SCORE_PARTS = ("index.html", "score.json", "*.png")
#: column of the table -> heading, unit, scale, decimals
COLUMNS = {
    "cost": ("cost J", "", 1.0, 3),
    "body_acceleration_rms": ("body acceleration", "m/s²", 1.0, 3),
    "suspension_travel_rms": ("travel", "mm", 1e3, 2),
    "tyre_load_rms": ("tyre load", "N", 1.0, 0),
}


class Shown:
    """A score made ready for drawing: who is shown how, and whom others are compared with."""

    def __init__(self, score: Score) -> None:
        self.score = score
        self.reference = next(iter(score.runs))  # everybody's comparison is driven first
        for row in score.policies:
            if row["cost"].get("change") == 0.0 and row["cost"].get("low") == row["cost"].get("high") == 0.0:
                self.reference = row["policy"]
                break
        self.rows = {row["policy"]: row for row in score.policies}
        self.names = [self.reference, *(n for n in score.runs if n != self.reference)]
        self.looks = looks(self.names)
        self.runs = score.runs
        self.step = score.runs[self.reference].control_step
        from .cost import StageCost

        self.costs = {n: run.cost(StageCost()) for n, run in self.runs.items()}
        self.best = min(self.names, key=lambda n: self.costs[n].mean())

    def few(self, count: int) -> tuple[list[str], str]:
        """The reference and the `count` best, and a sentence on who is left out: nobody can follow many curves."""
        others = sorted((n for n in self.names if n != self.reference), key=lambda n: self.costs[n].mean())
        kept = [n for n in self.names if n == self.reference or n in others[:count]]
        gone = [n for n in self.names if n not in kept]
        return kept, f" Left out for legibility: {', '.join(gone)}." if gone else ""

    @property
    def level(self) -> list[str]:
        """Who cannot be told from the best: the 95 % paired interval of the difference in cost holds zero."""
        draws = np.random.default_rng(0).integers(self.score.episodes, size=(2000, self.score.episodes))
        out = []
        for name in self.names:
            if name not in (self.best, self.reference):
                gap = (self.costs[name] - self.costs[self.best])[draws].mean(axis=1)
                if np.quantile(gap, 0.025) <= 0.0:
                    out.append(name)
        return out

    @property
    def headline(self) -> str:
        row = self.rows.get(self.best)
        if row is None or self.best == self.reference or "change" not in row["cost"]:
            return f"No policy shown here costs less than {self.reference}."
        q = row["cost"]
        if q["high"] >= 0.0:
            return (
                f"No policy is shown to beat {self.reference}: the cost of {self.best}, the best, changes by "
                f"{percent(q['change'])} (95 % interval {percent(q['low'])} to {percent(q['high'])})."
            )
        parts = [
            f"{COLUMNS[k][0]} {percent(row[k]['change'])}" for k in list(COLUMNS)[1:] if "change" in row[k]
        ]
        share = row["share_of_reachable_gain"]
        reached = (
            ""
            if share is None
            else f" That is {percent(share, 0, sign=False)} of the gain that is reachable on these roads."
        )
        level = (
            f" Level with it, as far as these episodes tell: {', '.join(self.level)}." if self.level else ""
        )
        return (
            f"{self.best} costs {percent(-q['change'], sign=False)} less than {self.reference} (95 % interval "
            f"{percent(-q['high'], sign=False)} to {percent(-q['low'], sign=False)}): {', '.join(parts)}.{reached}{level}"
        )

    def change(self, name: str, key: str) -> np.ndarray:
        """Change of each episode against the reference's same episode (episodes,), as a fraction."""
        own, base = (self._by_episode(n, key) for n in (name, self.reference))
        with np.errstate(divide="ignore", invalid="ignore"):
            return own / base - 1.0

    def _by_episode(self, name: str, key: str) -> np.ndarray:
        run = self.runs[name]
        if key == "cost":
            return self.costs[name]
        signal = {
            "body_acceleration_rms": run.body_acceleration,
            "suspension_travel_rms": run.suspension_travel,
            "tyre_load_rms": run.tyre_load,
        }[key]
        return np.sqrt(np.mean(signal**2, axis=0))


def histories(fig: Figure, shown: Shown) -> str:
    """Four seconds of a middling episode, around the reference's hardest moment."""
    base = shown.runs[shown.reference]
    cost = shown.costs[shown.reference]
    episode = int(np.argsort(cost)[len(cost) // 2])
    steps = len(base.tyre_load)
    width = min(steps, round(4.0 / shown.step))
    peak = int(np.argmax(np.abs(base.tyre_load[:, episode])))
    first = max(0, min(peak - width // 2, steps - width))
    time = (first + np.arange(width)) * shown.step
    rows = [
        ("body_acceleration", "body\nacceleration [m/s²]", 1.0),
        ("suspension_travel", "suspension\ntravel [mm]", 1e3),
        ("tyre_load", "dynamic\ntyre load [kN]", 1e-3),
    ]
    few, left_out = shown.few(2)
    moved = any(np.any(shown.runs[n].current) for n in few)
    if moved:
        rows.append(("current", "motor\ncurrent [A]", 1.0))
    fig.set_size_inches(7.2, 1.35 * len(rows) + 0.5)
    axes = fig.subplots(len(rows), 1, sharex=True)
    for ax, (key, label, scale) in zip(axes, rows, strict=True):
        for name in few:
            look = shown.looks[name]
            values = getattr(shown.runs[name], key)[first : first + width, episode] * scale
            if key == "current" and not np.any(shown.runs[name].current):
                continue
            ax.plot(time, values, color=look.colour, ls=look.line, lw=0.9 * look.width, label=name)
        ax.set_ylabel(label)
        ax.axhline(0, color=MUTED, lw=0.5, zorder=1)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(time[0], time[-1] + shown.step)
    fig.align_ylabels(axes)
    legend(fig, axes[0])
    return (
        f"Episode with seed {shown.score.seed + episode}, the one in the middle by {shown.reference}'s cost, around its "
        f"greatest tyre load. Travel is positive in extension, tyre load in compression.{left_out}"
    )


def halo() -> list[Any]:
    """A white rim, so that text on a line stays legible."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=2.5, foreground="white")]


def legend(fig: Figure, ax: Axes, columns: int = 6) -> None:
    """One legend above all axes."""
    handles, labels = ax.get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside upper left", ncols=min(columns, max(1, len(labels))))


def density(signal: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Power spectral density of the columns of `signal`, averaged: frequency [Hz], density [unit²/Hz]."""
    from scipy.signal import welch

    length = min(len(signal), round(8.0 / step))
    f, p = welch(signal, 1.0 / step, nperseg=length, axis=0, detrend="constant")
    f, p = f[1:], (p.mean(axis=1) if p.ndim > 1 else p)[1:]
    # twelve points an octave are enough: the more lines fall into one, the less it scatters
    index = np.floor(12 * np.log2(f / f[0]) + 1e-6).astype(int)
    count = np.bincount(index)
    some = count > 0
    return np.bincount(index, f)[some] / count[some], np.bincount(index, p)[some] / count[some]


def spectra(fig: Figure, shown: Shown) -> str:
    """PSDs above, their ratio to the reference below."""
    from .scoring import frequency_weighting

    columns = [
        ("body_acceleration", "body acceleration", "(m/s²)²/Hz", 1.0),
        ("suspension_travel", "suspension travel", "mm²/Hz", 1e3),
        ("tyre_load", "dynamic tyre load", "N²/Hz", 1.0),
    ]
    if not all(np.any(getattr(shown.runs[shown.reference], key)) for key, _, _, _ in columns):
        return ""  # nothing moves
    few, left_out = shown.few(3)
    fig.set_size_inches(7.6, 4.6)
    axes = fig.subplots(2, 3, sharex=True, height_ratios=[1.7, 1.0])
    for j, (key, title, unit, scale) in enumerate(columns):
        top, low = axes[0, j], axes[1, j]
        f, base = density(scale * getattr(shown.runs[shown.reference], key), shown.step)
        keep = (f >= 0.4) & (f <= 50.0)
        peak, least = base[keep].max(), base[keep & (f < 25.0)].min()
        for name in few:
            look = shown.looks[name]
            _, p = density(scale * getattr(shown.runs[name], key), shown.step)
            line = dict(color=look.colour, ls=look.line, lw=look.width)
            top.loglog(f[keep], p[keep], label=name, **line)
            low.loglog(f[keep], (p / base)[keep], **line)
            peak = max(peak, p[keep].max())
        top.set_title(title)
        top.set_ylabel(unit)
        top.set_ylim(max(0.5 * least, 1e-6 * peak), 2 * peak)
        low.set_ylim(0.125, 8.0)
        low.set_yticks([0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0], ["⅛", "¼", "½", "1", "2", "4", "8"])
        low.minorticks_off()
        low.set_xlim(0.4, 50.0)
        low.set_xticks([0.5, 1, 2, 5, 10, 20, 50], ["0.5", "1", "2", "5", "10", "20", "50"])
        low.set_xlabel("frequency [Hz]")
        if key == "body_acceleration":
            weight = top.twinx()
            grid = np.geomspace(0.4, 50.0, 200)
            w = frequency_weighting(grid)
            weight.fill_between(grid, w, color=PALE, alpha=0.8, lw=0)
            weight.set_ylim(0, 2.6)
            weight.set_yticks([0, 1], ["0", "1"])
            weight.grid(False)
            weight.tick_params(axis="y", length=2)
            top.text(0.62, 0.12, "$W_k$", transform=top.transAxes, color=MUTED, path_effects=halo())
            top.set_zorder(weight.get_zorder() + 1)
            top.patch.set_visible(False)
    axes[1, 0].set_ylabel(f"ratio to {shown.reference}")
    legend(fig, axes[0, 0])
    return (
        "One-sided power spectral densities, averaged over all episodes (Welch, 8 s Hann windows), and below them their "
        f"ratio to {shown.reference}. Grey: how strongly a seated person feels a frequency, W<sub>k</sub> of ISO 2631-1 "
        f"(its scale is on the right).{left_out}"
    )


def fronts(score: Score) -> list[tuple[float, np.ndarray]]:
    """Tyre load change and the causal bound's (travel change, acceleration change), where somebody knows it."""
    from importlib.metadata import entry_points

    from .errors import InputError
    from .network import Network

    if any(name != "passive" for name in list(score.runs)[:1]):
        return []  # the bound is told against the conventional car
    for point in entry_points(group="isd_gym.references", name="lq_front"):
        travel = np.array([-0.5, -0.4, -0.35, -0.3, -0.26, -0.22, -0.18, -0.14, -0.1, -0.05, 0.0, 0.3])
        out = []
        for tyre in (0.0, 0.03):
            try:
                out.append(
                    (
                        tyre,
                        point.load()(
                            tyre,
                            travel,
                            network=Network.load(score.network),
                            speed=score.speed,
                            road=score.road,
                        ),
                    )
                )
            except InputError:  # a road or a car for which there is no such bound
                return []
        return [(tyre, curve) for tyre, curve in out if len(curve) > 2]
    return []


def trade_off(fig: Figure, shown: Shown) -> str:
    """Acceleration over travel, both as change against the reference; the tyre load is written beside."""
    from .scoring import PAPER

    fig.set_size_inches(7.2, 4.6)
    ax = fig.subplots()
    ax.axhline(0, color=MUTED, lw=0.6)
    ax.axvline(0, color=MUTED, lw=0.6)
    points: list[tuple[float, float, str, str]] = []
    spans: list[tuple[float, float, float, float]] = []  # the intervals, which no label should cover
    for name in shown.names:
        look, row = shown.looks[name], shown.rows.get(name)
        if row is None or name == shown.reference:
            ax.plot(0, 0, look.marker, color=look.colour, ms=7, zorder=5)
            points.append((0.0, 0.0, name, look.colour))
            continue
        a, l, t = (row[k] for k in list(COLUMNS)[1:])
        if "change" not in a or "change" not in l:
            continue
        x, y = 100 * l["change"], 100 * a["change"]
        ax.errorbar(
            x, y,
            xerr=[[x - 100 * l["low"]], [100 * l["high"] - x]],
            yerr=[[y - 100 * a["low"]], [100 * a["high"] - y]],
            fmt=look.marker, color=look.colour, ms=7, lw=1.0, capsize=2, zorder=5,
        )  # fmt: skip
        points.append((x, y, f"{name}, tyre {percent(t.get('change'))}", look.colour))
        spans += [(100 * l["low"], y, 100 * l["high"], y), (x, 100 * a["low"], x, 100 * a["high"])]
    own = len(points)
    for (name, (before, after)), marker in zip(PAPER.items(), ("*", "p"), strict=True):
        a, l, t = (q / p - 1 for p, q in zip(before, after, strict=True))
        ax.plot(100 * l, 100 * a, marker, mfc="white", mec=MUTED, ms=9, zorder=4)
        points.append((100 * l, 100 * a, f"paper's {name.split(' (')[0]}, tyre {percent(t)}", MUTED))
    known = shown.score.references.get("clairvoyant_point")
    if known:
        a, l, t = (known[f"{k}_change"] for k in ("body_acceleration", "suspension_travel", "tyre_load"))
        ax.plot(100 * l, 100 * a, "o", mfc="white", mec=INK, mew=1.5, ms=8, zorder=5)
        points.append((100 * l, 100 * a, f"clairvoyant, tyre {percent(t)}", INK))
    xs, ys = np.array([p[0] for p in points]), np.array([p[1] for p in points])
    left, right = min(-22.0, xs.min() - 6), max(6.0, xs.max() + 6)
    bottom, top = min(-26.0, ys.min() - 4), max(5.0, ys.max() + 5)
    curves = fronts(shown.score)
    for (tyre, curve), line in zip(curves, ("-", (0, (5, 2))), strict=False):
        label = f"causal bound, tyre {percent(tyre, 0)}"
        ax.plot(100 * curve[:, 0], 100 * curve[:, 1], color=INK, ls=line, lw=1.1, zorder=3, label=label)
    if curves:
        curve = 100 * curves[-1][1]
        ax.fill_between(curve[:, 0], curve[:, 1], bottom, color=PALE, alpha=0.55, lw=0, zorder=0)
        ax.legend(loc="lower right", fontsize=8, frameon=True, edgecolor="none")
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)
    ax.set_xlabel(f"change of suspension travel against {shown.reference} [%]")
    ax.set_ylabel("change of body acceleration [%]")
    label_points(fig, ax, points, spans)
    bound = (
        " Lines: the linear-quadratic optimum of any force between body and wheel, unlimited and without friction, at "
        "the tyre load written there; no causal controller is below on average."
        if curves
        else ""
    )
    if known:
        bound += " The clairvoyant optimum knows these very roads in advance, which no controller does."
    return (
        f"Better is down and to the left. Crosses are 95 % paired intervals over {shown.score.episodes} episodes; the change "
        f"of RMS tyre load is written beside each point ({own} driven here, the paper's two for comparison).{bound}"
    )


def label_points(
    fig: Figure,
    ax: Axes,
    points: Sequence[tuple[float, float, str, str]],
    spans: Sequence[tuple[float, float, float, float]] = (),
) -> None:
    """Write (x, y, text, colour) beside each point where it covers no other text, point or span (x0, y0, x1, y1)."""
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    fig.canvas.draw()  # lays the axes out
    renderer = fig.canvas.get_renderer()  # type: ignore[attr-defined]
    to_screen = ax.transData.transform
    marks = np.array([to_screen((x, y)) for x, y, _, _ in points])
    area = ax.get_window_extent()
    unit = fig.dpi / 72
    taken: list[Any] = []
    bars = [Bbox([to_screen(s[:2]), to_screen(s[2:])]).padded(unit) for s in spans]
    for x, y, text, colour in points:
        best: tuple[float, Any, Any] | None = None
        for reach in (9, 16, 26, 40, 58):
            for angle in (0, 180, 30, -30, 150, -150, 60, -60, 120, -120, 90, -90):
                dx, dy = reach * math.cos(math.radians(angle)), reach * math.sin(math.radians(angle))
                ha = "center" if abs(dx) < 1 else "left" if dx > 0 else "right"
                label = ax.annotate(
                    text, (x, y), xytext=(dx, dy), textcoords="offset points", ha=ha, va="center", fontsize=8,
                    color=colour, zorder=6, path_effects=halo(),
                    arrowprops=dict(arrowstyle="-", color=colour, lw=0.6, shrinkB=3) if reach > 9 else None,
                )  # fmt: skip
                label.update_positions(renderer)
                box = Text.get_window_extent(label).padded(1.5 * unit)  # without its leader
                clash = sum(box.overlaps(b) for b in (*taken, *bars))
                clash += sum(box.contains(*m) for m in marks)
                start, end = np.array(to_screen((x, y))), 0.5 * (box.p0 + box.p1)
                path = [start + w * (end - start) for w in np.linspace(0.0, 1.0, 15)]
                clash += sum(
                    any(b.contains(*q) for q in path) for b in taken
                )  # its leader across another text
                outside = box.x0 < area.x0 or box.x1 > area.x1 or box.y0 < area.y0 or box.y1 > area.y1
                value = 10 * clash + 20 * outside + 0.02 * reach
                if best is None or value < best[0]:
                    if best is not None:
                        best[1].remove()
                    best = (value, label, box)
                else:
                    label.remove()
            if best is not None and best[0] < 5:
                break
        assert best is not None
        taken.append(best[2])


def distribution(fig: Figure, shown: Shown) -> str:
    """Change of every episode against the reference's own on the same road."""
    names = [n for n in shown.names if n != shown.reference and n in shown.rows] or [shown.reference]
    fig.set_size_inches(7.6, 0.9 + 0.42 * len(names))
    axes = fig.subplots(1, len(COLUMNS), sharey=True)
    order = np.arange(shown.score.episodes)
    for ax, (key, (title, _, _, _)) in zip(axes, COLUMNS.items(), strict=True):
        ax.axvline(0, color=MUTED, lw=0.8)
        for i, name in enumerate(names):
            look, q = shown.looks[name], shown.rows[name][key]
            values = 100 * shown.change(name, key)
            # spread by golden angle: same figure every time, neighbours apart
            lift = 0.22 * (2 * np.mod(order * 0.61803398875, 1.0) - 1)
            ax.plot(values, i + lift, "o", color=look.colour, ms=3.0, mew=0, alpha=0.45)
            if "change" in q:
                ax.plot(
                    [100 * q["low"], 100 * q["high"]],
                    [i, i],
                    color=look.colour,
                    lw=3.5,
                    solid_capstyle="butt",
                )
                ax.plot(100 * q["change"], i, look.marker, mfc="white", mec=look.colour, mew=1.4, ms=6)
        ax.set_title(title)
        ax.set_xlabel("change [%]")
        ax.margins(x=0.12)
    axes[0].set_yticks(range(len(names)), names)
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    for ax in axes:
        ax.grid(False, axis="y")
        ax.tick_params(axis="y", length=0)
    return (
        f"Each dot is one road: this policy against {shown.reference} on the same road. The open marker is the change of "
        "the value pooled over all episodes, the bar its 95 % interval (episodes drawn again, the same ones for both)."
    )


def limits(fig: Figure, shown: Shown) -> str:
    """Share of time that a signal spends above a value, up to and beyond the limit."""
    from .scoring import LIMITS

    fig.set_size_inches(7.6, 2.9)
    columns = [
        ("body_acceleration", "body acceleration", "m/s²", 1.0),
        ("suspension_travel", "suspension travel", "mm", 1e3),
        ("current", "motor current", "A", 1.0),
    ]
    axes = fig.subplots(1, 3, sharey=True)
    least = 0.5 / shown.runs[shown.reference].current.size
    for ax, (key, title, unit, scale) in zip(axes, columns, strict=True):
        top = LIMITS[key] * scale
        for name in shown.names:
            look = shown.looks[name]
            values = np.sort(np.abs(getattr(shown.runs[name], key)).ravel()) * scale
            if not values.any():
                continue
            share = 1.0 - np.arange(len(values)) / len(values)
            pick = np.unique(
                np.geomspace(1, len(values), 400).astype(int)
            )  # as dense in the tail as in the bulk
            pick = np.unique(np.concatenate([len(values) - pick, [0]]))
            ax.semilogy(values[pick], share[pick], color=look.colour, ls=look.line, lw=look.width, label=name)
        ax.axvline(top, color=INK, lw=1.0)
        ax.text(top, 0.8, " limit", fontsize=8, va="top", ha="left")
        ax.set_title(title)
        ax.set_xlabel(f"|value| [{unit}]")
        ax.set_xlim(0, None)
        ax.set_xlim(0, max(ax.get_xlim()[1], 1.22 * top))
    axes[0].set_ylabel("share of time above")
    axes[0].set_ylim(max(least, 1e-6), 1.0)
    handles: dict[str, Any] = {}
    for ax in axes:
        handles |= {label: h for h, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    fig.legend(list(handles.values()), list(handles), loc="outside upper left", ncols=6)
    return (
        "How much of the time each signal spends above a value; the vertical line is the limit of the paper's Table 5. "
        "A curve that crosses the line has passed the limit."
    )
