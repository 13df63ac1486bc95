"""Channels with different time stamps."""

from __future__ import annotations


def own_stamps(found):
    """Return the stamps of every raster under the raster's number, then the channels as "number name"."""
    rasters = [stamps for stamps, _ in list(found.values())[:1]]
    columns = []
    for name, (stamps, values) in found.items():
        number = next(
            (
                k
                for k, t in enumerate(rasters)
                if len(t) == len(stamps) and (t == stamps).all()
            ),
            None,
        )
        if number is None:
            number = len(rasters)
            rasters.append(stamps)
        columns.append((f"{number} {name}", values))
    return [(str(k), t) for k, t in enumerate(rasters)] + columns
