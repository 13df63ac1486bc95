"""Speed against Gymnasium's CartPole in the same run: `python benchmarks/speed.py [--json FILE]` (some minutes).

`python benchmarks/speed.py --official` measures with Gymnasium's own functions instead, beside CartPole, Pendulum and
Hopper of MuJoCo (`pip install "gymnasium[mujoco]"`).

Medians of alternating repetitions, processor time of a single thread, so that other work on the machine counts little.
`random` draws new currents over the full range at every step; with 5 A throughout every car ends on its stop.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING
from unittest import mock

import gymnasium as gym
import numpy as np
from json_files import save_json

from isd_gym import Network
from isd_gym.physics.road import paper_road
from isd_gym.physics.simulate import Plant

if TYPE_CHECKING:
    from collections.abc import Callable


def seconds(run: Callable[[], None]) -> float:
    begin = time.process_time()
    run()
    return time.process_time() - begin


def single(steps: int = 20_000) -> float:
    """Steps per second of `gymnasium.make`, over CartPole-v1's."""
    car, pole = gym.make("ISDSuspension-v0"), gym.make("CartPole-v1")
    idle = np.zeros(1, np.float32)

    def drive() -> None:
        car.reset(seed=0)
        for _ in range(steps):
            if car.step(idle)[3]:
                car.reset()

    def balance() -> None:
        pole.reset(seed=0)
        for k in range(steps):
            _, _, fell, over, _ = pole.step(k & 1)
            if fell or over:
                pole.reset()

    drive()
    return float(np.median([seconds(balance) / seconds(drive) for _ in range(5)]))


def batch(
    currents: str,
    count: int = 1024,
    steps: int = 300,
    *,
    name: str = "ISDSuspension-v0",
    **options: object,
) -> tuple[float, float]:
    """(ratio to CartPole's own vector environment, million steps per second) of `gymnasium.make_vec`.

    name: of the environment. options: of the environment. One thread.
    """
    cars = gym.make_vec(name, count, threads=1, **options)
    poles = gym.make_vec("CartPole-v1", count)
    rng = np.random.default_rng(0)
    draws = [
        rng.uniform(-5, 5, cars.action_space.shape)
        if currents == "random"
        else np.full(cars.action_space.shape, float(currents))
        for _ in range(50)
    ]
    draws = [draw.astype(np.float32) for draw in draws]
    pushes = poles.action_space.sample()
    poles.reset(seed=0)

    def drive() -> None:
        cars.reset(seed=0)
        begin = time.process_time()
        for k in range(steps):
            cars.step(draws[k % 50])
        spent.append(time.process_time() - begin)

    def balance() -> None:
        for _ in range(steps):
            poles.step(pushes)

    spent: list[float] = []
    drive()
    ratios = []
    for _ in range(5):
        theirs = seconds(balance)
        drive()
        ratios.append(theirs / spent[-1])
    return float(np.median(ratios)), count * steps / float(np.median(spent)) / 1e6


DRAWS = 20_000  # sampled actions


def _sample(space: gym.Space) -> None:
    for _ in range(DRAWS):
        space.sample()


#: environments of the official table
OFFICIAL = (
    "CartPole-v1",
    "Pendulum-v1",
    "Hopper-v5",
    "ISDSuspension-v0",
    "ISDHalfCar-v0",
    "ISDFullCar-v0",
)


def official(
    seconds_each: int = 1, repetitions: int = 5, cars: int = 1024
) -> dict[str, dict[str, float]]:
    """Return figures of `gymnasium.utils.performance` by environment, medians of alternating repetitions.

    The functions read the processor time instead of the clock, so that other work on the machine counts little.

    Returns:
        Steps per second of one environment, microseconds of a step and of the sample of its action within, and
        million steps per second of a vector environment, with random and with constant actions.
    """
    from gymnasium.utils import performance

    found: dict[str, dict[str, list[float]]] = {name: {} for name in OFFICIAL}
    with mock.patch.object(
        performance, "time", SimpleNamespace(time=time.process_time)
    ):
        for _ in range(repetitions):
            for name in OFFICIAL:
                one = gym.make(name)
                rate = performance.benchmark_step(one, seconds_each, seed=0)
                row = {"steps per second": rate, "step and sample [us]": 1e6 / rate}
                row["sample [us]"] = (
                    1e6 * seconds(partial(_sample, one.action_space)) / DRAWS
                )
                if gym.spec(name).vector_entry_point is not None:
                    many = gym.make_vec(
                        name, cars, **({"threads": 1} if "ISD" in name else {})
                    )
                    row["vector [M/s]"] = (
                        performance.benchmark_vector_step(many, seconds_each, seed=0)
                        / 1e6
                    )
                    action = many.action_space.sample()
                    many.action_space.sample = lambda action=action: action
                    row["vector, constant action [M/s]"] = (
                        performance.benchmark_vector_step(many, seconds_each, seed=0)
                        / 1e6
                    )
                for key, value in row.items():
                    found[name].setdefault(key, []).append(value)
    return {
        name: {k: float(np.median(v)) for k, v in rows.items()}
        for name, rows in found.items()
    }


