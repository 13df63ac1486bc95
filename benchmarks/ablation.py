"""Replay finished diagnoses with each limit of the decision varied and each gate removed, and count the verdicts that change.

python benchmarks/ablation.py [DIR ...] [--json FILE]
python benchmarks/ablation.py --store DIR [DIR ...]
python benchmarks/ablation.py --shares DIR [DIR ...] [--json FILE]

DIR     results of `python benchmarks/diagnose.py … --out DIR`: each holds the evidence that its verdict follows from. Without DIR the
        stored evidence is replayed.

`decide` is a pure function of evidence and limits, so a replay fits nothing and takes seconds. A limit that changes no verdict
over hundreds of rigs, or that helps a single one, is a candidate for deletion.

--store         keep the evidence of finished diagnoses in benchmarks/evidence.jsonl.gz, so that a reader repeats the replay without the
                records; an older entry of the same rig is replaced
--shares        how often places and kinds are true that are stated with less confidence, and the probability stated with
                its share of mistaken statements (`grades.MISTAKEN`) halved, as it is, and doubled
"""

from __future__ import annotations

import argparse
import datetime
import gzip
import json
import math
import sys
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import grading
from grading import Row

from isd_gym.diagnosis._selection.criteria import Criteria
from isd_gym.diagnosis._verdict import gates as rules
from isd_gym.diagnosis._verdict.evidence import EffectEvidence, Evidence
from isd_gym.diagnosis._verdict.grades import MISTAKEN

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

#: evidence of finished diagnoses
STORE = Path(__file__).with_name("evidence.jsonl.gz")
#: entries of a row, and of its diagnosis, that a replay reads
ROW = ("suite", "family", "kind", "name", "answer", "truth")
SAID = ("verdict", "reason", "effects", "findings", "gates", "best_candidate", "evidence", "criteria")
#: factors by which every limit is varied
FACTORS = (0.5, 0.8, 1.25, 2.0)


@dataclass(frozen=True)
class Change:
    """Verdicts that one variation changes, as names of rigs: for the better, for the worse, or neither."""

    rule: str
    variation: str
    better: tuple[str, ...] = ()
    worse: tuple[str, ...] = ()
    other: tuple[str, ...] = ()

    def row(self) -> list[str]:
        """Cells of the table."""
        return [
            self.rule,
            self.variation,
            *(str(len(names)) for names in (self.better, self.worse, self.other)),
        ]


@dataclass(frozen=True)
class Replay:
    """One finished diagnosis: its evidence and limits, and the grade that its verdict had."""

    row: Row
    evidence: Evidence
    criteria: Criteria
    candidate: list[tuple[str, frozenset[str]]] = field(default_factory=list)

    @classmethod
    def of(cls, row: Row) -> Replay:
        """Build a replay from the row of a result file. Raises KeyError where the row has no evidence."""
        said = row["diagnosis"]
        known = {f.name for f in fields(Criteria)}
        limits = Criteria(**{k: v for k, v in said["criteria"].items() if k in known})
        best = said.get("best_candidate") or {"effects": [], "where": []}
        named = grading.named(row) or [
            (effect, frozenset(where)) for effect, where in zip(best["effects"], best["where"], strict=True)
        ]
        return cls(row, evidence_of(said["evidence"]), limits, named)

    def outcome(self, limits: Criteria) -> tuple[str, str]:
        """Return (verdict, grade) under other limits."""
        verdict = rules.decide(self.evidence, limits).verdict
        named = self.candidate if verdict == "missing_effect" else []
        return verdict, grading.grade(verdict, named, self.row["answer"], grading.nuisances(self.row))


def evidence_of(saved: dict[str, Any]) -> Evidence:
    """Return the evidence that diagnosis.json holds; null stands for infinity."""

    def value(x: Any) -> Any:
        return math.inf if x is None else tuple(map(value, x)) if isinstance(x, list) else x

    known = {f.name for f in fields(Evidence)}
    rest = {k: value(v) for k, v in saved.items() if k in known and k != "effects"}
    effects = tuple(EffectEvidence(**{k: value(v) for k, v in e.items()}) for e in saved.get("effects", []))
    return Evidence(effects=effects, **rest)


