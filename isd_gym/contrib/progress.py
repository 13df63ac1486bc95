"""Output that several wings share: progress of counted items, work that goes on where it stopped, width of the terminal."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from isd_gym._commands.console import SELDOM

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@contextmanager
def counted(what: str) -> Iterator[Callable[[int, int], None]]:
    """Give a function that updates a counting bar on stderr; without a terminal, a line is printed now and then.

    Args:
        what: Counted things, such as 'cases'.

    Yields:
        ``update(done, all)``.
    """
    import time

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    begun = told = time.monotonic()
    if not sys.stderr.isatty():

        def line(done: int, every: int) -> None:
            nonlocal told
            if time.monotonic() - told > SELDOM and done < every:
                told = time.monotonic()
                typer.echo(f"{told - begun:.0f} s: {done} of {every} {what}", err=True)

        yield line
        return
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, every: bar.update(task, completed=done, total=every)


@contextmanager
def resumable() -> Iterator[None]:
    """Tell the user on Ctrl-C how to continue work that is stored item by item.

    Yields:
        Nothing.
    """
    try:
        yield
    except KeyboardInterrupt:
        typer.echo("what is done is kept: the same line goes on", err=True)
        raise


def terminal_columns() -> int:
    """Return the width of the terminal in characters; 80 where stdout is none."""
    import shutil

    return shutil.get_terminal_size((80, 24)).columns if sys.stdout.isatty() else 80
