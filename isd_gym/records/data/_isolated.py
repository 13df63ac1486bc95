"""Binary tables, read by `isd_gym.records._formats` in a separate process.

One helper process serves all files, so that libraries are loaded once; the helper ends with this process. A
crash, an endless loop or a decompression bomb ends the helper alone and gives a one-line error.
"""

from __future__ import annotations

import atexit
import os
import sys
import threading
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..._common.errors import InputError, how_to_install
from ..._common.guarded import Guarded
from ..._common.inputs import memory_limit, plain_file, too_large

if TYPE_CHECKING:
    import numpy as np

SECONDS, SECONDS_PER_MB = 5.0, 1.0  # processor time per file [s]
PATIENCE = 20.0  # multiple of the processor time, in wall-clock time: a busy machine is no endless loop

#: program of the helper; the package may lie in a folder that is no entry of the path
PROGRAM = f"""
import sys
sys.path.append({str(Path(__file__).parents[3])!r})
from isd_gym.records._formats.host import main
main()
"""
#: pyarrow must not reserve memory; HDF5 must not load plugins; XML is read by the standard library
ENVIRONMENT = {
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "HDF5_PLUGIN_PRELOAD": "::",
    "OPENPYXL_LXML": "False",
}


def _counts(head: dict[str, Any]) -> list[int]:
    return [count for _, count in head.get("columns", ())]


_helper: Guarded | None = None
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
    if sys.modules.get(module.LIBRARIES[0], 0) is None:  # this process treats the library as not installed
        raise InputError(
            f"{path}: reading {path.suffix} needs {module.LIBRARIES[0]}: {how_to_install(module.EXTRA)}"
        )
    size = plain_file(path) / 2**20
    seconds, limit = SECONDS + SECONDS_PER_MB * size, memory_limit()
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
            _helper = Guarded(PROGRAM, ENVIRONMENT)
        found = _helper.ask(request, _counts, PATIENCE * seconds)
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
