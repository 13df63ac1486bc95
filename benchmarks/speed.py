"""Speed against Gymnasium's CartPole in the same run: `python benchmarks/speed.py [--json FILE]` (under a minute).

Medians of alternating repetitions, single thread. `random` draws new currents over the full range at every step.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np

from isd_gym.network import Network
from isd_gym.road import paper_road
from isd_gym.simulate import Plant


def seconds(run: Callable[[], None]) -> float:
    begin = time.perf_counter()
    run()
    return time.perf_counter() - begin


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


def batch(random: bool, count: int = 1024, steps: int = 300) -> tuple[float, float]:
    """(ratio to CartPole's own vector environment, million steps per second) of `gymnasium.make_vec`."""
    cars, poles = gym.make_vec("ISDSuspension-v0", count), gym.make_vec("CartPole-v1", count)
    rng = np.random.default_rng(0)
    draws = [(rng.uniform(-5, 5, (count, 1)) * random).astype(np.float32) for _ in range(50)]
    pushes = poles.action_space.sample()
    poles.reset(seed=0)

    def drive() -> None:
        cars.reset(seed=0)
        begin = time.perf_counter()
        for k in range(steps):
            cars.step(draws[k % 50])
        spent.append(time.perf_counter() - begin)

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


def hour() -> float:
    """Seconds for one hour of the default car on the paper's road at 1 ms, outputs every 5 ms."""
    plant = Plant(Network.load("quarter-car-isd"))
    road = paper_road().heights(3600.0, rng=np.random.default_rng(0))
    inputs = {"road": road, "current": np.zeros(len(road))}
    return min(seconds(lambda: plant.run(inputs, every=5, samples=720_001)) for _ in range(3))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    file = parser.parse_args().json
    idle, moving = batch(False), batch(True)
    figures = {
        "gymnasium.make, over CartPole-v1": single(),
        "make_vec 1024 without current, over CartPole's own": idle[0],
        "  million steps per second": idle[1],
        "make_vec 1024 with random currents, over CartPole's own": moving[0],
        "  million steps per second, random": moving[1],
        "one hour of driving at 1 ms [s]": hour(),
    }
    for name, value in figures.items():
        print(f"{name:<58} {value:8.2f}")
    if file:
        file.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
