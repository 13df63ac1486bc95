"""Programs in separate processes with JSON requests: a crash, an endless loop or a decompression bomb ends only the process.

The separation isolates faults, not malicious code: the process has the rights of its user.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from .arrays import Array

#: one thread each, since several processes may run in parallel
THREADS = {f"{k}_NUM_THREADS": "1" for k in ("OMP", "OPENBLAS", "MKL", "NUMEXPR")}


class Guarded:
    """A process that runs a program text until it is closed.

    The program reads a line of JSON and the accompanying numbers from standard input. It answers with a
    line of JSON and numbers on standard output. All numbers are float64.
    """

    def __init__(
        self, program: str, environment: Mapping[str, str] | None = None, folder: str | Path | None = None
    ) -> None:
        self.owner = os.getpid()
        path = {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", program],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **THREADS, **path, **(environment or {})},
                cwd=folder,
            )
        except OSError as error:
            raise InputError(f"no process of its own can be started ({error.strerror})") from None

    def ask(
        self,
        request: Mapping[str, Any],
        counts: Callable[[dict[str, Any]], list[int]],
        patience: float,
        numbers: Array | None = None,
    ) -> tuple[dict[str, Any], list[Array]] | None:
        """Return the answer to a request, whose arrays have `counts` numbers; None if the process died or
        took longer than `patience` [s]."""
        asked, told = self.process.stdin, self.process.stdout
        assert asked is not None and told is not None
        watch = threading.Timer(patience, self.process.kill)
        watch.daemon = True
        watch.start()
        try:
            asked.write(json.dumps(request).encode() + b"\n")
            if numbers is not None:
                asked.write(np.ascontiguousarray(numbers, dtype=np.float64).tobytes())
            asked.flush()
            line = told.readline()
            if not line:
                return None
            head, arrays = json.loads(line), []
            for count in counts(head):
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
