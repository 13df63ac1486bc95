"""The three steps of a diagnosis in one figure: place, missing force, and laws on the curve of the force."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...diagnosis._estimation.structure import Hypothesis
from ...physics import elements as el
from .charts import Axis, Chart, Dots, Item, Line, Marks, Panel, Rule
from .forces import GRID, Curve, Missing
from .plots import BLUE, COLOURS, INK, MUTED, Look, caption, percent

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from ..._common.arrays import Array
    from ...diagnosis import Diagnosis
    from .diagnosis import View

    #: effects of a candidate at a place, with their values
    Laws = list[tuple[Hypothesis, dict[str, float]]]

#: places and laws that are drawn
MOST_PLACES, MOST_LAWS = 6, 4
#: least samples in a bin of a curve; quantiles of its band
LEAST, BAND = 10, (0.1, 0.9)


def draw_steps(view: View) -> Chart | None:
    """Return the chart of places, missing force and laws; None where nothing was searched."""
    if not view.d.places:
        return None
    panels = [_places(view)]
    missing = view.missing
    if missing is not None:
        kind = _axis_of(missing.curve)
        panels.append(_force(view, missing, kind))
        lines = list(_laws(view, missing, kind))
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
        caption("steps", view=view, has_laws=len(panels) > 2),
        {"all": panels},
        columns=len(panels),
        size=(7.2, 0.95 + 0.3 * rows) if missing is None else (8.6, 3.1),
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
        rows = [k for k, _ in own]
        items.append(
            Marks(
                "",
                share,
                rows,
                look,
                ([0.0] * len(own), share),
                size=4.5,
                bar=5.0,
            )
        )
    x = Axis("share of the error removed", "%", low=0.0, high=105.0)
    return Panel(
        x, Axis(rows=tuple(view.place_text(p.where) for p in shown)), tuple(items)
    )


def _axis_of(curve: Curve) -> str:
    """Return 'rate' or 'travel', over which the missing force has the narrower curve."""
    by_rate, by_travel = (
        _explained(x, curve.force) for x in (curve.rate, curve.travel)
    )
    return "rate" if by_rate >= by_travel else "travel"


def _explained(x: Array, force: Array) -> float:
    """Return the share of the square of a force that the medians over x give."""
    middle, (median,) = trend(x, force)
    if len(middle) < 2:
        return 0.0
    return _share(force - np.interp(x, middle, median), force)


def _share(left: Array, force: Array) -> float:
    """Return the share of the square of a force that is not left."""
    return 1.0 - float(np.mean(left**2) / max(float(np.var(force)), 1e-300))


def _force(view: View, missing: Missing, kind: str) -> Panel:
    """Return the panel of the missing force, sample by sample, with its curve."""
    turns = view.turns(missing.pair)
    force = missing.curve.force
    factor, axis = law_axis(kind, turns)
    x = factor * getattr(missing.curve, kind)
    middle, (low, median, high) = trend(x, force, (BAND[0], 0.5, BAND[1]))
    ends = [float(q) for q in np.quantile(x, (0.001, 0.999))]
    margin = 0.05 * (ends[1] - ends[0]) or 1.0
    top = 1.25 * float(np.quantile(np.abs(force), 0.98))
    thin = max(1, len(x) // 2500)
    curve = Line(
        "median",
        middle,
        median,
        Look(INK, "-", "o", 1.2),
        band=(low, high),
        band_name="80 % of the samples",
    )
    dots = Dots("", x[::thin], force[::thin], Look(MUTED, "-", "."), alpha=0.4)
    label = f"{axis.label} of {missing.pair[0]}–{missing.pair[1]}"
    axis = replace(axis, label=label, low=ends[0] - margin, high=ends[1] + margin)
    return Panel(
        axis,
        force_axis("missing force", turns, -top, top),
        (Rule("y", 0.0), dots, curve),
    )


def _laws(view: View, missing: Missing, kind: str) -> Iterator[Line]:
    """Yield the curve of each candidate at the place of the missing force."""
    trace = view.trace
    pair = missing.pair
    curve = missing.curve
    assert trace is not None
    factor, _ = law_axis(kind, view.turns(pair))
    step = float(trace.time[1] - trace.time[0])
    motion = el.Motion(curve.travel, curve.rate, np.gradient(curve.rate, step))
    given = [motion.d, motion.v, motion.a, np.ones(len(motion.d))]
    for k, laws in enumerate(_candidates_at(view.d, pair)):
        forces = [law_force(h, values, pair, motion) for h, values in laws]
        drawn_laws = [f for f in forces if f is not None]
        if not drawn_laws:
            continue
        columns = np.stack([*drawn_laws, *given], axis=1)
        size = np.linalg.norm(columns, axis=0)
        columns /= np.where(size > 0, size, 1.0)
        drawn = columns @ np.linalg.lstsq(columns, curve.force, rcond=1e-9)[0]
        middle, (median,) = trend(factor * getattr(curve, kind), drawn)
        share = _share(curve.force - drawn, curve.force)
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
