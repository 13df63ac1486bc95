"""MissingPhysBench: rigs with a known model, an unknown missing effect and a sealed truth, for any identification tool.

python benchmarks/missing_physics.py make FOLDER --seed N [--full]  FOLDER (cases) and FOLDER.truth (truth, for the scorer)
python benchmarks/missing_physics.py run FOLDER --tool NAME --out ANSWERS
python benchmarks/missing_physics.py score FOLDER ANSWERS [--json FILE]

`score` needs Python and numpy; this file alone is enough. `make` needs a source tree of isd_gym. `run` needs the
packages of the tool (missing_physics_tools.py). `make` draws every kind at one noise level, with --full at both. The format of cases and answers: docs/guides/missing-physics.md.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

#: the six sets: name -> kinds, "rig.what"
SETS: dict[str, tuple[str, ...]] = {
    "nothing": ("shaken.none", "pushed.none"),
    "one effect": (
        "shaken.friction_ground",
        "shaken.asymmetric",
        "two_masses.cubic_upper",
        "pushed.quadratic",
    ),
    "two effects": ("shaken.friction_ground_and_cubic", "pushed.friction_and_cubic"),
    "outside the library": ("shaken.tanh", "pushed.switched"),
    "faulty sensor": ("two_masses.gain", "pushed.delay"),
    "closed loop": ("loop.friction", "loop.cubic"),
}
#: signal-to-noise ratios of every channel [dB]
LEVELS = (40, 26)
#: smallest and largest number of samples of a record
SAMPLES = (600, 3000)
#: laws that an answer may name: force over distance d [m] and rate v [m/s], or what the channel reads
LAWS = {
    "coulomb_friction": "level * sign(v)",
    "stribeck_friction": "(level + (static_level - level) * exp(-(v / stribeck_velocity)^2)) * sign(v)",
    "linear_damping": "damping * v, where the model has no damper",
    "quadratic_damping": "damping * v * |v|",
    "asymmetric_damping": "extension * v for v > 0, compression * v for v < 0",
    "linear_stiffness": "stiffness * d, where the model has no spring",
    "cubic_stiffness": "stiffness * d^3",
    "gas_spring": "force * (1 - (1 + d / length)^-exponent)",
    "bump_stop": "stiffness * (d - clearance) for d > clearance, and likewise for d < -clearance",
    "hysteresis": "Bouc-Wen force of level and stiffness",
    "cogging_force": "amplitude * sin(2 pi d / pitch + phase)",
    "backlash": "a spring with a gap",
    "inertance": "inertance * a",
    "sensor_gain": "the channel reads gain * truth",
    "sensor_delay": "the channel reads the truth of `delay` seconds ago",
    "sensor_bias": "the channel reads truth + bias",
}
#: a statement counts as made from this probability on
STATED = 0.5

Answer = dict[str, Any]
Columns = dict[str, np.ndarray]


# ------------------------------------------------------------------------------------------------------------- files
def read_csv(path: Path) -> Columns:
    """Return the columns of a table with a header."""
    with path.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
    values = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    return dict(zip(names, values.T, strict=True))


def write_csv(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of equal length with a header."""
    table = np.column_stack(list(columns.values()))
    np.savetxt(
        path, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments=""
    )


def sealed(folder: Path) -> Path:
    """Return the folder of the truth of a folder of cases."""
    return folder.with_name(folder.name + ".truth")


def digest(folder: Path) -> str:
    """Return the SHA-256 of all files of a folder, in the order of their names."""
    total = hashlib.sha256()
    for path in sorted(folder.iterdir()):
        total.update(path.name.encode() + b"\0" + path.read_bytes())
    return total.hexdigest()


# ------------------------------------------------------------------------------------------------------------- score
def key_of(place: Any) -> tuple[str, ...]:
    """Return a place as a sorted tuple: two terminals in any order, or one channel."""
    return (place,) if isinstance(place, str) else tuple(sorted(place))


