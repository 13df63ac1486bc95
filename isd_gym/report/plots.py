"""Figures in one style, numbers as one prints them, and pages that stand alone.

Colours are those of Okabe and Ito (Color Universal Design, 2008); every line also has a dash pattern or a marker of
its own, so that a page printed in black tells the same story. No figure touches matplotlib's global state.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import platform
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata, resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


INK, MUTED, PALE = "#262b30", "#606870", "#dfe3e7"
BLACK, BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BROWN, OLIVE = (
    "#262b30", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7A4B2A", "#8A8A00",
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


COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BROWN, OLIVE)
LINES = (
    "-",
    (0, (5.5, 1.6)),
    (0, (6, 1.5, 1.2, 1.5)),
    (0, (3, 1.2)),
    (0, (6, 1.2, 1.2, 1.2, 1.2, 1.2)),
    (0, (9, 2)),
    (0, (1.6, 1.6)),
)
MARKERS = ("o", "D", "^", "v", "P", "X", "<", ">", "h", "d", "*")
#: the thing that others are compared with comes first
LOOKS = (
    Look(BLACK, (0, (1.2, 1.2)), "s", 1.2),
    *(Look(c, LINES[i % len(LINES)], MARKERS[i], 1.4) for i, c in enumerate(COLOURS)),
)


def looks(names: Sequence[str]) -> dict[str, Look]:
    """A look for each name, in order; no two of the first 57 share colour and line, or colour and marker."""
    others = (
        Look(COLOURS[i % len(COLOURS)], LINES[i % len(LINES)], MARKERS[i % len(MARKERS)], 1.4)
        for i in range(len(names))
    )
    return dict(zip(names, (LOOKS[0], *others), strict=False))


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
    """Write `fig` as PNG of 256 colours, a third of the size; the same bytes for the same figure."""
    import io

    from PIL import Image

    whole = io.BytesIO()
    fig.savefig(whole, format="png", dpi=DPI, metadata={"Software": None})
    with Image.open(whole) as picture:
        picture.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
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
    live: dict[str, Any] | None = None  # what the page's script makes of it

    @property
    def stem(self) -> str:
        return Path(self.name).stem


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
    return (
        unit.replace("^2", "²")
        .replace("^3", "³")
        .replace("N m", "N·m")
        .replace("N·m s", "N·m·s")
        .replace("N s", "N·s")
        .replace("deg", "°")
    )


def channel_text(name: str) -> str:
    """The name of a channel as one reads it."""
    return name.replace("_", " ")


def sentence(text: str) -> str:
    """The text with a capital first letter; the rest as it is (Hz stays Hz)."""
    return text[:1].upper() + text[1:]


@dataclass(frozen=True)
class Script:
    """A script in a page, and the digest by which the page's policy lets it, and nothing else, run."""

    text: str

    @property
    def digest(self) -> str:
        return base64.b64encode(hashlib.sha256(self.text.encode("utf-8")).digest()).decode("ascii")


def page(template: str, *, pictures: Iterable[Picture] = (), **context: Any) -> str:
    """The HTML of one of the package's templates; all values are escaped.

    Where one of `pictures` has a live form, the plotting scripts and its data go into the page, which fetches nothing.
    """
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    folder = resources.files(__package__) / "templates"
    pictures = list(pictures)
    charts = [
        {"name": p.stem, "data": json.dumps(p.live, separators=(",", ":")).replace("<", "\\u003c")}
        for p in pictures
        if p.live is not None
    ]
    files = ("uplot/uPlot.iife.min.js", "page.js") if charts else ("page.js",)
    scripts = [Script((folder / name).read_text(encoding="utf-8")) for name in files]
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
    sheet = (folder / "uplot" / "uPlot.min.css").read_text(encoding="utf-8") if charts else ""
    return env.get_template(template).render(
        pictures=pictures, charts=charts, scripts=scripts, uplot_style=sheet, **context
    )


def versions() -> list[tuple[str, str]]:
    """What a result hangs on: this package, Python and the numerical libraries."""
    out = [("Python", platform.python_version())]
    for name in ("isd-gym", "numpy", "scipy", "numba"):
        try:
            out.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            continue
    return out


# ------------------------------------------------------------------------------------------------ on a figure


def halo() -> list[Any]:
    """A white rim, so that text on a line stays legible."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=2.5, foreground="white")]


def legend(fig: Figure, ax: Axes, columns: int = 6) -> None:
    """One legend above all axes."""
    handles, labels = ax.get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside upper left", ncols=min(columns, max(1, len(labels))))


def density(signal: np.ndarray, step: float, window: float = 8.0) -> tuple[np.ndarray, np.ndarray]:
    """Power spectral density of the columns of `signal`, averaged: frequency [Hz], density [unit²/Hz].

    Hann windows of `window` [s], half overlapping; lines gathered to twelve an octave.
    """
    from scipy.signal import welch

    length = min(len(signal), round(window / step))
    f, p = welch(signal, 1.0 / step, nperseg=length, axis=0, detrend="constant")
    f, p = f[1:], (p.mean(axis=1) if p.ndim > 1 else p)[1:]
    # twelve points an octave are enough: the more lines fall into one, the less it scatters
    index = np.floor(12 * np.log2(f / f[0]) + 1e-6).astype(int)
    count = np.bincount(index)
    some = count > 0
    return np.bincount(index, f)[some] / count[some], np.bincount(index, p)[some] / count[some]


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
        for reach in (9, 16, 26, 40, 58, 84, 115):
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
