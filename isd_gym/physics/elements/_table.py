"""A tabulated law: force over elongation, over rate, or over both.

`elongation` [m] and `rate` [m/s] are rising knots, for one or both axes. `force` [N] has one value per knot;
for two axes, one row over the rate for each elongation. `interpolation` is linear between the knots, or a
smooth curve through the knots. `beyond` holds the last force or the last slope outside the table.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..._common.errors import InputError, plain, shown
from ..._common.inputs import number
from ._base import Element, parameter, register

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from ..network import Network

KNOTS, CELLS = (
    500,
    20_000,
)  # upper limits for knots of an axis, and for values of a table
FINER = 8  # linear pieces between two knots of a smooth table


def knots(unit: str) -> Any:
    """Define an axis or the values of a table; empty by default."""
    from dataclasses import field

    return field(default=(), metadata={"knots": unit})


def _tabulated(
    p: Array, d: float, v: float, d_last: float, z: float, h: float
) -> tuple[float, float]:
    # p: scale, numbers of elongations and rates, extrapolation flag, elongations, rates, forces
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
    test = (
        "Move the two parts through the table's range: the force must be the table's."
    )
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
            raise InputError(
                f'{what}: a table is over "elongation", over "rate" or over both'
            )
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
                raise InputError(
                    f"{what}: force must hold {nd + nv} numbers, one a knot, not {len(table)}"
                )
        if max(nd, 1) * max(nv, 1) > CELLS:
            raise InputError(
                f"{what}: a table of {nd} times {nv} numbers, at most {CELLS} are handled"
            )
        object.__setattr__(self, "force", table)
        if nv and not nd:
            object.__setattr__(self, "plane", "rate")

    @property
    def over(self) -> str:
        """Axes of the table: 'elongation', 'rate' or 'both'."""
        return (
            "both"
            if self.elongation and self.rate
            else "rate"
            if self.rate
            else "elongation"
        )

    def at(self, d: Array, v: Array) -> Array:
        """Return the force (n,) [N] at elongations (n,) [m] and rates (n,) [m/s]."""
        p = np.array(self.law_parameters())
        return np.array(
            [_tabulated(p, x, s, 0.0, 0.0, 0.0)[0] for x, s in zip(d, v, strict=True)]
        )

    def law_parameters(self) -> list[float]:
        d, v, f = (
            np.array(self.elongation),
            np.array(self.rate),
            np.array(self.force, float),
        )
        if self.interpolation == "smooth":
            d, v, f = _finer(d, v, f)
        on = 1.0 if self.beyond == "slope" else 0.0
        return [
            self.scale,
            float(len(d)),
            float(len(v)),
            on,
            *d.tolist(),
            *v.tolist(),
            *f.ravel().tolist(),
        ]

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
        return False  # the diagnosis draws a table if no law explains the missing force


def _row(values: Any, what: str) -> tuple[float, ...]:
    if not isinstance(values, list | tuple) or len(values) > KNOTS:
        raise InputError(
            f"{what} must be a list of at most {KNOTS} numbers, not {shown(values)}"
        )
    return tuple(number(x, what) for x in values)


def _finer(d: Array, v: Array, f: Array) -> tuple[Array, Array, Array]:
    """Return the same table with more knots: a smooth curve without overshoot."""
    from scipy.interpolate import PchipInterpolator

    def between(x: Array) -> Array:
        finer = [np.linspace(a, b, FINER, endpoint=False) for a, b in pairwise(x)]
        return np.concatenate([*finer, x[-1:]])

    if len(d) and len(v):
        most = int(math.sqrt(CELLS / f.size))
        if most < FINER:  # already fine enough
            return d, v, f
    if len(d):
        fine = between(d)
        d, f = fine, np.asarray(PchipInterpolator(d, f, axis=0)(fine))
    if len(v):
        fine = between(v)
        v, f = fine, np.asarray(PchipInterpolator(v, f, axis=-1)(fine))
    return d, v, f
