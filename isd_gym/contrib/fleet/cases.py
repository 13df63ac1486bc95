"""Fleets: diagnosis of every case in a folder on many processes or machines, resumable, with a table and a page of all cases.

    fleet/                        isd-gym diagnose fleet --model car.json --out found --jobs 2
      van7_2024-05-01/            a case: its vehicle and its date
        run1.csv  run2.csv        runs; validation*.csv (or .mf4 ...) take no part in fitting
      van7_2024-09-01/
        run1/                     a run of several loggers: their files, in the order of the map's loggers by
        name
          body.csv  wheel.mf4
        model.json                a model of the case, with priority over --model

Results are in ``OUT/cases``, one file per case with the complete `isd-diagnosis/1` and the resulting model. A
repeated call diagnoses only new and changed cases.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isd_gym._common.errors import InputError, ReportError, plain, shown
from isd_gym._common.files import claim_folder, write_text
from isd_gym.contrib.engine import Outcome, Task, stored
from isd_gym.contrib.engine import run as run_tasks
from isd_gym.records import schemas
from isd_gym.records.data._table import suffix_of, suffixes

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

SCHEMA = "isd-fleet/1"
FOLDER = ("fleet", "fleet.json", ("fleet.json", "fleet.html", "cases"))
DATE = re.compile(r"(\d{4})-?(\d{2})-?(\d{2})")


@dataclass(frozen=True)
class Case:
    """A case of a fleet.

    Attributes:
        name: Name of its folder.
        vehicle: Vehicle.
        date: Date; '' without a date in the name.
        data: Runs to fit.
        validate: Runs to validate.
        model: File of the model.
    """

    name: str
    vehicle: str
    date: str
    data: tuple[str, ...]
    validate: tuple[str, ...]
    model: str


def cases_of(folder: str | Path, model: str | None = None) -> list[Case]:
    """Return the cases in a folder, sorted by vehicle and date.

    Args:
        folder: Folder of cases.
        model: Model of cases without a model file.

    Returns:
        Cases.

    Raises:
        InputError: There are no cases, or a case has no model.
    """
    folder = Path(folder)
    places = sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
    out = [case for place in places if (case := _case(place, model)) is not None]
    if not out:
        raise InputError(
            f"{folder}: no folders of records in it (a case is a folder with tables: {' '.join(suffixes())})"
        )
    return sorted(out, key=lambda c: (c.vehicle, c.date, c.name))


def case_itself(folder: str | Path, model: str | None = None) -> Case | None:
    """Return the case of a folder that holds tables and no folders with tables.

    Args:
        folder: The folder.
        model: Model of a case without a model file.

    Returns:
        The case; None for other folders.

    Raises:
        InputError: The case has no model, or no runs to fit.
    """
    folder = Path(folder)
    runs = [p for p in folder.iterdir() if _run(p)]
    return _case(folder, model) if runs and not any(p.is_dir() for p in runs) else None


def _case(place: Path, model: str | None) -> Case | None:
    runs = [r for p in sorted(place.iterdir()) if (r := _run(p))]
    if not runs:
        return None
    own = place / "model.json"
    if not own.is_file() and model is None:
        raise InputError(f"{place}: holds no model.json; --model FILE is for all cases that have none")
    held = tuple(
        r for r in runs if Path(r.split("+")[0]).relative_to(place).parts[0].startswith("validation")
    )
    fit = tuple(r for r in runs if r not in held)
    if not fit:
        raise InputError(f"{place}: holds validation records alone, nothing to fit by")
    found = DATE.search(place.name)
    date = "-".join(found.groups()) if found else ""
    vehicle = (DATE.sub("", place.name).strip("_- ") or place.name) if found else place.name
    return Case(place.name, vehicle, date, fit, held, str(own) if own.is_file() else str(model))


def _run(path: Path) -> str:
    """Return a run in the notation of the command line; '' for other paths."""
    if path.is_dir():
        files = sorted(p for p in path.iterdir() if suffix_of(p) in suffixes())
        return "+".join(map(str, files))
    return str(path) if suffix_of(path) in suffixes() else ""


def _task(case: Case, options: Mapping[str, Any]) -> Task:
    # the key includes the state of all files: a changed file makes a new task
    files = [*case.data, *case.validate, case.model, options.get("map") or ""]
    states = [
        [p.stat().st_size, p.stat().st_mtime_ns]
        for word in files
        for p in map(Path, word.split("+"))
        if word and p.is_file()
    ]
    given = {"data": list(case.data), "validate": list(case.validate), "model": case.model, "files": states}
    return Task("isd_gym.contrib.fleet.cases:diagnose_case", {"name": case.name, **given, **options})


def diagnose_case(
    name: str,
    data: list[str],
    validate: list[str],
    model: str,
    files: list[Any],
    map: str | None = None,
    accept: Sequence[str] = (),
    seed: int = 0,
    max_lag: float = 0.5,
) -> dict[str, Any]:
    """Diagnose a case: the work of one task.

    Args:
        name: Name of the case.
        data: Runs to fit.
        validate: Runs to validate.
        model: File of the model.
        files: State of all files, for the key of the task.
        map: File that maps columns to channels.
        accept: Data checks whose errors are accepted.
        seed: Seed of random numbers.
        max_lag: Largest lag between loggers [s].

    Returns:
        Diagnosis (`isd-diagnosis/1`) and resulting model (`isd-model/1`), as plain data.

    Raises:
        InputError: The records or the model cannot be used.
    """
    from isd_gym.diagnosis import SearchSettings, diagnose
    from isd_gym.physics.network import Network
    from isd_gym.records._loggers import ChannelMap
    from isd_gym.records._loggers.record_reading import records_of

    del name, files  # part of the task's key only
    network, by = Network.load(model), None
    if map is not None:
        by = ChannelMap.load(map)
        network = by.measured(network)
    wanted = (*network.inputs, *network.outputs)
    fit, held = (
        [r for f in words for r in records_of(f, network, wanted, by=by)] for words in (data, validate)
    )
    found = diagnose(
        fit, network, validate=held, accept=accept, seed=seed, settings=SearchSettings(max_lag=max_lag)
    )
    made = found.model.to_dict() if isinstance(found.model, Network) else None
    return {"diagnosis": found.to_dict(), "model": made}


def fleet(
    folder: str | Path,
    out: str | Path,
    model: str | None = None,
    *,
    options: Mapping[str, Any] | None = None,
    jobs: int = 1,
    engine: str = "local",
    address: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> tuple[dict[str, Any], Outcome]:
    """Diagnose all new and changed cases of a folder.

    Args:
        folder: Folder of cases.
        out: Folder for ``fleet.json`` and ``cases``; `write_page` adds the page.
        model: Model of cases without a model file.
        options: Further arguments of `diagnose_case`: map, accept, seed, max_lag.
        jobs: Number of processes.
        engine: 'local' or 'ray', see `engine.run`.
        address: Address of a Ray cluster.
        progress: Called with the numbers of finished and of all cases.
        say: Called with lines for the user.

    Returns:
        Table of all cases (`isd-fleet/1`), and the outcome of the tasks.

    Raises:
        InputError: The cases or the options cannot be used.
    """
    cases = cases_of(folder, model)
    place = claim_folder(out, *FOLDER)
    tasks = [_task(c, dict(options or {})) for c in cases]
    if not (place / "fleet.json").exists():  # marks the folder as a fleet's for the next call
        write_text(place / "fleet.json", json.dumps(merge(cases, tasks, {})) + "\n")
    outcome = run_tasks(
        tasks,
        place / "cases",
        jobs=jobs,
        engine=engine,
        address=address,
        progress=progress,
        say=say,
        sound=_sound,
    )
    merged = merge(cases, tasks, stored(tasks, place / "cases", _sound), outcome.failed)
    write_text(place / "fleet.json", json.dumps(merged, indent=1, allow_nan=False) + "\n")
    return merged, outcome


def _sound(task: Task, result: Any) -> bool:
    """Return whether a result has the parts of a diagnosis that the table and the page of a fleet show."""
    from jsonschema import Draft202012Validator

    schema = schemas.load("isd-diagnosis/1")
    shown = {name: schema["properties"][name] for name in ("verdict", "summary", "effects")}
    clocks = {"type": "array", "items": {"type": "object"}}
    diagnosis = {
        "type": "object",
        "required": ["verdict", "effects"],
        "properties": shown | {"clocks": clocks},
    }
    part = {"type": "object", "required": ["diagnosis", "model"], "properties": {"diagnosis": diagnosis}}
    return bool(Draft202012Validator(part | {"$defs": schema["$defs"]}).is_valid(result))


def write_page(merged: Mapping[str, Any], out: str | Path) -> Path:
    """Write ``fleet.html`` beside ``fleet.json``.

    Args:
        merged: Table of all cases, as returned by `fleet`.
        out: Folder of the fleet.

    Returns:
        Path of the page.

    Raises:
        ReportError: The page cannot be drawn; an earlier page is removed, the results stay.
    """
    path = Path(out) / "fleet.html"
    path.unlink(missing_ok=True)
    try:
        write_text(path, page(merged))
    except Exception as error:
        raise ReportError("the page of the fleet", error, f"the results are in '{out}'") from error
    return path


def merge(
    cases: Sequence[Case],
    tasks: Sequence[Task],
    results: Mapping[str, Any],
    failed: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Return the table of a fleet (`isd-fleet/1`): one row per case, and the history of each effect of each vehicle.

    Args:
        cases: Cases of the fleet.
        tasks: Task of each case.
        results: Result by key of a task.
        failed: Error by key of a task.

    Returns:
        Plain data.
    """
    rows: list[dict[str, Any]] = []
    trends: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for case, task in zip(cases, tasks, strict=True):
        row: dict[str, Any] = {"case": case.name, "vehicle": case.vehicle, "date": case.date}
        found = results.get(task.key)
        if found is None:
            rows.append(
                {**row, "verdict": None, "error": (failed or {}).get(task.key, "not done yet"), "effects": []}
            )
            continue
        said = found["diagnosis"]
        rows.append(
            {
                **row,
                "verdict": said["verdict"],
                "summary": said.get("summary", ""),
                "effects": said["effects"],
                "clocks": said.get("clocks", []),
                "file": f"cases/{task.key}.json",
            }
        )
        for effect in said["effects"]:
            where = "-".join(effect.get("between") or [effect.get("channel") or ""])
            for name, q in effect["parameters"].items():
                if q["value"] is None:
                    continue
                key = (case.vehicle, effect["effect"], where, name, q.get("unit", ""))
                trends.setdefault(key, []).append(
                    {"case": case.name, "date": case.date, **{k: q.get(k) for k in ("value", "low", "high")}}
                )
    return {
        "schema": SCHEMA,
        "cases": rows,
        "trends": [
            {"vehicle": v, "effect": e, "where": w, "parameter": p, "unit": u, "points": points}
            for (v, e, w, p, u), points in trends.items()
        ],
        "missing": sum(r["verdict"] is None for r in rows),
    }


