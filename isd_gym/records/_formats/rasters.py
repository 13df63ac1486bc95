"""Channels with different time stamps: one raster per channel, or one raster for all channels."""

from __future__ import annotations

from . import Refused

#: value of "resample" that keeps every channel on the stamps of its own group
OWN = "own"


def own_stamps(found):
    """Return the stamps of every raster under the raster's number, then the channels as "number name"."""
    rasters, columns = [stamps for stamps, _ in list(found.values())[:1]], []
    for name, (stamps, values) in found.items():
        number = next(
            (k for k, t in enumerate(rasters) if len(t) == len(stamps) and (t == stamps).all()), None
        )
        if number is None:
            number = len(rasters)
            rasters.append(stamps)
        columns.append((f"{number} {name}", values))
    return [(str(k), t) for k, t in enumerate(rasters)] + columns


def joined(found, axis, resample):
    """Return the channels (stamps [s] and values by name) on one raster: the time column `axis`, then a column per channel.

    With `resample`, channels are interpolated linearly to the finest raster.
    """
    import numpy as np

    base = min((t for t, _ in found.values()), key=lambda t: (t[-1] - t[0]) / max(len(t) - 1, 1))
    same = all(len(t) == len(base) and np.allclose(t, base, rtol=0, atol=1e-9) for t, _ in found.values())
    if not same:
        if not resample:
            rates = sorted(
                {f"{(t[-1] - t[0]) / max(len(t) - 1, 1):.4g} s x {len(t)}" for t, _ in found.values()}
            )
            raise Refused(
                f"channels are on different rasters ({', '.join(rates[:20])}); ask to resample them"
            )
        start, end = max(t[0] for t, _ in found.values()), min(t[-1] for t, _ in found.values())
        base = base[(base >= start) & (base <= end)]
    columns = [(n, v if same else np.interp(base, t, v)) for n, (t, v) in found.items()]
    return [(axis, base), *columns]
