"""Measurements, and the files that hold measurements.

- `data`: tables and their files; `_formats` reads binary ones in a process of their own.
- `loggers`: files of several loggers, and which column is which channel.
- `schemas`: JSON schemas of the files that the package writes.
"""

from .._common.lazy import lazy

__getattr__, __dir__ = lazy(__name__, {})
