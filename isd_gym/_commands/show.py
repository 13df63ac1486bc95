"""`isd-gym show`: a window or a film of policies that drive."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .._common.errors import InputError
from ._options import (
    NetworkOption,
    PolicyArgument,
    PreviewOption,
    RoadOption,
    SpeedOption,
    TrainedOption,
    option,
)
from .console import check_file, progress, warm_up

LONGEST = 3600.0  # duration of a drive [s]


def command(
    policy: PolicyArgument,
    against: Annotated[
        str | None, option("--against POLICY", "Second policy, on the same road.")
    ] = None,
    out: Annotated[
        Path | None,
        option("--out FILE", "Write a film (.mp4) instead of opening a window."),
    ] = None,
    road: RoadOption = "paper",
    speed: SpeedOption = 20.0,
    seconds: Annotated[
        float, option("--seconds", "Length of the drive [s].", min=0.1)
    ] = 10.0,
    seed: Annotated[
        int, option("--seed", "Seed of the road, as in reset(seed=).", min=0)
    ] = 0,
    preview: PreviewOption = None,
    network: NetworkOption = "quarter-car-isd",
    trained_with: TrainedOption = None,
) -> None:
    """Show a policy that drives, alone or beside another, in a window or as a film.

    Half and full cars (--network half-car-isd) are shown from the side, full cars also from behind.

    Example: isd-gym show mpc --against passive --out mpc.mp4
    """
    from ..benchmark.policies import find_all
    from ..benchmark.show import film, live
    from ..physics.network import Network
    from ..physics.road import road as find_road
    from ..view.rendering import check_display

    check_file(out)
    if seconds > LONGEST:
        raise InputError(
            f"--seconds: a drive that is shown lasts at most {LONGEST:g} s, not {seconds:g}"
        )
    if out is not None and out.suffix.lower() != ".mp4":
        raise InputError(f"cannot write a film to '{out}': end the name in .mp4")
    plant = Network.load(network)
    ahead: dict[str, Any] = {} if preview is None else {"preview": preview}
    names = [name for name in (policy, against) if name is not None]
    entries = find_all(names, plant, speed=speed, trained=trained_with, **ahead)
    drive: dict[str, Any] = {
        "road": find_road(road),
        "speed": speed,
        "seconds": seconds,
        "seed": seed,
    }
    if out is None:
        check_display()
        with progress() as update:
            warm_up(update)
        live(entries, plant, **drive)
        return
    with progress() as update:
        warm_up(update)
        film(
            entries,
            plant,
            out,
            progress=lambda share: update("filming", share),
            **drive,
        )
    typer.echo(f"{seconds:g} s of {' and '.join(e.name for e in entries)} in {out}")
