"""Records: tables of measured channels, and their quality.

`_table` reads and writes tables. `_columns` are the content of a text file (`_text`) or of a binary file
(`_isolated`, which runs `isd_gym.records._formats` in a separate process). `_quality` is the data gate.
"""

from ..._common.units import convert
from ._quality import Finding, check
from ._table import Format, Table, read_table, write_table

__all__ = [
    "Finding",
    "Format",
    "Table",
    "check",
    "convert",
    "read_table",
    "write_table",
]
