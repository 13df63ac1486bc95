"""Run `isd-gym diagnose` over rigs whose truth is known, and print what was right, wrong and missed, family by family.

Each case is the command to its end, report included: a case whose report fails has no result.

python benchmarks/diagnose.py FOLDER [NAME ...]            a folder of rigs: FOLDER/truth.json or FOLDER.truth.json
python benchmarks/diagnose.py --suite [WHAT ...] --seeds 1 2   rigs of the hidden suite
python benchmarks/diagnose.py --again DIR ...              the figures of finished runs; nothing is run

WHAT: home (cars, device rigs), families, a family ("shaken", "half_car"), a kind ("shaken.friction_ground"); home and families without.
unseen: families without any development on them; only on request. A folder without a truth is one
of measured rigs: benchmarks/real.json says what may be named there.

--out DIR      one file per case (`isd_gym.benchmark.sweep.items`); the same line again goes on with what is not there yet
--jobs N       processes, one thread each (all cores without)
--limit S      processor seconds per case; one that needs more is counted as missed (600)
--json FILE    figures and rows in one file
--summary FILE adds the figures to a file of summaries under the name of the suite or folder and the seeds: benchmarks/diagnosis.json
               is such a file, from which docs/results.py makes the tables of the validation pages
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import hashlib
import io
import json
import os
import signal
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from json_files import read_json

os.environ.update(
    {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
)  # cases have the cores

import grading
from grading import Row

from isd_gym import InputError
from isd_gym.benchmark.sweep import items as engine

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Job:
    """A case to run: files of a folder, or a kind and a seed of the hidden suite."""

    suite: str  # the folder's name, "home", "families" or "unseen"
    family: str
    kind: str
    name: str
    folder: str = ""
    seed: int = 0
    answer: Any = None
    truth: Any = None


class OutOfTime(BaseException):
    """A case used up its processor time. Not an Exception: nothing on the way may take it for a failed fit."""


# ---------------------------------------------------------------------------------------------------- finding cases
def in_folder(folder: Path, wanted: list[str]) -> Iterator[Job]:
    inside, beside = (
        folder / "truth.json",
        folder.with_name(f"{folder.name}.truth.json"),
    )
    if inside.exists() or beside.exists():
        truth = read_json(inside if inside.exists() else beside)
        entries = {
            n: (t["kind"], t["answer"], t.get("truth")) for n, t in truth.items()
        }
    else:
        expected = read_json(ROOT / "benchmarks" / "real.json")
        entries = {n: (n, expected[n], None) for n in expected if (folder / n).is_dir()}
    if not entries:
        sys.exit(
            f"{folder}: neither truth.json nor {beside.name}, and no measured rig that benchmarks/real.json knows"
        )
    for name in sorted(entries, key=lambda s: s[-3:]):
        kind, answer, truth = entries[name]
        if wanted and not any(w in name or w in kind for w in wanted):
            continue
        family = (
            "measured"
            if isinstance(answer, dict)
            else "car"
            if inside.exists()
            else kind.split("_")[0]
        )
        yield Job(
            folder.name,
            family,
            kind,
            name,
            str((folder / name).resolve()),
            0,
            answer,
            truth,
        )


def in_suite(wanted: list[str], seeds: list[int]) -> Iterator[Job]:
    from rigs import families, hidden

    known = [("home", hidden.family(k), k) for k in hidden.ALL_KINDS]
    known += [("families", k.split(".")[0], k) for k in families.KINDS]
    aside = [("unseen", k.split(".")[0], k) for k in families.UNSEEN_KINDS]
    asked = set(wanted)
    for word in asked:
        if not any(word in k for k in known + aside):
            sys.exit(
                f"--suite {word}: neither home, families nor unseen, nor a family, nor a kind"
            )
    for seed in seeds:
        for suite, family, kind in known + aside:
            if asked & {suite, family, kind} or (not asked and suite != "unseen"):
                yield Job(suite, family, kind, f"{kind}-{seed}", seed=seed)


@dataclass(frozen=True)
class Case:
    """The files of a case, as the command takes them: records to fit by, the model, records held out."""

    records: list[str]
    model: Path
    held: list[str]
    #: which column is which channel, where two loggers wrote the record
    mapping: Path | None = None


def load(job: Job, place: Path) -> tuple[Case, Any, Any]:
    """The files of a case (written to `place` where they are made), its answer and its truth."""
    if job.folder:
        folder = Path(job.folder)
        said = job.answer if isinstance(job.answer, dict) else {}
        records, held = (
            # "a.csv+b": the files of two loggers
            [
                "+".join(str(folder / part) for part in f"{n}.csv".split("+"))
                for n in said[key]
            ]
            if key in said
            else [str(path) for path in sorted(folder.glob(f"{which}*.csv"))]
            for key, which in (("records", "estimation"), ("validate", "validation"))
        )
        mapping = folder / f"{said['map']}.json" if "map" in said else None
        return (
            Case(records, folder / "model.json", held, mapping),
            job.answer,
            job.truth,
        )
    from rigs import families, hidden

    from isd_gym import Network, Table
    from isd_gym.physics.elements import TYPES
    from isd_gym.records.data import write_table

    case = (hidden if job.suite == "home" else families).make_case(job.kind, job.seed)

    def tables(which: str) -> list[str]:
        columns = dict(getattr(case, which) or {})
        if not columns:
            return []
        write_table(place / f"{which}.csv", Table(columns.pop("time"), columns, which))
        return [str(place / f"{which}.csv")]

    Network.load(case.model).save(place / "model.json")
    files = Case(tables("estimation"), place / "model.json", tables("validation"))
    truth = {key: case.truth[key] for key in ("hidden", "nuisances")}
    model = case.truth["model"]
    # small effects have laws that the library does not have
    stated = [e for e in model["elements"] if e["type"] in TYPES]
    truth["parameters"] = Network.load({**model, "elements": stated}).parameters
    return files, case.answer, truth


# --------------------------------------------------------------------------------------------------------- one case
def run(limit: float, **case: Any) -> Row:
    """Diagnose one case, the fields of a `Job`: an item of `engine`."""
    job = Job(**case)
    row: Row = {k: case[k] for k in ("suite", "family", "kind", "name")} | {
        "state": code_state()
    }
    with tempfile.TemporaryDirectory() as place:
        try:
            files, row["answer"], row["truth"] = load(job, Path(place))
        except ArithmeticError as error:
            raise InputError(f"no data: {error}") from None

        def stop(*_: Any) -> None:
            raise OutOfTime

        signal.signal(signal.SIGPROF, stop)
        wall, began = time.perf_counter(), time.process_time()
        signal.setitimer(signal.ITIMER_PROF, limit)
        try:
            row["diagnosis"] = command(files, Path(place) / "found")
        except OutOfTime:
            row["timed_out"] = True
        except Exception as error:
            row["error"] = f"{type(error).__name__}: {error}"
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
        row["seconds"], row["wall"] = (
            time.process_time() - began,
            time.perf_counter() - wall,
        )
    print(line(row), flush=True)
    return row


def command(files: Case, out: Path) -> Any:
    """Run `isd-gym diagnose` and return its diagnosis.json. Raises for a failed command or report."""
    from isd_gym._commands import app

    held = ["--validate", *files.held] if files.held else []
    mapping = ["--map", files.mapping] if files.mapping else []
    words = [
        "diagnose",
        *files.records,
        "--model",
        files.model,
        "--out",
        out,
        *held,
        *mapping,
    ]
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        status = app([str(w) for w in words], standalone_mode=False)
    missing = [
        f
        for f in ("diagnosis.json", "model.json", "report.html")
        if not (out / f).exists()
    ]
    if status or missing:
        last = (said.getvalue().strip().splitlines() or [""])[-1]
        raise RuntimeError(
            f"exit status {status or 0}, without {', '.join(missing) or 'fault'}: {last}"
        )
    return read_json(out / "diagnosis.json")


def line(row: Row) -> str:
    closed = row.get("diagnosis", {}).get("gap", {}).get("closed")
    said = [f"{n} {'-'.join(sorted(p))}" for n, p in grading.named(row)]
    sure = [
        f"{e['confidence']:.3f}" for e in row.get("diagnosis", {}).get("effects", [])
    ]
    why = (
        grading.outcome(row) if "diagnosis" in row else row.get("error", "out of time")
    )
    return (
        f"{grading.graded(row):6s} {row['name']} {row['kind'] if row['kind'] not in row['name'] else ''} {row['seconds']:.1f}s "
        f"closed {'-' if closed is None else f'{closed:.3f}'} {why} {said} {sure} <- {row['answer']}"
    )


def code_state() -> str:
    """A fingerprint of the sources that a verdict rests on."""
    digest = hashlib.sha1()
    for path in sorted((ROOT / "isd_gym").rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


def run_all(jobs: list[Job], out: Path, count: int, limit: float) -> list[Row]:
    """Return the rows of all finished cases; cases with a row in `out` are not run again."""
    items = [{**asdict(job), "limit": limit} for job in jobs]
    if there := len(engine.stored(items, out)):
        print(f"{there} of {len(jobs)} are there already", flush=True)
    engine.run(
        run, items, out, jobs=count, say=lambda text: print(text[-400:], flush=True)
    )
    return said([*engine.stored(items, out).values()])


def read(folders: list[Path]) -> list[Row]:
    """The rows of finished runs."""
    return said(
        [
            read_json(p)["result"]
            for folder in folders
            for p in sorted(folder.glob("*.json"))
        ]
    )


def said(rows: list[Row]) -> list[Row]:
    """The same rows, after a word where they are of different states of the code."""
    states = {r["state"] for r in rows}
    if len(states) > 1:
        print(f"these results are of {len(states)} states of the code", flush=True)
    return rows


def summarise(rows: list[Row], path: Path) -> None:
    """Add the figures of a run to a file of summaries.

    Args:
        rows: Rows of the cases.
        path: The file; it is made if it does not exist.
    """
    known = read_json(path) if path.exists() else {}
    seeds = sorted(
        {
            r["name"].rpartition("-")[2]
            for r in rows
            if r["suite"] in ("home", "families", "unseen")
        }
    )
    name = " ".join([*sorted({r["suite"] for r in rows}), *seeds])
    today = datetime.date.today().isoformat()
    known[name] = {
        "date": today,
        "version": version("isd-gym"),
        **grading.figures(rows),
    }
    path.write_text(json.dumps(known, indent=1, sort_keys=True) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--suite", nargs="*")
    parser.add_argument("--seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--again", nargs="+", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--limit", type=float, default=600.0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--summary", type=Path)
    args = parser.parse_args()
    if args.again:
        rows = read(args.again)
    else:
        jobs = list(in_folder(args.folder, args.names)) if args.folder else []
        jobs += list(in_suite(args.suite, args.seeds)) if args.suite is not None else []
        if not jobs:
            parser.error("nothing to run: a FOLDER, --suite or --again")
        out = args.out or Path(tempfile.mkdtemp(prefix="diagnose-"))
        print(f"{len(jobs)} cases; results in {out}", flush=True)
        rows = run_all(jobs, out, args.jobs, args.limit)
    print("\n" + grading.report(rows))
    if args.json:
        args.json.write_text(
            json.dumps({"figures": grading.figures(rows), "rows": rows})
        )
    if args.summary:
        summarise(rows, args.summary)


if __name__ == "__main__":
    main()
