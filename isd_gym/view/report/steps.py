"""The three steps of a diagnosis in one figure: place, missing force, and laws on the curve of the force."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...diagnosis._estimation.structure import Hypothesis
from ...physics import elements as el
from .charts import Axis, Chart, Dots, Item, Line, Marks, Panel, Rule
from .plots import BLUE, COLOURS, INK, MUTED, Look, caption, percent

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from ..._common.arrays import Array
    from ...diagnosis import Diagnosis
    from .diagnosis import View
    from .forces import Cloud

    #: effects of a candidate at a place, with their values
    Laws = list[tuple[Hypothesis, dict[str, float]]]

#: places and laws that are drawn
MOST_PLACES, MOST_LAWS = 6, 4
#: least samples in a bin of a curve; quantiles of its band
LEAST, BAND = 10, (0.1, 0.9)
#: points of the curve of a law: a cogging may have dozens of periods
GRID = 1601


def draw_steps(view: View) -> Chart | None:
    """Return the chart of places, missing force and laws; None where nothing was searched."""
    if not view.d.places:
        return None
    panels = [_places(view)]
    cloud = next(iter(view.clouds), None)
    if cloud is not None:
        kind = _axis_of(cloud)
        panels.append(_force(view, cloud, kind))
        lines = list(_laws(view, cloud, kind))
        if lines:
            rule, _, curve = panels[-1].items
            bare = [replace(curve, band=None)] if isinstance(curve, Line) else []
            panels.append(replace(panels[-1], items=(rule, *bare, *lines)))
    titles = ("1. Place", "2. Force", "3. Laws")
    panels = [replace(p, title=title) for p, title in zip(panels, titles, strict=False)]
    rows = len(panels[0].y.rows)
    return Chart(
        "steps",
        "How the effect was looked for",
        "Places by the share of the error that a law there removes; the missing force over the motion; laws on its curve",
        caption("steps", view=view, cloud=cloud, has_laws=len(panels) > 2),
        {"all": panels},
        columns=len(panels),
        size=(7.2, 0.95 + 0.3 * rows) if cloud is None else (8.6, 3.1),
        align=False,
    )


def _places(view: View) -> Panel:
    """Return the panel of places, with the best law at each."""
    shown = view.d.places[:MOST_PLACES]
    found = [
        {*(e.between or ()), *([e.channel] if e.channel else ())}
        for e in view.d.effects
    ]
    items: list[Item] = []
    for is_found, look in (
        (True, Look(BLUE, "-", "o")),
        (False, Look(MUTED, "-", "o")),
    ):
        own = [
            (k, p) for k, p in enumerate(shown) if (set(p.where) in found) == is_found
        ]
        share = [100 * max(p.share, 0.0) for _, p in own]
        notes = [
            f"{view.place_text(p.where)}: {el.spoken(p.effect)} removes {percent(p.share, 0, sign=False)}"
            for _, p in own
        ]
        rows = [k for k, _ in own]
        items.append(
            Marks(
                "",
                share,
                rows,
                look,
                ([0.0] * len(own), share),
                notes=notes,
                size=4.5,
                bar=5.0,
            )
        )
    x = Axis("share of the error removed", "%", low=0.0, high=105.0)
    return Panel(
        x, Axis(rows=tuple(view.place_text(p.where) for p in shown)), tuple(items)
    )


def _axis_of(cloud: Cloud) -> str:
    """Return 'rate' or 'travel', over which the missing force has the narrower curve."""
    by_rate, by_travel = (
        _explained(x, cloud.before) for x in (cloud.rate, cloud.travel)
    )
    return "rate" if by_rate >= by_travel else "travel"


def _explained(x: Array, force: Array) -> float:
    """Return the share of the square of a force that the medians over x give."""
    middle, (median,) = trend(x, force)
    if len(middle) < 2:
        return 0.0
    left = force - np.interp(x, middle, median)
    return 1.0 - float(np.mean(left**2) / max(np.var(force), 1e-300))


def _force(view: View, cloud: Cloud, kind: str) -> Panel:
    """Return the panel of the missing force, sample by sample, with its curve."""
    turns = view.turns(cloud.pair)
    factor, axis = law_axis(kind, turns)
    x = factor * getattr(cloud, kind)
    middle, (low, median, high) = trend(x, cloud.before, (BAND[0], 0.5, BAND[1]))
    ends = [float(q) for q in np.quantile(x, (0.001, 0.999))]
    margin = 0.05 * (ends[1] - ends[0]) or 1.0
    top = 1.25 * float(np.quantile(np.abs(cloud.before), 0.98))
    thin = max(1, len(x) // 2500)
    curve = Line(
        "median",
        middle,
        median,
        Look(INK, "-", "o", 1.2),
        band=(low, high),
        band_name="80 % of the samples",
    )
    dots = Dots("", x[::thin], cloud.before[::thin], Look(MUTED, "-", "."), alpha=0.4)
    label = f"{axis.label} of {cloud.pair[0]}–{cloud.pair[1]}"
    axis = replace(axis, label=label, low=ends[0] - margin, high=ends[1] + margin)
    return Panel(
        axis,
        force_axis("missing force", turns, -top, top),
        (Rule("y", 0.0), dots, curve),
    )


def _laws(view: View, cloud: Cloud, kind: str) -> Iterator[Line]:
    """Yield the curve of each candidate at the place of the missing force."""
    trace = view.trace
    if trace is None:
        return
    factor, _ = law_axis(kind, view.turns(cloud.pair))
    step = float(trace.time[1] - trace.time[0])
    motion = el.Motion(cloud.travel, cloud.rate, np.gradient(cloud.rate, step))
    given = [cloud.travel, cloud.rate, motion.a, np.ones(len(cloud.rate))]
    for k, laws in enumerate(_candidates_at(view.d, cloud.pair)):
        forces = [law_force(h, values, cloud.pair, motion) for h, values in laws]
        drawn_laws = [f for f in forces if f is not None]
        if not drawn_laws:
            continue
        columns = np.stack([*drawn_laws, *given], axis=1)
        size = np.linalg.norm(columns, axis=0)
        columns /= np.where(size > 0, size, 1.0)
        drawn = columns @ np.linalg.lstsq(columns, cloud.before, rcond=1e-9)[0]
        middle, (median,) = trend(factor * getattr(cloud, kind), drawn)
        share = 1.0 - float(
            np.mean((cloud.before - drawn) ** 2) / max(np.var(cloud.before), 1e-300)
        )
        name = " and ".join(el.spoken(h.effect) for h, _ in laws)
        text = f"{name} ({percent(max(share, 0.0), 0, sign=False)})"
        yield Line(text, middle, median, Look(COLOURS[k], "-", "", 1.4))


def law_force(
    h: Hypothesis,
    values: Mapping[str, float],
    pair: tuple[str, str],
    motion: el.Motion,
) -> Array | None:
    """Return the force (samples,) [N] of a law along the motion of a pair, from its curve; None for a law without one."""
    if h.kind.plane == "time":
        return None
    element = h.kind(name="alone", where=h.where, **values, **dict(h.options))
    side = 1.0 if h.where == pair else -1.0
    along = side * (motion.v if h.kind.plane == "rate" else motion.d)
    axis = np.linspace(float(along.min()), float(along.max()), GRID)
    return side * np.interp(along, axis, element.curve(axis))


def _candidates_at(d: Diagnosis, pair: tuple[str, str]) -> list[Laws]:
    """Return the laws of each candidate at a place, the named or best candidate first; laws in series are left out."""
    every: list[Iterable[tuple[str, Sequence[str], dict[str, float], dict[str, str]]]]
    every = [
        [
            (
                e.effect,
                e.between or (),
                {k: q.value for k, q in e.parameters.items()},
                {},
            )
            for e in d.effects
        ]
    ]
    best = d.best_candidate
    if best is not None:
        none: tuple[dict[str, str], ...] = ({},) * len(best.effects)
        every.append(zip(best.effects, best.where, best.values, none, strict=True))
    for c in d.alternatives:
        every.append(zip(c.effects, c.where, c.values, c.options, strict=True))
    out: dict[tuple[str, ...], Laws] = {}
    for effects in every:
        laws = [
            (Hypothesis(effect, tuple(where), tuple(options.items())), values)
            for effect, where, values, options in effects
            if set(where) == set(pair)
            and effect in el.TYPES
            and not el.TYPES[effect].series
        ]
        if laws:
            out.setdefault(tuple(sorted(h.effect for h, _ in laws)), laws)
    return list(out.values())[:MOST_LAWS]


def trend(
    x: Array, y: Array, at: tuple[float, ...] = (0.5,), bins: int = 24
) -> tuple[Array, Array]:
    """Return means of x (bins,) and quantiles of y (quantiles, bins) in bins of x with enough samples."""
    edges = np.linspace(
        float(np.quantile(x, 0.002)), float(np.quantile(x, 0.998)), bins + 1
    )
    index = np.digitize(x, edges) - 1
    pick = [k for k in range(bins) if np.sum(index == k) >= LEAST]
    middle = np.array([x[index == k].mean() for k in pick])
    return middle, np.array([np.quantile(y[index == k], at) for k in pick]).reshape(
        -1, len(at)
    ).T


def law_axis(kind: str, turns: bool) -> tuple[float, Axis]:
    """Return the factor from SI units and the axis of a motion; `kind` is 'rate' or 'travel'."""
    if turns:
        return 1.0, Axis("angular velocity", "rad/s") if kind == "rate" else Axis(
            "angle", "rad"
        )
    return (
        (1.0, Axis("velocity", "m/s"))
        if kind == "rate"
        else (1e3, Axis("travel", "mm"))
    )


def force_axis(label: str, turns: bool, low: float, high: float) -> Axis:
    """Return the axis of a force, or of a torque where nodes turn."""
    label, unit = (label.replace("force", "torque"), "N·m") if turns else (label, "N")
    return Axis(label, unit, low=low, high=high)
