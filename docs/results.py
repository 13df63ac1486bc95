"""Write the tables of results into README and the validation pages, from the files that the benchmarks wrote.

python docs/results.py               every table
python docs/results.py --read DIR    first copy the answers of diagnoses in DIR into benchmarks/measured.json:
                                     DIR/NAME/diagnosis.json for every NAME there

A table stands between the comments ``<!-- NAME: python docs/results.py -->`` and ``<!-- end of NAME -->``.
"""

from __future__ import annotations

import argparse
import dataclasses
import datetime
import importlib.metadata
import inspect
import json
import re
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import controllers
import grading
import learning
import tracks as tracks_of
from json_files import read_json
from scipy.stats import trim_mean
from table import card_table, change_of, markdown, percent

from isd_gym import StageCost
from isd_gym.benchmark import cards, lq_bounds
from isd_gym.benchmark.ceilings import ceiling
from isd_gym.benchmark.tracks import TRACKS
from isd_gym.diagnosis._selection import criteria
from isd_gym.diagnosis._verdict import grades
from isd_gym.env import Options
from isd_gym.env.registration import ENVIRONMENTS, LEARNING
from isd_gym.physics.elements import TYPES, parameter_fields

if TYPE_CHECKING:
    from collections.abc import Callable

    from isd_gym.benchmark.tracks import Track

ROOT = Path(__file__).resolve().parents[1]
BENCHMARKS = ROOT / "benchmarks"
MEASURED = BENCHMARKS / "measured.json"

#: policies of README's table, with a few words each
SHOWN = {
    "passive": "spring and damper, no device",
    "skyhook": "a textbook law",
    "mpc-friction": "predictive control that knows the friction",
    "ppo": "a trained policy, shipped",
}


def stored(name: str) -> Any:
    """The content of a file that a benchmark wrote."""
    return read_json(BENCHMARKS / name)


# ------------------------------------------------------------------------------------------------ controllers


def card_rows(track: str = "standard") -> dict[str, dict[str, Any]]:
    """The rows of the shipped card by policy."""
    return {
        row["policy"]: row
        for row in cards.ranking(cards.load("ISDSuspension-v0"), track)
    }


def headline() -> str:
    """README: four policies."""
    rows = card_rows()
    body = []
    for name, words in SHOWN.items():
        row = rows[name]
        body.append(
            [
                f"`{name}`: {words}",
                f"{row['cost']['value']:.3f}",
                "" if name == "passive" else change_of(row["cost"]),
                f"{row['body_acceleration_rms']['value']:.3f} m/s²",
                f"{1e3 * row['suspension_travel_rms']['value']:.2f} mm",
            ]
        )
    heads = "controller | J | change against `passive` [95 % interval] | acceleration | travel"
    return markdown(heads, body, "lrrrr")


def scores() -> str:
    """Every reference of the standard track, short."""
    body = []
    for name, row in card_rows().items():
        if name == "passive":
            continue
        names = ("body_acceleration_rms", "suspension_travel_rms", "tyre_load_rms")
        body.append(
            [
                f"`{name}`",
                change_of(row["cost"]),
                *(percent(row[n]["change"]) for n in names),
            ]
        )
    return markdown("policy | J | acceleration | travel | tyre load", body, "lrrrr")


def ceilings() -> str:
    """Searched and proven bounds, by the seconds of road ahead."""
    body = []
    for preview in (0.0, 0.1, 0.2):
        found = ceiling("quarter-car-isd", preview=preview)
        assert found is not None
        body.append(
            [
                "none" if preview == 0 else f"{preview:g} s",
                str(len(found.roads)),
                f"{percent(found.change)} ± {100 * found.standard_error:.1f} %",
                f"{percent(found.proven_change)} ± {100 * found.proven_standard_error:.1f} %",
            ]
        )
    heads = "road ahead | roads | ceiling (searched) | proven bound, without end stops"
    return markdown(heads, body, "lrrr")


