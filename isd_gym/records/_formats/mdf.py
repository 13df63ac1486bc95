"""MDF files, read with asammdf."""

from __future__ import annotations

from . import Refused, bearable
from .rasters import own_stamps

LIBRARIES = ("asammdf",)
EXTRA = "io"
#: arithmetic and tabular conversions; formulas in a file are not evaluated
MDF_CONVERSIONS = {4: {0, 1, 2, 4, 5}, 3: {0, 1, 2, 6, 7, 8, 9, 65535}}


def read(path, wanted, axis, limit):
    """Return all numeric channels of an MDF file on their own stamps, and their units; of a repeated name, that of the first group."""
    import asammdf
    import numpy as np

    with open(path, "rb") as stream:
        head = stream.read(168)
        if len(head) < 168 or not head.startswith(b"MDF"):
            raise Refused("is not an MDF file")
    found, units, total = {}, {}, 0
    with open(path, "rb") as stream, asammdf.MDF(stream) as mdf:
        masters = set(mdf.masters_db.items())
        allowed = MDF_CONVERSIONS[4 if mdf.version >= "4" else 3]
        for name, every in mdf.channels_db.items():
            places = [place for place in every if tuple(place) not in masters]
            if not places:
                continue
            group, index = places[0]
            channels = mdf.groups[group].channels
            conversions = (
                channels[i].conversion
                for i in {index, mdf.masters_db.get(group, index)}
            )
            if any(
                c is not None and c.conversion_type not in allowed for c in conversions
            ):
                continue
            total += 16 * mdf.groups[group].channel_group.cycles_nr
            bearable(total, limit)
            item = mdf.get(group=group, index=index)
            if (
                item.samples.ndim == 1
                and item.samples.dtype.kind in "fiub"
                and len(item.samples)
            ):
                found[name] = (
                    np.array(item.timestamps, float),
                    np.array(item.samples, float),
                )
                units[name] = str(item.unit)[:200]
    if not found:
        raise Refused("holds no numeric channel")
    return own_stamps(found), {n: u for n, u in units.items() if u}, []
