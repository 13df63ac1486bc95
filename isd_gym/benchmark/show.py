"""Live view and films of policies: one car, or two cars side by side on the same road."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .._common.errors import InputError
from ..physics.network import Network
from ..physics.vehicle import vehicle

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from ..physics.road import Road
    from ..view.rendering import CarSnapshot
    from .driving import Entry

#: size of a picture [px] by number of cars
SIZE = {1: (960, 600), 2: (1200, 640)}
# of two cars with a left and a right track, which have two views each
WIDE = (
    1400,
    600,
)
FPS = 50.0  # frames of a film per second


def snapshots(
    entries: list[Entry],
    network: Network | str | Path = "quarter-car-isd",
    *,
    road: Road | str = "paper",
    speed: float = 20.0,
    seconds: float = 10.0,
    seed: int = 0,
) -> Iterator[tuple[CarSnapshot, ...]]:
    """Drive policies on the same road."""
    from ..env import ISDSuspensionEnv
    from ..env.task import CONTROL_STEP

    network = Network.load(network)
    cars: list[Any] = []  # name, controller, environment, observation
    for entry in entries:
        controller = entry.driver()
        env = ISDSuspensionEnv(
            network=entry.network or network,
            allow_passive=True,
            road=road,
            speed=speed,
            duration=seconds,
            observation=controller.observation,
            preview=controller.preview or None,
            render_mode="rgb_array",
        )
        controller.reset()
        observation, _ = env.reset(seed=seed)
        cars.append([entry.name, controller, env, observation])
    yield tuple(replace(env.snapshot(), label=name) for name, _, env, _ in cars)
    for k in range(round(seconds / CONTROL_STEP)):
        for car in cars:
            name, controller, env, observation = car
            car[3], _, terminated, _, _ = env.step(
                np.atleast_1d(controller.act(observation))
            )
            if terminated:
                raise InputError(
                    f"'{name}' broke the car after {(k + 1) * CONTROL_STEP:.2f} s"
                )
        yield tuple(replace(env.snapshot(), label=name) for name, _, env, _ in cars)


@contextmanager
def _renderer(mode: Any, network: Network, cars: int) -> Iterator[Any]:
    from ..view.rendering import Renderer

    is_wide = cars == 2 and vehicle(network).wheels.tracks == 2
    width, height = WIDE if is_wide else SIZE[cars]
    drawn = Renderer(mode, width=width, height=height, cars=cars)
    try:
        yield drawn
    finally:
        drawn.close()


def film(
    entries: list[Entry],
    network: Network | str | Path,
    path: str | Path,
    *,
    progress: Callable[[float], None] | None = None,
    **drive: Any,
) -> None:
    """Write an MP4 film of policies."""
    from ..env.task import CONTROL_STEP
    from ..view.rendering import write_video

    network = Network.load(network)
    every = round(1.0 / (FPS * CONTROL_STEP))
    total = max(1, round(drive.get("seconds", 10.0) / CONTROL_STEP))

    def frames(renderer: Any) -> Iterator[NDArray[np.uint8]]:
        for k, shots in enumerate(snapshots(entries, network, **drive)):
            if k % every == 0:
                yield renderer.draw(*shots)
            if progress is not None and k % 50 == 0:
                progress(k / total)

    with _renderer("rgb_array", network, len(entries)) as renderer:
        write_video(path, frames(renderer), fps=FPS)
    if progress is not None:
        progress(1.0)


def live(entries: list[Entry], network: Network | str | Path, **drive: Any) -> None:
    """Show policies in a window at the pace of the simulated time, until the end or until the window is closed."""
    network = Network.load(network)
    with _renderer("human", network, len(entries)) as renderer:
        for shots in snapshots(entries, network, **drive):
            renderer.draw(*shots)
            if renderer.closed:
                return
