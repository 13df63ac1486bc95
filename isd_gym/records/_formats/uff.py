"""Time series of universal files (data set 58, ASCII or binary), read with pyuff."""

from __future__ import annotations

import os

from . import Refused, bearable
from .rasters import OWN, joined, own_stamps

LIBRARIES = ("pyuff",)
EXTRA = "files"
#: texts that stand for nothing
EMPTY = ("", "NONE", "NA")
DIRECTIONS = {0: "", 1: "+X", -1: "-X", 2: "+Y", -2: "-Y", 3: "+Z", -3: "-Z", 4: "+RX", -4: "-RX", 5: "+RY"}
DIRECTIONS |= {-5: "-RY", 6: "+RZ", -6: "-RZ"}


def read(path, wanted, axis, resample, limit):
    """Return the time series, their units and the number of other functions of a universal file.

    A channel has the name in the first line of its header. Where that is empty or repeated, the name is the node with the direction.
    """
    import numpy as np
    import pyuff

    bearable(8 * os.path.getsize(path), limit)
    file = pyuff.UFF(path)
    kinds = list(file.get_set_types())
    sets = [file.read_sets(int(k)) for k, kind in enumerate(kinds) if int(kind) == 58]
    series = [s for s in sets if s["func_type"] == 1 and np.isrealobj(s["data"]) and len(s["data"]) > 0]
    if not series:
        raise Refused("holds no time series (data set 58, function type 1)")
    bearable(16 * sum(len(s["data"]) for s in series), limit)
    titles = [str(s["id1"]).strip() for s in series]
    found, units = {}, {}
    for title, s in zip(titles, series, strict=True):
        name = title
        if title.upper() in EMPTY or titles.count(title) > 1:
            place = str(s.get("rsp_ent_name", "")).strip()
            place = "node" if place.upper() in EMPTY else place
            name = f"{place} {s['rsp_node']} {DIRECTIONS.get(int(s['rsp_dir']), '')}".strip()
        first, count = name, 1
        while name in found:
            count += 1
            name = f"{first} ({count})"
        found[name] = (np.array(s["x"], float), np.array(s["data"], float))
        unit = str(s.get("ordinate_axis_units_lab", "")).strip()
        if unit.upper() not in EMPTY:
            units[name] = unit[:200]
    for name in wanted or ():
        if name not in found:
            return None, list(found)[:1000], name
    if resample == OWN:
        return own_stamps(found), units, []
    return joined({n: found[n] for n in wanted} if wanted else found, axis, resample), units, []
