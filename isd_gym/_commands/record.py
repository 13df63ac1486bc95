"""`isd-gym record`: rollouts of a policy as a Minari data set."""

from __future__ import annotations

from typing import Annotated

import typer

from ._options import (
    DurationOption,
    NetworkOption,
    PolicyArgument,
    RoadOption,
    SpeedOption,
    TrainedOption,
)
from .console import progress, warm_up


def command(
    policy: PolicyArgument,
    out: Annotated[
        str, typer.Option("--out", help="New folder, or a Minari id such as isd/mpc-v0.", metavar="DIR|ID")
    ],
    episodes: Annotated[int, typer.Option(help="Number of roads.", min=1)] = 32,
    seed: Annotated[int, typer.Option(help="Seed of the first road. Episode i has seed + i.", min=0)] = 0,
    duration: DurationOption = 20.0,
    road: RoadOption = "paper",
    speed: SpeedOption = 20.0,
    network: NetworkOption = "quarter-car-isd",
    trained_with: TrainedOption = None,
) -> None:
    """Save a policy's rollouts as a Minari data set, for offline reinforcement learning.

    Example: isd-gym record mpc --out isd/mpc-v0
    """
    from ..benchmark.datasets import ID, write_dataset
    from ..benchmark.policies import find
    from ..physics.network import Network

    plant = Network.load(network)
    entry = find(policy, plant, speed=speed, trained=trained_with)
    with progress() as update:
        warm_up(update)
        write_dataset(
            entry,
            out,
            plant,
            episodes=episodes,
            seed=seed,
            duration=duration,
            road=road,
            speed=speed,
            progress=lambda share: update(policy, share),
        )
    how = f'minari.load_dataset("{out}")' if ID.fullmatch(out) else f'minari.MinariDataset("{out}")'
    typer.echo(f"{episodes} episodes of {policy}: {how}")