def statements(answer: Answer) -> dict[tuple[tuple[str, ...], str], float]:
    """Return the probability of every stated (place, law)."""
    return {
        (key_of(e["place"]), e["law"]): float(e.get("probability", 1.0))
        for e in answer["effects"]
        if e.get("law") is not None
    }


def places(answer: Answer) -> set[tuple[str, ...]]:
    """Return the stated places, those without a law included."""
    return {
        key_of(e["place"])
        for e in answer["effects"]
        if float(e.get("probability", 1.0)) >= STATED
    }


def prediction_error(truth: Columns, prediction: Columns) -> float:
    """Return the root mean square over channels of RMS error over standard deviation; inf where values are missing."""
    errors = []
    for name, y in truth.items():
        if name == "time":
            continue
        x = prediction.get(name)
        if x is None or x.shape != y.shape or not np.isfinite(x).all():
            return float("inf")
        errors.append(float(np.mean((x - y) ** 2) / np.var(y)))
    return float(np.sqrt(np.mean(errors)))


def score_case(
    truth: Mapping[str, Any],
    test: Columns,
    answer: Answer | None,
    prediction: Columns | None,
) -> dict[str, Any]:
    """Score the answer for one case.

    Args:
        truth: Entry of truth.json.
        test: Noise-free outputs for the test input.
        answer: The answer; None counts as an answer without a statement.
        prediction: Predicted outputs for the test input; None if there is no prediction.

    Returns:
        Row of the case.
    """
    answer = {"effects": []} if answer is None else answer
    true = {(key_of(e["place"]), e["law"]) for e in truth["effects"]}
    small = {(key_of(e["place"]), e["law"]) for e in truth["nuisances"]}
    true_places = {key_of(p) for p in truth["places"]}
    said = {s: p for s, p in statements(answer).items() if s not in small - true}
    named = {s for s, p in said.items() if p >= STATED}
    stated = {
        p
        for p in places(answer)
        if p in true_places or p not in {place for place, _ in small}
    }
    row: dict[str, Any] = {
        "set": truth["set"],
        "noise_db": truth["noise_db"],
        "named": sorted([law, *place] for place, law in named),
        "truth": sorted([law, *place] for place, law in true),
        "nameable": bool(true),
        "right": bool(true) and named == true,
        "wrong": bool(named - true),
        "abstained": not named,
        "place": [
            len(stated & true_places),
            len(stated - true_places),
            len(true_places - stated),
        ],
        "brier": [
            (said.get(s, 0.0) - (s in true)) ** 2 for s in sorted(true | set(said))
        ]
        or [0.0],
        "bias": {
            path: answer["parameters"][path] / value - 1.0
            for path, value in truth["parameters"].items()
            if path in answer.get("parameters", {})
        },
        "seconds": answer.get("seconds"),
        "error": None if prediction is None else prediction_error(test, prediction),
        "nominal_error": truth["nominal_error"],
    }
    if truth["places"] and row["error"] is not None:
        # a divergent prediction is as bad as an error of twice the reference in squares
        row["reduction"] = max(-1.0, 1.0 - (row["error"] / truth["nominal_error"]) ** 2)
    return row