def steps() -> str:
    """Time per step of the controllers on the paper's road."""
    found = stored("mpc.json")["steps"]
    body = []
    for label in (
        "lqg",
        "mpc-paper, horizon 20",
        "mpc",
        "mpc-friction",
        "mpc-friction-preview",
    ):
        row = found[f"{label}, road paper"]
        name, comma, rest = label.partition(",")
        times = [
            f"{row[k][q]:.3f} ms" for k in ("own", "cpu") for q in ("median", "p99_9")
        ]
        body.append([f"`{name}`{comma}{rest}", *times])
    return markdown(
        "controller | own: median | 99.9 % | processor: median | 99.9 %",
        body,
        "lrrrr",
    )


def half_car() -> str:
    """Controllers of the half car, with and without wheelbase preview."""
    found = stored("half-car.json")
    names = (
        "body_acceleration_rms",
        "pitch_acceleration_rms",
        "suspension_travel_front_rms",
        "suspension_travel_rear_rms",
    )
    body = []
    for row in found["policies"]:
        if row["policy"] != "passive":
            body.append(
                [
                    f"`{row['policy']}`",
                    change_of(row["cost"]),
                    *(percent(row[n]["change"]) for n in names),
                ]
            )
    heads = "policy | J | vertical acceleration | pitch acceleration | travel front | travel rear"
    return markdown(heads, body, "lrrrrr")


def wheelbase() -> str:
    """The gain by wheelbase preview over the speed."""
    body = []
    for found in stored("wheelbase.json")["speeds"]:
        rows, bound = found["policies"], found["lq_bound"]
        body.append(
            [
                f"{found['speed']['value']:g} m/s",
                f"{found['preview']['value']:.3f} s",
                *(
                    percent(rows[n]["cost"]["change"])
                    for n in ("mpc-friction", "lqg-wheelbase", "mpc-wheelbase")
                ),
                change_of(rows["mpc-wheelbase"]["cost_against_mpc-friction"]),
                percent(bound["change_without_rear_road"]),
                percent(bound["change"]),
            ]
        )
    heads = "speed | preview | `mpc-friction` | `lqg-wheelbase` | `mpc-wheelbase` | `mpc-wheelbase` against `mpc-friction` | LQ bound without the rear road | with it"  # fmt: skip
    return markdown(heads, body, "lrrrrrrr")


def pulling() -> str:
    """Share of the control steps in which the linear tyre pulls, by road and speed."""
    found = stored("rough-roads.json")["shares"]
    speeds = sorted({row["speed"] for row in found})
    body = []
    for name in (
        "quarter-car-passive",
        "quarter-car-isd",
        "half-car-isd",
        "full-car-isd",
    ):
        for road in ("C", "D", "E"):
            share = {
                r["speed"]: r["share"]
                for r in found
                if (r["network"], r["road"]) == (name, road)
            }
            body.append(
                [f"`{name}`", road, *(f"{100 * share[speed]:.2f}" for speed in speeds)]
            )
    return markdown(
        " | ".join(["car", "class", *(f"{v:g} m/s" for v in speeds)]),
        body,
        "ll" + "r" * len(speeds),
    )


def lift_off() -> str:
    """Figures of the linear tyre over the figures of a tyre that lifts off."""
    found = stored("rough-roads.json")
    body = []
    for row in found["effects"]:
        change = {
            k: v / row["lifts_off"][k] - 1
            for k, v in row["linear"].items()
            if k != "share"
        }
        body.append(
            [
                f"`{row['network']}`",
                row["road"],
                *(
                    percent(round(change[k], 4) + 0.0, 2)
                    for k in ("cost", "acceleration", "tyre_load")
                ),
            ]
        )
    return markdown("car | road, 20 m/s | J | acceleration | tyre load", body, "llrrr")


# ----------------------------------------------------------------------------------------------------- tracks

