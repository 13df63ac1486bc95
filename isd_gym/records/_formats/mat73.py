"""MATLAB files of version 7.3, which are HDF5 files, read with h5py."""

from __future__ import annotations

from . import Refused, bearable
from .mat import chosen

LIBRARIES = ("h5py",)
EXTRA = "files"


def read(path, wanted, axis, limit):
    """Return the numeric vectors, their units and the names of other variables of a MATLAB 7.3 file.

    Links to other files, data in other files and references are not followed.
    """
    import h5py
    import numpy as np

    columns, units, other = {}, {}, []
    total = 0

    def text(item):
        return (
            "".join(map(chr, np.asarray(item[()]).ravel())) if item.size < 1000 else ""
        )

    def take(group, depth=0):
        nonlocal total
        for name in group:
            link = group.get(name, getlink=True)
            if name.startswith("#") or not isinstance(link, h5py.HardLink):
                continue
            item = group[name]
            if isinstance(item, h5py.Group):
                if name == "units":
                    units.update(
                        {n: text(item[n])[:200] for n in item if _is_text(item[n])}
                    )
                elif depth < 8:
                    take(item, depth + 1)
                continue
            vector = (item.ndim == 2 and min(item.shape) == 1) or item.ndim == 1
            kind = item.attrs.get("MATLAB_class", b"")
            numeric = item.dtype.kind in "fiub" and kind not in (b"char", b"cell")
            if (
                not (numeric and vector)
                or item.size == 1
                or item.attrs.get("MATLAB_empty", 0)
            ):
                if name == axis or (wanted is not None and name in wanted):
                    raise Refused(
                        f"{name!r} is not a plain vector of numbers (cells and objects are refused)"
                    )
                other.append(name)
                continue
            if item.external or item.is_virtual:
                raise Refused(f"{name!r} lies in another file")
            if name in columns:
                raise Refused(f"holds {name!r} more than once")
            total += 8 * item.size
            bearable(total, limit)
            columns[name] = np.asarray(item[()]).ravel()

    def _is_text(item):
        return (
            isinstance(item, h5py.Dataset)
            and item.attrs.get("MATLAB_class", b"") == b"char"
        )

    with h5py.File(path, "r") as file:
        take(file)
    return chosen(columns, axis, wanted), units, other
