"""Figures in one style, printed numbers, and self-contained pages.

The colours are those of Okabe and Ito (Color Universal Design, 2008). Every line also has a dash pattern or a
marker, so that a black-and-white print remains readable. No figure changes matplotlib's global state.
"""

from __future__ import annotations

import base64
import hashlib
import io
import math
import platform
import re
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib import metadata, resources
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError
from ..._common.units import TABLE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from jinja2 import Environment
    from matplotlib.figure import Figure


INK, MUTED, PALE = "#262b30", "#606870", "#dfe3e7"
BLACK, BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BROWN, OLIVE = (
    "#262b30", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a4b2a", "#8a8a00",
)  # fmt: skip
DPI = 160
#: colours of the figures in print, and on a dark page
THEMED = {
    "#262b30": "#e4e8ec", "#606870": "#a0a8b0", "#dfe3e7": "#3c444c", "#ffffff": "#14181c", "#0072b2": "#56aef0",
    "#d55e00": "#ff8a3d", "#009e73": "#2fcf9f", "#cc79a7": "#e79bc6", "#e69f00": "#ffbf3a", "#56b4e9": "#8fd3ff",
    "#7a4b2a": "#c9946b", "#8a8a00": "#c8c83c",
}  # fmt: skip

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
    "svg.fonttype": "none",
    "svg.hashsalt": "isd_gym",
}


@dataclass(frozen=True)
class Look:
    """Style of a series; no two series share all of colour, line and marker."""

    colour: str  # colour
    line: Any  # dash pattern of matplotlib
    marker: str  # marker of matplotlib
    width: float = 1.3  # line width [pt]


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


def _styles(count: int) -> Iterator[Look]:
    """Yield the style of the reference of a comparison, then that of each other series."""
    yield Look(BLACK, (0, (1.2, 1.2)), "s", 1.2)
    for i in range(count):
        colour = COLOURS[i % len(COLOURS)]
        line = LINES[i % len(LINES)]
        yield Look(colour, line, MARKERS[i % len(MARKERS)], 1.4)


LOOKS = tuple(_styles(len(COLOURS)))


def looks(names: Sequence[str]) -> dict[str, Look]:
    """Return a style for each name; no two of the first 57 share colour and line, or colour and marker."""
    return dict(zip(names, _styles(len(names)), strict=False))


@contextmanager
def style() -> Iterator[None]:
    """Apply matplotlib's defaults and the project's style to figures that are made and saved within the block.

    Settings of the user's matplotlibrc have no effect.
    """
    try:
        from matplotlib import rc_context, rcParamsDefault
    except UnicodeDecodeError as error:
        raise InputError(
            f"matplotlibrc is not UTF-8 text ({error.reason}): correct or remove the file"
        ) from None

    # of the process, not of a figure
    own = {
        "backend",
        "backend_fallback",
        "interactive",
        "toolbar",
    }
    defaults = {
        name: value for name, value in rcParamsDefault.items() if name not in own
    }
    with rc_context(defaults | STYLE):  # type: ignore[arg-type]
        yield


