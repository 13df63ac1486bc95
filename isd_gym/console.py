"""What commands share: progress on stderr, files that they are asked to write."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from . import files
from .errors import InputError, hint, shown

TrustOption = Annotated[
    bool,
    typer.Option(
        "--trust-zip", help="Open a .zip of Stable-Baselines3 as it is, without converting it first."
    ),
]

ColumnsOption = Annotated[
    str | None,
    typer.Option(
        "--columns",
        help="The columns of text files without a header row, in order, with or without units: 'time,force [kN],travel [mm]'.",
        metavar="NAME,NAME,...",
    ),
]


def column_names(text: str | None) -> list[str] | None:
    """Return the names that --columns gives; None where it is not given. Raises `InputError` for a name that is empty or there twice."""
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if "" in names:
        raise InputError(f"--columns: name {names.index('') + 1} of {len(names)} is empty")
    if twice := next((n for n in names if names.count(n) > 1), None):
        raise InputError(f"--columns names {shown(twice)} twice")
    return names


RenameOption = Annotated[
    list[str] | None,
    typer.Option(
        "--rename",
        help="The name of a column in the files, and the channel it holds.",
        metavar="COLUMN=CHANNEL",
    ),
]

UnitOption = Annotated[
    list[str] | None,
    typer.Option("--unit", help="The unit of a channel in the files.", metavar="CHANNEL=UNIT"),
]

MapOption = Annotated[
    Path | None,
    typer.Option(
        "--map",
        help="Which column is which channel: a file that isd-gym inspect --out wrote.",
        metavar="FILE",
    ),
]


def write_json(path: Path | None, data: dict[str, Any]) -> None:
    """Write what a command found to the FILE of --json, if there is one."""
    if path is not None:
        files.write_text(path, json.dumps(data, indent=1, allow_nan=False) + "\n")


def check_file(path: Path | None, *read: str | Path | None) -> None:
    """Raise `InputError` at once where FILE, if there is one, could not be written at the end of long work.

    Nor may it be one of the files that are `read`.
    """
    if path is not None:
        files.check_file(path, *read)


def pairs(values: list[str] | None, option: str, form: str) -> dict[str, str]:
    """The values ``KEY=WORD`` of an option; `InputError` with the form that is wanted."""
    out: dict[str, str] = {}
    for value in values or []:
        key, joined, word = value.partition("=")
        if not (key and joined and word):
            raise InputError(f"{option} wants {form}, not '{value}'")
        out[key] = word
    return out


def check_channels(names: Iterable[str], known: Iterable[str], option: str) -> None:
    """Raise `InputError` for a name that is none of the known channels."""
    known = list(known)
    for name in names:
        if name not in known:
            raise InputError(f"{option}: the model has no channel '{name}'; {hint(name, known)}")


def channel_names(
    network: Any,
    rename: list[str] | None,
    unit: list[str] | None,
    map_file: Path | None,
    columns: str | None = None,
) -> dict[str, Any]:
    """Which column is which channel, from the options of a command, as `records_of` takes it.

    Args:
        network: Model whose channels the columns are.
        rename: Values of --rename.
        unit: Values of --unit.
        map_file: File of --map.
        columns: Value of --columns.

    Raises:
        InputError: A channel is unknown, or --map is given with one of the others.
    """
    from .loggers import ChannelMap

    named: dict[str, Any] = {
        "rename": pairs(rename, "--rename", "COLUMN=CHANNEL"),
        "units": pairs(unit, "--unit", "CHANNEL=UNIT"),
        "columns": column_names(columns),
    }
    channels = ["time", *(c.name for c in (*network.inputs, *network.outputs))]
    check_channels(named["rename"].values(), channels, "--rename")
    check_channels(named["units"], [*channels, *named["rename"]], "--unit")
    if map_file is None:
        return named
    if rename or unit:
        raise InputError("--map says it all: write what --rename and --unit would say into it")
    return {"by": ChannelMap.load(map_file), "columns": named["columns"]}


#: columns of what is printed into a pipe or a file
PIPED = 80


def printer() -> Any:
    """A console on stdout that wraps at words: as wide as the terminal, `PIPED` columns where there is none."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else PIPED, highlight=False, markup=False)


def tell(text: str, *, dim: bool = False) -> None:
    """Print a sentence on stdout, wrapped at words."""
    printer().print(text, style="dim" if dim else None)


@contextmanager
def lines() -> Iterator[Callable[[str], None]]:
    """Lines of progress with the time gone by on stderr; silent where it is no terminal."""
    import time

    from rich.console import Console

    if not sys.stderr.isatty():
        yield lambda line: None
        return
    console, begun = Console(stderr=True), time.monotonic()
    with console.status("starting") as status:

        def say(line: str) -> None:
            console.print(
                f"{time.monotonic() - begun:6.1f} s  {line}", style="dim", highlight=False, markup=False
            )
            status.update("working")

        yield say


@contextmanager
def progress() -> Iterator[Callable[[str, float], None]]:
    """A progress bar on stderr, one line a task; silent where stderr is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    bar = Progress(
        TextColumn("{task.description:<24}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    )
    tasks: dict[str, Any] = {}

    def update(name: str, share: float) -> None:
        if name not in tasks:
            tasks[name] = bar.add_task(name, total=1.0)
        bar.update(tasks[name], completed=share)

    with bar:
        yield update


#: [s] between lines of progress where there is no terminal for a bar
SELDOM = 30.0


@contextmanager
def counted(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on stderr that counts (done, all); a line now and then where stderr is no terminal. what: 'cases'."""
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
    """Work that is kept item by item: Ctrl-C says how to go on with it."""
    try:
        yield
    except KeyboardInterrupt:
        typer.echo("what is done is kept: the same line goes on", err=True)
        raise


def warm_up(update: Callable[[str, float], None]) -> None:
    """Compile the kernel, or load it, with a line that says so."""
    import numpy as np

    from .env import ISDSuspensionVectorEnv

    update("preparing the kernel", 0.0)
    env = ISDSuspensionVectorEnv(2)
    env.reset(seed=0)
    env.step(np.zeros((2, 1)))
    update("preparing the kernel", 1.0)
