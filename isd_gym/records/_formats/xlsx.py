"""Excel workbooks, read with openpyxl: the first sheet with numbers, as a text table."""

from __future__ import annotations

import datetime
import zipfile

from . import Refused, bearable

LIBRARIES = ("openpyxl",)
EXTRA = "files"
#: memory of a workbook that is read, and of its text, as multiples of the text
SHARE = 12


def read(path, wanted, axis, limit):
    """Return the first sheet that holds at least two rows with numbers, as a text with tabs. Stored results of formulas are read.

    No formula is computed, and links to other workbooks are not followed.
    """
    import openpyxl

    try:
        with zipfile.ZipFile(path) as archive:
            for item in archive.infolist():
                bearable(item.file_size, limit)
    except zipfile.BadZipFile:
        raise Refused("is not an Excel workbook (.xlsx)") from None
    book = openpyxl.load_workbook(
        path, read_only=True, data_only=True, keep_links=False
    )
    for sheet in book.worksheets:
        sheet.reset_dimensions()  # what a file states of its size may be wrong
        lines, size, rows = [], 0, 0
        for cells in sheet.iter_rows(values_only=True):
            rows += sum(_is_number(x) for x in cells) > 0
            line = "\t".join(map(_text, cells)).rstrip("\t")
            size += len(line)
            bearable(SHARE * size, limit)
            lines.append(line)
        if rows > 1:
            width = max(line.count("\t") for line in lines)
            return "\n".join(
                line + "\t" * (width - line.count("\t")) if line else ""
                for line in lines
            )
    raise Refused("holds no sheet with rows of numbers")


def _is_number(value):
    return isinstance(value, int | float) and not isinstance(value, bool)


def _text(value):
    """Return a cell as text: numbers exactly, times in ISO 8601."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, datetime.datetime | datetime.time):
        return value.isoformat()
    if isinstance(value, datetime.timedelta):
        return repr(value.total_seconds())
    if isinstance(value, int | float):
        return repr(value)
    return " ".join(str(value).replace('"', "'").split())
