"""Charts as data: a `Chart` consists of panels, and a `Panel` has two axes and items. `picture` draws a chart for a page."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .plots import MUTED, PALE, Look, Picture, as_picture, figure, number

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..._common.arrays import Array

Ticks = tuple[tuple[float, str], ...]

QUIET = Look(MUTED, "-", "", 0.9)
# columns in which a long curve is reduced to its extremes: about a pixel each
COLUMNS = 500
MOST_DOTS = 300  # largest cloud of separate shapes; a larger cloud is one image


@dataclass(frozen=True)
class Axis:
    """An axis."""

    label: str = ""  # label of its values
    unit: str = ""  # unit; '' without a unit
    log: bool = False  # whether the axis is logarithmic
    low: float | None = None  # lower end; None to fit the values
    high: float | None = None  # upper end; None to fit the values
    ticks: Ticks = ()  # positions and texts of the ticks; empty for automatic ticks
    # names of the integers from the top down, instead of numbers
    rows: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Label with the unit."""
        return f"{self.label} [{self.unit}]" if self.unit and self.label else self.label


@dataclass(frozen=True)
class Line:
    """A curve, optionally with a band."""

    name: str  # name in the legend
    x: Array  # abscissae (n,)
    y: Array  # ordinates (n,)
    look: Look  # style
    # lower and upper ordinates (n,) of the band; None without a band
    band: tuple[Array, Array] | None = None
    band_name: str = "95 % interval"  # name of the band in the legend
    fill: bool = False  # whether the area down to the axis is filled


@dataclass(frozen=True)
class Dots:
    """A cloud of samples."""

    name: str  # name in the legend
    x: Array  # abscissae (n,)
    y: Array  # ordinates (n,)
    look: Look  # style
    alpha: float = 0.55  # opacity from 0 to 1


@dataclass(frozen=True)
class Marks:
    """Single points, optionally with intervals."""

    name: str  # name in the legend
    x: Sequence[float]  # abscissae (n,)
    y: Sequence[float]  # ordinates (n,)
    look: Look  # style
    #: lower and upper abscissae; None without intervals
    x_interval: tuple[Sequence[float], Sequence[float]] | None = None
    #: lower and upper ordinates; None without intervals
    y_interval: tuple[Sequence[float], Sequence[float]] | None = None
    open: bool = False  # whether markers are hollow
    size: float = 7.0  # size of a marker [pt]
    bar: float = 1.0  # width of the interval lines [pt]


@dataclass(frozen=True)
class Rule:
    """A straight line across a panel."""

    axis: str  # axis of the value, 'x' or 'y'
    at: float  # value
    look: Look = QUIET  # style


@dataclass(frozen=True)
class Span:
    """A shaded interval of x."""

    low: float  # lower end
    high: float  # upper end


Item = Line | Dots | Marks | Rule | Span


@dataclass(frozen=True)
class Panel:
    """Items on two axes."""

    x: Axis  # horizontal axis
    y: Axis  # vertical axis
    items: tuple[Item, ...]  # items in the order of drawing
    title: str = ""  # title; '' without a title
    link: str = ""  # panels with the same link share their horizontal axis


@dataclass(frozen=True)
class Chart:
    """A figure of a page."""

    name: str  # stem of the file name
    title: str  # title
    alt: str  # text for readers who cannot see the figure
    caption: str  # caption
    #: panels by the name of a record. The page shows the first, and the others on request.
    choices: Mapping[str, Sequence[Panel]]
    columns: int = 1  # number of columns of panels
    size: tuple[float, float] = (7.4, 3.0)  # size of the picture [inch]
    still: int | None = None  # number of panels that are drawn; None for all
    #: captions by choice, for choices with another caption than `caption`
    captions: Mapping[str, str] = field(default_factory=dict)

    @property
    def panels(self) -> Sequence[Panel]:
        """Panels of the picture."""
        return next(iter(self.choices.values()))[: self.still]