#: track -> what separates policies there
DISCRIMINATES = {
    "full-car-preview-0.2": "use of 4 m of road ahead, by four currents",
    "preview-0.2": "use of 4 m of road ahead",
    "preview-0.1": "use of 2 m of road ahead",
    "half-car": "memory: the rear wheels meet the road of the front wheels 0.135 s later; two currents for heave and pitch",
    "full-car": "memory: the rear wheels meet the road of the front wheels 0.135 s later; four currents for heave, pitch and roll",
    "robust": "one policy for 64 combinations of car, road, speed and sensors",
    "standard": "estimation, friction of the seal and saturation: the last points beyond a skyhook",
}


def bound_of(track: Track) -> str:
    """Bound of the change of J on a track."""
    if track.card == tracks_of.QUARTER:
        found = ceiling("quarter-car-isd", preview=track.preview)
        if found is not None:
            return f"{percent(found.change)} searched, {percent(found.proven_change)} proven without end stops"
    if track.card == "ISDHalfCar-v0":
        speeds = stored("wheelbase.json")["speeds"]
        (found,) = (s["lq_bound"] for s in speeds if s["speed"]["value"] == 20.0)
        return (
            f"{percent(found['change'])} linear-quadratic, without friction and limits"
        )
    return "not known"


def least_change(track: Track) -> str:
    """Change of J by the linear-quadratic optimum of an unlimited force, which sees no road ahead."""
    if track.road == "bump":
        return ""
    how = {"speed": track.speed, "road": track.road}
    base = lq_bounds.reference(track.network, **how)
    weights = np.array([*StageCost().quadratic[:2], 0.0]) * base**2
    point = np.array(
        lq_bounds.lq_bound(track.network, **how, weights=tuple(weights)).triple
    )
    return percent(float(weights @ (point / base) ** 2 / weights.sum() - 1.0))


def each_road(card_name: str) -> str:
    """Policies of a car on roads A to E and on the bump, with the entries; limits first."""
    card = cards.load(card_name)
    on = {name: track for name, track in TRACKS.items() if track.card == card_name}
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for name, track in on.items():
        files = sorted((BENCHMARKS / "entries").glob(f"{name}-*.json"))
        for row in cards.ranking(
            card, track.name, [cards.read_score(file) for file in files]
        ):
            found.setdefault(row["policy"], {})[track.road] = row
    body = []
    for policy, by in found.items():
        worst = [
            f"{100 * max(row[key]['value'] for row in by.values()):.2f}"
            for key in ("travel_exceedance", "wheel_lift")
        ]
        costs = [
            percent(by[road]["cost"].get("change", 0.0)) if road in by else ""
            for road in tracks_of.ROADS
        ]
        on_c = [
            percent(by["C"][key].get("change", 0.0)) if "C" in by else ""
            for key in (
                "body_acceleration_rms",
                "suspension_travel_rms",
                "tyre_load_rms",
            )
        ]
        order = by["C"]["cost"]["value"] if "C" in by else np.inf
        body.append((order, [f"`{policy}`", *worst, *costs, *on_c]))
    least = [least_change(track) for track in on.values()]
    lines = [cells for _, cells in sorted(body)]
    lines.append(["least for any force", "", "", *least, "", "", ""])
    speeds = [f"J, {track.road}, {track.speed:g} m/s" for track in on.values()]
    heads = ["policy", "travel beyond 80 mm, worst road [% of time]", "wheel lifts, worst road [% of time]", *speeds, "acceleration, C", "travel, C", "tyre load, C"]  # fmt: skip
    return markdown(" | ".join(heads), lines, "l" + "r" * (len(heads) - 1))


def budget_of(policy: str) -> str:
    """Steps and time of the training of a shipped policy."""
    file = ROOT / "agents" / "policies" / policy / "policy.json"
    training = read_json(file)["training"]
    return f"{training['settings']['steps'] / 1e6:g} M steps, {training['seconds'] / 60:.0f} min of one core"


