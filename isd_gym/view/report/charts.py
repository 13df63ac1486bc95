"""Charts that are described once and drawn twice: as a picture (matplotlib) and live in a page (``templates/page.js``).

A `Chart` consists of panels; a `Panel` has two axes and items. `draw` makes the picture for print and for
pages without scripts. `live` gives the same chart as JSON; the page's script adds values under the pointer,
zoom, and series that can be hidden. Long signals are stored as 16-bit numbers, to keep pages small.
"""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .plots import MUTED, PALE, Look, Picture, embedded, figure, label_points, number, pixels, save

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ...common.arrays import Array

Ticks = tuple[tuple[float, str], ...]

QUIET = Look(MUTED, "-", "", 0.9)


@dataclass(frozen=True)
class Axis:
    """An axis.

    Attributes:
        label: Label of its values.
        unit: Unit; '' without a unit.
        log: Whether the axis is logarithmic.
        low: Lower end of the picture and of the first live view; None to fit the values.
        high: Upper end; None to fit the values.
        ticks: Positions and texts of the ticks; empty for automatic ticks.
        rows: Names of the integers from the top down, instead of numbers.
    """

    label: str = ""
    unit: str = ""
    log: bool = False
    low: float | None = None
    high: float | None = None
    ticks: Ticks = ()
    rows: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Label with the unit."""
        return f"{self.label} [{self.unit}]" if self.unit and self.label else self.label


@dataclass(frozen=True)
class Line:
    """A curve, optionally with a band.

    Attributes:
        name: Name in the legend.
        x: Abscissae (n,).
        y: Ordinates (n,).
        look: Style.
        band: Lower and upper ordinates (n,) of the band; None without a band.
        fill: Whether the area down to the axis is filled.
        still: Whether the curve is in the picture.
        on: Whether the curve is visible at the start of a live chart.
    """

    name: str
    x: Array
    y: Array
    look: Look
    band: tuple[Array, Array] | None = None
    fill: bool = False
    still: bool = True
    on: bool = True


@dataclass(frozen=True)
class Dots:
    """A cloud of samples.

    Attributes:
        name: Name in the legend.
        x: Abscissae (n,).
        y: Ordinates (n,).
        look: Style.
        size: Diameter of a dot [pt].
        alpha: Opacity from 0 to 1.
    """

    name: str
    x: Array
    y: Array
    look: Look
    size: float = 2.2
    alpha: float = 0.55


@dataclass(frozen=True)
class Marks:
    """Single points, optionally with intervals.

    Attributes:
        name: Name in the legend.
        x: Abscissae (n,).
        y: Ordinates (n,).
        look: Style.
        x_interval: Lower and upper abscissae; None without intervals.
        y_interval: Lower and upper ordinates; None without intervals.
        texts: Labels beside the points.
        notes: Texts under the pointer.
        open: Whether markers are hollow.
        size: Size of a marker [pt].
        bar: Width of the interval lines [pt].
        quiet: Whether the points are absent from the legend, since the labels name the points.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    look: Look
    x_interval: tuple[Sequence[float], Sequence[float]] | None = None
    y_interval: tuple[Sequence[float], Sequence[float]] | None = None
    texts: Sequence[str] = ()
    notes: Sequence[str] = ()
    open: bool = False
    size: float = 7.0
    bar: float = 1.0
    quiet: bool = False


@dataclass(frozen=True)
class Rule:
    """A straight line across a panel.

    Attributes:
        axis: Axis of the value, 'x' or 'y'.
        at: Value.
        text: Label; '' without a label.
        look: Style.
    """

    axis: str
    at: float
    text: str = ""
    look: Look = QUIET


@dataclass(frozen=True)
class Span:
    """A shaded interval of x.

    Attributes:
        low: Lower end.
        high: Upper end.
    """

    low: float
    high: float


Item = Line | Dots | Marks | Rule | Span


@dataclass(frozen=True)
class Panel:
    """Items on two axes.

    Attributes:
        x: Horizontal axis.
        y: Vertical axis.
        items: Items in the order of drawing.
        title: Title; '' without a title.
        link: Panels with the same link share zoom and pointer along x.
        tall: Height relative to the other panels of the chart.
    """

    x: Axis
    y: Axis
    items: tuple[Item, ...]
    title: str = ""
    link: str = ""
    tall: float = 1.0


