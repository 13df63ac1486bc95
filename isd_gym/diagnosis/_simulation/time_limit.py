"""Limit of the time of a diagnosis: every simulation looks at the clock, and a stage whose time is over ends."""

from __future__ import annotations

import time
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

from ..._common.jit import compile_seconds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: share of the limit at which each stage ends, if it is not finished
SEARCH, EVIDENCE, RESULT = 0.7, 0.94, 0.97


class TimeUp(Exception):
    """The time of a stage is over: its result is not complete and must not be used."""


class TimeLimit:
    """Limit of time [s] from now on, or from a `start` of the clock. The compilation of kernels, which a machine does once, does not
    count. The clock is that of the processor by default, for the same result on a busy machine."""

    def __init__(
        self,
        limit: float | None = None,
        clock: Callable[[], float] = time.process_time,
        start: float | None = None,
    ) -> None:
        self._limit, self._clock = limit, clock
        self._start = clock() if start is None else start
        self._compiled = compile_seconds()
        self.deadline: float | None = None
        #: parts of the work that were left out since the time was up, in words
        self.left_out: list[str] = []

    @property
    def seconds(self) -> float:
        """Time since the start, without the compilation of kernels [s]."""
        return self._clock() - self._start - (compile_seconds() - self._compiled)

    def leave_out(self, what: str) -> None:
        """Note a part of the work that is left out."""
        if what not in self.left_out:
            self.left_out.append(what)

    @contextmanager
    def until(self, share: float) -> Iterator[None]:
        """Let simulations within the block raise `TimeUp` after a share of the time; an earlier end of an outer block stays."""
        before = self.deadline
        if self._limit is not None:
            own = share * self._limit
            self.deadline = own if before is None else min(own, before)
        token = _RUNNING.set(self)
        try:
            yield
        finally:
            self.deadline = before
            _RUNNING.reset(token)


_RUNNING: ContextVar[TimeLimit | None] = ContextVar("time limit", default=None)


def check_time() -> None:
    """Raise `TimeUp` if the time of the running stage is over."""
    limit = _RUNNING.get()
    if (
        limit is not None
        and limit.deadline is not None
        and limit.seconds > limit.deadline
    ):
        raise TimeUp(f"{limit.deadline:g} s are over")


def running() -> TimeLimit | None:
    """Return the limit of the running stage, for `adopt` in a thread."""
    return _RUNNING.get()


def adopt(limit: TimeLimit | None) -> None:
    """Make a limit that of the running thread."""
    _RUNNING.set(limit)