def tracks() -> str:
    """Every track with an id of its own, the most discriminating first."""
    body = []
    for name in DISCRIMINATES:
        if name not in TRACKS:
            continue
        track = TRACKS[name]
        card = cards.load(track.card)
        rows = cards.ranking(card, track.name)
        by = {
            row["policy"]: row["cost"]["change"]
            for row in cards.ranking(card, "standard")
        }
        by |= {row["policy"]: row["cost"]["change"] for row in rows}
        pair = [tracks_of.best(rows, learned=learned) for learned in (True, False)]
        cells = [
            "none" if row is None else f"`{row['policy']}` {change_of(row['cost'])}"
            for row in pair
        ]
        held = next(t for t in card["tracks"] if t["track"] == track.name)
        learned = pair[0]
        body.append(
            (
                by["skyhook"] - rows[0]["cost"]["change"],
                name,
                percent(by["skyhook"]),
                *cells,
                bound_of(track),
                "" if learned is None else budget_of(learned["policy"]),
                f"`{track.card}`, {held['episodes']} roads, {card['date']}",
            )
        )
    if tracks_of.ROBUST.exists():
        body.append(robust_row())
    lines = []
    for spread, name, *cells in sorted(body, reverse=True):
        lines.append([name, DISCRIMINATES[name], f"{100 * spread:.1f}", *cells])
    heads = "track | what separates policies | from `skyhook` to the best [points of J] | `skyhook` | best learned | best classical | ceiling or bound | training of the best learned | card"  # fmt: skip
    return markdown(heads, lines, "llrrrrlll")


def robust_row() -> tuple[float, *tuple[str, ...]]:
    """Row of the robust track: the mean change of J over the conditions."""
    found = read_json(tracks_of.ROBUST)
    rows = sorted(found["overall"], key=lambda row: row["change"]["value"])
    by = {row["policy"]: row["change"]["value"] for row in rows}
    cells = []
    for learned in (True, False):
        row = tracks_of.best(rows, learned=learned)
        assert row is not None
        cells.append(f"`{row['policy']}` {change_of(row['change'], 'value')}")
    spread = by["skyhook"] - rows[0]["change"]["value"]
    sweep = f"`isd-gym sweep robust`, {found['conditions']} conditions"
    return (
        spread,
        "robust",
        percent(by["skyhook"]),
        *cells,
        "not known",
        "policy of the nominal car",
        sweep,
    )


def regeneration() -> str:
    """Processor time of each card."""
    body = []
    for name, found in read_json(tracks_of.TIMES).items():
        for track, seconds in found["processor_seconds"].items():
            body.append([name, track, f"{seconds:.0f} s"])
    return markdown("card | track | processor time", body, "llr")


# ------------------------------------------------------------------------------------------------ environment

SECTION = re.compile(r"^(Args|Raises):\n((?:    .*\n|\n)*)", re.MULTILINE)
FIELD = re.compile(r"^    (\w+): ((?:.|\n {5,})*)", re.MULTILINE)


def environment() -> str:
    """Docstring of the environments as Markdown, with tables of the arguments and of the options."""
    from isd_gym import ISDSuspensionEnv, ISDSuspensionVectorEnv

    names = ", ".join(f"`{name}`" for name in (*ENVIRONMENTS, *LEARNING))
    parts = [
        f"## One car\n\n`gymnasium.make(name, **options)` with one of the names {names}.",
        told(ISDSuspensionEnv),
    ]
    parts += ["## Options", told(Options), options(Options)]
    parts += ["## Many cars", told(ISDSuspensionVectorEnv)]
    return "\n\n".join(parts)


