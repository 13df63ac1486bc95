"""Records: tables of measured channels, and their quality.

`table` reads and writes tables. `columns` are the content of a text file (`text`) or of a binary file
(`isolated`, which runs `isd_gym.records.formats` in a separate process). `quality` is the data gate.
"""

from .quality import Finding, check
from .table import Table, read_table, write_table

__all__ = [
    "Finding",
    "Table",
    "check",
    "read_table",
    "write_table",
]
