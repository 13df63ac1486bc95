"""TDMS files of LabVIEW and DIAdem, read with npTDMS."""

from __future__ import annotations

from . import Refused, bearable
from .rasters import OWN, joined, own_stamps

LIBRARIES = ("nptdms",)
EXTRA = "files"


def read(path, wanted, axis, resample, limit):
    """Return the numeric channels, their units and the names of other channels of a TDMS file.

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
        names = [c.name if plain.count(c.name) == 1 else f"{c.group_name}/{c.name}" for c in channels]
        if wanted:
            for name in wanted:
                if name not in names:
                    return None, names[:1000], name
        numeric = [
            (n, c) for n, c in zip(names, channels, strict=True) if c.dtype.kind in "fiub" and len(c) > 0
        ]
        other = [n for n in names if n not in {m for m, _ in numeric}]
        timed = all("wf_increment" in c.properties for _, c in numeric)
        if wanted and timed:
            for name in wanted:
                if name in other:
                    raise Refused(f"channel {name!r} does not hold plain numbers")
            numeric = [(n, c) for n, c in numeric if n in wanted]
        bearable(sum(16 * len(c) for _, c in numeric), limit)
        if not numeric:
            raise Refused("holds no numeric channel")
        units = {n: str(c.properties.get("unit_string", ""))[:200] for n, c in numeric}
        units = {n: u for n, u in units.items() if u}
        if not timed:
            return _table([(n, c.group_name, c[:]) for n, c in numeric], resample), units, other
        found = {n: (_stamps(c, numeric), c[:]) for n, c in numeric}
    if resample == OWN:
        return own_stamps(found), units, []
    return joined(found, axis, resample), units, []


def _stamps(channel, every):
    """Return the stamps of a channel [s], from the earliest start of all channels."""
    import numpy as np

    starts = [c.properties.get("wf_start_time") for _, c in every]
    own, late = channel.properties.get("wf_start_time"), 0.0
    if own is not None and all(s is not None for s in starts):
        late = (np.datetime64(own) - min(np.datetime64(s) for s in starts)) / np.timedelta64(1, "us") * 1e-6
    return channel.time_track() + late


def _table(columns, resample):
    """Return the columns of groups without waveform properties; each group is a raster if rasters are asked for."""
    if resample != OWN:
        return [(name, values) for name, _, values in columns]
    groups = list(dict.fromkeys(group for _, group, _ in columns))
    return [(f"{groups.index(group)} {name}", values) for name, group, values in columns]