@dataclass(frozen=True)
class Chart:
    """A figure of a page.

    Attributes:
        name: Stem of the file name.
        title: Title.
        alt: Text for readers who cannot see the figure.
        caption: Caption.
        choices: Panels by the name of a record; the picture shows the first.
        columns: Number of columns of panels.
        size: Size of the picture [inch].
        walk: Whether a live chart has buttons for moving along x.
        widths: Relative widths of the columns; empty for equal widths.
        align: Whether the panels of a column are aligned.
        still: Number of panels in the picture; None for all.
        captions: Captions by choice, for choices with another caption than `caption`.
    """

    name: str
    title: str
    alt: str
    caption: str
    choices: Mapping[str, Sequence[Panel]]
    columns: int = 1
    size: tuple[float, float] = (7.4, 3.0)
    walk: bool = False
    widths: tuple[float, ...] = ()
    align: bool = True
    still: int | None = None
    captions: Mapping[str, str] = field(default_factory=dict)

    @property
    def panels(self) -> Sequence[Panel]:
        """Panels of the picture."""
        return next(iter(self.choices.values()))[: self.still]


def picture(chart: Chart, folder: Path) -> Picture:
    """Draw a chart into a folder, and return the figure of a page; to be called within `plots.style`.

    Args:
        chart: The chart.
        folder: Folder of the PNG file.

    Returns:
        Figure with picture and live form.
    """
    fig = figure(*chart.size)
    draw(fig, chart)
    path = save(fig, folder / f"{chart.name}.png")
    return Picture(path.name, chart.title, chart.alt, chart.caption, embedded(path), pixels(fig), live(chart))


# ------------------------------------------------------------------------------------------------- the picture


