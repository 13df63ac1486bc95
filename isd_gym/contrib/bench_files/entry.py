"""Formats that `isd_gym.records.data._table` finds by their suffixes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from isd_gym.records.data import _isolated as isolated
from isd_gym.records.data._columns import TIME
from isd_gym.records.data._table import Format, binary_format
from isd_gym.records.data._text import read_text, read_text_rasters

from .lvm import read_lvm, read_lvm_rasters

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from isd_gym.records.data._columns import Choice, Columns


def _sheet(path: Path) -> str:
    """Return the text of the first sheet with numbers of a workbook."""
    return str(isolated.read(f"{__package__}.xlsx", path, None, TIME, False)[0]["text"])


def _read_workbook(
    path: Path, wanted: Choice, axis: str, resample: bool, columns: Sequence[str] | None = None
) -> Columns:
    return read_text(path, wanted, axis, resample, columns, _sheet(path))


def _read_workbook_rasters(path: Path, columns: Sequence[str] | None = None) -> list[Columns]:
    return read_text_rasters(path, columns, _sheet(path))


lvm = Format(read_lvm, read_lvm_rasters, has_own_stamps=True)
tdms = binary_format(f"{__package__}.tdms", has_own_stamps=True)
uff = binary_format(f"{__package__}.uff", has_own_stamps=True)
xlsx = Format(_read_workbook, _read_workbook_rasters)
mat73 = binary_format(f"{__package__}.mat73")
