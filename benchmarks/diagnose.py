"""Run the diagnosis over a folder of rigs with sealed effects, or over the project's own hidden suite, and print the figures.

python benchmarks/diagnose.py FOLDER [NAME ...] [--json FILE] [--detail]
python benchmarks/diagnose.py --suite [KIND ...] --seeds 1 2
python benchmarks/diagnose.py --again FILE

Seconds are processor time, both threads together.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import traceback
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from isd_gym.data import Table
from isd_gym.discrepancy import workflow
from isd_gym.network import Network


def text(a) -> str:
    return np.array2string(np.asarray(a), precision=3, suppress_small=True)


def pair(place):
    return None if place is None else frozenset([place] if isinstance(place, str) else place)


def same(found, answer) -> bool:
    """Every effect named, in the right place (None: anywhere), and nothing else."""
    if len(found) != len(answer):
        return False
    left = list(found)
    for what, where in answer:
        hit = next((f for f in left if f[0] == what and (where is None or f[1] == pair(where))), None)
        if hit is None:
            return False
        left.remove(hit)
    return True


#: parameter of an effect -> its name in the sealed truth of a folder of rigs
SEALED = {
    "quadratic_damping.damping": "c2dev",
    "cubic_stiffness.stiffness": "k3",
    "bump_stop.clearance": "bump_gap",
    "bump_stop.stiffness": "bump_k",
    "thrust_saturation.current": "sat_I",
    "actuator_lag.time_constant": "lag_tau",
    "linear_damping.damping": "ct",
    "cogging_force.amplitude": "cog_amp",
    "cogging_force.pitch": "cog_pitch",
    "stribeck_friction.level": "f",
    "stribeck_friction.static_level": "stribeck_fs",
    "stribeck_friction.stribeck_velocity": "stribeck_vs",
}


def truths(row) -> dict[str, float]:
    """The sealed values of the parameters of what was named, as far as the truth tells them."""
    truth = row["truth"]
    if isinstance(truth, dict):
        out = {k: truth[v] for k, v in SEALED.items() if v in truth}
        if "bw_A" in truth:  # dz = A v - beta (|v| z + v |z|): stiffness A, saturation at A / (2 beta)
            out["hysteresis.stiffness"] = truth["bw_A"]
            out["hysteresis.level"] = truth["bw_A"] / (2 * truth["bw_beta"])
        places = dict((e, set(w)) for e, w in row["found"])
        key = "strut_f" if places.get("coulomb_friction") == {"body", "wheel"} else "f"
        if key in truth:
            out["coulomb_friction.level"] = truth[key]
        return out
    return {
        f"{e['type']}.{k}": v
        for e in truth
        for k, v in e.items()
        if isinstance(v, int | float) and not isinstance(v, bool)
    }


def grade(verdict: str, found, answer) -> str:
    if answer == "unknown":
        return "right" if verdict == "unknown_effect" else "wrong" if found else "missed"
    if not answer:
        return "wrong" if found else "right" if verdict in ("no_discrepancy", "parameters_only") else "missed"
    if same(found, answer):
        return "right"
    return "wrong" if found else "missed"


def one(name, estimation, validation, model, answer, detail):
    t0 = time.process_time()
    captured = {}
    original = workflow.Workflow.conclude

    def conclude(self, *args):
        captured["w"] = self
        return original(self, *args)

    workflow.Workflow.conclude = conclude
    try:
        d = workflow.diagnose([estimation], model, validate=[validation])
    except Exception as error:
        traceback.print_exc(limit=-4)
        return {
            "name": name,
            "grade": "error",
            "verdict": type(error).__name__,
            "seconds": time.process_time() - t0,
            "answer": answer,
            "found": [],
        }
    finally:
        workflow.Workflow.conclude = original
    seconds = time.process_time() - t0
    found = [(e.effect, pair(e.channel or (list(e.between) if e.between else None))) for e in d.effects]
    g = grade(d.verdict, found, answer)
    row = {
        "name": name,
        "answer": answer,
        "verdict": d.verdict,
        "found": [(a, sorted(b or [])) for a, b in found],
        "grade": g,
        "closed": d.closed,
        "seconds": seconds,
        "parameters": {
            f"{e.effect}.{k}": (q.value, q.low, q.high) for e in d.effects for k, q in e.parameters.items()
        },
        "base": {k: (q.value, q.low, q.high) for k, q in d.parameters.items()},
    }
    closed = "-" if d.closed is None else f"{d.closed:.3f}"
    print(f"{g:6s} {name} {seconds:5.1f}s closed {closed} {d.verdict} {row['found']} <- {answer}", flush=True)
    if detail and "w" in captured:
        w = captured["w"].weighed
        refit, after = ([*d.gap[row].values()] for row in ("refit", "after"))
        print(
            f"        before {text(w.before)} refit {text(refit)} after {text(after)} floor {text(w.floor)} small {text(w.worth)}"
        )
        print(
            f"        noise {w.quiet:.3f} explained {w.explained:.3f} gaps {text(w.gaps)} abreast {[r.hypotheses[-1].label for r in w.abreast]}"
        )
        for t in w.table:
            print("        ", t)
        for stage in w.stages:
            for r in stage[:5]:
                s = w.stood.get(id(r))
                values = {
                    q.path.split(".")[-1]: float(f"{q.back(x):.3g}")
                    for q, x in zip(r.fit.structure.free, r.fit.x, strict=True)
                    if q.owner >= 0
                }
                print(
                    f"           L {r.likelihood - stage[0].likelihood:8.0f} V {s.score if s else float('nan'):.3f}",
                    r.hypotheses[-1].label,
                    values,
                )
        print(
            "        ",
            {
                k: f"{q.value:.4g} [{q.low:.4g}, {q.high:.4g}]"
                for e in d.effects
                for k, q in e.parameters.items()
            },
            flush=True,
        )
    return row


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?")
    parser.add_argument("names", nargs="*")
    parser.add_argument("--suite", nargs="*")
    parser.add_argument("--seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--json")
    parser.add_argument("--detail", action="store_true")
    parser.add_argument("--again", help="print the figures of a file written with --json, and run nothing")
    args = parser.parse_args()
    if args.again:
        return summary(json.loads(Path(args.again).read_text()))
    rows = []
    if args.folder:
        folder = Path(args.folder)
        truth = json.loads((folder / "truth.json").read_text())
        for name in sorted(truth, key=lambda s: s[-3:]):
            if args.names and not any(n in name for n in args.names):
                continue
            case = folder / name
            row = one(
                f"{name} {truth[name]['kind']}",
                case / "estimation.csv",
                case / "validation.csv",
                case / "model.json",
                truth[name]["answer"],
                args.detail,
            )
            row["truth"] = truth[name]["truth"]
            rows.append(row)
    if args.suite is not None:
        sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
        import hidden

        for seed in args.seeds:
            for kind in args.suite or hidden.ALL_KINDS:
                try:
                    case = hidden.make_case(kind, seed)
                except ArithmeticError as error:
                    print(f"no data {kind} #{seed}: the reference integrator says {error}", flush=True)
                    continue
                tables = []
                for k, columns in (("estimation", case.estimation), ("validation", case.validation)):
                    columns = dict(columns)
                    tables.append(Table(columns.pop("time"), columns, k))
                row = one(
                    f"{kind} #{seed} {case.snr_db:.0f}dB",
                    tables[0],
                    tables[1],
                    Network.load(case.model),
                    case.answer,
                    args.detail,
                )
                row["truth"] = case.truth["hidden"]
                rows.append(row)
    summary(rows)
    if args.json:
        Path(args.json).write_text(json.dumps(rows, default=str))


def summary(rows) -> None:
    groups = {
        "effects": [r for r in rows if r["answer"] not in ("unknown", [])],
        "clean": [r for r in rows if r["answer"] == []],
        "unknown": [r for r in rows if r["answer"] == "unknown"],
    }
    print()
    for name, group in groups.items():
        if group:
            count = Counter(r["grade"] for r in group)
            print(
                f"{name:8s} {len(group):3d}: "
                + ", ".join(f"{k} {v} ({100 * v / len(group):.0f} %)" for k, v in count.items())
            )
    closed = [r["closed"] for r in rows if r.get("closed") is not None]
    if closed:
        print(f"closed   median {np.median(closed):.3f}, least {min(closed):.3f}")
    errors, inside = [], []
    for r in rows:
        if r["grade"] != "right":
            continue
        known = truths(r)
        for name, (value, low, high) in r.get("parameters", {}).items():
            if known.get(name):
                errors.append(abs(value / known[name] - 1))
                inside.append(low <= known[name] <= high)
    if errors:
        print(
            f"values   error median {100 * np.median(errors):.1f} %, "
            f"95 % intervals hold {sum(inside)} of {len(inside)}"
        )
    print(
        f"time     median {np.median([r['seconds'] for r in rows]):.1f} s, longest {max(r['seconds'] for r in rows):.1f} s"
    )
    print("\nconfusion (what was hidden -> what was said)")
    table = Counter()
    for r in rows:
        said = "+".join(sorted(f[0] for f in r["found"])) or r["verdict"]
        truth = (
            "unknown"
            if r["answer"] == "unknown"
            else "+".join(sorted(a[0] for a in r["answer"])) or "nothing"
        )
        table[truth, said] += 1
    for (truth, said), n in sorted(table.items()):
        print(f"  {truth:45s} -> {said:45s} {n}")


if __name__ == "__main__":
    main()