def told(of: type) -> str:
    """A docstring as Markdown: headings of the third level, sections as tables."""
    text = inspect.cleandoc(of.__doc__ or "") + "\n"
    text = re.sub(r"^## ", "### ", text, flags=re.MULTILINE)

    def table_of(section: re.Match[str]) -> str:
        title, body = section.groups()
        rows = [
            [f"`{name}`", " ".join(words.split())]
            for name, words in FIELD.findall(body)
        ]
        head = {"Args": "argument | meaning", "Raises": "error | reason"}[title]
        return f"{markdown(head, rows, 'll')}\n\n"

    return SECTION.sub(table_of, text).strip()


def options(of: type) -> str:
    """Fields of a dataclass as a table, with the comments above the fields."""
    rows, comment = [], []
    defaults = {f.name: f.default for f in dataclasses.fields(of)}
    for line in map(str.strip, inspect.getsource(of).splitlines()):
        if line.startswith("# "):
            comment.append(line[2:])
            continue
        name = line.partition(":")[0]
        if name in defaults and comment:
            rows.append([f"`{name}`", f"`{defaults.pop(name)!r}`", " ".join(comment)])
        comment = []
    assert not defaults, f"options without a comment: {', '.join(defaults)}"
    return markdown("option | default | meaning", rows, "lll")


# --------------------------------------------------------------------------------------------------- learning


def learning_study() -> str:
    """Algorithms and settings over training seeds; the best and the worst seed are those of J."""
    body = []
    for name, by_seed in learning.read().items():
        changes = np.array([run["change"] for run in by_seed.values()])
        seconds = np.mean([run["seconds"] for run in by_seed.values()])
        figures = (trim_mean(changes, 0.25), changes.min(), changes.max())
        body.append(
            [
                name,
                f"{learning.SETTINGS[name].decisions:,}",
                str(len(changes)),
                f"{seconds:.0f} s",
                *(percent(value / 100) for value in figures),
            ]
        )
    heads = "algorithm and setting | decisions | seeds | processor time | J, interquartile mean | best | worst"
    return markdown(heads, body, "lrrrrrr")


# -------------------------------------------------------------------------------------------------- diagnosis


def suites() -> str:
    """Rigs of known truth: shares of right and wrong answers, by suite."""

    def share(value: float | None, count: int) -> str:
        return "–" if value is None else f"{100 * value:.0f} % of {count}"

    body = []
    for name, f in stored("diagnosis.json").items():
        n = f["counts"]
        body.append(
            [
                f"`{name}`",
                str(f["rigs"]),
                share(f["right"], n["effect"]),
                share(f["kind_right"], n["effect"]),
                share(f["wrong"], n["effect"]),
                share(f["clean_left_alone"], n["clean"]),
                share(f["unknown_recognised"], n["unknown"]),
                f"{f['seconds_median']:.0f} s / {f['seconds_longest']:.0f} s",
                f"{f['date']}, {f['version']}",
            ]
        )
    heads = "suite, seed | rigs | right | place and kind right | wrong name | clean left alone | unknown recognised | processor time: median / longest | date, version"
    return markdown(heads, body, "lrrrrrrrl")


#: statements of a level and a probability below which their share says little
FEWEST = 10


def calibration() -> str:
    """Stated probability against the share of true statements, by level."""
    body = []
    for name, f in stored("diagnosis.json").items():
        for level in grading.LEVELS:
            for b in f["reliability"][level]:
                if b["stated"] >= 0.5 and b["names"] >= FEWEST:
                    body.append(
                        [
                            f"`{name}`",
                            level,
                            f"{b['stated']:.2f}",
                            str(b["names"]),
                            f"{b['right']:.2f}",
                            f"{b['least']:.2f} to {b['most']:.2f}",
                        ]
                    )
    heads = "suite, seed | level | stated | statements | true | 95 % interval"
    return markdown(heads, body, "llrrrr")


