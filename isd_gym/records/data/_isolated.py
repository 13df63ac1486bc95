"""Binary tables, read by `isd_gym.records._formats` in a separate process.

One helper process serves all files, so that libraries are loaded once; the helper ends with this process. A
crash, an endless loop or a decompression bomb ends the helper alone and gives a one-line error.
"""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
import threading
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..._common.errors import InputError, how_to_install
from ..._common.inputs import memory_limit, plain_file, too_large

SECONDS, SECONDS_PER_MB = 5.0, 1.0  # processor time per file [s]
PATIENCE = 20.0  # multiple of the processor time, in wall-clock time: a busy machine is no endless loop

#: program of the helper; the package may lie in a folder that is no entry of the path
PROGRAM = f"""
import sys
sys.path.append({str(Path(__file__).parents[3])!r})
from isd_gym.records._formats.host import main
main()
"""
#: one thread; pyarrow must not reserve memory; HDF5 must not load plugins; XML is read by the standard library
ENVIRONMENT = {
    **{f"{k}_NUM_THREADS": "1" for k in ("OMP", "OPENBLAS", "MKL", "NUMEXPR")},
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "HDF5_PLUGIN_PRELOAD": "::",
    "OPENPYXL_LXML": "False",
}


class Helper:
    """The process in which binary tables are read (`isd_gym.records._formats.host`)."""

    def __init__(self) -> None:
        self.owner = os.getpid()
        path = os.pathsep.join(p for p in sys.path if p)
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", PROGRAM],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **ENVIRONMENT, "PYTHONPATH": path},
            )
        except OSError as error:
            raise InputError(
                f"no process of its own can be started ({error.strerror})"
            ) from None

    def ask(
        self, request: dict[str, Any], patience: float
    ) -> tuple[dict[str, Any], list[np.ndarray]] | None:
        """Return header and columns of a table; None if the process died or took longer than `patience` [s]."""
        asked = self.process.stdin
        told = self.process.stdout
        assert asked is not None and told is not None
        watch = threading.Timer(patience, self.process.kill)
        watch.daemon = True
        watch.start()
        try:
            asked.write(json.dumps(request).encode() + b"\n")
            asked.flush()
            line = told.readline()
            if not line:
                return None
            head, arrays = json.loads(line), []
            for _, count in head.get("columns", ()):
                data = told.read(8 * count)
                if len(data) < 8 * count:
                    return None
                arrays.append(np.frombuffer(data))
            return head, arrays
        except (OSError, ValueError):
            return None
        finally:
            watch.cancel()

    def close(self) -> None:
        """End the process; a forked process only drops its handle, since the process belongs to the parent."""
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with suppress(OSError):  # the process ended first
                    pipe.close()
        if self.owner == os.getpid():
            self.process.kill()
            self.process.wait()
        else:
            self.process.returncode = 0  # the parent waits for the process


_helper: Helper | None = None
_lock = threading.Lock()


def _forget() -> None:
    """Drop the helper in a forked process; the helper belongs to the parent."""
    global _lock
    _lock = threading.Lock()
    _stop()


def _stop() -> None:
    global _helper
    if _helper is not None:
        _helper.close()
        _helper = None


atexit.register(_stop)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)


def read(
    reader: str, path: Path, wanted: list[str] | None = None, axis: str = "time"
) -> tuple[dict[str, Any], list[np.ndarray]]:
    """Return the header of a binary table, and its wanted columns (n,) in the order of the header.

    `reader` is the module of the reader, `axis` the time column. A workbook has its `text` in the header, and no columns.
    """
    global _helper
    module = import_module(reader)
    # this process treats the library as not installed
    if sys.modules.get(module.LIBRARIES[0], 0) is None:
        raise InputError(
            f"{path}: reading {path.suffix} needs {module.LIBRARIES[0]}: {how_to_install(module.EXTRA)}"
        )
    size = plain_file(path) / 2**20
    seconds = SECONDS + SECONDS_PER_MB * size
    limit = memory_limit()
    request = {
        "reader": reader,
        "path": os.path.abspath(path),
        "wanted": wanted,
        "axis": axis,
        "limit": limit,
        "seconds": seconds,
    }
    with _lock:
        if _helper is None:
            _helper = Helper()
        found = _helper.ask(request, PATIENCE * seconds)
        if found is None or found[0]["last"]:
            _stop()
    if found is None:
        raise InputError(
            f"{path}: cannot be read (the library that reads it crashed, or took more than {seconds:.0f} s)"
        )
    head, arrays = found
    if "lacks" in head:
        raise InputError(
            f"{path}: reading {path.suffix} needs {head['lacks']}: {how_to_install(module.EXTRA)}"
        )
    if "refused" in head:
        raise InputError(f"{path}: {head['refused']}")
    if "too_large" in head:
        raise too_large(str(path), head["too_large"], limit)
    return head, arrays
