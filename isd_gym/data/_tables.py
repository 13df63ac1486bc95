"""Reader of MATLAB, Parquet and MDF tables in a separate process, where a fault or a bomb is only an error.

`isolated` starts this text with ``python -c``; the text imports nothing from the package. A request is a line
of JSON on standard input. The answer is a line of JSON on standard output, followed by the columns as
float64. The libraries for these formats are written in C: a broken file can crash a library, and a small file
can unpack to more than the memory.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import zlib

HERE = 1 << 20  # bytes unpacked at a time


class Refused(Exception):
    """Error with one line for the user."""


class TooLarge(Exception):
    """Error with the memory that a file would need [bytes]."""


def bearable(size, limit):
    """Raise `TooLarge` for a size [bytes] above the limit [bytes]."""
    if size > limit:
        raise TooLarge(int(size))


# ------------------------------------------------------------------------------------------------ Parquet


def read_parquet(path, wanted, axis, resample, limit):
    """Return the numeric columns, their units and the names of other columns of a Parquet file."""
    import pyarrow
    import pyarrow.parquet as parquet

    file = parquet.ParquetFile(path, memory_map=False, pre_buffer=False)
    types = pyarrow.types
    numeric: list[str] = []
    other: list[str] = []
    units = {}
    for item in file.schema_arrow:
        unit = (item.metadata or {}).get(b"unit", b"").decode("utf-8", "replace")
        kind = item.type
        plain = types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)
        (numeric if plain else other).append(item.name)
        if unit:
            units[item.name] = unit
    rows = file.metadata.num_rows
    bearable(8 * rows * (len(numeric) + 1), limit)
    columns = []
    for name in numeric:  # one column at a time, to bound the memory
        table = file.read(columns=[name], use_threads=False)
        if table.num_columns != 1 or table.column_names[0] != name:
            raise Refused(f"column {name!r} is there more than once")
        columns.append((name, table.column(0).to_numpy()))
    return columns, units, other


# ------------------------------------------------------------------------------------------------- MATLAB


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


def read_mat(path, wanted, axis, resample, limit):
    """Return the numeric vectors, their units and the names of other variables of a MATLAB file."""
    import numpy as np
    from scipy.io import loadmat

    try:
        bearable(mat_size(path, limit), limit)
    except zlib.error:
        raise Refused("is not a MATLAB file that can be read (a packed part is broken)") from None
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
            if value.dtype.names and value.ndim == 0 and depth < 8:  # a struct: the fields are channels
                fields = {n: value[n].item() for n in value.dtype.names}
                if name == "units":
                    units.update({n: str(u)[:200] for n, u in fields.items()})
                else:
                    take(fields.items(), depth + 1)
            elif value.dtype.kind in "fiub" and value.ndim == 1 and name not in columns:
                columns[name] = value
            elif value.dtype.kind in "fiub" and value.ndim == 1:
                raise Refused(f"holds {name!r} more than once")
            elif value.dtype.kind in "fiub" and value.ndim == 0:  # a constant or a setting, whatever its name
                other.append(name)
            elif name == axis or (wanted is not None and name in wanted):
                raise Refused(f"{name!r} is not a plain vector of numbers (cells and objects are refused)")
            else:
                other.append(name)

    take((k, v) for k, v in content.items() if not k.startswith("__"))
    if wanted is None:  # constants and settings may accompany the channels
        lengths = [len(v) for v in columns.values()]
        common = len(columns[axis]) if axis in columns else max(lengths, key=lengths.count, default=0)
        columns = {n: v for n, v in columns.items() if len(v) == common}
    return list(columns.items()), units, other


# --------------------------------------------------------------------------------------------------- MDF

#: arithmetic and tabular conversions; formulas in a file are not evaluated
MDF_CONVERSIONS = {4: {0, 1, 2, 4, 5}, 3: {0, 1, 2, 6, 7, 8, 9, 65535}}


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


def read_mdf(path, wanted, axis, resample, limit):
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
    return [(axis, base), *columns], {n: u for n, u in units.items() if u}, []


READERS = {"parquet": read_parquet, "mat": read_mat, "mdf": read_mdf}
LIBRARIES = {"parquet": ["pyarrow", "pyarrow.parquet"], "mat": ["scipy.io"], "mdf": ["asammdf"]}


# ----------------------------------------------------------------------------------------------- limits


def restrain(memory, seconds):
    """Limit the memory [bytes] and processor time [s] that this process may still use, where the system can."""
    try:
        import resource
    except ImportError:
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    soft = int(used.ru_utime + used.ru_stime) + int(seconds) + 1
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    if hard == resource.RLIM_INFINITY or soft < hard:
        resource.setrlimit(resource.RLIMIT_CPU, (soft, hard))
    try:
        with open("/proc/self/statm") as stream:
            size = int(stream.read().split()[0]) * resource.getpagesize()
    except OSError:  # only Linux reports the size this way; elsewhere the sizes in the file must suffice
        return
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    wanted = int(size + memory)
    if hard == resource.RLIM_INFINITY or wanted < hard:
        resource.setrlimit(resource.RLIMIT_AS, (wanted, hard))


def peak():
    """Return the peak memory [bytes] of this program; 0 if unknown."""
    try:  # ru_maxrss also counts the process that started this program
        with open("/proc/self/status") as status:
            return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmHWM:"))
    except (OSError, StopIteration):
        pass
    try:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    except ImportError:
        return 0


def answer(request):
    """Return the header and the arrays that answer a request."""
    import warnings

    import numpy as np

    kind, limit = request["kind"], request["limit"]
    try:
        for library in LIBRARIES[kind]:
            __import__(library)
    except ImportError as error:
        return {"lacks": error.name or str(error)}, []
    restrain(2 * limit + (256 << 20), request["seconds"])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            columns, units, other = READERS[kind](
                request["path"], request["wanted"], request["axis"], request["resample"], limit
            )
            if columns is None:
                return {"no_channel": other, "names": units}, []
            out, total = [], 0
            for name, values in columns:
                values = np.asarray(values)
                if values.dtype.kind not in "fiub" or values.ndim != 1:
                    other.append(name)
                    continue
                total += 8 * len(values)
                bearable(total, limit)
                out.append((name, np.ascontiguousarray(values, np.float64)))
        head = {"columns": [[n, len(v)] for n, v in out], "units": units, "other": other[:10_000]}
        return head, [v for _, v in out]
    except Refused as error:
        return {"refused": str(error)}, []
    except TooLarge as error:
        return {"too_large": error.args[0]}, []
    except MemoryError:
        return {"too_large": 2 * limit}, []
    except Exception as error:  # the formats' own libraries raise anything on a damaged file
        text = (str(error).strip().splitlines() or [type(error).__name__])[0]
        if isinstance(error, OSError) and "memory" in text.lower():
            return {"too_large": 2 * limit}, []
        return {"refused": f"cannot be read ({text[:160]})"}, []


def main():
    """Answer requests until standard input ends."""
    out = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_RDWR)
    os.dup2(nowhere, 1)  # messages of the libraries are discarded
    os.dup2(nowhere, 2)
    for line in sys.stdin.buffer:
        head, arrays = answer(json.loads(line))
        last = peak() > 1 << 30  # memory that a library keeps
        out.write(json.dumps(head | {"last": last}).encode() + b"\n")
        for values in arrays:
            out.write(values.tobytes())
        out.flush()
        if last:
            break


main()
