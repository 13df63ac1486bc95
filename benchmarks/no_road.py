"""The diagnosis of a car on a road that nobody measured: cut at the wheel, whose accelerometer drives what stands above it.

python benchmarks/no_road.py --seeds 1 2 3 [--kinds KIND ...] [--known] [--json FILE]

The cars of the hidden suite (an integrator of its own, base parameters off, small effects besides, noise of 26 to 40 dB), with an accelerometer at
the wheel whose noise is that of the suite's road column times `COARSER`. Each case is the command `isd-gym diagnose --cut wheel` to its
end, report included. Without --known the road and the tyre's force are taken away; with --known the data hold both, as a comparison.
The benchmark continues FILE where it exists.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import io
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

KINDS = ("friction_strut", "friction_device", "asym_damper", "bump_stop", "none")
WHEEL = {"name": "wheel_acceleration", "quantity": "acceleration", "at": "wheel", "unit": "m/s^2"}
ROAD_NOISE, COARSER = 2e-3, 2.5  # of the deviation


def car_with_wheel(r: Any, secret: Any) -> dict[str, Any]:
    """The suite's car with one more sensor."""
    from rigs.hidden.car import car_base

    model = car_base(r, secret)
    return {**model, "outputs": [*model["outputs"], dict(WHEEL)]}


def case(kind: str, seed: int, known: bool) -> dict[str, Any]:
    """Identify one car and return the result beside the truth."""
    from rigs.hidden import make

    from isd_gym.physics.network import Network
    from isd_gym.records.data import Table, write_table

    rng = np.random.default_rng([seed, KINDS.index(kind)])
    snr = float(rng.choice([26.0, 32.0, 40.0]))
    usual, noise, drawn = make.FAMILIES["car"], make._ar1, 0

    def quieter(r: Any, size: int, deviation: float) -> Any:
        nonlocal drawn
        drawn += 1
        wheel = drawn % 5 == 0  # the last of five outputs
        return noise(r, size, deviation * (COARSER * ROAD_NOISE * 10 ** (snr / 20) if wheel else 1.0))

    make.FAMILIES["car"], make._ar1 = (car_with_wheel, *usual[1:]), quieter
    try:
        made = make.make_case(kind, seed, snr_db=snr)
    finally:
        make.FAMILIES["car"], make._ar1 = usual, noise
    owner = copy.deepcopy(made.model)
    tables = []
    for name, record in (("estimation", made.estimation), ("validation", made.validation)):
        columns = {k: v for k, v in record.items() if k != "time"}
        if known:
            del columns["wheel_acceleration"]
        else:
            del columns["road"], columns["tyre_force"]
        tables.append(Table(time=record["time"], columns=columns, source=name))
    if known:
        owner["outputs"] = [c for c in owner["outputs"] if c["name"] != "wheel_acceleration"]
    begun = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for table in tables:
            write_table(place / f"{table.source}.csv", table)
        Network.load(owner).save(place / "model.json")
        result = command(place, [] if known else ["--cut", "wheel"])
    found = sorted([e["effect"], e.get("between") or [e["channel"]]] for e in result["effects"])
    truth = sorted([e, list(w)] for e, w in made.answer)
    same = [(e, sorted(w)) for e, w in found] == [(e, sorted(w)) for e, w in truth]
    agreed = result["verdict"] in ("no_discrepancy", "parameters_only")
    right = agreed if not truth else same
    return {
        "kind": kind, "seed": seed, "known": known, "verdict": result["verdict"], "found": found, "truth": truth, "right": right,
        "wrong_name": bool(found) and not same, "gap": result["gap"]["held_out"], "summary": result["summary"], "seconds": time.process_time() - begun,
    }  # fmt: skip


def command(place: Path, more: list[str]) -> dict[str, Any]:
    """Run `isd-gym diagnose` and return its diagnosis.json.

    Args:
        place: Folder with estimation.csv, validation.csv and model.json.
        more: Further words of the command line.

    Raises:
        RuntimeError: Where the command fails or one of its files is absent.
    """
    from isd_gym._commands import app
    from isd_gym.physics.network import Network

    out = place / "found"
    words = ["diagnose", place / "estimation.csv", "--validate", place / "validation.csv"]
    words += ["--model", place / "model.json", "--out", out, *more]
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        status = app([str(w) for w in words], standalone_mode=False)
    missing = [f for f in ("diagnosis.json", "model.json", "report.html") if not (out / f).exists()]
    if status or missing:
        raise RuntimeError(f"exit status {status or 0}, absent: {', '.join(missing) or 'nothing'}")
    Network.load(out / "model.json")
    found: dict[str, Any] = json.loads((out / "diagnosis.json").read_text())
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS))
    parser.add_argument("--known", action="store_true")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rows = json.loads(args.json.read_text()) if args.json and args.json.exists() else []
    done = {(r["kind"], r["seed"], r["known"]) for r in rows}
    for seed in args.seeds:
        for kind in args.kinds:
            if (kind, seed, args.known) in done:
                continue
            row = case(kind, seed, args.known)
            rows.append(row)
            said = "right" if row["right"] else "WRONG NAME" if row["wrong_name"] else "missed"
            print(
                f"{kind:18s} seed {seed}: {said:10s} {row['verdict']:15s} {row['found']} ({row['seconds']:.0f} s)",
                flush=True,
            )
            if args.json:
                args.json.write_text(json.dumps(rows, indent=1) + "\n")
    mine = [r for r in rows if r["known"] == args.known and r["seed"] in args.seeds]
    for kind in args.kinds:
        of = [r for r in mine if r["kind"] == kind]
        print(
            f"{kind:18s} right {sum(r['right'] for r in of)} of {len(of)}, wrong names {sum(r['wrong_name'] for r in of)}"
        )


if __name__ == "__main__":
    main()
