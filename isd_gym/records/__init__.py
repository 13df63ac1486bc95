"""Measurements, and the files that hold measurements.

- `data`: tables and their files; `_formats` reads binary ones in a process of their own.
- `_loggers`: files of several loggers, and which column is which channel.
- `schemas`: JSON schemas of the files that the package writes.
"""

from __future__ import annotations

TYPE_CHECKING = False  # typing's own import costs 10 ms
if TYPE_CHECKING:
    from typing import Any

    from ._loggers.start import state_of as state_of

#: public name -> its module
_HOME = {
    "state_of": "_loggers.start",
}
__all__ = [*_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    from importlib import import_module

    value = globals()[name] = getattr(import_module(f".{_HOME[name]}", __name__), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