def limits() -> str:
    """Every limit of the verdict."""
    body = []
    for row in criteria.table():
        words = (str(row[k]) for k in ("unit", "why", "source"))
        body.append([f"`{row['id']}`", f"{row['limit']:.3g}", *words])
    return markdown("limit | value | unit | reason | source", body, "lrlll")


def mistaken() -> str:
    """Shares of statements that are wrong although no resampling shows it."""
    return markdown(
        "statement | mistaken",
        [[f"`{k}`", f"{v:.2f}"] for k, v in grades.MISTAKEN.items()],
        "lr",
    )


def measurements() -> str:
    """What is known of every public data set, what the diagnosis answers, and whether that is right."""
    body = []
    for entry in read_json(MEASURED).values():
        answer = entry.get("diagnosis")
        judged = {
            "right": "yes",
            "wrong": "**no**",
            "missed": "undecided",
            None: "open",
        }
        body.append(
            [
                entry["rig"],
                entry["known"],
                f"{answer['answer']} <small>({answer['date']}, {answer['version']})</small>"
                if answer
                else "not run yet",
                judged[answer["grade"]]
                + (f": {answer['remark']}" if answer.get("remark") else "")
                if answer
                else "",
            ]
        )
    return markdown(
        "rig | what is known | answer of the diagnosis | right?", body, "llll"
    )


def first_looks() -> str:
    """Rigs that the diagnosis had never seen, run once: figures by date."""

    def right(stated: list[list[Any]], least: float = 0.9) -> str:
        sure = [is_true for p, is_true in stated if p >= least]
        return f"{sum(sure)} of {len(sure)}" if sure else "–"

    body = []
    for look in stored("first-looks.json"):
        rigs = look["rigs"]
        said = {
            level: [s for r in rigs for s in r["stated"][level]]
            for level in ("law", "kind", "place")
        }
        body.append(
            [
                f"{look['date']}, {look['version']}",
                str(len(rigs)),
                str(sum(r["law"] == "right" for r in rigs)),
                str(sum(r["kind"] == "right" for r in rigs)),
                str(sum(r["law"] == "wrong" for r in rigs)),
                *(right(said[level]) for level in ("law", "kind", "place")),
            ]
        )
    heads = "date, version | rigs | law right or rightly silent | place and kind right | wrong name"
    for level in ("name", "kind", "place"):
        heads += f" | {level} stated at 0.9 or more that is right"
    return markdown(heads, body, "lrrrrrrr")


def first_looks_by_rig() -> str:
    """What was known of each rig before its first look, and the answer; without the rigs of `measurements`."""
    grades = {"right": "yes", "wrong": "**no**", "missed": "undecided"}
    listed = read_json(MEASURED)
    body = [
        [f"{r['rig']} <small>({r['source']})</small>", r["known"], r["answer"], grades[r["law"]], grades[r["kind"]]]
        for look in stored("first-looks.json")
        for r in look["rigs"]
        if r["name"] not in listed
    ]  # fmt: skip
    return markdown(
        "rig | what is known | first answer | right? | place and kind",
        body,
        "lllll",
    )


def sources() -> str:
    """Where the public data sets are, their licences, and the records that are compared."""
    body = [
        [
            f"`{name}`",
            entry["source"],
            entry["licence"],
            entry["records"],
            entry["model"],
        ]
        for name, entry in read_json(MEASURED).items()
    ]
    return markdown("name | source | licence | records | nominal model", body, "lllll")


def answer_of(diagnosis: dict[str, Any]) -> str:
    """The verdict, and the deepest statement of a diagnosis with its probability."""
    effects = [
        f"{e['effect'].replace('_', ' ')} ({'–'.join(e.get('between') or [e.get('channel', '')])}, {e['confidence']:.2f})"
        for e in diagnosis["effects"]
    ]
    kinds = [
        f"{f['kind'].replace('_', ' ')} ({'–'.join(f['place']) or 'place open'}, {f['kind_probability']:.2f})"
        for f in diagnosis.get("findings", [])
        if f.get("kind") and not f.get("named")
    ]
    said = effects or kinds
    return f"`{diagnosis['verdict']}`" + (f": {', '.join(said)}" if said else "")


