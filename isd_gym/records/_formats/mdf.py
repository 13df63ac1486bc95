"""MDF files, read with asammdf."""

from __future__ import annotations

from . import Refused, bearable
from .rasters import OWN, joined, own_stamps

LIBRARIES = ("asammdf",)
EXTRA = "io"
#: arithmetic and tabular conversions; formulas in a file are not evaluated
MDF_CONVERSIONS = {4: {0, 1, 2, 4, 5}, 3: {0, 1, 2, 6, 7, 8, 9, 65535}}


def read(path, wanted, axis, resample, limit):
    """Return the numeric channels, their units and the names of other channels of an MDF file."""
    import asammdf
    import numpy as np

    with open(path, "rb") as stream:
        head = stream.read(168)
        if len(head) < 168 or not head.startswith(b"MDF"):
            raise Refused("is not an MDF file")
    found, units = {}, {}
    with open(path, "rb") as stream, asammdf.MDF(stream) as mdf:
        masters = set(mdf.masters_db.items())
        allowed = MDF_CONVERSIONS[4 if mdf.version >= "4" else 3]
        names = wanted or [n for n in mdf.channels_db if n != axis]  # without any wanted channel: time alone
        total = 0
        for name in names:
            places = [p for p in mdf.channels_db.get(name, ()) if tuple(p) not in masters]
            if not places:
                if not wanted:
                    continue
                return None, [n for n in list(mdf.channels_db)[:1000] if isinstance(n, str)], name
            if resample == OWN:
                places = places[:1]  # for a repeated name, the first group
            if len(places) > 1:
                raise Refused(
                    f"holds channel {name!r} {len(places)} times, in groups {[p[0] for p in places][:20]}"
                )
            group, index = places[0]
            conversions = (
                mdf.groups[group].channels[i].conversion for i in {index, mdf.masters_db.get(group, index)}
            )
            if any(c is not None and c.conversion_type not in allowed for c in conversions):
                if resample == OWN and not wanted:
                    continue
                raise Refused(f"channel {name!r} needs a formula or text conversion; export it as numbers")
            total += 16 * mdf.groups[group].channel_group.cycles_nr
            bearable(total, limit)
            item = mdf.get(group=group, index=index)
            if item.samples.ndim == 1 and item.samples.dtype.kind in "fiub" and len(item.samples):
                found[name] = (np.array(item.timestamps, float), np.array(item.samples, float))
                units[name] = str(item.unit)[:200]
            elif wanted:
                raise Refused(f"channel {name!r} does not hold plain numbers")
    if not found:
        raise Refused("holds no numeric channel")
    if resample == OWN:
        return own_stamps(found), {n: u for n, u in units.items() if u}, []
    return joined(found, axis, resample), {n: u for n, u in units.items() if u}, []
