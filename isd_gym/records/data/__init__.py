"""Records: tables of measured channels, their quality, and tools for sampled signals.

`table` reads and writes tables. `columns` are the content of a text file (`text`) or of a binary file
(`isolated`, which runs `_tables` in a separate process). `quality` is the data gate. `signals` estimates
noise and derivatives, and compares channels of the same motion.
"""

from .quality import Finding, check
from .signals import Consistency, integral_consistency, noise_level, smooth_derivatives
from .table import Table, read_table, write_table

__all__ = [
    "Consistency",
    "Finding",
    "Table",
    "check",
    "integral_consistency",
    "noise_level",
    "read_table",
    "smooth_derivatives",
    "write_table",
]
