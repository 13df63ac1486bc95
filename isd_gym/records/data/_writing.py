"""Writers of binary tables: Parquet, MATLAB and MDF, with the units of the channels."""

from __future__ import annotations

import re
import warnings
from typing import TYPE_CHECKING

from ..._common.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from ._table import Table

TIME = "time"


def write_binary(table: Table, temporary: Path, path: Path) -> None:
    """Write a table to a temporary file in the format of the suffix of `path`, the file that it will be."""
    {".parquet": _parquet, ".mat": _mat, ".mf4": _mf4}[path.suffix.lower()](
        table, temporary, path
    )


def _parquet(table: Table, temporary: Path, path: Path) -> None:
    import pyarrow
    import pyarrow.parquet as parquet

    units = {TIME: "s"} | table.units
    fields = [
        pyarrow.field(n, pyarrow.float64(), metadata={"unit": units.get(n, "")})
        for n in (TIME, *table.columns)
    ]
    data = [table.time, *table.columns.values()]
    parquet.write_table(
        pyarrow.Table.from_arrays(data, schema=pyarrow.schema(fields)), temporary
    )


def _mat(table: Table, temporary: Path, path: Path) -> None:
    from scipy.io import savemat

    for name in table.columns:
        if not re.fullmatch(r"[A-Za-z]\w{0,62}", name) or name == "units":
            raise InputError(f"{path}: '{name}' is no name for a MATLAB variable")
    extra = {"units": table.units} if table.units else {}
    data = {TIME: table.time, **table.columns}
    savemat(temporary, data | extra, long_field_names=True, oned_as="column")


def _mf4(table: Table, temporary: Path, path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from asammdf import MDF, Signal

        with MDF(version="4.10") as mdf:
            mdf.append(
                [
                    Signal(v, table.time, name=n, unit=table.units.get(n, ""))
                    for n, v in table.columns.items()
                ]
            )
            mdf.save(temporary, overwrite=True)
