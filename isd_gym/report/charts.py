"""Charts told once and drawn twice: as a picture (matplotlib) and live in the page (``templates/page.js``).

A `Chart` is panels, a `Panel` two axes and what is drawn on them. `draw` makes the picture that a page shows where no
script runs and that is printed; `live` is the same as JSON, which the page's script makes into plots with values under the
pointer, zoom and series that can be switched off. Long signals travel as 16-bit numbers, so that pages stay small.
"""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .plots import (
    MUTED,
    PALE,
    Look,
    Picture,
    embedded,
    figure,
    label_points,
    number,
    pixels,
    save,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..arrays import Array

Ticks = tuple[tuple[float, str], ...]

QUIET = Look(MUTED, "-", "", 0.9)


@dataclass(frozen=True)
class Axis:
    """One axis: `label` and `unit` of its values; `rows` names whole numbers from the top down instead."""

    label: str = ""
    unit: str = ""
    log: bool = False
    low: float | None = None  # in the picture, and where a live plot begins
    high: float | None = None
    ticks: Ticks = ()
    rows: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        return f"{self.label} [{self.unit}]" if self.unit and self.label else self.label


@dataclass(frozen=True)
class Line:
    """A curve, with a `band` (low, high) about it where it has one. `still`: whether it is in the picture."""

    name: str
    x: Array
    y: Array
    look: Look
    band: tuple[Array, Array] | None = None
    fill: bool = False  # down to the axis
    still: bool = True
    on: bool = True  # shown from the start in a live chart


@dataclass(frozen=True)
class Dots:
    """A cloud of samples."""

    name: str
    x: Array
    y: Array
    look: Look
    size: float = 2.2
    alpha: float = 0.55


@dataclass(frozen=True)
class Marks:
    """Single points with intervals; `texts` stand beside them, `notes` are what they say under the pointer."""

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
    bar: float = 1.0  # width of the intervals
    quiet: bool = False  # not in the picture's legend: its texts say who it is


@dataclass(frozen=True)
class Rule:
    """A straight line across the panel at a value of `axis`, with a word where it needs one."""

    axis: str
    at: float
    text: str = ""
    look: Look = QUIET


@dataclass(frozen=True)
class Span:
    """A stretch of x that is shaded."""

    low: float
    high: float


Item = Line | Dots | Marks | Rule | Span


@dataclass(frozen=True)
class Panel:
    """Items on two axes. Panels of the same `link` share their x: zoom and pointer go together."""

    x: Axis
    y: Axis
    items: tuple[Item, ...]
    title: str = ""
    link: str = ""
    tall: float = 1.0  # height relative to the others' of its chart


@dataclass(frozen=True)
class Chart:
    """A figure of a page. `choices`: the panels by the name of a record; the picture shows the first.

    walk: a live chart has buttons that go along x. size: of the picture [inch]. captions: of the choices whose words differ from
    `caption`, by name.
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
    still: int | None = None  # how many panels are in the picture; all unless given
    captions: Mapping[str, str] = field(default_factory=dict)

    @property
    def panels(self) -> Sequence[Panel]:
        """Those of the picture."""
        return next(iter(self.choices.values()))[: self.still]


def picture(chart: Chart, folder: Path) -> Picture:
    """Draw `chart` into `folder` and make it ready for a page; to be called within `plots.style`."""
    fig = figure(*chart.size)
    draw(fig, chart)
    path = save(fig, folder / f"{chart.name}.png")
    return Picture(path.name, chart.title, chart.alt, chart.caption, embedded(path), pixels(fig), live(chart))


# ------------------------------------------------------------------------------------------------- the picture


def draw(fig: Figure, chart: Chart) -> None:
    """Draw the first choice of `chart` on an empty figure."""
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
        room = max(1, int(chart.size[0] / 7.2 * 95))  # characters
        wide = 6 + max(map(len, handles))
        fig.legend(
            list(handles.values()),
            list(handles),
            loc="outside upper left",
            ncols=max(1, min(len(handles), room // wide)),
        )
    if chart.align:
        fig.align_ylabels([ax for ax, _ in beside[::columns]])
    for ax, panel in beside:  # after the layout is known
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
    """The words beside points, where they cover nothing."""
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
    """Round numbers between two positive ones: more than two of them where there are."""
    ticks: list[float] = []
    for steps in ((1,), (1, 2, 5), range(1, 10), [1 + k / 10 for k in range(90)]):
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
    """Ticks at powers of ten between two positive numbers, or rounder ones where there is no decade."""
    ticks = [10.0**k for k in range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)]
    if len(ticks) < 2:
        return log_ticks(low, high)
    ticks = ticks[:: -(-len(ticks) // 6)]
    return tuple((t, number(t, 1)) for t in ticks)


# ----------------------------------------------------------------------------------------------- for the script


def packed(values: Array, few: int = 64) -> Any:
    """Numbers for the script: a list where there are `few`, an even grid in three, others on a scale of 16 bits."""
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
    """Positive numbers over many decades, to 16 bits of their logarithm."""
    values = np.asarray(values, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        inner = packed(np.where(values > 0, np.log(values), np.nan))
    return {"exp": inner}


def live(chart: Chart) -> dict[str, Any]:
    """The chart as the page's script wants it."""
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
    lines = bool(grid) and not any(isinstance(i, Dots | Marks) for i in p.items)
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
    return 0 if isinstance(item, Line) else 1  # the first line carries the x of all


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