@contextmanager
def without_gates(*names: str) -> Iterator[None]:
    """Let gates pass whatever their values."""
    original = rules.gates_of

    def gates(e: Evidence, c: Criteria = rules.CRITERIA) -> Any:
        return tuple(replace(g, passed=True) if g.name in names else g for g in original(e, c))

    rules.gates_of = gates
    try:
        yield
    finally:
        rules.gates_of = original


def compare(replays: Sequence[Replay], rule: str, variation: str, **limits: float) -> Change:
    """Return the verdicts that change against the limits of record."""
    changed: dict[str, list[str]] = {"better": [], "worse": [], "other": []}
    worth = {"wrong": -1, "missed": 0, "right": 1}
    for r in replays:
        verdict, grade = r.outcome(replace(r.criteria, **limits))
        before = r.row["diagnosis"]["verdict"], grading.graded(r.row)
        if (verdict, grade) == before:
            continue
        step = worth[grade] - worth[before[1]]
        changed["better" if step > 0 else "worse" if step < 0 else "other"].append(r.row["name"])
    return Change(rule, variation, *(tuple(changed[k]) for k in ("better", "worse", "other")))


def ablate(replays: Sequence[Replay]) -> list[Change]:
    """Return one change per gate and per pair of gates removed, for all gates removed that change nothing alone, and per limit and factor."""
    gates = sorted({g["gate"] for r in replays for g in r.row["diagnosis"]["gates"]})
    out = []
    for name in gates:
        with without_gates(name):
            out.append(compare(replays, f"gate {name}", "removed"))
    idle = [name for name, c in zip(gates, out, strict=True) if not (c.better or c.worse or c.other)]
    for names in (*combinations(gates, 2), tuple(idle)):
        with without_gates(*names):
            out.append(compare(replays, f"gates {', '.join(names)}", "removed together"))
    for f in fields(Criteria):
        for factor in FACTORS:
            limit = factor * float(getattr(rules.CRITERIA, f.name))
            out.append(compare(replays, f.name, f"× {factor:g} = {limit:.3g}", **{f.name: limit}))
    return out