def lines(merged: Mapping[str, Any], width: int = 80) -> list[str]:
    """Return a fleet as lines for a terminal: verdict and effects of every case, then the history of the effects.

    Args:
        merged: Table of all cases.
        width: Number of characters of a line.

    Returns:
        Lines.
    """
    import textwrap

    rows = merged["cases"]
    wide = min(max(len("vehicle"), *(len(r["vehicle"]) for r in rows)), 20)
    out = [f"{'vehicle':<{wide}} {'date':<10} verdict"]
    for r in rows:
        head = f"{plain(r['vehicle'], wide):<{wide}} {r['date'] or '-':<10} "
        text = "; ".join(_effect(e) for e in r["effects"])
        text = (
            f"failed: {r['error']}"
            if r["verdict"] is None
            else f"{r['verdict']}{': ' + text if text else ''}"
        )
        out += textwrap.wrap(
            plain(text, 400),
            width,
            initial_indent=head,
            subsequent_indent=" " * (len(head) + 2),
            break_long_words=True,
        )
    grown = [t for t in merged["trends"] if len(t["points"]) > 1]
    if grown:
        out += ["", "Over the dates:"]
    for t in grown:
        points = " -> ".join(f"{p['value']:.4g}" for p in t["points"])
        first, last = t["points"][0], t["points"][-1]
        sure = None not in (first["high"], last["low"], first["low"], last["high"])
        grew = sure and (last["low"] > first["high"] or last["high"] < first["low"])
        change = 100 * (last["value"] / first["value"] - 1) if first["value"] else float("nan")
        text = (
            f"{t['vehicle']}, {t['effect'].replace('_', ' ')} {t['where']}, {t['parameter']}: {points} {t['unit']} ({change:+.0f} %, "
            f"{'beyond its intervals' if grew else 'within its intervals'})"
        )
        out += textwrap.wrap(plain(text, 400), width, initial_indent="  ", subsequent_indent="    ")
    return out


