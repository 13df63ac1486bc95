"""Readers of binary tables, one module per format. They run in a separate process (`host`).

The libraries for these formats are large or written in C: a broken file can crash a library, and a small file can unpack to more than
the memory. Each module has `LIBRARIES`, the names to import, `EXTRA`, the extra that installs them, and ``read(path, wanted, axis, limit)``. The function returns the
columns, their units and the names of other columns; or a text table.
"""

from __future__ import annotations


class Refused(Exception):
    """Error with one line for the user."""


class TooLarge(Exception):
    """Error with the memory that a file would need [bytes]."""


def bearable(size: float, limit: float) -> None:
    """Check that a file needs at most `limit` bytes of memory."""
    if size > limit:
        raise TooLarge(int(size))