def picture(chart: Chart, folder: Path) -> Picture:
    """Draw a chart into a folder, and return the figure of a page; to be called within `plots.style`."""
    drawn = []
    for name, panels in chart.choices.items():
        one = replace(chart, choices={name: panels})
        fig = figure(*chart.size)
        draw(fig, one)
        caption = chart.captions.get(name, chart.caption)
        drawn.append(as_picture(fig, chart.name, chart.title, chart.alt, caption))
    drawn[0].save(folder)
    return replace(
        drawn[0], others=dict(zip(list(chart.choices)[1:], drawn[1:], strict=True))
    )


# ------------------------------------------------------------------------------------------------- the picture


def draw(fig: Figure, chart: Chart) -> None:
    """Draw the first choice of a chart on an empty figure."""
    panels = chart.panels
    columns = min(chart.columns, len(panels))
    rows = -(-len(panels) // columns)
    fig.set_size_inches(*chart.size)
    grid = fig.add_gridspec(rows, columns)
    first: dict[str, Axes] = {}
    axes: list[Axes] = []
    for k, panel in enumerate(panels):
        row, column = divmod(k, columns)
        share = first.get(panel.link) if panel.link else None
        left = (
            axes[k - 1]
            if column and panel.y == panels[k - 1].y and not panel.link
            else None
        )
        ax = fig.add_subplot(grid[row, column], sharex=share, sharey=left)
        first.setdefault(panel.link, ax)
        axes.append(ax)
        _draw_panel(ax, panel)
        below = panels[k + columns] if k + columns < len(panels) else None
        if below is not None and below.x.text == panel.x.text:
            ax.set_xlabel("")
            if panel.link and below.link == panel.link:
                ax.tick_params(labelbottom=False)
        if left is not None:
            ax.tick_params(labelleft=False)
            ax.set_ylabel("")
    handles: dict[str, Any] = {}
    for ax in axes:
        own = {
            label: h for h, label in zip(*ax.get_legend_handles_labels(), strict=True)
        }
        handles |= {k: h for k, h in own.items() if k not in handles}
    if handles:
        room = max(1, int(chart.size[0] / 7.2 * 95))  # width in characters
        wide = 6 + max(map(len, handles))
        fig.legend(
            list(handles.values()),
            list(handles),
            loc="outside upper left",
            ncols=max(1, min(len(handles), room // wide)),
        )
    fig.align_ylabels(axes[::columns])


def _draw_panel(ax: Axes, panel: Panel) -> None:
    if panel.x.log:
        ax.set_xscale("log")
    if panel.y.log:
        ax.set_yscale("log")
    for item in panel.items:
        if isinstance(item, Line):
            _draw_line(ax, item, panel.x)
        elif isinstance(item, Dots):
            ax.plot(
                item.x, item.y, item.look.marker or ".", color=item.look.colour, ms=2.2, mew=0,
                alpha=item.alpha, label=item.name or None, rasterized=len(item.x) > MOST_DOTS,
            )  # fmt: skip
        elif isinstance(item, Marks):
            _draw_marks(ax, item)
        elif isinstance(item, Rule):
            line = ax.axvline if item.axis == "x" else ax.axhline
            line(
                item.at,
                color=item.look.colour,
                ls=item.look.line,
                lw=item.look.width,
                zorder=1 if item.look is QUIET else 4,
            )
        else:
            ax.axvspan(item.low, item.high, color=PALE, alpha=0.7, lw=0, zorder=0)
    ax.set_title(panel.title)
    _axis(ax, "x", panel.x)
    _axis(ax, "y", panel.y)


def _draw_line(ax: Axes, item: Line, axis: Axis) -> None:
    if item.band is not None:
        ax.fill_between(
            item.x,
            *item.band,
            color=item.look.colour,
            alpha=0.25,
            lw=0,
            label=item.band_name,
        )
    if item.fill:
        ax.fill_between(
            item.x,
            item.y,
            ax.get_ylim()[0],
            color=PALE,
            lw=0,
            label=item.name,
            zorder=0,
        )
        return
    ax.plot(
        *_thinned(item, axis),
        color=item.look.colour,
        ls=item.look.line,
        lw=item.look.width,
        marker=item.look.marker if len(item.x) < 40 else None,
        ms=3,
        mfc="white",
        label=item.name or None,
    )


def _thinned(line: Line, axis: Axis) -> tuple[Array, Array]:
    """Return the visible part of a curve; a curve of many samples is reduced to its extremes in `COLUMNS` columns."""
    x = np.asarray(line.x, float)
    y = np.asarray(line.y, float)
    if len(x) < 2 or not (np.diff(x) > 0).all():  # a loop
        return x, y
    low = x[0] if axis.low is None else axis.low
    high = x[-1] if axis.high is None else axis.high
    first = np.searchsorted(x, low)
    last = np.searchsorted(x, high, side="right")
    x = x[max(first - 1, 0) : last + 1]
    y = y[max(first - 1, 0) : last + 1]
    each = len(x) // COLUMNS
    if each < 3:
        return x, y
    whole = len(x) // each * each
    columns = y[:whole].reshape(-1, each)
    starts = np.arange(0, whole, each)
    kept = np.r_[
        starts + columns.argmin(axis=1),
        starts + columns.argmax(axis=1),
        np.arange(whole, len(x)),
    ]
    kept = np.unique(kept)
    return x[kept], y[kept]


def _draw_marks(ax: Axes, item: Marks) -> None:
    x = np.asarray(item.x, float)
    y = np.asarray(item.y, float)
    for spans, other, flat in ((item.x_interval, y, True), (item.y_interval, x, False)):
        if spans is None:
            continue
        for a, b, at in zip(*spans, other, strict=True):
            ends = ([a, b], [at, at]) if flat else ([at, at], [a, b])
            ax.plot(
                *ends,
                color=item.look.colour,
                lw=item.bar,
                solid_capstyle="butt",
                zorder=3,
            )
    look = item.look
    if look.marker:
        ax.plot(
            x,
            y,
            label=item.name or None,
            marker=look.marker,
            color=look.colour,
            mfc="white" if item.open else look.colour,
            mew=1.4,
            ms=item.size,
            ls="none",
            zorder=5,
        )
    elif item.name:
        ax.plot(
            [],
            [],
            color=item.look.colour,
            lw=item.bar,
            solid_capstyle="butt",
            label=item.name,
        )


def _axis(ax: Axes, which: str, axis: Axis) -> None:
    from matplotlib.ticker import NullLocator

    label, limits, ticks = (
        getattr(ax, f"set_{which}{k}") for k in ("label", "lim", "ticks")
    )
    label(axis.text)
    if axis.rows:
        ticks(range(len(axis.rows)), axis.rows)
        limits(len(axis.rows) - 0.4, -0.6)
        ax.grid(False, axis=which)  # type: ignore[arg-type]
        ax.tick_params(axis=which, length=0)  # type: ignore[arg-type]
        return
    if axis.low is not None or axis.high is not None:
        limits(axis.low, axis.high)
    elif which == "x" and not axis.log and ax.lines and not ax.collections:
        ax.margins(x=0.02)
    if axis.log and axis.ticks:
        low, high = getattr(ax, f"get_{which}lim")()
        ticks(
            [t for t, _ in axis.ticks if low <= t <= high],
            [s for t, s in axis.ticks if low <= t <= high],
        )
        getattr(ax, f"{which}axis").set_minor_locator(NullLocator())


def log_ticks(low: float, high: float, form: str = "{:g}") -> Ticks:
    """Return ticks at round numbers between two positive numbers, if possible more than three, and few enough for their texts."""
    ticks: list[float] = []
    finer = ([1 + k / n for k in range(9 * n)] for n in (1, 2, 5, 10))
    for steps in ((1,), (1, 2, 5), *finer):
        ticks = [
            t
            for k in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
            for m in steps
            if low <= (t := round(m * 10.0**k, 12)) <= high
        ]
        if len(ticks) > 3:
            break
    return tuple((t, form.format(t)) for t in ticks)


def decades(low: float, high: float) -> Ticks:
    """Return ticks at powers of ten between two positive numbers, or at round numbers within a decade."""
    ticks = [
        10.0**k
        for k in range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)
    ]
    if len(ticks) < 2:
        return log_ticks(low, high)
    ticks = ticks[:: -(-len(ticks) // 6)]
    return tuple((t, number(t, 1)) for t in ticks)
