"""Whether `isd-gym plan` and `isd-gym diagnose` agree on how small an effect may be and still be named.

python benchmarks/plan.py --out DIR [CASE ...]     CASE: a word in RIG:EFFECT:PLACE, such as car or friction; all without

For each case `plan` says the smallest size that is named; then data with that effect are simulated at 1.5 times and at
two thirds of it, at sizes between by bisection, and beyond where both give the same, and `diagnose` is asked. What is found: the size from which on
it names the effect rightly, and its ratio to what `plan` said. The bar: within a factor of 1.5 (`agrees`).

--out DIR      one file per diagnosis, written whole; called again with the same DIR, what is there is not run again
--seed N       of the noise (1)
--seconds S    stop after so many (of work that is not there yet); call again to go on
--json FILE    the figures
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from isd_gym.contrib.forecast import EffectForecast, Plan, plan
from isd_gym.contrib.forecast.planning import Rig, infer_rig, make_excitation, make_record
from isd_gym.diagnosis import diagnose
from isd_gym.diagnosis._estimation.structure import Hypothesis, add, base_structure
from isd_gym.physics.elements import TYPES
from isd_gym.physics.network import Network
from isd_gym.physics.simulate import simulate
from isd_gym.records.data import Table

BAR = 1.5
FURTHEST = 5.0  # multiples of the planned size beyond which nobody looks
STEPS = 2  # of the bisection within the bar

SHAKEN = {
    "schema": "isd-model/1",
    "name": "shaken-mass",
    "masses": {"table": 12.0},
    "elements": [
        {"name": "spring", "type": "linear_stiffness", "between": ["table", "shaker"], "stiffness": 9000.0},
        {"name": "damper", "type": "linear_damping", "between": ["table", "shaker"], "damping": 45.0},
    ],
    "inputs": [{"name": "stroke", "quantity": "displacement", "at": "shaker", "unit": "m"}],
    "outputs": [
        {"name": "acceleration", "quantity": "acceleration", "at": "table", "unit": "m/s^2"},
        {"name": "travel", "quantity": "displacement", "between": ["table", "shaker"], "unit": "m"},
    ],
    "uncertainty": {"table.mass": 0.03, "spring.stiffness": 0.1, "damper.damping": 0.2},
}


@dataclass(frozen=True)
class Case:
    """An effect to hide: the rig, the noise as a share of each output's deviation (as the plan takes it, where None)."""

    rig: str
    effect: str
    where: tuple[str, ...]
    noise: float | None = None

    @property
    def name(self) -> str:
        loud = f"-noise{self.noise:g}" if self.noise else ""
        return f"{self.rig}-{self.effect}-{'-'.join(self.where)}{loud}"


CASES = (
    Case("shaken", "coulomb_friction", ("table", "ground")),
    Case("shaken", "cubic_stiffness", ("table", "shaker")),
    Case("shaken", "quadratic_damping", ("table", "shaker")),
    Case("shaken", "asymmetric_damping", ("table", "shaker")),
    Case("shaken", "bump_stop", ("table", "shaker")),
    Case("shaken", "sensor_gain", ("travel",)),
    Case("shaken", "coulomb_friction", ("table", "ground"), 0.3),
    Case("shaken", "cubic_stiffness", ("table", "shaker"), 0.3),
    Case("rig", "quadratic_damping", ("piston", "ground")),
    Case("rig", "linear_stiffness", ("piston", "ground")),
    Case("rig", "hysteresis", ("piston", "ground")),
    Case("rig", "backlash", ("piston", "ground")),
    Case("car", "coulomb_friction", ("body", "wheel")),
    Case("car", "asymmetric_damping", ("body", "wheel")),
    Case("car", "cubic_stiffness", ("body", "wheel")),
    Case("car", "linear_damping", ("body", "ground")),
    Case("car", "coulomb_friction", ("body", "wheel"), 0.3),
)
MODELS: dict[str, Any] = {"shaken": SHAKEN, "rig": "force-rig", "car": "quarter-car-passive"}


def laid(case: Case) -> tuple[Network, Rig, dict[str, float] | None]:
    network = Network.load(MODELS[case.rig])
    rig = infer_rig(network)
    if case.noise is None:
        return network, rig, None
    record = make_record(network, rig, make_excitation(network, rig))
    clean = simulate(network, record.time, record.inputs)
    return network, rig, {name: case.noise * float(y.std()) for name, y in clean.items()}