def shares_of(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Compare the share of true statements with the probability that is stated with a share of `MISTAKEN` varied.

    A stated probability is a sum of weights, times one minus the share of mistaken statements, so another share needs no replay.
    `weak`: places of the foremost candidate where the candidate explains less than `least_removed`. `extra`: kinds that did not
    pass the inclusion test beside a candidate that explains more; the laws of such a kind have the probability of the kind in sum.

    Args:
        rows: Rows of cases.

    Returns:
        One entry for each limit: statements, share of true ones with its 95 % interval, and the mean stated probability with the limit
        halved, as it is, and doubled (at most 1).
    """
    found: dict[str, list[tuple[float, bool]]] = {"weak": [], "extra": []}
    for row in rows:
        said = row.get("diagnosis", {})
        evidence, c = said.get("evidence"), said.get("criteria")
        if not evidence or not c:
            continue
        is_weak = evidence["explained"] < c["least_removed"]
        own = {frozenset(where) for where in (said.get("best_candidate") or {}).get("where", [])}
        counted = []
        for f in said["findings"]:
            laws = sum(law["probability"] for law in f["laws"])
            is_extra = math.isclose(laws, f["kind_probability"], rel_tol=0.004)
            is_free = any(law["effect"] == "free_force" for law in f["laws"])
            if not is_free and (frozenset(f["place"]) in own if is_weak else is_extra):
                counted.append(f)
        limit, level = ("weak", "place") if is_weak else ("extra", "kind")
        # earlier results have the shares among their limits
        share = max(c.get(f"mistaken_{name}", MISTAKEN[name]) for name in (limit, level))
        statements = grading.statements({**row, "diagnosis": {"findings": counted}}, level)
        found[limit] += [(p / (1.0 - share), is_true) for p, is_true in statements]
    out = []
    for limit, statements in found.items():
        if not statements:
            continue
        count, right = len(statements), sum(is_true for _, is_true in statements)
        low, high = grading.wilson(right, count)
        weight, value = sum(w for w, _ in statements) / count, MISTAKEN[limit]
        entry = {"limit": limit, "statements": count, "true": right / count, "least": low, "most": high}
        factors = {"halved": 0.5, "stated": 1.0, "doubled": 2.0}
        out.append(entry | {name: weight * (1.0 - min(k * value, 1.0)) for name, k in factors.items()})
    return out


def markdown(changes: Sequence[Change], count: int) -> str:
    """Return the table of changes as Markdown."""
    head = ["rule", "variation", "better", "worse", "neither"]
    rows = [head, ["---", "---", "---:", "---:", "---:"], *(c.row() for c in changes)]
    table = "\n".join(f"| {' | '.join(cells)} |" for cells in rows)
    return f"Verdicts of {count} diagnoses that change:\n\n{table}\n"


def rows_of(folders: Sequence[Path]) -> list[Row]:
    """Return the rows of result folders; without folders the stored rows."""
    if not folders:
        with gzip.open(STORE, "rt", encoding="utf-8") as lines:
            return [json.loads(line) for line in lines]
    paths = sorted(p for folder in folders for p in folder.glob("*.json"))
    return [json.loads(p.read_text())["result"] for p in paths]


def store(folders: Sequence[Path]) -> None:
    """Add what a replay reads of the rows of result folders to the stored rows."""
    kept = {r["name"]: r for r in (rows_of(()) if STORE.exists() else [])}
    for row in rows_of(folders):
        said = row.get("diagnosis", {})
        if "evidence" in said:
            kept[row["name"]] = {k: row[k] for k in ROW if k in row} | {
                "diagnosis": {k: said[k] for k in SAID if k in said}
            }
    with STORE.open("wb") as file, gzip.GzipFile("", "wb", fileobj=file, mtime=0) as packed:
        packed.writelines(json.dumps(kept[name]).encode() + b"\n" for name in sorted(kept))
    print(f"{len(kept)} diagnoses in {STORE}")


def replays_of(folders: Sequence[Path]) -> list[Replay]:
    """Return the finished diagnoses of result folders; those without evidence, or decided elsewhere, are left out."""
    out, skipped = [], 0
    for row in rows_of(folders):
        try:
            replay = Replay.of(row)
        except (KeyError, TypeError, AttributeError):
            skipped += 1
            continue
        if replay.outcome(replay.criteria)[0] != row["diagnosis"]["verdict"]:
            skipped += 1  # decided by another path, such as the one for a table
            continue
        out.append(replay)
    if skipped:
        print(f"{skipped} results left out: no evidence, or the replay does not give their verdict")
    return out


def add_shares(folders: Sequence[Path], file: Path) -> None:
    """Add the shares of true statements of result folders to a file, under the names of their suites and seeds."""
    rows = rows_of(folders)
    seeds = sorted({r["name"].rpartition("-")[2] for r in rows if r["suite"] in ("home", "families")})
    name = ", ".join([*sorted({r["suite"] for r in rows}), *seeds])
    known = json.loads(file.read_text()) if file.exists() else {}
    known[name] = {"date": datetime.date.today().isoformat(), "rigs": len(rows), "shares": shares_of(rows)}
    file.write_text(json.dumps(known, indent=1) + "\n")
    print(json.dumps({name: known[name]}, indent=1))


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path, metavar="DIR")
    parser.add_argument(
        "--shares", action="store_true", help="stated and observed shares of doubtful statements"
    )
    parser.add_argument("--store", action="store_true", help="keep the evidence of results for later replays")
    parser.add_argument("--json", type=Path, help="write the changes with the names of the rigs")
    args = parser.parse_args()
    if args.shares:
        add_shares(args.folders, args.json or Path(__file__).with_name("ablation-shares.json"))
        return
    if args.store:
        store(args.folders)
        return
    replays = replays_of(args.folders)
    if not replays:
        parser.error(f"no results in {', '.join(map(str, args.folders))}")
    changes = ablate(replays)
    print(markdown(changes, len(replays)))
    if args.json:
        found = {"diagnoses": len(replays), "changes": [vars(c) for c in changes]}
        args.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
