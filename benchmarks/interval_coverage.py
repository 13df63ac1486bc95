"""How often the 95 % interval of a fitted parameter contains the true value, on fresh rigs of `benchmarks/rigs/families`.

python benchmarks/interval_coverage.py --seeds 0 200 [--families NAME ...] [--with exact small ...] [--json FILE]

The rigs are integrated by a Runge-Kutta of `benchmarks/rigs/families`, not by the simulator of the package. The structure of the nominal model is
right, its parameters are off by their stated uncertainty. Populations:

- `exact`: the records contain nothing else;
- `small`: each rig has one to three effects that the model lacks, each below 1.5 % of a channel's deviation;
- `law`: as `exact`, with Coulomb friction, which the nominal model has with a wrong level.

Only the nominal model is fitted (`SearchSettings(depth=0)`). For each parameter the file has truth, estimate, interval and prior.
"""

from __future__ import annotations

import argparse
import copy
import functools
import json
import math
import time
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from json_files import read_json, save_json

POPULATIONS = ("exact", "small", "law")
#: largest number of samples of a rig: a fit of a longer record takes minutes
LONGEST = 4000
#: half width of a 95 % interval over its standard deviation
HALF = 1.959963984540054
#: interval over that of the stated uncertainty below which a parameter counts as determined by the records
DETERMINED = 0.5


def make_rig(
    family: str, population: str, seed: int
) -> tuple[dict[str, Any], dict[str, float], list[Any]]:
    """Return the nominal model, the true parameters by path, and the records of a rig."""
    from rigs.families import FAMILIES
    from rigs.families.bench import changed, outputs, run, scale, set_relative
    from rigs.families.case import Noise, nuisances, sized, spreads
    from rigs.families.effects import coulomb

    from isd_gym import Network, Table

    for attempt in range(100):
        rng = np.random.default_rng(
            [zlib.crc32(f"coverage {family} {population}".encode()), seed, attempt]
        )
        rig = FAMILIES[family].draw(rng)
        if rig.size > LONGEST:
            continue
        spread = float(rng.choice([0.02, 0.05, 0.10, 0.20]))
        stated = spreads(rig, spread)
        snr_db = float(rng.uniform(*rig.snr_db))
        true = rig.model
        try:
            if population == "law" and rig.pairs:
                pair = rig.pairs[int(rng.integers(len(rig.pairs)))]
                plain = outputs(rig, true, run(rig, true, rig.drives[0]))
                make = coulomb(
                    rng, scale(rig, run(rig, true, rig.drives[0]), pair), pair
                )
                change = sized(
                    rig, make, 0.2, functools.partial(_moved, rig.model, plain)
                )
                true = changed(true, change, "law")
                stated["law_1.level"] = 0.3
            owner = copy.deepcopy(true)
            if population == "small":
                true = changed(true, nuisances(rig, set(), rng), "nuisance")
            seen = [outputs(rig, true, run(rig, true, drive)) for drive in rig.drives]
        except ArithmeticError:
            continue
        owner["uncertainty"] = stated
        for path, sigma in stated.items():
            set_relative(
                owner, path, sigma * float(np.clip(rng.standard_normal(), -2.0, 2.0))
            )
        truth = Network.load(
            {**copy.deepcopy(rig.model if population != "law" else true)}
        ).parameters
        sensors = Noise.draw(
            rng, owner, {k: float(np.std(y)) for k, y in seen[0].items()}, snr_db
        )
        tables = []
        for drive, y in zip(rig.drives, seen, strict=True):
            record = sensors.record(rng, rig, drive, y)
            tables.append(
                Table(
                    time=record.pop("time"),
                    columns=record,
                    source=f"{family}_{seed}_{len(tables)}",
                )
            )
        return owner, truth, tables
    raise ArithmeticError(f"{family} {seed}: no rig with at most {LONGEST} samples")


def _moved(
    model: dict[str, Any], plain: dict[str, Any], outputs: dict[str, Any]
) -> float:
    """Return the largest change of a channel as a share of its deviation."""
    from rigs.families.bench import shares

    return max(shares(model, outputs, plain).values())