def summarise(rows: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of scored cases; None where no case has the figure."""
    rows = list(rows)

    def mean(values: list[Any]) -> float | None:
        return float(np.mean(values)) if values else None

    def median(values: list[Any]) -> float | None:
        return float(np.median(values)) if values else None

    hit, false, missed = (sum(r["place"][k] for r in rows) for k in range(3))
    bias = [abs(b) for r in rows for b in r["bias"].values()]
    reductions = [r["reduction"] for r in rows if "reduction" in r]
    return {
        "cases": len(rows),
        "place_f1": 2 * hit / (2 * hit + false + missed)
        if hit + false + missed
        else None,
        "law_accuracy": mean([r["right"] for r in rows if r["nameable"]]),
        "wrong_names": mean([r["wrong"] for r in rows]),
        "abstention": mean([r["abstained"] for r in rows if not r["nameable"]]),
        "brier": mean([b for r in rows for b in r["brier"]]),
        "parameter_error": median(bias),
        "error_reduction": median(reductions),
        "seconds": median([r["seconds"] for r in rows if r["seconds"] is not None]),
    }


def score(folder: Path, answers: Path) -> dict[str, Any]:
    """Score a folder of answers.

    Args:
        folder: Folder of the cases.
        answers: Folder with CASE/answer.json and CASE/prediction.csv.

    Returns:
        Figures over all cases, by set, by noise level, and the rows.
    """
    truth_folder = sealed(folder)
    seal = json.loads((folder / "benchmark.json").read_text(encoding="utf-8"))
    if digest(truth_folder) != seal["truth_sha256"]:
        raise SystemExit(
            f"{truth_folder}: not the truth that {folder}/benchmark.json was sealed with"
        )
    rows = {}
    for name, truth in json.loads(
        (truth_folder / "truth.json").read_text(encoding="utf-8")
    ).items():
        said, predicted = (
            answers / name / "answer.json",
            answers / name / "prediction.csv",
        )
        rows[name] = score_case(
            truth,
            read_csv(truth_folder / f"{name}.csv"),
            json.loads(said.read_text(encoding="utf-8")) if said.exists() else None,
            read_csv(predicted) if predicted.exists() else None,
        )
    kinds = list(dict.fromkeys(r["set"] for r in rows.values()))
    levels = sorted({r["noise_db"] for r in rows.values()}, reverse=True)
    about = answers / "run.json"
    return {
        "seed": seal["seed"],
        **(json.loads(about.read_text(encoding="utf-8")) if about.exists() else {}),
        "all": summarise(rows.values()),
        "sets": {
            k: summarise(r for r in rows.values() if r["set"] == k) for k in kinds
        },
        "noise": {
            str(n): summarise(r for r in rows.values() if r["noise_db"] == n)
            for n in levels
        },
        "rows": rows,
    }


def table(figures: Mapping[str, Any]) -> str:
    """Return the figures over all cases and by set, as text."""
    heads = [
        "set",
        "cases",
        "place F1",
        "law",
        "wrong",
        "abst.",
        "Brier",
        "par.",
        "reduc.",
        "s",
    ]
    lines = ["".join(f"{h:>9s}" if k else f"{h:22s}" for k, h in enumerate(heads))]
    for name, f in {**figures["sets"], "all": figures["all"]}.items():
        cells = [
            f"{v:9.2f}" if isinstance(v, float) else f"{'-' if v is None else v:>9}"
            for v in f.values()
        ]
        lines.append(f"{name:22s}" + "".join(cells))
    return "\n".join(lines)


# -------------------------------------------------------------------------------------------------------------- make
def plan(full: bool) -> list[tuple[str, str, int]]:
    """Return set, kind and noise level of every case: every set has both levels."""
    return [
        (which, kind, level)
        for which, kinds in SETS.items()
        for k, kind in enumerate(kinds)
        for level in (LEVELS if full else (LEVELS[k % len(LEVELS)],))
    ]


def make(folder: Path, seed: int, full: bool = False) -> None:
    """Write the cases of a seed, and their truth beside them.

    Args:
        folder: New folder of the cases; the truth is in `sealed(folder)`.
        seed: Seed of all random numbers.
        full: Whether every kind is drawn at both noise levels.
    """
    import missing_physics_rigs as rigs

    truth_folder = sealed(folder)
    folder.mkdir(parents=True)
    truth_folder.mkdir()
    wanted, truths = plan(full), {}
    order = np.random.default_rng(seed).permutation(
        len(wanted)
    )  # the number says nothing about the set
    for number, (which, kind, level) in zip(order, wanted, strict=True):
        name = f"case_{number + 1:02d}"
        files, test, truth = rigs.make_case(kind, seed, level, SAMPLES)
        model = files.pop("model")
        place = folder / name
        place.mkdir()
        (place / "model.json").write_text(
            json.dumps(model, indent=1) + "\n", encoding="utf-8"
        )
        for file, columns in files.items():
            write_csv(place / f"{file}.csv", columns)
        write_csv(truth_folder / f"{name}.csv", test)
        truths[name] = {"set": which, "kind": kind, "noise_db": level, **truth}
        print(
            name,
            which,
            kind,
            f"{level} dB",
            f"nominal error {truth['nominal_error']:.3f}",
            flush=True,
        )
    ordered = dict(sorted(truths.items()))
    (truth_folder / "truth.json").write_text(
        json.dumps(ordered, indent=1) + "\n", encoding="utf-8"
    )
    head = {
        "name": "MissingPhysBench",
        "version": 1,
        "seed": seed,
        "cases": list(ordered),
        "laws": LAWS,
        "truth_sha256": digest(truth_folder),
    }
    (folder / "benchmark.json").write_text(
        json.dumps(head, indent=1) + "\n", encoding="utf-8"
    )


# --------------------------------------------------------------------------------------------------------------- run
def run(folder: Path, tool: str, answers: Path, only: list[str] | None = None) -> None:
    """Write the answers of a tool. Cases that have an answer are left out.

    Args:
        folder: Folder of the cases.
        tool: Key of `missing_physics_tools.TOOLS`.
        answers: Folder of the answers.
        only: Names of cases; all without.
    """
    import missing_physics_tools as tools

    names = json.loads((folder / "benchmark.json").read_text(encoding="utf-8"))["cases"]
    answers.mkdir(parents=True, exist_ok=True)
    (answers / "run.json").write_text(
        json.dumps({"tool": tool, "packages": tools.versions(tool)}), encoding="utf-8"
    )
    for name in only or names:
        out = answers / name
        if (out / "answer.json").exists():
            continue
        out.mkdir(parents=True, exist_ok=True)
        began = time.perf_counter()
        try:
            answer, prediction = tools.TOOLS[tool](folder / name, out)
        except Exception as error:  # a tool that fails has made no statement
            answer, prediction = (
                {"effects": [], "error": f"{type(error).__name__}: {error}"},
                None,
            )
        # `seconds` is processor time; a tool with a process of its own measures there
        answer = (
            {"seconds": tools.processor_seconds(), **answer}
            if "seconds" not in answer
            else answer
        )
        if prediction is not None:
            write_csv(out / "prediction.csv", prediction)
        (out / "answer.json").write_text(
            json.dumps(answer, indent=1) + "\n", encoding="utf-8"
        )
        said = [
            (e["law"], e["place"], round(e.get("probability", 1.0), 3))
            for e in answer["effects"]
        ]
        print(
            name,
            f"{time.perf_counter() - began:.0f} s",
            said,
            answer.get("error", ""),
            flush=True,
        )


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    of_make = commands.add_parser("make")
    of_run = commands.add_parser("run")
    of_score = commands.add_parser("score")
    for each in (of_make, of_run, of_score):
        each.add_argument("folder", type=Path)
    of_make.add_argument("--seed", type=int, required=True)
    of_make.add_argument("--full", action="store_true")
    of_run.add_argument("--tool", required=True)
    of_run.add_argument("--out", type=Path, required=True)
    of_run.add_argument("--only", nargs="+")
    of_score.add_argument("answers", type=Path)
    of_score.add_argument(
        "--json",
        type=Path,
        help="add the figures to this file, under the name of ANSWERS",
    )
    given = parser.parse_args()
    if given.command == "make":
        make(given.folder, given.seed, given.full)
    elif given.command == "run":
        run(given.folder, given.tool, given.out, given.only)
    else:
        figures = score(given.folder, given.answers)
        print(table(figures))
        if given.json:
            known = (
                json.loads(given.json.read_text(encoding="utf-8"))
                if given.json.exists()
                else {}
            )
            known[given.answers.name] = figures
            given.json.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    main()
