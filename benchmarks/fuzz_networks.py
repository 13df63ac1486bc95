"""Random networks through `simulate` and the environment: finite, or one clear line; never a traceback, never a silent nan.

`python benchmarks/fuzz_networks.py [--count 100000] [--json FILE]` (goes on where FILE ends; about 6 ms a network). Every network
has one to five masses, up to two massless nodes, and laws anywhere at plausible values (`benchmarks/rigs/random_networks.py`);
every fiftieth is the car with some of these laws, driven at full current by the environment.
"""

from __future__ import annotations

import argparse
import collections
import json
import time as clock
from pathlib import Path

import numpy as np
from rigs import random_networks

from isd_gym._common.errors import InputError
from isd_gym.env._environment import ISDSuspensionEnv
from isd_gym.physics.network import Network
from isd_gym.physics.simulate import simulate

TIME = np.arange(201) * 1e-3
PAIRS = [("body", "wheel"), ("piston", "joint"), ("joint", "wheel"), ("wheel", "road"), ("body", "piston")]


def network(rng: np.random.Generator) -> str:
    """What becomes of a network: 'finite', or the kind of line that refuses it."""
    model = random_networks.draw(rng)
    try:
        out = simulate(model, TIME, random_networks.moves(rng, model, TIME))
    except InputError as error:
        if "\n" in str(error):
            return "more than a line"
        text = str(error)
        return next(
            (k for k in ("fails at", "cannot be stepped", "singular", "floats") if k in text), "refused"
        )
    return "finite" if all(np.isfinite(v).all() for v in out.values()) else "SILENT NAN"


def car(rng: np.random.Generator) -> str:
    """The car with one to three more laws, 40 steps at full current: rewards and observations are finite."""
    net = Network.load("quarter-car-isd")
    try:
        for i in range(rng.integers(1, 4)):
            kind = str(rng.choice(random_networks.BETWEEN))
            pair = PAIRS[int(rng.integers(len(PAIRS)))]
            net = net.with_element(random_networks.element(rng, f"x{i}", kind, pair, False))
        env = ISDSuspensionEnv(net)
    except InputError:
        return "car refused"
    env.reset(seed=int(rng.integers(1 << 30)))
    for _ in range(40):
        obs, reward, terminated, _, info = env.step(np.array([rng.choice([-5.0, 5.0])], np.float32))
        if not (np.isfinite(obs).all() and np.isfinite(reward) and np.isfinite(list(info.values())).all()):
            return "SILENT NAN"
        if terminated:
            return "car terminated"
    return "car finite"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    kept = json.loads(options.json.read_text()) if options.json and options.json.exists() else {}
    counts = collections.Counter(kept.get("counts", {}))
    wrong: list[list[object]] = kept.get("wrong", [])
    np.seterr(all="ignore")
    begun = clock.process_time()
    for seed in range(kept.get("done", 0), options.count):
        rng = np.random.default_rng([13, seed])
        try:
            kind = car(rng) if seed % 50 == 0 else network(rng)
        except Exception as error:
            kind = "TRACEBACK"
            wrong.append([seed, f"{type(error).__name__}: {error}"[:300]])
        if kind in ("SILENT NAN", "more than a line"):
            wrong.append([seed, kind])
        counts[kind] += 1
        if options.json and (seed % 500 == 499 or seed == options.count - 1):
            options.json.write_text(
                json.dumps({"done": seed + 1, "counts": dict(counts), "wrong": wrong}, indent=1) + "\n"
            )
    for kind, count in counts.most_common():
        print(f"{kind:<20}{count:>8}")
    for seed, what in wrong:
        print(seed, what)
    print(f"{(clock.process_time() - begun):.0f} s")


if __name__ == "__main__":
    main()
