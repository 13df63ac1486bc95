"""Rough roads: how often a linear tyre pulls on the road, and what a tyre that lifts off changes and costs.

python benchmarks/rough_roads.py [--episodes 16] --json FILE

Share of the control steps with a negative total tyre load, without current, by car, road and speed; figures of the car
with the element `tyre_lift_off`; speed of a batch of 1024 such cars over the linear cars, in pairs of runs (some minutes).
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from json_files import save_json

from isd_gym import Network, TyreContactWarning
from isd_gym.physics._tyre_contact import pulling_share
from isd_gym.physics.road import road as find_road
from isd_gym.physics.vehicle import vehicle

CARS = ("quarter-car-passive", "quarter-car-isd", "half-car-isd", "full-car-isd")
ROADS = ("paper", "A", "B", "C", "D", "E")
SPEEDS = (10.0, 15.0, 20.0, 25.0, 30.0, 40.0)
STEPS = 4000
BATCH = 1024


def lifting(name: str) -> Network:
    """A built-in car whose wheels lift off."""
    network = Network.load(name)
    car, content = vehicle(network), network.to_dict()
    stiffness = {
        e["between"][1]: e["stiffness"]
        for e in content["elements"]
        if e["name"].startswith("tyre")
    }
    for corner, load in zip(car.corners, car.static_tyre_loads, strict=True):
        place = [corner.wheel, corner.road]
        values = {"stiffness": stiffness[corner.road], "load": load}
        content["elements"].append(
            {
                "name": corner.named("lift_off"),
                "type": "tyre_lift_off",
                "between": place,
                **values,
            }
        )
    return Network.load(content)


def batch(network: Network, count: int, road: str, speed: float = 20.0) -> Any:
    """Cars at rest on new roads."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TyreContactWarning)
        cars = gym.make_vec(
            "ISDSuspension-v0",
            count,
            network=network,
            road=road,
            speed=speed,
            threads=1,
            max_episode_steps=10**9,
        )
    cars.reset(seed=0)
    return cars


def drive(network: Network, road: str, speed: float, episodes: int) -> dict[str, float]:
    """Figures of a car without current."""
    cars = batch(network, episodes, road, speed)
    task = cars.unwrapped.task
    static = np.array(task.vehicle.static_tyre_loads)[:, None]
    idle = np.zeros(cars.action_space.shape, np.float32)
    squares, pulls = np.zeros(3), 0.0
    for _ in range(STEPS):
        seen, reward, _, _, info = cars.step(idle)
        loads = np.array([info[name] for name in task.vehicle.tyre_loads])
        pulls += float(np.mean(loads + static < -1e-6 * static))
        squares += [
            -reward.mean(),
            np.mean(seen[:, 0].astype(float) ** 2),
            np.mean(loads**2),
        ]
    cost, acceleration, load = squares / STEPS
    return {
        "share": pulls / STEPS,
        "cost": cost,
        "acceleration": acceleration**0.5,
        "tyre_load": load**0.5,
    }


def speeds(
    networks: list[Network], steps: int = 60, repetitions: int = 15
) -> list[float]:
    """Speed of batches over the first, median of alternating runs, processor time."""
    fleet = [batch(network, BATCH, "paper") for network in networks]
    idle = np.zeros(fleet[0].action_space.shape, np.float32)
    spent: list[list[float]] = []
    for _ in range(repetitions + 1):  # the first run compiles
        row = []
        for cars in fleet:
            begin = time.process_time()
            for _ in range(steps):
                cars.step(idle)
            row.append(time.process_time() - begin)
        spent.append(row)
    times = np.array(spent[1:])
    return [float(v) for v in np.median(times[:, :1] / times, axis=0)]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0] if __doc__ else ""
    )
    parser.add_argument("--episodes", type=int, default=16)
    parser.add_argument("--json", type=Path, required=True)
    given = parser.parse_args()
    shares, effects = [], []
    for name in CARS:
        car = vehicle(Network.load(name))
        for road in ROADS:
            for speed in SPEEDS:
                found = drive(car.network, road, speed, given.episodes)["share"]
                linear = pulling_share(car, find_road(road), speed)
                shares.append(
                    {
                        "network": name,
                        "road": road,
                        "speed": speed,
                        "share": found,
                        "predicted": linear,
                    }
                )
    for name in ("quarter-car-passive", "quarter-car-isd"):
        for road in ("paper", "C", "D", "E"):
            linear_tyre = drive(Network.load(name), road, 20.0, given.episodes)
            lifts_off = drive(lifting(name), road, 20.0, given.episodes)
            effects.append(
                {
                    "network": name,
                    "road": road,
                    "linear": linear_tyre,
                    "lifts_off": lifts_off,
                }
            )
    ratios = {
        name: speeds([Network.load(name), lifting(name)])[1] for name in CARS[1:3]
    }
    about = {
        "date": time.strftime("%Y-%m-%d"),
        "episodes": given.episodes,
        "seconds": STEPS * 0.005,
    }
    data = {
        **about,
        "shares": shares,
        "effects": effects,
        "batch_speed_of_lift_off": ratios,
    }
    save_json(given.json, data)


if __name__ == "__main__":
    main()
