"""TDMS files of LabVIEW and DIAdem, read with npTDMS."""

from __future__ import annotations

from . import Refused, bearable
from .rasters import own_stamps

LIBRARIES = ("nptdms",)
EXTRA = "files"


def read(path, wanted, axis, limit):
    """Return all numeric channels of a TDMS file on their own stamps, and their units.

    A channel with waveform properties has time stamps of its own. Groups of channels without them are plain tables, whose column of
    time is one of the channels. Channels of one name in several groups are called "group/name".
    """
    from nptdms import TdmsFile

    with open(path, "rb") as stream:
        if stream.read(4) != b"TDSm":
            raise Refused("is not a TDMS file")
    with TdmsFile.open(path) as file:
        channels = [c for g in file.groups() for c in g.channels()]
        plain = [c.name for c in channels]
        numeric = []
        for c in channels:
            if c.dtype.kind in "fiub" and len(c) > 0:
                name = (
                    c.name if plain.count(c.name) == 1 else f"{c.group_name}/{c.name}"
                )
                numeric.append((name, c))
        bearable(sum(16 * len(c) for _, c in numeric), limit)
        if not numeric:
            raise Refused("holds no numeric channel")
        units = {n: str(c.properties.get("unit_string", ""))[:200] for n, c in numeric}
        if all("wf_increment" in c.properties for _, c in numeric):
            columns = own_stamps({n: (_stamps(c, numeric), c[:]) for n, c in numeric})
        else:
            groups = list(dict.fromkeys(c.group_name for _, c in numeric))
            columns = [(f"{groups.index(c.group_name)} {n}", c[:]) for n, c in numeric]
    return columns, {n: u for n, u in units.items() if u}, []


def _stamps(channel, every):
    """Return the stamps of a channel [s], from the earliest start of all channels."""
    import numpy as np

    starts = [c.properties.get("wf_start_time") for _, c in every]
    own = channel.properties.get("wf_start_time")
    late = 0.0
    if own is not None and all(s is not None for s in starts):
        late = (
            (np.datetime64(own) - min(np.datetime64(s) for s in starts))
            / np.timedelta64(1, "us")
            * 1e-6
        )
    return channel.time_track() + late
