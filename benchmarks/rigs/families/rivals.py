"""Could something else be meant? What is left of a hidden force when another law, and any linear one, does what it can.

A rig is only a fair question where the answer is the only one. So the hidden force along the true motion is regressed on
elongation, rate and each rival law in turn (over a grid of the shape that it has); what is left, as a share of what
elongation and rate alone leave, tells how well the rival imitates. This looks at forces, not at responses, and at one
place: it is a fair first judge, not a last one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from .plant import Array

#: laws that a diagnosis may name beside the truth and still be right: the truth is a special case of them, or nearly
CONTAINS = {
    "coulomb_friction": ("stribeck_friction", "hysteresis"),
    "stribeck_friction": (),
    "hysteresis": (
        "coulomb_friction",
    ),  # told from it by its corners, which `way` makes wide enough
    "cubic_stiffness": ("gas_spring", "cogging_force"),
    "x_sine_less_linear": ("cubic_stiffness", "gas_spring", "cogging_force"),
    "gas_spring": (),
    "quadratic_damping": (),
}


@numba.njit(cache=True)
def _slider(d: Array, way: float) -> Array:
    """Force of an elastic slider of unit level with rounded corners (Dahl) whose corners take `way`."""
    z = np.zeros(len(d))
    for i in range(1, len(d)):
        u = (d[i] - d[i - 1]) / way
        s = 1.0 if u > 0.0 else -1.0
        z[i] = s - (s - z[i - 1]) * np.exp(-abs(u))
    return z


def laws(d: Array, v: Array) -> Iterator[tuple[str, Array]]:
    """(name, columns (n, k)) of every law of the library between two terminals, its shape over a grid."""
    size, rms_v = float(np.abs(d).max()), float(np.sqrt(np.mean(v**2)))
    sign = np.clip(v / (1e-3 * rms_v), -1.0, 1.0)
    yield "coulomb_friction", sign[:, None]
    for share in (0.1, 0.3, 0.6):
        fade = np.exp(-((v / (share * rms_v)) ** 2))
        yield "stribeck_friction", np.stack([sign, sign * fade], axis=1)
    yield "quadratic_damping", (v * np.abs(v))[:, None]
    yield "asymmetric_damping", np.maximum(v, 0.0)[:, None]
    yield "cubic_stiffness", (d**3)[:, None]
    for length in (1.3, 2.0, 4.0):
        yield "gas_spring", ((1.0 + d / (length * size)) ** -1.3)[:, None]
    for share in np.linspace(0.1, 0.9, 9):
        over, under = (
            np.maximum(d - share * size, 0.0),
            np.minimum(d + share * size, 0.0),
        )
        yield "bump_stop", (over + under)[:, None]
        yield "bump_stop", over[:, None]
        yield "bump_stop", under[:, None]
    for way in (0.03, 0.1, 0.3, 1.0):
        yield "hysteresis", _slider(d, way * size)[:, None]
    for waves in np.exp(np.linspace(np.log(0.7), np.log(20.0), 30)):
        k = np.pi * waves / size
        yield "cogging_force", np.stack([np.sin(k * d), np.cos(k * d)], axis=1)


def imitated(force: Array, d: Array, v: Array, hidden: str) -> tuple[str, float]:
    """The rival of `hidden` that comes nearest, and what it leaves of the force (0: the same, 1: no help at all)."""
    n = len(force)
    keep = slice(0, n, max(1, n // 4000))
    d, v, force = d[keep], v[keep], force[keep]
    linear = [np.ones(len(d)), d, v]

    def left(extra: Array | None) -> float:
        columns = linear if extra is None else [*linear, *extra.T]
        A = np.stack([c / max(float(np.abs(c).max()), 1e-300) for c in columns], axis=1)
        return float(
            np.sqrt(
                np.mean((force - A @ np.linalg.lstsq(A, force, rcond=1e-10)[0]) ** 2)
            )
        )

    alone = max(left(None), 1e-300)
    same = (hidden, *CONTAINS.get(hidden, ()))
    rest = [(left(x) / alone, name) for name, x in laws(d, v) if name not in same]
    share, name = min(rest)
    return name, share
