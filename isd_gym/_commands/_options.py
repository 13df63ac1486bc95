"""Options that several commands share, and readers of their values."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from .._common.errors import InputError, hint, shown


def complete(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return a completion for the shell. The names are looked up when the shell asks."""

    def words(incomplete: str) -> list[str]:
        return sorted(name for name in names() if name.startswith(incomplete))

    return words


def policy_names() -> Iterable[str]:
    """Return the names of the policies that can be found."""
    from ..benchmark.policies import available

    return available()


def network_names() -> Iterable[str]:
    """Return the names of the built-in networks."""
    from ..physics.network import builtin_networks

    return builtin_networks()


def road_names() -> Iterable[str]:
    """Return the names of the roads."""
    return ("paper", "paper-printed", "flat", *"ABCDEFGH", "bump", "pothole", "sweep")


def option(usage: str, help: str, **settings: Any) -> Any:
    """Return an option from its usage: a flag and a metavar, such as ``--map FILE``, or a flag alone."""
    flag, _, metavar = usage.partition(" ")
    return typer.Option(flag, help=help, metavar=metavar or None, **settings)


_POLICY = typer.Argument(
    help="passive, mpc, ... (isd-gym policies lists them), a policy's folder, a .zip of Stable-Baselines3 (only its weights are "
    "read), or your own file.py:Class or file.py:function (the program runs the file).",
    autocompletion=complete(policy_names),
)
PolicyArgument = Annotated[str, _POLICY]
PoliciesArgument = Annotated[list[str], _POLICY]
ModelArgument = Annotated[
    str,
    typer.Argument(
        help="A model file (isd-model/1) or a built-in network.",
        autocompletion=complete(network_names),
    ),
]
NetworkOption = Annotated[
    str,
    option(
        "--network",
        "The vehicle: a built-in network or a model file.",
        autocompletion=complete(network_names),
    ),
]
RoadOption = Annotated[
    str,
    option(
        "--road",
        "paper, paper-printed, flat, A ... H, bump, pothole, sweep, C+bump, or a CSV file.",
        autocompletion=complete(road_names),
    ),
]
SpeedOption = Annotated[float, option("--speed", "Speed [m/s].", min=0.1)]
DurationOption = Annotated[
    float, option("--duration", "Length of an episode [s].", min=0.005)
]
SeedOption = Annotated[
    int | None,
    option(
        "--seed",
        "Seed of the first road, as in reset(seed=). Default: the scoring roads, which no seed reaches.",
        min=0,
    ),
]
PreviewOption = Annotated[
    float | None,
    option(
        "--preview", "Length of road ahead [s] that policies with preview see.", min=0.0
    ),
]
JsonOption = Annotated[
    Path | None, option("--json FILE", "Write the results to this file.")
]
TrainedOption = Annotated[
    str | None,
    option(
        "--trained-with NAME=VALUE,...",
        "Options of the training of a .zip that was saved without them: observation=measured or history, "
        "action=current, share or increment, normalize=FILE or none, joined by commas.",
    ),
]
ColumnsOption = Annotated[
    str | None,
    option(
        "--columns NAME,NAME,...",
        "Names of the columns of text files without a header, in order: 'time,force [kN],travel [mm]'.",
    ),
]
RenameOption = Annotated[
    list[str] | None,
    option(
        "--rename COLUMN=CHANNEL",
        "Column of the files and the channel of the model. May be repeated.",
    ),
]
UnitOption = Annotated[
    list[str] | None,
    option(
        "--unit CHANNEL=UNIT",
        "Unit of a channel, or of the time, in the files. May be repeated.",
    ),
]
SignOption = Annotated[
    list[str] | None,
    option(
        "--sign CHANNEL=-1",
        "Channel that is turned round in the files. May be repeated.",
    ),
]
FileRateOption = Annotated[
    float | None,
    option("--rate HZ", "Sampling rate of files without time stamps [Hz]."),
]
MapOption = Annotated[
    Path | None,
    option(
        "--map FILE",
        "File with the column of each channel, written by isd-gym inspect --out.",
    ),
]
ElementsOption = Annotated[
    list[Path] | None,
    option(
        "--elements FILE.py",
        "Python file that registers your own elements. The program runs the file.",
    ),
]
JobsOption = Annotated[
    int, option("--jobs", "Number of processes on this machine.", min=1)
]
EngineOption = Annotated[
    str, option("--engine", "Where the work runs: local, or ray for a Ray cluster.")
]


