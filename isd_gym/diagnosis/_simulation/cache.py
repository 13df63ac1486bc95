"""What was simulated last, kept as long as there is room."""

from __future__ import annotations

from collections import OrderedDict
from threading import Lock
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..._common.arrays import Array


class SimulationCache:
    """What was simulated last, to be had again without simulating: no more than `limit` bytes of it."""

    def __init__(self, limit: int = 200_000_000):
        self.limit, self.size = limit, 0
        self._kept: OrderedDict[tuple[object, ...], tuple[object, tuple[Array, ...]]] = OrderedDict()
        self._lock = Lock()

    def get(self, key: tuple[object, ...]) -> tuple[Array, ...] | None:
        with self._lock:
            found = self._kept.get(key)
            if found is not None:
                self._kept.move_to_end(key)
            return found[1] if found else None

    def made(
        self, key: tuple[object, ...], of: object, make: Callable[[], tuple[Array, ...]]
    ) -> tuple[Array, ...]:
        """Return the values of a key, made and stored if they are not there."""
        known = self.get(key)
        if known is None:
            known = make()
            self.put(key, of, known)
        return known

    def put(self, key: tuple[object, ...], of: object, values: tuple[Array, ...]) -> None:
        """Store values. `of` is the object whose identity is part of the key; the cache keeps `of` alive."""
        with self._lock:
            if key not in self._kept:
                self._kept[key] = of, values
                self.size += sum(v.nbytes for v in values)
            while self.size > self.limit and len(self._kept) > 1:
                _, (_, gone) = self._kept.popitem(last=False)
                self.size -= sum(v.nbytes for v in gone)
