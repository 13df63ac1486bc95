"""Foreign binary tables, read in a process of their own: see `_tables`, which runs there.

One helper process serves all files of this one, so that libraries are loaded once; it ends with it. A fault, an endless loop or a
bomb in a file ends the helper alone, and is one line here.
"""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
import threading
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..inputs import memory_limit, plain_file, too_large

SECONDS, SECONDS_PER_MB = 5.0, 1.0  # processor time for a file
PATIENCE = 20.0  # times that, by the clock: a busy machine is no endless loop


class _Helper:
    """The process and its pipes."""

    def __init__(self) -> None:
        self.owner = os.getpid()
        program = (resources.files("isd_gym.data") / "_tables.py").read_text(encoding="utf-8")
        threads = {f"{k}_NUM_THREADS": "1" for k in ("OMP", "OPENBLAS", "MKL", "NUMEXPR")}
        env = {
            **os.environ,
            **threads,
            "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
            "ARROW_DEFAULT_MEMORY_POOL": "system",
        }
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", program],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=env,
            )
        except OSError as error:
            raise InputError(f"no process can be started to read the file in ({error.strerror})") from None

    def ask(self, request: dict[str, Any], patience: float) -> tuple[dict[str, Any], list[np.ndarray]] | None:
        """The answer; None where the process went down on it or was stopped after `patience` seconds."""
        asked, told = self.process.stdin, self.process.stdout
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
            head = json.loads(line)
            arrays = []
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
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with suppress(OSError):  # it went first
                    pipe.close()
        if self.owner == os.getpid():
            self.process.kill()
            self.process.wait()


_helper: _Helper | None = None
_lock = threading.Lock()


def _forget() -> None:
    """In a forked process: the helper is the parent's."""
    global _helper, _lock
    _lock = threading.Lock()
    if _helper is not None:
        _helper.process.returncode = 0  # not ours to wait for
        _helper.close()
        _helper = None


def _stop() -> None:
    global _helper
    if _helper is not None:
        _helper.close()
        _helper = None


atexit.register(_stop)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)


def read(
    kind: str, path: Path, wanted: list[str] | None, axis: str, resample: bool | str
) -> tuple[dict[str, Any], list[np.ndarray]]:
    """What `_tables` answers for the file: its header and the columns. Raises `InputError`."""
    global _helper
    size = plain_file(path) / 2**20
    seconds, limit = SECONDS + SECONDS_PER_MB * size, memory_limit()
    request = {
        "kind": kind,
        "path": os.path.abspath(path),
        "wanted": wanted,
        "axis": axis,
        "resample": resample,
        "limit": limit,
        "seconds": seconds,
    }
    with _lock:
        if _helper is None:
            _helper = _Helper()
        found = _helper.ask(request, PATIENCE * seconds)
        if found is None or found[0]["last"]:
            _stop()
    if found is None:
        raise InputError(
            f"{path}: cannot be read (the library that reads it broke down, or took more than {seconds:.0f} s)"
        )
    head, arrays = found
    if "lacks" in head:
        raise InputError(f'{path}: reading {path.suffix} needs {head["lacks"]}: pip install "isd-gym[io]"')
    if "refused" in head:
        raise InputError(f"{path}: {head['refused']}")
    if "too_large" in head:
        raise too_large(str(path), head["too_large"], limit)
    return head, arrays
