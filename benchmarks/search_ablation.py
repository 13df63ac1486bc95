"""Diagnose a sample of quick rigs with one setting, constant or rule of the search varied: `ablation.py --search`.

A variation is worth its lines where verdicts become worse without it. The sample is small: a variation that changes no number of any
diagnosis (`moved` is 0) was not exercised, and the sample says nothing about it.
"""

from __future__ import annotations

import datetime
import hashlib
import importlib
import json
import math
import os
import re
import sys
import tempfile
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ.update({f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")})
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import diagnose
import grading

from isd_gym.diagnosis import _workflow as workflow
from isd_gym.diagnosis._selection.settings import SearchSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence

FILE = Path(__file__).with_name("ablation-search.json")
SELECTION = "isd_gym.diagnosis._selection"

#: suite and kind of each rig: several families, known and unknown laws, forces, sensors, one and two effects, none
SAMPLE = (
    ("families", "dyno.stribeck"),
    ("families", "dyno.unknown_position_damping"),
    ("families", "cart.cogging"),
    ("families", "pushed.delay"),
    ("families", "decay.asymmetric"),
    ("families", "decay.drag_and_sine"),
    ("families", "shaken.none"),
    ("home", "drive_gas_spring"),
    ("home", "mass_bump"),
    ("home", "decay_friction"),
    ("home", "rig_compliance"),
)


@dataclass(frozen=True)
class Variation:
    """A change of the search: a field of `SearchSettings`, or an attribute of a module of `selection`."""

    target: str
    label: str
    value: Any
    #: part of a line that runs only where the variation has an effect; by default the name of the target
    line: str = ""

    def is_used(self, lines: Collection[str]) -> bool:
        """Return whether a diagnosis that executed the lines may depend on the target."""
        name = self.target.rpartition(".")[2]
        return any(self.line in x if self.line else re.search(rf"\b{name}\b", x) for x in lines)

    @property
    def is_setting(self) -> bool:
        """Whether the target is a field of `SearchSettings`."""
        return "." not in self.target


def _settings(**values: tuple[float, ...]) -> list[Variation]:
    return [Variation(name, f"{x:g}", x) for name, options in values.items() for x in options]


def _nothing(*args: Any, **more: Any) -> None:
    return None


def _no_structures(*args: Any, **more: Any) -> tuple[()]:
    return ()


VARIATIONS = [
    Variation("forward_backward.joint_structures", "off", _no_structures, "laws = [candidate.elements[k]"),
    Variation("forward_backward.equivalent_structures", "off", _no_structures, "in curves(problem, element)"),
    Variation("candidate_fitter.ASTRAY", "off", math.inf),
    Variation("forward_backward.Search._hint", "off", _nothing, "hint = self._hint("),
    Variation("free_force.BOTH", "off", 0),
    Variation("free_force.RICHER", "off", 1.0),
    Variation("free_force.LENGTHS", "one", {"rate": (0.7,), "elongation": (0.7,), "both": (0.7,)}),
    *_settings(turns=(0,), worst_equivalent=(math.inf,)),
    Variation("candidate_comparison.RIVALS", "3", 3),
    *_settings(chance=(15, 60), sure=(0, 120)),
    Variation("held_out.BLOCKS", "10", 10),
    Variation("held_out.BLOCKS", "40", 40),
    Variation("equivalent_laws.NEAR", "0.25", 0.25),
    Variation("equivalent_laws.MAX_MATCHES", "1", 1),
    *_settings(matches=(4, 16), finals=(2, 8), lost_phase=(0.25, 1.0), depth=(2,)),
    Variation("free_force.STRONG", "1.5", 1.5),
    Variation("free_force.STRONG", "6", 6.0),
    Variation("free_force.FINALS", "1", 1),
    Variation("free_force.KNOTS", "half", {"rate": 17, "elongation": 17, "both": 7}),
    Variation("free_force.MAX_DIRECTIONS", "half", {"rate": 6, "elongation": 6, "both": 12}),
    Variation("free_force.ENOUGH", "0.8", 0.8),
    Variation("candidate.CONVERGED", "10", 10.0),
    Variation("equivalent_laws.STARTS", "2", 2),
    Variation("equivalent_laws.POINTS", "120", 120),
    Variation("held_out.LEAST_BLOCK", "20", 20),
    Variation("held_out.SMALL", "0.01", 0.01),
    Variation("free_force.INSIDE", "0.98", 0.98),
    Variation("free_force.KEPT", "0.001", 1e-3),
    *_settings(wide_gap=(0.05, 0.2), shortest=(40, 160), astray=(0.25, 1.0)),
    *_settings(segment=(8, 32), least_segment=(2, 8), segments=(15, 60)),
]


#: what the targets do, for the table; the comments of `SearchSettings` explain its fields
MEANING = {
    "forward_backward.joint_structures": "one law in place of several over one plane at one place",
    "forward_backward.equivalent_structures": "other laws with nearly the same force are fitted beside the chosen law",
    "forward_backward.Search._hint": "a model that errs by noise alone is searched for a small effect",
    "candidate_fitter.ASTRAY": "refits with a larger error than the best refit are left out",
    "candidate_comparison.RIVALS": "candidates of a stage that are compared with the best",
    "candidate.CONVERGED": "gain (2 log L) below which fits with new weights end",
    "equivalent_laws.NEAR": "error of a match of two laws, as a share of the force, up to which the law is fitted",
    "equivalent_laws.MAX_MATCHES": "matched laws per effect that are fitted",
    "equivalent_laws.STARTS": "starts of a match",
    "equivalent_laws.POINTS": "points of a match",
    "free_force.BOTH": "places with a table over elongation and rate",
    "free_force.RICHER": "a table with more freedom must err clearly less",
    "free_force.LENGTHS": "correlation lengths of the free force",
    "free_force.STRONG": "prior deviation of the free force, in typical forces",
    "free_force.FINALS": "tables that are fitted",
    "free_force.KNOTS": "knots of a table",
    "free_force.MAX_DIRECTIONS": "directions of a table",
    "free_force.ENOUGH": "explained share above which no table over both arguments is fitted",
    "free_force.INSIDE": "share of the motion that the knots span",
    "free_force.KEPT": "smallest variance of a direction",
    "held_out.BLOCKS": "blocks per record of the log predictive density",
    "held_out.LEAST_BLOCK": "least samples of a block",
    "held_out.SMALL": "size of the unmodelled effects that are simulated",
}


@contextmanager
def varied(variation: Variation | None) -> Iterator[SearchSettings]:
    """Apply a variation and return the settings of the search; None for no variation."""
    settings = SearchSettings(jobs=1)
    if variation is None:
        yield settings
    elif variation.is_setting:
        kind = type(getattr(settings, variation.target))
        yield replace(settings, **{variation.target: kind(variation.value)})
    else:
        module, *path, name = variation.target.split(".")
        owner = importlib.import_module(f"{SELECTION}.{module}")
        for part in path:
            owner = getattr(owner, part)
        original = getattr(owner, name)
        # this constant is imported by name into other modules
        copies = [
            m
            for n, m in sys.modules.items()
            if name == "RIVALS" and n.startswith(SELECTION) and m is not owner and hasattr(m, name)
        ]
        for place in (owner, *copies):
            setattr(place, name, variation.value)
        try:
            yield settings
        finally:
            for place in (owner, *copies):
                setattr(place, name, original)


@contextmanager
def executed() -> Iterator[set[str]]:
    """Collect the lines of the search and of the workflow that are executed."""
    lines: set[str] = set()
    sources: dict[str, list[str]] = {}

    def local(frame: Any, event: str, arg: object) -> Callable[..., Any]:
        if event == "line":
            name = frame.f_code.co_filename
            if name not in sources:
                sources[name] = Path(name).read_text().splitlines()
            lines.add(sources[name][frame.f_lineno - 1])
        return local

    def outer(frame: Any, event: str, arg: object) -> Callable[..., Any] | None:
        name = frame.f_code.co_filename
        return local if "/diagnosis/_selection/" in name or name.endswith("diagnosis/_workflow.py") else None

    threading.settrace(outer)
    sys.settrace(outer)
    try:
        yield lines
    finally:
        sys.settrace(None)
        threading.settrace(None)  # type: ignore[arg-type]


def diagnosed(job: diagnose.Job, files: diagnose.Case, settings: SearchSettings) -> dict[str, Any]:
    """Diagnose a case and return verdict, grade, processor time [s], and a digest of every number of the evidence."""
    row: grading.Row = {"answer": job.answer, "truth": job.truth, "name": job.name}
    began = time.process_time()
    try:
        found = workflow.diagnose(files.records, files.model, validate=files.held, settings=settings)
        row["diagnosis"] = json.loads(found.to_json()) if hasattr(found, "to_json") else found.to_dict()
    except Exception as error:
        row["error"] = f"{type(error).__name__}: {error}"
    seconds = time.process_time() - began
    said = row.get("diagnosis", {})
    numbers = json.dumps([said.get(k) for k in ("evidence", "effects", "findings")], default=str)
    return {
        "verdict": grading.outcome(row),
        "named": [f"{name} at {'-'.join(sorted(where))}" for name, where in grading.named(row)],
        "grade": grading.graded(row),
        "seconds": round(seconds, 2),
        "numbers": hashlib.sha1(numbers.encode()).hexdigest()[:10],
    }


def change(variation: Variation, before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    """Return the verdicts that a variation changes, by rig, and the ratio of the processor times."""
    out: dict[str, Any] = {"rule": variation.target, "variation": variation.label}
    out["meaning"] = MEANING.get(variation.target, "")
    out |= {"better": [], "worse": [], "other": [], "moved": 0}
    worth = {"wrong": -1, "missed": 0, "right": 1}
    for name, then in before.items():
        now = after[name]
        out["moved"] += now["numbers"] != then["numbers"]
        if all(now[k] == then[k] for k in ("verdict", "named", "grade")):
            continue
        step = worth[now["grade"]] - worth[then["grade"]]
        said = f"{name}: {then['verdict']} {then['named']} -> {now['verdict']} {now['named']}"
        out["better" if step > 0 else "worse" if step < 0 else "other"].append(said)
    out["time"] = round(
        sum(r["seconds"] for r in after.values()) / sum(r["seconds"] for r in before.values()), 2
    )
    return out


def not_run(changes: Sequence[dict[str, Any]]) -> list[dict[str, str]]:
    """Return the variations that are not among the changes of a run."""
    there = {(c["rule"], c["variation"]) for c in changes}
    return [
        {"rule": v.target, "variation": v.label, "meaning": MEANING.get(v.target, "")}
        for v in VARIATIONS
        if (v.target, v.label) not in there
    ]


def run(seed: int, file: Path, only: Sequence[str] = ("",), rigs: Sequence[tuple[str, str]] = SAMPLE) -> None:
    """Run the sample for every variation that a file does not hold yet, and write the file after each.

    Args:
        seed: Seed of the sample.
        file: Result file.
        only: Words of which a variation's name must have one.
        rigs: Suite and kind of each rig.
    """
    known = {f.name for f in fields(SearchSettings)}
    assert all(v.target in known for v in VARIATIONS if v.is_setting)
    found = json.loads(file.read_text()) if file.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        cases = []
        for suite, kind in rigs:
            place = Path(folder) / kind
            place.mkdir()
            job = diagnose.Job(suite, kind, kind, f"{kind}-{seed}", seed=seed)
            files, answer, truth = diagnose.load(job, place)
            cases.append((replace(job, answer=answer, truth=truth), files))

        def sample(variation: Variation | None) -> dict[str, Any]:
            out = {}
            with varied(variation) as settings:
                for job, files in cases:
                    used = found.get("used", {}).get(job.name)
                    if variation is not None and used is not None and variation.target not in used:
                        out[job.name] = found["rigs"][job.name]  # the diagnosis never reads the target
                        continue
                    out[job.name] = diagnosed(job, files, settings)
                    if variation is None:
                        print(job.name, out[job.name], flush=True)
            return out

        diagnosed(*cases[0], SearchSettings(jobs=1))  # compiled functions are loaded
        if found.get("state") != diagnose.code_state():
            found = {"date": datetime.date.today().isoformat(), "state": diagnose.code_state(), "seed": seed}
            found |= {"rigs": sample(None), "changes": []}
            file.write_text(json.dumps(found, indent=1) + "\n")
        if "used" not in found:
            found["used"] = {}
            for job, files in cases:
                with executed() as lines:
                    diagnosed(job, files, SearchSettings(jobs=1))
                used = sorted({v.target for v in VARIATIONS if v.is_used(lines)})
                print(job.name, used, flush=True)
                found["used"][job.name] = used
            file.write_text(json.dumps(found, indent=1) + "\n")
        there = {(c["rule"], c["variation"]) for c in found["changes"]}

        def cost(v: Variation) -> float:
            return sum(r["seconds"] for name, r in found["rigs"].items() if v.target in found["used"][name])

        for v in sorted(
            VARIATIONS, key=cost
        ):  # the cheapest first: where time is short, most of the table is there
            if (v.target, v.label) in there or not any(word in v.target for word in only):
                continue
            c = change(v, found["rigs"], sample(v))
            found["changes"].append(c)
            found["open"] = not_run(found["changes"])
            file.write_text(json.dumps(found, indent=1) + "\n")
            print(
                v.target,
                v.label,
                {k: c[k] for k in ("better", "worse", "other", "moved", "time")},
                flush=True,
            )
