"""Start values of fits for laws without `starts` of their own, scaled by the motion and force of the data."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError
from ._base import Element, Motion, Setting, Start, parameter_fields, rms

if TYPE_CHECKING:
    from collections.abc import Mapping
    from dataclasses import Field

    from ..._common.arrays import Array


def _values_of(f: Field[Any], motion: Motion | None) -> list[float]:
    """Return trial values of a parameter: fractions of the motion, or the middle of the plausible range, as the unit suggests."""
    low, high = f.metadata["range"]
    if f.metadata["fixed"]:
        return [float(f.default)]  # type: ignore[arg-type]
    if motion is not None and f.metadata["unit"] in ("m", "rad"):
        return [share * motion.reach for share in (0.15, 0.5, 1.5)]
    if motion is not None and f.metadata["unit"] in ("m/s", "rad/s"):
        return [share * rms(motion.v) for share in (0.3, 1.0, 3.0)]
    return [math.sqrt(low * high) if low > 0 else 0.5 * (low + high)]


def _force(
    cls: type[Element], values: Mapping[str, float], at: Setting
) -> Array | None:
    """Return the force of a law over a thinned piece of the motion; None for impossible values."""
    try:
        e = cls(name="trial", where=at.where, **values, **at.options)
    except (InputError, TypeError):
        return None
    m = at.moves
    pick = slice(0, 4000)
    d, v, a = m.d[pick], m.v[pick], m.a[pick]
    if cls.bound is not None:
        p = np.array(e.law_parameters())
        return np.array(
            [cls.bound(p, x, s) * np.sign(s) for x, s in zip(d, v, strict=True)]
        )
    if cls.law is not None:
        p, z, last, out = np.array(e.law_parameters()), 0.0, d[0], []
        h = (
            float(np.median(np.abs(np.diff(d))) / max(np.median(np.abs(v)), 1e-12))
            or 1e-3
        )
        for x, s in zip(d, v, strict=True):
            f, z = cls.law(p, x, s, last, z, h)
            last = x
            out.append(f)
        return np.array(out)
    k, c, b = e.linear()
    return np.asarray(k * d + c * v + b * a, dtype=np.float64)


def generic_starts(cls: type[Element], at: Setting) -> list[Start]:
    """Return start values for a law, scaled by the motion and force of the data."""
    free = [f for f in parameter_fields(cls) if not f.metadata["fixed"]]
    if (
        at.motion is None
    ):  # an effect at a motor or a channel has no size before the fit
        middle = {f.name: _values_of(f, None)[0] for f in free}
        return [Start(middle, grows=tuple(middle)[:1])]
    trials: list[dict[str, float]] = [{}]
    for f in free:
        trials = [t | {f.name: x} for t in trials for x in _values_of(f, at.motion)][
            :27
        ]
    out = []
    for values in trials:
        force = _force(cls, values, at)
        if force is None or not np.isfinite(force).all() or rms(force) <= 1e-12:
            continue
        grows = []
        for f in free:
            doubled = _force(cls, values | {f.name: 2.0 * values[f.name]}, at)
            if doubled is not None and np.allclose(
                doubled, 2.0 * force, rtol=1e-6, atol=1e-9 * rms(force)
            ):
                grows.append(f.name)
        if not grows:  # several parameters may scale the force only together, such as the levels of a curve
            rest = [
                f.name
                for f in free
                if f.metadata["unit"] not in ("m", "rad", "m/s", "rad/s", "-")
            ]
            doubled = _force(cls, values | {n: 2.0 * values[n] for n in rest}, at)
            if (
                rest
                and doubled is not None
                and np.allclose(doubled, 2.0 * force, rtol=1e-6, atol=1e-9 * rms(force))
            ):
                grows = rest
        scale = at.small / rms(force)
        sized = values | {
            n: values[n] * scale for n in (grows if len(grows) != 1 else grows[:1])
        }
        signed = any(f.metadata["minimum"] < 0 for f in free if f.name in grows)
        out.append(Start(sized, grows=tuple(grows), signed=signed))
    return out or [Start(trials[0])]