def _effect(effect: Mapping[str, Any]) -> str:
    where = "-".join(effect.get("between") or [effect.get("channel") or ""])
    values = ", ".join(
        f"{n} {q['value']:.4g} {q.get('unit', '')}".strip().replace("^2", "²").replace("^3", "³")
        for n, q in effect["parameters"].items()
        if q["value"] is not None
    )
    return f"{effect['effect'].replace('_', ' ')} {where} ({values})"


def page(merged: Mapping[str, Any]) -> str:
    """Return a fleet as one self-contained HTML page.

    Args:
        merged: Table of all cases.

    Returns:
        HTML.
    """
    from isd_gym.view._report.plots import page as fill

    rows = [{**r, "told": [_effect(e) for e in r["effects"]]} for r in merged["cases"]]
    trends = [{**t, "picture": _trend(t["points"])} for t in merged["trends"] if len(t["points"]) > 1]
    title, details = finding(merged)
    return fill("fleet.html", rows=rows, trends=trends, title=title, details=details)


#: meaning of a verdict for one case, and for several
FOUND = {
    "missing_effect": ("lacks a physical effect", "lack a physical effect"),
    "unknown_effect": ("lacks something without a name", "lack something without a name"),
    "ambiguous": ("lacks one of several effects", "lack one of several effects"),
    "parameters_only": ("is off in parameters alone", "are off in parameters alone"),
    "no_discrepancy": ("agrees with its model", "agree with their model"),
    None: ("has no result", "have no result"),
}


