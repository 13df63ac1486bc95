"""Output of commands: progress on stderr, text on stdout, files that were asked for."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer

from .._common import files


def write_json(path: Path | None, data: dict[str, Any]) -> None:
    """Write the results of a command to the file of --json."""
    if path is not None:
        files.write_text(path, json.dumps(data, indent=1, allow_nan=False) + "\n")


def check_file(path: Path | None, *read: str | Path | None) -> None:
    """Check before long work that an output file can be written."""
    if path is not None:
        files.check_file(path, *read)


#: interval between lines of progress without a terminal [s]
SELDOM = 10.0
#: number of characters per line in a pipe or a file
PIPED = 80


def printer() -> Any:
    """Return a console on stdout with word wrap at the width of the terminal, or at `PIPED` characters."""
    from rich.console import Console

    return Console(
        width=None if sys.stdout.isatty() else PIPED, highlight=False, markup=False
    )


def tell(text: str) -> None:
    """Print a sentence on stdout with word wrap."""
    printer().print(text)


@contextmanager
def lines() -> Iterator[Callable[[str], None]]:
    """Give a function that prints lines of progress with the elapsed time on stderr.

    Without a terminal, the current line is printed now and then: after `SELDOM` seconds, and not more often.
    """
    import time

    from rich.console import Console

    if not sys.stderr.isatty():
        with _seldom() as say_seldom:
            yield say_seldom
        return
    console = Console(stderr=True)
    begun = time.monotonic()
    with console.status("starting") as status:

        def say(line: str) -> None:
            console.print(
                f"{time.monotonic() - begun:6.1f} s  {line}",
                style="dim",
                highlight=False,
                markup=False,
            )
            status.update("working")

        yield say


@contextmanager
def _seldom() -> Iterator[Callable[[str], None]]:
    """Give a function that receives lines of progress; a thread prints the latest one every `SELDOM` seconds."""
    import threading
    import time

    begun, ended = time.monotonic(), threading.Event()
    latest = ["starting"]

    def tell_now_and_then() -> None:
        while not ended.wait(SELDOM):
            try:
                print(
                    f"{time.monotonic() - begun:.0f} s: {latest[0].strip()}",
                    file=sys.stderr,
                    flush=True,
                )
            except (OSError, ValueError):  # closed meanwhile
                return

    def say(line: str) -> None:
        latest[0] = line

    thread = threading.Thread(target=tell_now_and_then, daemon=True)
    thread.start()
    try:
        yield say
    finally:
        ended.set()
        thread.join()


@contextmanager
def progress() -> Iterator[Callable[[str, float], None]]:
    """Give a function that updates a progress bar on stderr, one line per task, silent without a terminal."""
    if not sys.stderr.isatty():  # a disabled bar prints an empty line
        yield lambda name, share: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    bar = Progress(
        TextColumn("{task.description:<24}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    tasks: dict[str, Any] = {}

    def update(name: str, share: float) -> None:
        if name not in tasks:
            tasks[name] = bar.add_task(name, total=1.0)
        bar.update(tasks[name], completed=share)

    with bar:
        yield update


def warm_up(update: Callable[[str, float], None]) -> None:
    """Compile or load the kernel, with a line of progress."""
    import numpy as np

    from ..env import ISDSuspensionVectorEnv

    update("preparing the kernel", 0.0)
    env = ISDSuspensionVectorEnv(2)
    env.reset(seed=0)
    env.step(np.zeros((2, 1)))
    update("preparing the kernel", 1.0)


def print_names(rows: Mapping[str, str]) -> None:
    """Print names with their descriptions, wrapped to the width of the terminal."""
    from rich.table import Table

    made = Table.grid(padding=(0, 2))
    made.add_column(no_wrap=True)
    made.add_column()
    for name, text in rows.items():
        made.add_row(name, text)
    printer().print(made)


@contextmanager
def resumable() -> Iterator[None]:
    """Tell the user on Ctrl-C how to continue work that is stored item by item."""
    try:
        yield
    except KeyboardInterrupt:
        typer.echo("what is done is kept: the same line goes on", err=True)
        raise


def terminal_columns() -> int:
    """Return the width of the terminal in characters; 80 where stdout is none."""
    import shutil

    return shutil.get_terminal_size((80, 24)).columns if sys.stdout.isatty() else 80
