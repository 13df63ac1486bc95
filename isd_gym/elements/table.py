"""A law given by numbers: force over elongation, over rate, or over both.

`elongation` [m] and `rate` [m/s] are its knots, rising, one of them or both; `force` [N] is given at each knot, or for both as a
row of forces by rate for each elongation. `interpolation`: lines between the knots, or a smooth curve through them;
`beyond`: past its ends the last force is held, or its last slope.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..errors import InputError, plain, shown
from ..inputs import number
from .base import Array, Element, parameter, register

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..network import Network

KNOTS, CELLS = 500, 20_000  # of an axis, and of a table, at most
FINER = 8  # lines between two knots of a smooth table


def knots(unit: str) -> Any:
    """A row of numbers [unit] of a table; none by default."""
    from dataclasses import field

    return field(default=(), metadata={"knots": unit})


def _tabulated(p: Array, d: float, v: float, d_last: float, z: float, h: float) -> tuple[float, float]:
    # p: scale, how many elongations and rates, whether it goes on beyond its ends, the elongations, the rates, the forces
    nd, nv, on = int(p[1]), int(p[2]), p[3]
    force, row = 4 + nd + nv, max(nv, 1)
    i, s = 0, 0.0
    if nd > 1:
        low, high = 0, nd - 1
        while high - low > 1:
            middle = (low + high) // 2
            if d < p[4 + middle]:
                high = middle
            else:
                low = middle
        i, s = low, (d - p[4 + low]) / (p[5 + low] - p[4 + low])
        if on == 0.0:
            s = min(max(s, 0.0), 1.0)
    j, t = 0, 0.0
    if nv > 1:
        low, high = 0, nv - 1
        while high - low > 1:
            middle = (low + high) // 2
            if v < p[4 + nd + middle]:
                high = middle
            else:
                low = middle
        j, t = low, (v - p[4 + nd + low]) / (p[5 + nd + low] - p[4 + nd + low])
        if on == 0.0:
            t = min(max(t, 0.0), 1.0)
    here = force + i * row + j
    f = p[here]
    if nv > 1:
        f += t * (p[here + 1] - p[here])
    if nd > 1:
        g = p[here + row]
        if nv > 1:
            g += t * (p[here + row + 1] - p[here + row])
        f += s * (g - f)
    return p[0] * f, z


@register
class TabulatedForce(Element):
    type = "tabulated_force"
    mechanism = "other"
    equation = "F = scale * table(d, v)"
    source = "a measured law, or the one that a diagnosis found without a name for it"
    signature = "whatever the table says"
    test = "Move the terminals through the table's range: the force must be the table's."
    law = staticmethod(_tabulated)
    choices: ClassVar[dict[str, tuple[str, ...]]] = {
        "interpolation": ("linear", "smooth"),
        "beyond": ("hold", "slope"),
    }
    elongation: tuple[float, ...] = knots("m")
    rate: tuple[float, ...] = knots("m/s")
    force: tuple[Any, ...] = knots("N")
    scale: float = parameter("-", 0.1, 10.0, default=1.0, minimum=-math.inf, fixed=True)
    interpolation: str = "linear"
    beyond: str = "hold"

    def __post_init__(self) -> None:
        super().__post_init__()
        what = f"element '{plain(self.name)}'"
        axes = []
        for key in ("elongation", "rate"):
            row = _row(getattr(self, key), f"{what}: {key}")
            if len(row) == 1 or any(b <= a for a, b in zip(row, row[1:], strict=False)):
                raise InputError(
                    f"{what}: {key} must hold two numbers or more, each larger than the one before"
                )
            object.__setattr__(self, key, row)
            axes.append(len(row))
        nd, nv = axes
        if not nd and not nv:
            raise InputError(f'{what}: a table is over "elongation", over "rate" or over both')
        if nd and nv:
            force = self.force if isinstance(self.force, list | tuple) else ()
            table: tuple[Any, ...] = tuple(_row(r, f"{what}: force") for r in force)
            if len(table) != nd or any(len(r) != nv for r in table):
                raise InputError(
                    f"{what}: force must hold {nd} rows (of elongation) of {nv} numbers (of rate)"
                )
        else:
            table = _row(self.force, f"{what}: force")
            if len(table) != nd + nv:
                raise InputError(f"{what}: force must hold {nd + nv} numbers, one a knot, not {len(table)}")
        if max(nd, 1) * max(nv, 1) > CELLS:
            raise InputError(f"{what}: a table of {nd} times {nv} numbers, at most {CELLS} are handled")
        object.__setattr__(self, "force", table)
        if nv and not nd:
            object.__setattr__(self, "plane", "rate")

    @property
    def over(self) -> str:
        """'elongation', 'rate' or 'both'."""
        return "both" if self.elongation and self.rate else "rate" if self.rate else "elongation"

    def at(self, d: Array, v: Array) -> Array:
        """Force [N] at elongations d [m] and rates v [m/s], both (n,)."""
        p = np.array(self.law_parameters())
        return np.array([_tabulated(p, x, s, 0.0, 0.0, 0.0)[0] for x, s in zip(d, v, strict=True)])

    def law_parameters(self) -> list[float]:
        d, v, f = np.array(self.elongation), np.array(self.rate), np.array(self.force, float)
        if self.interpolation == "smooth":
            d, v, f = _finer(d, v, f)
        on = 1.0 if self.beyond == "slope" else 0.0
        return [self.scale, float(len(d)), float(len(v)), on, *d.tolist(), *v.tolist(), *f.ravel().tolist()]

    def curve(self, axis: Array) -> Array:
        still = np.zeros(len(axis))
        return self.at(still, axis) if self.over == "rate" else self.at(axis, still)

    def to_dict(self) -> dict[str, Any]:
        out = super().to_dict()
        for key in ("elongation", "rate"):
            if not out[key]:
                del out[key]
        return out

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        return False  # the diagnosis draws one where no law explains what is missing


def _row(values: Any, what: str) -> tuple[float, ...]:
    if not isinstance(values, list | tuple) or len(values) > KNOTS:
        raise InputError(f"{what} must be a list of at most {KNOTS} numbers, not {shown(values)}")
    return tuple(number(x, what) for x in values)


def _finer(d: Array, v: Array, f: Array) -> tuple[Array, Array, Array]:
    """The same table through more knots: a curve that overshoots none of its own, smooth at each."""
    from scipy.interpolate import PchipInterpolator

    def between(x: Array) -> Array:
        return np.concatenate([np.linspace(a, b, FINER, endpoint=False) for a, b in _pairs(x)] + [x[-1:]])

    if len(d) and len(v):
        most = int(math.sqrt(CELLS / f.size))
        if most < FINER:  # fine enough as it is
            return d, v, f
    if len(d):
        fine = between(d)
        d, f = fine, np.asarray(PchipInterpolator(d, f, axis=0)(fine))
    if len(v):
        fine = between(v)
        v, f = fine, np.asarray(PchipInterpolator(v, f, axis=-1)(fine))
    return d, v, f


def _pairs(x: Array) -> Sequence[tuple[float, float]]:
    return list(zip(x[:-1], x[1:], strict=True))
