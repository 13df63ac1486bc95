"""The process in which tables are read: requests and answers.

A request is a line of JSON on standard input. The answer is a line of JSON on standard output, followed by the columns as float64.
"""

from __future__ import annotations

import importlib
import json
import os
import sys

from . import Refused, TooLarge, bearable


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
            return next(
                int(line.split()[1]) * 1024
                for line in status
                if line.startswith("VmHWM:")
            )
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

    limit = request["limit"]
    reader = importlib.import_module(request["reader"])
    try:
        for library in reader.LIBRARIES:
            __import__(library)
    except ImportError as error:
        return {"lacks": error.name or str(error)}, []
    restrain(2 * limit + (256 << 20), request["seconds"])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = reader.read(
                request["path"], request["wanted"], request["axis"], limit
            )
            if isinstance(found, str):
                return {"text": found}, []
            columns, units, other = found
            out, total = [], 0
            for name, values in columns:
                values = np.asarray(values)
                if values.dtype.kind not in "fiub" or values.ndim != 1:
                    other.append(name)
                    continue
                total += 8 * len(values)
                bearable(total, limit)
                out.append((name, np.ascontiguousarray(values, np.float64)))
        head = {
            "columns": [[n, len(v)] for n, v in out],
            "units": units,
            "other": other[:10_000],
        }
        return head, [v for _, v in out]
    except Refused as error:
        return {"refused": str(error)}, []
    except TooLarge as error:
        return {"too_large": error.args[0]}, []
    except MemoryError:
        return {"too_large": 2 * limit}, []
    except (
        Exception
    ) as error:  # the formats' own libraries raise anything on a damaged file
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
