"""How well the lag of another logger's clock is found, on rigs of every family: python benchmarks/lags.py [--seeds 1 2] [KIND ...]

The inputs are on one logger, the outputs on another whose stamps are late or early (of a rig without inputs the first output is on
one, the rest on the other). Only the estimation record is used, with the nominal model: parameters are off, and the hidden effect of KIND is missing.
Without KIND every family's clean rig and one with an effect are drawn.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from rigs.families import FAMILIES, make_case

from isd_gym._common.errors import InputError
from isd_gym.diagnosis._estimation.clock_lag import align_clocks
from isd_gym.diagnosis._records.multirate import build_record
from isd_gym.physics.network import Network
from isd_gym.records._loggers import Recording, Signal


def split(case: Any, network: Network, lag: float) -> Recording | None:
    """The estimation record as two loggers wrote it; None where there is one channel only."""
    inputs, outputs = [[c.name for c in side] for side in (network.inputs, network.outputs)]
    first = inputs or outputs[:1]
    if not inputs and len(outputs) < 2:
        return None
    stamps = case.estimation["time"]
    signals = {}
    for c in (*network.inputs, *network.outputs):
        own = c.name in first
        signals[c.name] = Signal(
            stamps if own else stamps + lag,
            case.estimation[c.name],
            c.si,
            "first" if own else "second",
            c.name,
        )
    return Recording(case.name, signals)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kinds", nargs="*", metavar="KIND")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--lags", type=float, nargs="+", default=[0.02, -0.02], help="[s]")
    parser.add_argument(
        "--completed",
        action="store_true",
        help="what is hidden is in the model, as after a diagnosis that named it",
    )
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    kinds = options.kinds or [f"{f}.{k}" for f, made in FAMILIES.items() for k in list(made.kinds)[:2]]
    rows = []
    for kind in kinds:
        for seed in options.seeds:
            try:
                case = make_case(kind, seed)
            except ArithmeticError:
                continue
            network = Network.load(case.model)
            if options.completed:
                for e in case.truth["hidden"]:
                    network = network.with_element({**e, "name": f"found_{e['type']}"})
            for lag in options.lags:
                run = split(case, network, lag)
                if run is None:
                    break
                begun = time.process_time()
                row: dict[str, Any] = {"kind": kind, "seed": seed, "lag": lag, "snr_db": case.snr_db}
                try:
                    record = build_record(run, network)
                    _, (found,) = align_clocks([record], network)
                    told = (found.value, found.low, found.high)
                    if (
                        found.clock == "first"
                    ):  # the clock with more channels is the one that others are told by
                        told = (-found.value, -found.high, -found.low)
                    row |= dict(zip(("found", "low", "high"), told, strict=True)) | {"doubt": found.doubt}
                    row |= {"step": record.step, "pace": record.pace}
                except InputError as error:
                    row["error"] = str(error)
                row["seconds"] = time.process_time() - begun
                rows.append(row)
                print(line(row), flush=True)
    good = [r for r in rows if "found" in r]
    off = np.abs([r["found"] - r["lag"] for r in good])
    inside = np.mean([r["low"] <= r["lag"] <= r["high"] for r in good])
    print(
        f"{len(good)} of {len(rows)}: median error {1e3 * np.median(off):.3f} ms, within 1 ms {np.mean(off < 1e-3):.0%}, interval holds "
        f"the truth {inside:.0%}; of those without a doubt {np.mean(off[[not r['doubt'] for r in good]] < 1e-3):.0%} within 1 ms"
    )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def line(row: dict[str, Any]) -> str:
    head = f"{row['kind']:28} {row['seed']:3d} {1e3 * row['lag']:+6.1f} ms: "
    if "error" in row:
        return head + row["error"]
    return head + (
        f"{1e3 * row['found']:+9.3f} [{1e3 * row['low']:+.3f}, {1e3 * row['high']:+.3f}], off {1e3 * (row['found'] - row['lag']):+.3f}; step "
        f"{1e3 * row['step']:.3g} ms, motion {1e3 * row['pace']:.3g} ms, {row['snr_db']:.0f} dB, {row['seconds']:.1f} s {row['doubt']}"
    )


if __name__ == "__main__":
    main()
