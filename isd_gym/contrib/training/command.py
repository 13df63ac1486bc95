"""The command `isd-gym train`."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from isd_gym._commands._options import SpeedOption, option

#: plant unless given
DEFAULT = "quarter-car-isd"


class Algorithm(StrEnum):
    """Learning algorithms by name."""

    ppo = "ppo"
    sac = "sac"


RunOption = Annotated[Path, option("--out DIR", "Folder of the run; an unfinished one goes on.")]
StepsOption = Annotated[
    int | None,
    option(
        "--steps",
        "Control steps of all cars together, to within a rollout (ppo: 327680 steps, with --preview or of a half or full car 393216; sac: 4096); tuned unless given.",
        min=1,
    ),
]
PlantOption = Annotated[
    str,
    option(
        "--network", "The plant: a built-in network, such as half-car-isd or full-car-isd, or a model file."
    ),
]
RandomizeOption = Annotated[
    bool,
    option(
        "--randomize", "Vary mass, friction, thrust constant, road, speed and noise as the robust track does."
    ),
]
FoundOption = Annotated[
    Path | None,
    option(
        "--found DIR",
        "Folder of isd-gym diagnose, in place of --network and --randomize: the plant is the found model, and its "
        "parameters vary within their 95 % intervals.",
    ),
]
TrainingPreviewOption = Annotated[
    float,
    option(
        "--preview",
        "Road ahead that the policy of a quarter car sees [s], e.g. 0.1; none unless given.",
        min=0.0,
    ),
]
UnaidedOption = Annotated[
    bool,
    option(
        "--from-nothing",
        "Train without a teacher and without the estimate of a Kalman filter among the features.",
    ),
]
TrainingSensorsOption = Annotated[
    str,
    option(
        "--sensors",
        "Imperfections of the sensors, joined by commas: noise=1 (or 0:2), delay=1, road_error=0.001, road_lag=0.01, road_range=3.",
    ),
]


def train(
    algorithm: Annotated[Algorithm, typer.Argument(help="ppo or sac.")],
    out: RunOption,
    seed: Annotated[int, option("--seed", "Training seed.", min=0)] = 0,
    steps: StepsOption = None,
    network: PlantOption = DEFAULT,
    road: Annotated[str, option("--road", "paper, A ... H, bump, a CSV file, C+bump, ...")] = "paper",
    speed: SpeedOption = 20.0,
    randomize: RandomizeOption = False,
    found: FoundOption = None,
    preview: TrainingPreviewOption = 0.0,
    unaided: UnaidedOption = False,
    sensors: TrainingSensorsOption = "",
    json_file: Annotated[Path | None, option("--json FILE", "Write the figures to this file.")] = None,
) -> None:
    """Train a policy; a repeated call with the same folder continues an unfinished run.

    The policy first imitates the friction-aware MPC, then PPO or SAC trains it; --from-nothing leaves the imitation
    out. A policy of a half or full car commands one current per motor, and knows the road ahead of the rear wheels from the front wheels.
    Ctrl-C saves the run and prints the command that continues it. Shows the cost J on validation roads, after
    the costs of the passive car and the baselines. The best policy is in DIR/policy, for `isd-gym score
    DIR/policy`; the log of TensorBoard is in DIR/tensorboard.

    Example: isd-gym train sac --out runs/sac
    """
    from isd_gym._common.errors import InputError

    from .train import train as run

    if json_file is not None and not os.path.isdir(json_file.parent):
        raise InputError(f"cannot write '{json_file}': no folder '{json_file.parent}'")
    spread: bool | Path = randomize
    if found is not None:
        if randomize or network != DEFAULT:
            raise InputError("--found takes the place of --network and --randomize: leave them out")
        network, spread = str(found / "model.json"), found
    with _bar() as (say, progress):
        report = run(
            algorithm.value,
            out,
            seed=seed,
            steps=steps,
            network=network,
            road=road,
            speed=speed,
            randomize=spread,
            preview=preview,
            sensors=sensors,
            unaided=unaided,
            say=say,
            progress=progress,
        )
    if json_file is not None:
        from isd_gym._common.files import write_text

        write_text(json_file, json.dumps(report, indent=1) + "\n")


@contextmanager
def _bar() -> Iterator[tuple[Callable[[str], None], Callable[[str, float], None]]]:
    """Give functions for lines on stderr, and for a bar with elapsed and remaining time on a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True, highlight=False, markup=False)
    bar = Progress(
        TextColumn("{task.description:<16}"),
        BarColumn(bar_width=24),
        TextColumn("{task.percentage:5.1f} %"),
        TimeElapsedColumn(),
        TextColumn("to go"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
    tasks: dict[str, Any] = {}

    def progress(name: str, share: float) -> None:
        if name not in tasks:
            for earlier in tasks.values():
                bar.update(earlier, visible=False)
            tasks[name] = bar.add_task(name, total=1.0)
        bar.update(tasks[name], completed=min(share, 1.0))

    def say(line: str) -> None:  # wrapped at words, except for a command to be typed again
        console.print(line, soft_wrap="isd-gym train" in line)

    if not sys.stderr.isatty():  # a disabled bar prints an empty line
        yield say, lambda name, share: None
        return
    with bar:
        yield say, progress
