"""Measurements, and the files that hold measurements.

- `data`: tables and their files; `_formats` reads binary ones in a process of their own.
- `_loggers`: files of several loggers, and which column is which channel.
- `schemas`: JSON schemas of the files that the package writes.
"""

from __future__ import annotations

from .._common.lazy import lazy

TYPE_CHECKING = False  # typing's own import costs 10 ms
if TYPE_CHECKING:
    from ._loggers.start import state_of as state_of

#: public name -> its module
_HOME = {
    "state_of": "_loggers.start",
}
__all__ = [*_HOME]
__getattr__, __dir__ = lazy(__name__, _HOME)