def draw(fig: Figure, chart: Chart) -> None:
    """Draw the first choice of a chart on an empty figure.

    Args:
        fig: The figure.
        chart: The chart.
    """
    panels = chart.panels
    columns = min(chart.columns, len(panels))
    rows = -(-len(panels) // columns)
    fig.set_size_inches(*chart.size)
    tall = [max(p.tall for p in panels[r * columns : (r + 1) * columns]) for r in range(rows)]
    grid = fig.add_gridspec(rows, columns, height_ratios=tall, width_ratios=chart.widths or None)
    first: dict[str, Axes] = {}
    beside: list[tuple[Axes, Panel]] = []
    for k, panel in enumerate(panels):
        row, column = divmod(k, columns)
        share = first.get(panel.link) if panel.link else None
        left = beside[k - 1][0] if column and panel.y == panels[k - 1].y and not panel.link else None
        ax = fig.add_subplot(grid[row, column], sharex=share, sharey=left)
        first.setdefault(panel.link, ax)
        beside.append((ax, panel))
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
    for ax, _ in beside:
        own = {label: h for h, label in zip(*ax.get_legend_handles_labels(), strict=True)}
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
    if chart.align:
        fig.align_ylabels([ax for ax, _ in beside[::columns]])
    for ax, panel in beside:  # after the layout is computed
        _label(fig, ax, panel)


def _draw_panel(ax: Axes, panel: Panel) -> None:
    if panel.x.log:
        ax.set_xscale("log")
    if panel.y.log:
        ax.set_yscale("log")
    for item in panel.items:
        if isinstance(item, Line):
            _draw_line(ax, item)
        elif isinstance(item, Dots):
            ax.plot(
                item.x, item.y, item.look.marker or ".", color=item.look.colour, ms=item.size, mew=0,
                alpha=item.alpha, label=item.name or None,
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
            if item.text and item.axis == "x":
                ax.text(
                    item.at, 0.97, f" {item.text}", transform=ax.get_xaxis_transform(), fontsize=8, va="top"
                )
        else:
            ax.axvspan(item.low, item.high, color=PALE, alpha=0.7, lw=0, zorder=0)
    ax.set_title(panel.title)
    _axis(ax, "x", panel.x)
    _axis(ax, "y", panel.y)


def _draw_line(ax: Axes, item: Line) -> None:
    if not item.still:
        return
    if item.band is not None:
        ax.fill_between(item.x, *item.band, color=item.look.colour, alpha=0.25, lw=0, label="95 % interval")
    if item.fill:
        ax.fill_between(item.x, item.y, ax.get_ylim()[0], color=PALE, lw=0, label=item.name, zorder=0)
        return
    ax.plot(
        item.x,
        item.y,
        color=item.look.colour,
        ls=item.look.line,
        lw=item.look.width,
        marker=item.look.marker if len(item.x) < 40 else None,
        ms=3,
        mfc="white",
        label=item.name or None,
    )


def _draw_marks(ax: Axes, item: Marks) -> None:
    x, y = np.asarray(item.x, float), np.asarray(item.y, float)
    for spans, other, flat in ((item.x_interval, y, True), (item.y_interval, x, False)):
        if spans is None:
            continue
        for a, b, at in zip(*spans, other, strict=True):
            ends = ([a, b], [at, at]) if flat else ([at, at], [a, b])
            ax.plot(*ends, color=item.look.colour, lw=item.bar, solid_capstyle="butt", zorder=3)
    if item.look.marker:
        ax.plot(
            x, y, item.look.marker, color=item.look.colour, mfc="white" if item.open else item.look.colour,
            mew=1.4, ms=item.size, ls="none", zorder=5, label=None if item.quiet else item.name or None,
        )  # fmt: skip
    elif item.name:
        ax.plot([], [], color=item.look.colour, lw=item.bar, solid_capstyle="butt", label=item.name)


def _axis(ax: Axes, which: str, axis: Axis) -> None:
    from matplotlib.ticker import NullLocator

    label, limits, ticks = (getattr(ax, f"set_{which}{k}") for k in ("label", "lim", "ticks"))
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
        ticks([t for t, _ in axis.ticks if low <= t <= high], [s for t, s in axis.ticks if low <= t <= high])
        getattr(ax, f"{which}axis").set_minor_locator(NullLocator())


def _label(fig: Figure, ax: Axes, panel: Panel) -> None:
    """Write labels beside points without overlaps."""
    points, spans = [], []
    for m in (i for i in panel.items if isinstance(i, Marks) and i.texts):
        points += [(x, y, t, m.look.colour) for x, y, t in zip(m.x, m.y, m.texts, strict=True)]
        if m.x_interval is not None:
            spans += [(a, y, b, y) for a, b, y in zip(*m.x_interval, m.y, strict=True)]
        if m.y_interval is not None:
            spans += [(x, a, x, b) for a, b, x in zip(*m.y_interval, m.x, strict=True)]
    if points:
        label_points(fig, ax, points, spans)


def log_ticks(low: float, high: float, form: str = "{:g}") -> Ticks:
    """Return ticks at round numbers between two positive numbers, if possible more than three, and few enough for their texts.

    Args:
        low: Lower end.
        high: Upper end.
        form: Format of the texts.

    Returns:
        Positions and texts.
    """
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
    """Return ticks at powers of ten between two positive numbers, or at round numbers within a decade.

    Args:
        low: Lower end.
        high: Upper end.

    Returns:
        Positions and texts.
    """
    ticks = [10.0**k for k in range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)]
    if len(ticks) < 2:
        return log_ticks(low, high)
    ticks = ticks[:: -(-len(ticks) // 6)]
    return tuple((t, number(t, 1)) for t in ticks)


# ----------------------------------------------------------------------------------------------- for the script


def packed(values: Array, few: int = 64) -> Any:
    """Return numbers in a compact form for the script.

    Args:
        values: Numbers (n,).
        few: Largest length of a plain list.

    Returns:
        A list for few numbers, three numbers for a uniform grid, otherwise 16-bit integers on a scale.
    """
    values = np.asarray(values, float)
    if len(values) > 2 and np.ptp(steps := np.diff(values)) < 1e-6 * abs(steps[0]):
        return {"from": float(values[0]), "to": float(values[-1]), "n": len(values)}
    finite = np.isfinite(values)
    if len(values) <= few:
        return [float(f"{v:.6g}") if ok else None for v, ok in zip(values, finite, strict=True)]
    low = float(values[finite].min(initial=0.0 if not finite.any() else np.inf))
    high = float(values[finite].max(initial=0.0 if not finite.any() else -np.inf))
    step = (high - low) / 65534 or 1.0
    whole = np.full(len(values), 65535, "<u2")
    whole[finite] = np.round((values[finite] - low) / step)
    return {"low": low, "step": step, "data": base64.b64encode(whole.tobytes()).decode("ascii")}


def packed_log(values: Array) -> Any:
    """Return positive numbers over many decades as 16-bit integers of their logarithms.

    Args:
        values: Numbers (n,).

    Returns:
        The compact form of the logarithms.
    """
    values = np.asarray(values, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        inner = packed(np.where(values > 0, np.log(values), np.nan))
    return {"exp": inner}


def live(chart: Chart) -> dict[str, Any]:
    """Return a chart in the form of the page's script.

    Args:
        chart: The chart.

    Returns:
        Plain data.
    """
    return {
        "columns": chart.columns,
        "walk": chart.walk,
        "choices": [
            {
                "name": name,
                "caption": chart.captions.get(name, chart.caption),
                "panels": [_panel(p) for p in panels],
            }
            for name, panels in chart.choices.items()
        ],
    }


def _panel(p: Panel) -> dict[str, Any]:
    def axis(a: Axis) -> dict[str, Any]:
        out: dict[str, Any] = {"label": a.label, "unit": a.unit, "log": a.log, "low": a.low, "high": a.high}
        if a.ticks:
            out["ticks"] = [[t, s] for t, s in a.ticks]
        if a.rows:
            out["rows"] = list(a.rows)
        return out

    items = [i for i in p.items if isinstance(i, Line)]
    grid = items and all(len(i.x) == len(items[0].x) and np.array_equal(i.x, items[0].x) for i in items)
    rising = bool(grid) and bool(np.all(np.diff(items[0].x) > 0))  # a loop is no function of x
    lines = rising and not any(isinstance(i, Dots | Marks) for i in p.items)
    return {
        "kind": "lines" if lines else "points",
        "title": p.title,
        "link": p.link,
        "tall": p.tall,
        "x": axis(p.x),
        "y": axis(p.y),
        "items": [_item(i, p, lines and k > 0) for k, i in enumerate(sorted(p.items, key=_order))],
    }


def _order(item: Item) -> int:
    return 0 if isinstance(item, Line) else 1  # the first line holds the x values of all lines


def _item(item: Item, panel: Panel, shared: bool) -> dict[str, Any]:
    def numbers(values: Sequence[float] | Array, axis: Axis) -> Any:
        values = np.asarray(values, float)
        return packed_log(values) if axis.log and len(values) > 64 else packed(values)

    def plain(values: Sequence[float]) -> list[float | None]:
        return [float(f"{v:.6g}") if math.isfinite(v) else None for v in values]

    kind = type(item).__name__.lower()
    if isinstance(item, Span):
        return {"kind": kind, "low": item.low, "high": item.high}
    if isinstance(item, Rule):
        return {"kind": kind, "axis": item.axis, "at": item.at, "text": item.text, "look": _look(item.look)}
    out: dict[str, Any] = {"kind": kind, "name": item.name, "look": _look(item.look)}
    if isinstance(item, Marks):
        out |= {"x": plain(item.x), "y": plain(item.y), "open": item.open, "bar": item.bar, "size": item.size}
        out |= {"texts": list(item.texts), "notes": list(item.notes)}
        for key, spans in (("xs", item.x_interval), ("ys", item.y_interval)):
            if spans is not None:
                out[key] = [plain(spans[0]), plain(spans[1])]
        return out
    out["y"] = numbers(item.y, panel.y)
    if not (shared and isinstance(item, Line)):
        out["x"] = numbers(item.x, panel.x)
    if isinstance(item, Line):
        out |= {"on": item.on, "fill": item.fill}
        if item.band is not None:
            out["band"] = [numbers(b, panel.y) for b in item.band]
    return out


def _look(look: Look) -> dict[str, Any]:
    dash = list(look.line[1]) if isinstance(look.line, tuple) else []
    return {"colour": look.colour, "dash": dash, "width": look.width, "marker": look.marker}
