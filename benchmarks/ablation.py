"""Replay finished diagnoses with each limit of the decision varied and each gate removed, and count the verdicts that change.

python benchmarks/ablation.py DIR [DIR ...] [--json FILE] [--markdown FILE]
python benchmarks/ablation.py --search [--seed N] [--json FILE] [--only WORD ...]

DIR     results of `python benchmarks/diagnose.py … --out DIR`: each holds the evidence that its verdict follows from.

`decide` is a pure function of evidence and limits, so a replay fits nothing and takes seconds. A limit that changes no verdict
over hundreds of rigs, or that helps a single one, is a candidate for deletion.

--search        diagnose a sample of quick rigs again for each variation of `search_ablation.py`: a setting, a constant or a rule of
                the search. The file is written after each variation; the same line again goes on with the variations that are not
                there yet. A variation takes about a minute.
--only WORD     variations with a word in their name
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import grading
from grading import Row

from isd_gym.discrepancy.selection.criteria import Criteria
from isd_gym.discrepancy.verdict import gates as rules
from isd_gym.discrepancy.verdict.evidence import EffectEvidence, Evidence

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

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
def without_gate(name: str) -> Iterator[None]:
    """Let a gate pass whatever its value."""
    original = rules.gates_of

    def gates(e: Evidence, c: Criteria = rules.CRITERIA) -> Any:
        return tuple(replace(g, passed=True) if g.name == name else g for g in original(e, c))

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
    """Return one change per gate removed and per limit and factor."""
    gates = sorted({g["gate"] for r in replays for g in r.row["diagnosis"]["gates"]})
    out = []
    for name in gates:
        with without_gate(name):
            out.append(compare(replays, f"gate {name}", "removed"))
    for f in fields(Criteria):
        for factor in FACTORS:
            limit = factor * float(getattr(rules.CRITERIA, f.name))
            out.append(compare(replays, f.name, f"× {factor:g} = {limit:.3g}", **{f.name: limit}))
    return out


def markdown(changes: Sequence[Change], count: int) -> str:
    """Return the table of changes as Markdown."""
    head = ["rule", "variation", "better", "worse", "neither"]
    rows = [head, ["---", "---", "---:", "---:", "---:"], *(c.row() for c in changes)]
    table = "\n".join(f"| {' | '.join(cells)} |" for cells in rows)
    return f"Verdicts of {count} diagnoses that change:\n\n{table}\n"


def replays_of(folders: Sequence[Path]) -> list[Replay]:
    """Return the finished diagnoses of result folders; those without evidence, or decided elsewhere, are left out."""
    out, skipped = [], 0
    for path in sorted(p for folder in folders for p in folder.glob("*.json")):
        row = json.loads(path.read_text())["result"]
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


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="*", type=Path, metavar="DIR")
    parser.add_argument("--search", action="store_true", help="run a sample again with settings of the search varied")
    parser.add_argument("--seed", type=int, default=464)
    parser.add_argument("--only", nargs="*", default=[""], metavar="WORD")
    parser.add_argument("--json", type=Path, help="write the changes with the names of the rigs")
    parser.add_argument("--markdown", type=Path, help="write the table")
    args = parser.parse_args()
    if args.search:
        import search_ablation

        search_ablation.run(args.seed, args.json or search_ablation.FILE, args.only)
        return
    replays = replays_of(args.folders)
    if not replays:
        parser.error(f"no results in {', '.join(map(str, args.folders))}")
    changes = ablate(replays)
    text = markdown(changes, len(replays))
    print(text)
    if args.markdown:
        args.markdown.write_text(text)
    if args.json:
        found = {"diagnoses": len(replays), "changes": [vars(c) for c in changes]}
        args.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
