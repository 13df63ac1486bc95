"""Tables of figures on the terminal, of which no cell is folded or cut."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import islice
from typing import TYPE_CHECKING

from .console import printer

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    #: cells of each column by its heading
    Columns = Mapping[str, Sequence[str | Text]]


def print_columns(names: Columns, *parts: Columns) -> None:
    """Print columns in one table, or in several tables where the terminal is too narrow for one.

    A table ends between two parts where possible, and inside a part that is too wide for a table of its own.
    """
    from rich.measure import Measurement

    console = printer()
    unlimited = console.options.update(max_width=10_000)

    def width(columns: Columns) -> int:
        return Measurement.get(console, unlimited, _table(names, columns)).maximum

    left = [dict(part) for part in parts if part]
    while left:
        columns = left.pop(0)
        while left and width(columns | left[0]) <= console.width:
            columns |= left.pop(0)
        kept = len(columns)
        while kept > 1 and width(dict(islice(columns.items(), kept))) > console.width:
            kept -= 1
        if kept < len(columns):
            left.insert(0, dict(islice(columns.items(), kept, None)))
            columns = dict(islice(columns.items(), kept))
        console.print(
            _table(names, columns), width=max(console.width, width(columns)), crop=False
        )


def _table(names: Columns, columns: Columns) -> Table:
    """Return a table of the columns, names on the left."""
    from rich import box
    from rich.table import Table

    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in (*names, *columns):
        made.add_column(
            head, justify="left" if head in names else "right", no_wrap=True
        )
    for row in zip(*names.values(), *columns.values(), strict=True):
        made.add_row(*row)
    return made