def case(family: str, population: str, seed: int) -> dict[str, Any]:
    """Return truth, estimate, interval and prior of each parameter of a rig."""
    from isd_gym import diagnose
    from isd_gym.diagnosis import SearchSettings

    model, truth, tables = make_rig(family, population, seed)
    begun = time.perf_counter()
    result = diagnose(
        tables,
        model,
        accept=["all"],
        settings=SearchSettings(depth=0, jobs=1, max_seconds=60.0),
    )
    rows = [
        {
            "path": path, "truth": truth[path], "prior": q.prior, "sigma": model["uncertainty"].get(path),
            "value": q.value, "low": q.low, "high": q.high,
        }
        for path, q in result.parameters.items()
    ]  # fmt: skip
    return {
        "family": family, "population": population, "seed": seed, "verdict": result.verdict, "parameters": rows,
        "error": list(result.gap["refit"].values()), "seconds": time.perf_counter() - begun,
    }  # fmt: skip


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the coverage of the intervals of all parameters, and of those that the records determine."""
    out: dict[str, Any] = {"rigs": len(rows)}
    every = [p for r in rows for p in r["parameters"]]
    known = [p for p in every if _width(p) < DETERMINED * HALF * p["sigma"]]
    for name, of in (("all", every), ("determined", known)):
        if not of:
            continue
        inside = [p["low"] <= p["truth"] <= p["high"] for p in of]
        errors = np.array([abs(math.log(p["value"] / p["truth"])) for p in of])
        widths = np.array([_width(p) for p in of])
        share = float(np.mean(inside))
        out[name] = {
            "parameters": len(of),
            "coverage": share,
            "standard_error": math.sqrt(share * (1 - share) / len(of)),
            "median_half_width": float(np.median(widths)),
            "median_error": float(np.median(errors)),
            # 1 where the interval is that of a normal distribution of the errors
            "half_width_over_error": float(
                np.median(widths) / HALF * 0.6745 / max(np.median(errors), 1e-300)
            ),
        }
    return out


def _width(p: dict[str, Any]) -> float:
    """Return half of an interval as the logarithm of a factor."""
    return 0.5 * math.log(p["high"] / p["low"]) if p["low"] > 0 else math.inf


def main() -> None:
    from rigs.families import FAMILIES

    from isd_gym import InputError

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--seeds", type=int, nargs=2, required=True, metavar=("FIRST", "END")
    )
    parser.add_argument(
        "--families",
        nargs="+",
        choices=FAMILIES,
        default=[f for f in FAMILIES if f != "half_car"],
    )
    parser.add_argument(
        "--with",
        dest="populations",
        nargs="+",
        choices=POPULATIONS,
        default=list(POPULATIONS[:2]),
    )
    parser.add_argument(
        "--json", type=Path, help="file of the results; a run goes on with it"
    )
    args = parser.parse_args()
    rows = read_json(args.json)["rigs"] if args.json and args.json.exists() else []
    done = {(r["family"], r["population"], r["seed"]) for r in rows}
    for seed in range(*args.seeds):
        family = args.families[seed % len(args.families)]
        for population in args.populations:
            if (family, population, seed) in done:
                continue
            try:
                rows.append(case(family, population, seed))
            except (
                ArithmeticError,
                InputError,
            ) as error:  # a rig that cannot be fitted has no interval
                print(f"{family} {population} {seed}: {error}", flush=True)
                continue
            inside = sum(
                p["low"] <= p["truth"] <= p["high"] for p in rows[-1]["parameters"]
            )
            print(
                f"{family:10s} {population:6s} seed {seed}: {inside} of {len(rows[-1]['parameters'])} inside, "
                f"{rows[-1]['verdict']} ({rows[-1]['seconds']:.0f} s)", flush=True,
            )  # fmt: skip
            if args.json:
                found = {
                    p: summary([r for r in rows if r["population"] == p])
                    for p in args.populations
                }
                save_json(args.json, {"summary": found, "rigs": rows})
    for population in args.populations:
        print(
            population,
            json.dumps(
                summary([r for r in rows if r["population"] == population]), indent=1
            ),
        )


if __name__ == "__main__":
    main()