def finding(merged: Mapping[str, Any]) -> tuple[str, list[str]]:
    """Return the main finding of a fleet, and further findings: verdicts and effects with their counts.

    Args:
        merged: Table of all cases.

    Returns:
        A line, and further lines.
    """
    rows = merged["cases"]
    counts = Counter(r["verdict"] for r in rows)
    verdicts = [
        f"{counts[v]} of {len(rows)} cases {said[counts[v] > 1]}" for v, said in FOUND.items() if counts[v]
    ]
    effects = Counter(
        f"{e['effect'].replace('_', ' ')} {'-'.join(e.get('between') or [e.get('channel') or ''])}"
        for r in rows
        for e in r["effects"]
    )
    named = [f"{name} in {n} case{'s' * (n > 1)}" for name, n in effects.most_common()]
    return verdicts[0], [", ".join(named)] * bool(named) + verdicts[1:]


def _trend(
    points: Sequence[Mapping[str, Any]], width: float = 600.0, height: float = 120.0
) -> dict[str, Any]:
    """Return values with their intervals over the cases, scaled from zero, as numbers of an SVG."""
    top = max(max(abs(p[k]) for k in ("value", "low", "high") if p[k] is not None) for p in points) or 1.0
    every = []
    for k, p in enumerate(points):
        x = 30 + (width - 60) * k / max(len(points) - 1, 1)
        y = {
            n: height - (height - 10) * abs(p[n] if p[n] is not None else p["value"]) / top
            for n in ("value", "low", "high")
        }
        every.append(
            {
                "x": round(x, 1),
                **{n: round(v, 1) for n, v in y.items()},
                "date": p["date"] or p["case"],
                "told": f"{p['value']:.4g}",
            }
        )
    return {"points": every, "line": " ".join(f"{p['x']},{p['value']}" for p in every)}


def check(folder: Path, out: Path) -> None:
    """Check before long work that the results of a fleet can be written.

    Args:
        folder: Folder of cases.
        out: Folder of the results.

    Raises:
        InputError: The results would lie among the cases, or cannot be written.
    """
    from isd_gym._common.files import check_folder

    if out.resolve() == folder.resolve() or folder.resolve() in out.resolve().parents:
        raise InputError(f"--out {shown(str(out))} lies among the cases: name a folder elsewhere")
    check_folder(out, *FOLDER)