def threads(count: int = 8192, steps: int = 100) -> float:
    """Speed of two threads over one, by the clock: means something only where two cores are idle."""
    pair = [gym.make_vec("ISDSuspension-v0", count, threads=n) for n in (1, 2)]
    idle = np.zeros((count, 1), np.float32)
    for cars in pair:
        cars.reset(seed=0)
        cars.step(idle)
    ratios = []
    for _ in range(7):
        clock = []
        for cars in pair:
            begin = time.perf_counter()
            for _ in range(steps):
                cars.step(idle)
            clock.append(time.perf_counter() - begin)
        ratios.append(clock[0] / clock[1])
    return float(np.median(ratios))


FRESH = """
import time
import gymnasium, numpy
begin = time.process_time()
car = gymnasium.make("ISDSuspension-v0")
car.reset(seed=0)
car.step(numpy.zeros(1, numpy.float32))
one = time.process_time() - begin
cars = gymnasium.make_vec("ISDSuspension-v0", 1024)
cars.reset(seed=0)
cars.step(numpy.zeros((1024, 1), numpy.float32))
print(one, time.process_time() - begin - one)
"""


def fresh() -> tuple[float, float]:
    """Processor time of the first step of a car, and of the first step of a batch after it, nothing compiled before."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        out = subprocess.run(
            [sys.executable, "-c", FRESH],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
    first, more = (float(word) for word in out.stdout.split())
    return first, more


def hour() -> float:
    """Seconds for one hour of the default car on the paper's road at 1 ms, outputs every 5 ms."""
    plant = Plant(Network.load("quarter-car-isd"))
    road = paper_road().heights(3600.0, rng=np.random.default_rng(0))
    inputs = {"road": road, "current": np.zeros(len(road))}
    return min(
        seconds(lambda: plant.run(inputs, every=5, samples=720_001)) for _ in range(3)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument(
        "--official", action="store_true", help="Gymnasium's own functions"
    )
    given = parser.parse_args()
    if given.official:
        for name, row in official().items():
            print(
                f"{name:<18}", *(f"{key}: {value:.4g};" for key, value in row.items())
            )
        return
    idle, moving = batch("0"), batch("random")
    first, more = fresh()
    figures = {
        "gymnasium.make, over CartPole-v1": single(),
        "make_vec 1024 without current, over CartPole's own": idle[0],
        "  million steps per second": idle[1],
        "make_vec 1024 with random currents, over CartPole's own": moving[0],
        "  million steps per second, random": moving[1],
        "make_vec 1024 on the end stops (5 A throughout), over CartPole's": batch("5")[
            0
        ],
        "make_vec 1024 on a class E road, over CartPole's": batch("0", road="E")[0],
        "make_vec 1024, body mass randomised, over CartPole's": batch(
            "0", randomize={"body.mass": (0.8, 1.2)}
        )[0],
        "make_vec 1024 with a preview of 0.4 s, over CartPole's": batch(
            "0", observation="preview", preview=0.4
        )[0],
        "make_vec 1024 half cars with random currents, over CartPole's": batch(
            "random", name="ISDHalfCar-v0"
        )[0],
        "make_vec 1024 full cars with random currents, over CartPole's": batch(
            "random", name="ISDFullCar-v0"
        )[0],
        "make_vec 8192, two threads over one (two idle cores)": threads(),
        "first step in a fresh environment [s]": first,
        "  the first of a batch after it [s]": more,
        "one hour of driving at 1 ms [s]": hour(),
    }
    for name, value in figures.items():
        print(f"{name:<65} {value:8.2f}")
    if given.json:
        save_json(given.json, figures)


if __name__ == "__main__":
    main()
