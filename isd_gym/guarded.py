"""Programs in processes of their own, asked by lines of JSON: a fault, an endless loop or a bomb ends them and nothing else.

That keeps faults apart, not intents: such a process has the rights of its user.
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

#: one thread each: several of them may run side by side
THREADS = {f"{k}_NUM_THREADS": "1" for k in ("OMP", "OPENBLAS", "MKL", "NUMEXPR")}


class Guarded:
    """A process that runs the text of a `program` until it is closed.

    It reads a line of JSON from its standard input, and the numbers that come with it; it answers with a line of JSON on
    its standard output and the numbers that belong to it, all of them float64. environment: variables of its own; folder:
    in which it runs. Raises `InputError` where none can be started.
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
        """The answer; None where the process went down on it or was stopped after `patience` [s].

        numbers: sent along. counts: how many numbers follow the answer, array by array.
        """
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
        """End it; in a forked process let go of it, since it is the parent's."""
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with suppress(OSError):  # it went first
                    pipe.close()
        if self.owner == os.getpid():
            self.process.kill()
            self.process.wait()
        else:
            self.process.returncode = 0  # not ours to wait for