def planned(case: Case) -> tuple[Plan, EffectForecast]:
    network, rig, noise = laid(case)
    found = plan(network, rig=rig, noise=noise, only=[case.effect, *case.where], add_sensors=False)
    return found, found.effects[0]


def sized(e: EffectForecast, factor: float) -> dict[str, float]:
    """The values of the effect, `factor` times as large as the smallest that is said to be named."""
    values = {k: a.value for k, a in e.smallest.items()}
    defaults = {f.name: f.default for f in TYPES[e.effect].__dataclass_fields__.values()}
    for key in e.varied:
        neutral = defaults.get(key)
        zero = float(neutral) if isinstance(neutral, int | float) else 0.0
        values[key] = zero + factor * (values[key] - zero)
    return values


def asked(p: Plan, e: EffectForecast, case: Case, factor: float, seed: int) -> dict[str, Any]:
    """What the diagnosis says of the planned test on a rig that has the effect."""
    network = Network.load(MODELS[case.rig])
    h = Hypothesis(e.effect, case.where, e.options)
    truth = add(base_structure(network), h, sized(e, factor)).network
    record = p.records[0]
    clean = simulate(truth, record.time, record.inputs)
    rng = np.random.default_rng([seed, round(1e4 * factor)])
    noisy = {k: y + p.noise[k] * rng.standard_normal(len(y)) for k, y in clean.items()}
    begun = time.process_time()
    d = diagnose([Table(record.time, {**record.inputs, **noisy}, "planned")], p.network)
    names = [(x.effect, list(x.between or [x.channel])) for x in d.effects]
    right = len(names) == 1 and names[0][0] == e.effect and set(names[0][1]) == set(e.where)
    failed = [g.name for g in d.gates if not g.passed]
    return {
        "factor": factor,
        "right": right,
        "verdict": d.verdict,
        "named": names,
        "failed": failed,
        "seconds": time.process_time() - begun,
    }


class OutOfTime(Exception):
    """The time given is used up."""


def threshold(case: Case, seed: int, out: Path, until: float) -> dict[str, Any]:
    """The case's figures; raises `OutOfTime`."""

    def kept(name: str, make: Any) -> Any:
        path = out / f"{case.name}-{name}.json"
        if not path.exists():
            if time.monotonic() > until:
                raise OutOfTime
            path.write_text(json.dumps(make(), indent=1))
        return json.loads(path.read_text())

    cache: list[tuple[Plan, EffectForecast]] = []

    def the_plan() -> tuple[Plan, EffectForecast]:
        if not cache:
            cache.append(planned(case))
        return cache[0]

    said = kept("plan", lambda: the_plan()[1].to_dict())
    row: dict[str, Any] = {
        "case": case.name,
        "status": said["status"],
        "smallest": said["smallest"],
        "share": said["share"],
    }
    row["limited_by"] = said["limited_by"]
    if said["status"] != "named":
        return row
    trials: dict[float, dict[str, Any]] = {}

    def right(factor: float) -> bool:
        factor = round(factor, 4)
        trials[factor] = kept(f"{seed}-{factor:g}", lambda: asked(*the_plan(), case, factor, seed))
        return bool(trials[factor]["right"])

    low, high = 1 / BAR, BAR
    while right(low) and low > 1 / FURTHEST:
        low, high = low / BAR, low
    while high >= BAR - 1e-9 and not right(high) and high < FURTHEST:
        low, high = high, high * BAR
    for _ in range(STEPS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if right(middle) else (middle, high)
    ratio = math.sqrt(low * high)
    row |= {"ratio": ratio, "agrees": 1 / BAR <= ratio <= BAR, "trials": [trials[k] for k in sorted(trials)]}
    return row


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=math.inf)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    until, rows, late = time.monotonic() + args.seconds, [], False
    for case in CASES:
        if args.cases and not any(w in case.name for w in args.cases):
            continue
        try:
            rows.append(threshold(case, args.seed, args.out, until))
        except OutOfTime:
            late = True
            break
        r = rows[-1]
        tail = f"ratio {r['ratio']:.2f}{'' if r['agrees'] else '  OUTSIDE'}" if "ratio" in r else ""
        print(f"{r['case']:52s} {r['status']:9s} {tail}", flush=True)
    told = [r for r in rows if "ratio" in r]
    if told:
        print(f"{sum(r['agrees'] for r in told)} of {len(told)} within a factor of {BAR}")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))
    sys.exit(3 if late else 0)


if __name__ == "__main__":
    main()