def figure(width: float = 7.2, height: float = 4.0) -> Figure:
    """Return an empty figure outside of matplotlib's global list; sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=(width, height))
    FigureCanvasAgg(fig)
    return fig


@dataclass(frozen=True)
class Picture:
    """A figure on a page."""

    stem: str  # stem of the file name
    title: str  # title
    alt: str  # text for readers who cannot see the figure
    caption: str  # caption
    drawing: str  # SVG text
    width: int  # width at which the text has the size of the page's small print [CSS pixel]
    #: further pictures of the figure by name, such as those of other records
    others: Mapping[str, Picture] = field(default_factory=dict)

    @property
    def inline(self) -> str:
        """The picture as an element of a page, in the colours of the page."""
        text = themed(self.drawing)
        head = f'<svg class="chart" style="width:{self.width}px" role="img" aria-label="{escape(self.alt)}"'
        return text.replace("<svg", head, 1)

    def save(self, folder: Path) -> None:
        """Write the picture as an SVG file."""
        (folder / f"{self.stem}.svg").write_text(self.drawing + "\n", encoding="utf-8")


def themed(drawing: str) -> str:
    """Return the SVG of a figure in the colours of its page."""
    for colour in THEMED:
        drawing = drawing.replace(colour, f"var(--c{colour[1:]}, {colour})")
    return drawing


def as_picture(fig: Figure, stem: str, title: str, alt: str, caption: str) -> Picture:
    """Return a figure as a picture of a page; equal figures give equal texts. To be called within `style`."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    whole = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    fig.set_dpi(DPI)
    canvas: Any = FigureCanvasSVG(fig)
    canvas.print_svg(whole, metadata=nothing)  # `savefig` would draw it twice
    text = whole.getvalue()
    text = text[text.index("<svg") :].strip()
    # names that matplotlib gives in every figure
    text = re.sub(r'<g id="[\w.]+">', "<g>", text)
    text = re.sub(
        r'\b(d|x|y|transform)="[^"]*"',
        lambda part: re.sub(r"(\.\d\d)\d+", r"\1", part[0]),
        text,
    )
    width = round(122 * fig.get_size_inches()[0])
    return Picture(stem, title, alt, caption, text, width)


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with significant digits and a true minus sign, if possible without an exponent; a dash for None."""
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
    """Return a fraction as percent, such as ``−12.3 %``; a dash for None. `sign` writes a plus sign, too."""
    if share is None or not math.isfinite(share):
        return "–"
    value = round(100 * share, digits) + 0.0
    return f"{value:{'+' if sign and value else ''}.{digits}f}\u00a0%".replace("-", "−")


def unit_text(unit: str) -> str:
    """Return a unit in print: ``m/s^2`` -> m/s², ``-`` -> nothing."""
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


#: names that units are made of, and a unit after a number in a sentence
_PARTS = "|".join(
    sorted(
        {part for unit in TABLE for part in re.findall(r"[A-Za-z]+", unit)},
        key=len,
        reverse=True,
    )
)
_STATED = re.compile(
    rf"(?<=\d )(?:{_PARTS})(?:\^\d)?(?:[ /](?:{_PARTS})(?:\^\d)?)*(?!\w)"
)


def units_text(sentence: str) -> str:
    """Return a sentence with the units after its numbers in print; words that only look like a unit stay."""
    return _STATED.sub(lambda unit: unit_text(unit[0]), sentence)


def channel_text(name: str) -> str:
    """Return the name of a channel in print."""
    return name.replace("_", " ")


def sentence(text: str) -> str:
    """Return a text with a capital first letter; the rest is unchanged (Hz stays Hz)."""
    return text[:1].upper() + text[1:]


def page(template: str, **context: Any) -> str:
    """Return the HTML of one of the package's templates; all values are escaped. The page fetches nothing."""
    return _environment(escaped=True).get_template(template).render(**context)


def caption(name: str, **values: Any) -> str:
    """Return the caption of a chart: a macro of the template `captions.txt`, in one line."""
    macros = _environment(escaped=False).get_template("captions.txt").module
    return re.sub(r"[ \n]+", " ", str(getattr(macros, name)(**values))).strip()


@cache
def _environment(*, escaped: bool) -> Environment:
    """Return the package's templates and the functions that they call."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    env = Environment(
        loader=PackageLoader(__package__),
        autoescape=escaped,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    script = (resources.files(__package__) / "templates" / "page.js").read_text(
        encoding="utf-8"
    )
    env.globals.update(
        number=number,
        sentence=sentence,
        percent=percent,
        unit=unit_text,
        channel=channel_text,
        versions=versions(),
        zip=zip,
        script=script,
        # the page's policy allows this script alone
        digest=base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode(
            "ascii"
        ),
        themed=THEMED,
    )
    return env


def versions() -> list[tuple[str, str]]:
    """Return the versions that a result depends on: this package, Python and the numerical libraries."""
    out = [("Python", platform.python_version())]
    for name in ("isd-gym", "numpy", "scipy", "numba"):
        try:
            out.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            continue
    return out


# ------------------------------------------------------------------------------------------------ on a figure


def density(
    signal: np.ndarray, step: float, window: float = 8.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies [Hz] and averaged power spectral density [unit²/Hz] of the columns of a signal (n,) or (n, columns).

    Hann windows with half overlap; lines are averaged to twelve per octave.
    """
    from scipy.signal import welch

    length = min(len(signal), round(window / step))
    f, p = welch(signal, 1.0 / step, nperseg=length, axis=0, detrend="constant")
    f = f[1:]
    p = (p.mean(axis=1) if p.ndim > 1 else p)[1:]
    # with twelve points per octave, each point averages more lines and scatters less
    index = np.floor(12 * np.log2(f / f[0]) + 1e-6).astype(int)
    count = np.bincount(index)
    some = count > 0
    return np.bincount(index, f)[some] / count[some], np.bincount(index, p)[
        some
    ] / count[some]