def column_names(text: str | None) -> list[str] | None:
    """Return the names of --columns, None without the option. Raise `InputError` for an empty or repeated name."""
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if "" in names:
        raise InputError(
            f"--columns: name {names.index('') + 1} of {len(names)} is empty"
        )
    if twice := next((n for n in names if names.count(n) > 1), None):
        raise InputError(f"--columns names {shown(twice)} twice")
    return names


def pairs(values: list[str] | None, option: str, form: str) -> dict[str, str]:
    """Return the values ``KEY=WORD`` of an option. Raise `InputError` for another form."""
    out: dict[str, str] = {}
    for value in values or []:
        key, joined, word = value.partition("=")
        if not (key and joined and word):
            raise InputError(f"{option} wants {form}, not '{value}'")
        out[key] = word
    return out


def check_channels(names: Iterable[str], known: Iterable[str], option: str) -> None:
    """Raise `InputError` for a name that is not a channel of the model."""
    known = list(known)
    for name in names:
        if name not in known:
            raise InputError(
                f"{option}: the model has no channel '{name}'; {hint(name, known)}"
            )


def read_names(
    rename: list[str] | None,
    unit: list[str] | None,
    columns: str | None,
    sign: list[str] | None,
) -> dict[str, Any]:
    """Return the values of --rename, --unit, --columns and --sign by name of the argument of `records_of`."""
    return {
        "rename": pairs(rename, "--rename", "COLUMN=CHANNEL"),
        "units": pairs(unit, "--unit", "CHANNEL=UNIT"),
        "columns": column_names(columns),
        "signs": signs_of(sign),
    }


def channel_names(
    network: Any,
    rename: list[str] | None,
    unit: list[str] | None,
    map_file: Path | None,
    columns: str | None = None,
    sign: list[str] | None = None,
    rate: float | None = None,
) -> dict[str, Any]:
    """Return the column of each channel from the options of a command, as arguments of `records_of`."""
    from ..records.loggers import ChannelMap

    named = read_names(rename, unit, columns, sign)
    channels = ["time", *(c.name for c in (*network.inputs, *network.outputs))]
    check_channels(named["rename"].values(), channels, "--rename")
    if map_file is None:
        return named | {"rate": rate}
    if rename or unit or sign:
        raise InputError(
            "--map replaces --rename, --unit and --sign: write their values into the map"
        )
    return {"by": ChannelMap.load(map_file), "columns": named["columns"], "rate": rate}


def signs_of(values: list[str] | None) -> dict[str, int]:
    """Return the factors of --sign. Raise `InputError` for a factor other than 1 and -1."""
    out = {}
    for name, word in pairs(values, "--sign", "CHANNEL=-1").items():
        if word not in ("-1", "1", "+1"):
            raise InputError(f"--sign {name}: wants -1 or 1, not {shown(word)}")
        out[name] = int(word)
    return out


def check_records(data: list[Path], validate: list[Path]) -> None:
    """Raise `InputError` for a record given twice, or given for fitting and for validation."""
    from ..records.loggers import files_of

    seen: set[Path] = set()
    fitted = [f for word in data for f in files_of(word)]
    held = [f for word in validate for f in files_of(word)]
    for file in (*fitted, *held):
        if (own := file.resolve()) in seen:
            both = file in held and own in {f.resolve() for f in fitted}
            raise InputError(
                f"{file}: is among the records to fit; --validate wants others"
                if both
                else f"{file}: is named twice"
            )
        seen.add(own)
