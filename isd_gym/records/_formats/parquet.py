"""Parquet tables, read with pyarrow."""

from __future__ import annotations

from . import Refused, bearable

LIBRARIES = ("pyarrow", "pyarrow.parquet")
EXTRA = "io"


def read(path, wanted, axis, limit):
    """Return the numeric columns, their units and the names of other columns of a Parquet file."""
    import pyarrow
    import pyarrow.parquet as parquet

    file = parquet.ParquetFile(path, memory_map=False, pre_buffer=False)
    types = pyarrow.types
    numeric: list[str] = []
    other: list[str] = []
    units = {}
    for item in file.schema_arrow:
        unit = (item.metadata or {}).get(b"unit", b"").decode("utf-8", "replace")
        kind = item.type
        plain = (
            types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)
        )
        (numeric if plain else other).append(item.name)
        if unit:
            units[item.name] = unit
    rows = file.metadata.num_rows
    bearable(8 * rows * (len(numeric) + 1), limit)
    columns = []
    for name in numeric:  # one column at a time, to bound the memory
        table = file.read(columns=[name], use_threads=False)
        if table.num_columns != 1 or table.column_names[0] != name:
            raise Refused(f"column {name!r} is there more than once")
        columns.append((name, table.column(0).to_numpy()))
    return columns, units, other