def read_answers(folder: Path) -> None:
    """Copy the answers of diagnoses into `benchmarks/measured.json`.

    Args:
        folder: holds NAME/diagnosis.json for every data set that was run.
    """
    entries = read_json(MEASURED)
    expected = stored("real.json")
    for name, entry in entries.items():
        file = folder / name / "diagnosis.json"
        if not file.exists():
            continue
        diagnosis = read_json(file)
        before = entry.get("diagnosis", {})
        answer = answer_of(diagnosis)
        grade = before.get("grade") if before.get("answer") == answer else None
        if name in expected:
            grade = grading.graded(
                {"diagnosis": diagnosis, "answer": expected[name], "truth": None}
            )
        entry["diagnosis"] = {
            "answer": answer,
            "grade": grade,
            "remark": before.get("remark", "")
            if before.get("answer") == answer
            else "",
            "date": datetime.date.fromtimestamp(file.stat().st_mtime).isoformat(),
            "version": importlib.metadata.version("isd-gym"),
        }
    MEASURED.write_text(
        json.dumps(entries, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )


#: figures of Champneys and others 2024 on the official splits: method, Silverbox [mV], EMPS [mm]
PUBLISHED = [
    ("linear state space", "6.96 / 14.4 / 6.58", "5.53"),
    ("ARX", "6.95 / 14.2 / 6.59", "12.6"),
    ("polynomial NARX", "0.640 / 2.25 / 0.571", "5.17"),
    ("Gaussian process NARX", "0.301 / 0.600 / 0.259", "1690"),
    ("MLP NARX", "2.80 / 5.18 / 2.40", "133"),
    ("MLP FIR", "18.9 / 20.2 / 15.3", "121"),
    ("RNN", "1.64 / 4.88 / 1.73", "89.2"),
    ("LSTM", "1.50 / 2.68 / 0.960", "74.1"),
    ("state of the art quoted there", "0.36 / 0.26 / 0.32", "2.64"),
]


def yardsticks() -> str:
    """Figures of the completed models on the official splits, beside the published ones."""
    found = stored("yardsticks.json")
    silverbox = " / ".join(f"{v:.2f}" for v in found["silverbox"]["figures"].values())
    ours = [
        "**`isd-gym diagnose`**",
        f"**{silverbox}**",
        f"**{found['emps']['figures']['test']:.2f}**",
    ]
    return markdown(
        "method | Silverbox [mV] | EMPS [mm]", [ours, *map(list, PUBLISHED)], "lrr"
    )


def yardstick_models() -> str:
    """Completed models of the official splits: effects, parameters, figures and time."""
    body = []
    for name, f in stored("yardsticks.json").items():
        effects = ", ".join(e.replace("_", " ") for e in f["effects"])
        values = ", ".join(
            f"{path} {value:.4g}" for path, value in f["parameters"].items()
        )
        figures = "; ".join(
            f"{k.replace('_', ' ')} {v:.2f} {f['unit']}"
            for k, v in f["figures"].items()
        )
        time = f"{f['seconds']:.0f} s"
        body.append(
            [f"`{name}`", effects, str(len(f["parameters"])), values, figures, time]
        )
    heads = "benchmark | effects named | parameters | values in `model.json` | test figures | time"
    return markdown(heads, body, "llrllr")


# ------------------------------------------------------------------------------------------------------ pages


def elements() -> str:
    """Every element type: law, parameters with units and plausible ranges, what tells it apart, source."""
    where = {
        "between": "between two nodes",
        "element": "at a motor",
        "channel": "at a channel",
    }
    parts = []
    for place, title in where.items():
        parts.append(f"## {title[0].upper()}{title[1:]}\n")
        for kind, cls in TYPES.items():
            if cls.place != place:
                continue
            parts += [f"### `{kind}`\n", f"`{cls.equation}`\n"]
            rows = []
            for f in parameter_fields(cls):
                low, high = f.metadata["range"]
                usual = f"{low:g} to {high:g}" if abs(high) < float("inf") else "any"
                default = (
                    f"{f.default:g}" if isinstance(f.default, int | float) else "needed"
                )
                rows.append([f"`{f.name}`", f.metadata["unit"], usual, default])
            for key, allowed in cls.choices.items():
                default = cls.__dataclass_fields__[key].default
                rows.append([f"`{key}`", "", ", ".join(allowed), default])
            parts += [
                markdown("parameter | unit | usual | default", rows, "llll") + "\n",
                f"Recognised by: {cls.signature}. Source: {cls.source}.\n",
            ]
    return "\n".join(parts).strip()


def named(*makers: Callable[[], str]) -> dict[str, Callable[[], str]]:
    """Tables by the names of the functions that make them."""
    return {make.__name__: make for make in makers}


def of_controllers(name: str, file: str) -> str:
    """A table of the controllers' page from the file of a benchmark."""
    return getattr(controllers, name)(stored(file))


#: page -> its tables by name
PAGES: dict[str, dict[str, Callable[[], str]]] = {
    "README.md": named(headline),
    "docs/tutorials/half-car.md": named(half_car),
    "docs/explanation/baselines.md": {
        "wheelbase": wheelbase,
        "times": partial(of_controllers, "times", "mpc.json"),
        "solvers": partial(of_controllers, "solvers", "mpc.json"),
        "robustness": partial(of_controllers, "robustness", "robustness.json"),
    },
    "docs/explanation/ceiling.md": named(ceilings),
    "docs/explanation/road.md": named(pulling, lift_off),
    "docs/reference/elements.md": named(elements),
    "docs/explanation/study.md": named(learning_study),
    "docs/validation/controllers.md": named(scores, ceilings, steps),
    "docs/validation/diagnosis.md": named(suites, calibration),
    "docs/validation/public-measurements.md": named(
        measurements, first_looks, first_looks_by_rig, sources
    ),
    "docs/validation/yardsticks.md": named(yardsticks, yardstick_models),
    "docs/reference/benchmark.md": {
        track: partial(card_table, "ISDSuspension-v0", track)
        for track in ("standard", "preview-0.1", "preview-0.2")
    },
    "docs/reference/environment.md": named(environment),
    "docs/reference/tracks.md": {
        "tracks": tracks,
        "active_roads": partial(each_road, "quarter-car-active"),
        "semiactive_roads": partial(each_road, "quarter-car-semiactive"),
        "half_car_card": partial(card_table, "ISDHalfCar-v0"),
        "full_car_card": partial(card_table, "ISDFullCar-v0"),
        "regeneration": regeneration,
    },
    "docs/reference/limits.md": named(limits, mistaken),
}


def fill(page: str) -> str:
    """The text of a page with its tables made anew.

    Args:
        page: path below the root of the repository, a key of `PAGES`.

    Returns:
        The whole page.
    """
    text = (ROOT / page).read_text(encoding="utf-8")
    for name, make in PAGES[page].items():
        start, end = (
            f"<!-- {name}: python docs/results.py -->",
            f"<!-- end of {name} -->",
        )
        block = f"{start}\n\n{make()}\n\n{end}"
        pattern = f"{re.escape(start)}.*?{re.escape(end)}"
        text, count = re.subn(
            pattern, lambda _, block=block: block, text, flags=re.DOTALL
        )
        if count != 1:
            raise SystemExit(f"{page}: no place for {name}")
    return text


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--read", type=Path, metavar="DIR")
    folder = parser.parse_args().read
    if folder is not None:
        read_answers(folder)
    for path in PAGES:
        (ROOT / path).write_text(fill(path), encoding="utf-8")
