"""MATLAB files of the versions 4 to 7, read with scipy."""

from __future__ import annotations

import os
import struct
import zlib

from . import Refused, bearable

LIBRARIES = ("scipy.io",)
EXTRA = "io"
HERE = 1 << 20  # bytes unpacked at a time


def mat_size(path, limit):
    """Return the unpacked size [bytes] of the variables of a MATLAB 5 file, counted without storing the variables."""
    with open(path, "rb") as stream:
        head = stream.read(128)
        if len(head) < 128 or head[126:128] not in (b"IM", b"MI"):
            return os.path.getsize(path)  # version 4 has no packed parts
        order = "<" if head[126:128] == b"IM" else ">"
        total = 0
        while len(tag := stream.read(8)) == 8:
            kind, size = struct.unpack(order + "II", tag)
            if kind != 15:
                total += size
                stream.seek(size, os.SEEK_CUR)
                continue
            unpack, left = zlib.decompressobj(), size
            while left > 0 and not unpack.eof:
                data = stream.read(min(left, HERE))
                if not data:
                    break
                left -= len(data)
                while data and not unpack.eof:
                    total += len(unpack.decompress(data, HERE))
                    data = unpack.unconsumed_tail
                    bearable(total, limit)
            stream.seek(left, os.SEEK_CUR)
        return total


def read(path, wanted, axis, limit):
    """Return the numeric vectors, their units and the names of other variables of a MATLAB file."""
    import numpy as np
    from scipy.io import loadmat

    try:
        bearable(mat_size(path, limit), limit)
    except zlib.error:
        raise Refused(
            "is not a MATLAB file that can be read (a packed part is broken)"
        ) from None
    try:
        content = loadmat(path, squeeze_me=True, chars_as_strings=True)
    except NotImplementedError:
        raise Refused(
            f"is a MATLAB 7.3 file; save it with save({os.path.basename(path)!r}, ..., '-v7')"
        ) from None
    columns, units, other = {}, {}, []

    def take(items, depth=0):
        for name, value in items:
            value = np.asarray(value)
            # a struct: the fields are channels
            if value.dtype.names and value.ndim == 0 and depth < 8:
                fields = {n: value[n].item() for n in value.dtype.names}
                if name == "units":
                    units.update({n: str(u)[:200] for n, u in fields.items()})
                else:
                    take(fields.items(), depth + 1)
            elif value.dtype.kind in "fiub" and value.ndim == 1 and name not in columns:
                columns[name] = value
            elif value.dtype.kind in "fiub" and value.ndim == 1:
                raise Refused(f"holds {name!r} more than once")
            elif (
                value.dtype.kind in "fiub" and value.ndim == 0
            ):  # a constant or a setting, whatever its name
                other.append(name)
            elif name == axis or (wanted is not None and name in wanted):
                raise Refused(
                    f"{name!r} is not a plain vector of numbers (cells and objects are refused)"
                )
            else:
                other.append(name)

    take((k, v) for k, v in content.items() if not k.startswith("__"))
    return chosen(columns, axis, wanted), units, other


def chosen(columns, axis, wanted):
    """Return the vectors of a file by name; if all are asked for, those with as many samples as the time.

    Constants and settings may accompany the channels.
    """
    if wanted is None:
        lengths = [len(v) for v in columns.values()]
        common = (
            len(columns[axis])
            if axis in columns
            else max(lengths, key=lengths.count, default=0)
        )
        columns = {n: v for n, v in columns.items() if len(v) == common}
    return list(columns.items())
