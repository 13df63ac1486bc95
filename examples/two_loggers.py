"""A car on a road, as two loggers wrote it down: the files of docs/tutorials/loggers.md.

    python examples/two_loggers.py --out drive

The measuring box on the body has the acceleration [g] and the string pots [mm] at 500 Hz; the box at the wheel a laser on the road and the
drive's current at 400 Hz, as an MDF, with a clock that is 17 ms late. Columns are called as on the day. The car has a seal
that sticks, which its owner does not know: `drive/car.json` is what he believes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from isd_gym import Network, Table, simulate
from isd_gym.physics.road import road
from isd_gym.records.data import write_table

LATE = 0.017  # s


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("drive"))
    out = parser.parse_args().out
    out.mkdir(exist_ok=True)
    owner = Network.load("quarter-car-isd")
    owner.without_element("seal").save(out / "car.json")
    car = owner.with_parameters({"body.mass": 355.0, "damper.damping": 1460.0})
    rng = np.random.default_rng(7)
    for run in ("run1", "run2"):
        step, seconds = 5e-4, 14.0
        time = step * np.arange(int(seconds / step))
        heights = road("C").heights(time[-1], speed=15.0, step=step, rng=rng)
        current = np.repeat(rng.uniform(-3, 3, 280), len(time) // 280)
        said = simulate(car, time, {"road": heights, "current": current}, step=step)

        def logged(
            values: np.ndarray, at: np.ndarray, share: float, time: np.ndarray = time
        ) -> np.ndarray:
            own = np.interp(at, time, values)
            return own + share * own.std() * rng.standard_normal(len(own))

        body = np.arange(0.5, 13.5, 1 / 500)
        with (out / f"{run}_body.csv").open("w", encoding="utf-8") as file:
            file.write(
                "Zeit [ms];az_Aufbau [g];Federweg [mm];Weg_Inerter [mm];Temp [degC]\n"
            )
            columns = [
                1e3 * (body - body[0]),
                logged(said["body_acceleration"], body, 0.02) / 9.80665,
                1e3 * logged(said["suspension_travel"], body, 0.02),
                1e3 * logged(said["device_travel"], body, 0.02),
                21.0 + 0.01 * rng.standard_normal(len(body)),
            ]
            for row in zip(*columns, strict=True):
                file.write(";".join(f"{x:.6g}" for x in row).replace(".", ",") + "\n")
        wheel = np.arange(0.5, 13.5, 1 / 400)
        held = current[np.minimum((wheel / step).astype(int), len(current) - 1)]
        columns = {"Laser_Strasse": 1e3 * logged(heights, wheel, 1e-3), "I_Motor": held}
        stamps = wheel - wheel[0] + LATE
        write_table(
            out / f"{run}_wheel.mf4",
            Table(stamps, columns, units={"Laser_Strasse": "mm", "I_Motor": "A"}),
        )
    print(
        f"run1 and run2 in {out}, each of two loggers; the owner's model: {out / 'car.json'}"
    )


if __name__ == "__main__":
    main()
