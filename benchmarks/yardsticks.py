"""Public benchmarks with an official split: from the linear model to the completed model, by the diagnosis alone.

python benchmarks/yardsticks.py [FOLDER] [--only NAME ...] [--json FILE]

`FOLDER` holds silverbox/train.csv, silverbox/test_multisine.csv, silverbox/test_arrow_full.csv,
silverbox/test_arrow_no_extrapolation.csv, emps/train.csv and emps/test.csv (columns below). Without `FOLDER` the package
nonlinear-benchmarks downloads the same splits (pip install nonlinear-benchmarks). Models are fitted to the training record
only. The first samples of a test record (50 or 20) give the initial state and are not scored; the rest is a free run.

`--json`: default benchmarks/yardsticks.json; entries of other benchmarks in the file stay.
"""

from __future__ import annotations

import argparse
import datetime
import importlib.metadata
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from json_files import read_json, save_json
from rigs.families.draw import element, model

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from isd_gym import Network, Table, read_table, simulate
from isd_gym._common.arrays import rms
from isd_gym.diagnosis._records.filtering import differentiate_inputs
from isd_gym.diagnosis._records.reading import read_record
from isd_gym.diagnosis._simulation.interpolation import differences
from isd_gym.diagnosis._simulation.problem import Problem, low_pass
from isd_gym.diagnosis.simulation import initial_state
from isd_gym.records.data import write_table

if TYPE_CHECKING:
    from collections.abc import Mapping

JSON = Path(__file__).with_name("yardsticks.json")
#: force of the drive of EMPS over its command [N/V] (Janot, Gautier and Brunot 2019)
DRIVE_GAIN = 35.15065
#: length of the short free runs of EMPS [s]
STRETCH = 1.0


class Yardstick(NamedTuple):
    """A benchmark with its nominal model: mass, spring and damper only."""

    #: folder of the records
    folder: str
    model: dict[str, Any]
    #: test records
    tests: tuple[str, ...]
    #: samples of a test record that give the initial state
    window: int
    #: unit of the score, and its factor to the unit of the output
    unit: str
    factor: float
    #: nodes, range, plane (`Element.plane`) and label of the pictured law
    picture: tuple[tuple[str, str], float, str, str]


def _free(channel: str, quantity: str, node: str) -> dict[str, Any]:
    """Return an output with an unknown offset."""
    return {"name": channel, "quantity": quantity, "at": node, "offset": "free"}


MASS, CARRIAGE = ("mass", "ground"), ("carriage", "ground")
YARDSTICKS = {
    "silverbox": Yardstick(
        "silverbox",
        model(
            "silverbox",
            {"mass": 5.28e-6},
            [
                element("linear_stiffness", "spring", *MASS, stiffness=1.01),
                element("linear_damping", "damper", *MASS, damping=2.3e-4),
            ],
            ["drive force mass"],
            [_free("position", "displacement", "mass")],
        )
        | {
            "uncertainty": {
                "mass.mass": 0.05,
                "spring.stiffness": 0.05,
                "damper.damping": 0.2,
            }
        },
        ("test_multisine", "test_arrow_full", "test_arrow_no_extrapolation"),
        50,
        "mV",
        1e3,
        (MASS, 0.3, "elongation", "position [V]"),
    ),
    "emps": Yardstick(
        "emps",
        model(
            "emps",
            {"carriage": 95.0},
            [element("linear_damping", "guide", *CARRIAGE, damping=220.0)],
            ["force force carriage"],
            ["displacement displacement carriage"],
        )
        | {"uncertainty": {"carriage.mass": 0.1, "guide.damping": 0.5}},
        ("test",),
        20,
        "mm",
        1e3,
        (CARRIAGE, 0.3, "rate", "velocity [m/s]"),
    ),
    "emps-inverse": Yardstick(
        "emps",
        model(
            "emps-inverse",
            {},
            [
                element("inertance", "carriage", *CARRIAGE, inertance=95.0),
                element("linear_damping", "guide", *CARRIAGE, damping=200.0),
            ],
            ["displacement displacement carriage"],
            [_free("force", "force", "carriage")],
        )
        | {"uncertainty": {"carriage.inertance": 0.05, "guide.damping": 0.3}},
        ("test",),
        0,
        "%",
        100.0,
        (CARRIAGE, 0.3, "rate", "velocity [m/s]"),
    ),
}


def download(folder: Path) -> None:
    """Write the official splits as tables, from the package nonlinear-benchmarks.

    Args:
        folder: Folder to write to.
    """
    import nonlinear_benchmarks

    def write(path: str, data: Any, columns: Mapping[str, np.ndarray]) -> None:
        count = len(next(iter(columns.values())))
        target = folder / path
        target.parent.mkdir(exist_ok=True)
        write_table(
            target,
            Table(np.arange(count) * float(data.sampling_time), dict(columns), path),
        )

    train, tests = nonlinear_benchmarks.Silverbox()
    names = YARDSTICKS["silverbox"].tests
    for name, data in zip(("train", *names), (train, *tests), strict=True):
        write(f"silverbox/{name}.csv", data, {"drive": data.u, "position": data.y})
    for name, data in zip(("train", "test"), nonlinear_benchmarks.EMPS(), strict=True):
        write(
            f"emps/{name}.csv",
            data,
            {"force": DRIVE_GAIN * data.u, "displacement": data.y},
        )


def diagnose(yardstick: Yardstick, folder: Path, out: Path) -> tuple[float, float]:
    """Run the command `isd-gym diagnose` on the training record.

    Args:
        yardstick: The benchmark.
        folder: Folder of the records.
        out: Folder of the result.

    Returns:
        Wall time and processor time [s].
    """
    model = out.with_suffix(".json")
    model.write_text(json.dumps(yardstick.model), encoding="utf-8")
    train = folder / yardstick.folder / "train.csv"
    words = [
        sys.executable,
        "-m",
        "isd_gym",
        "diagnose",
        train,
        "--model",
        model,
        "--out",
        out,
    ]
    start, before = (
        time.perf_counter(),
        resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime,
    )
    subprocess.run(list(map(str, words)), check=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    return time.perf_counter() - start, used


def free_run_error(network: Network, table: Table, window: int) -> np.ndarray:
    """Return measured minus simulated output after the window that gives the initial state.

    Args:
        network: The completed model.
        table: Test record with the input and the output.
        window: Number of samples of the window.

    Returns:
        Errors (samples - window,).
    """
    fixed = replace(
        network, outputs=tuple(replace(c, offset=None) for c in network.outputs)
    )
    head = Table(
        table.time[:window],
        {k: v[:window] for k, v in table.columns.items()},
        table.source,
    )
    begun = initial_state(head, fixed)
    inputs = {c.name: table[c.name] for c in fixed.inputs}
    name = fixed.outputs[0].name
    outputs = simulate(
        fixed, table.time, inputs, initial=begun.state, interpolation="auto"
    )
    return np.asarray(table[name] - outputs[name])[window:]


def stretch_error(network: Network, table: Table, window: int) -> float:
    """Return the RMS error of free runs over stretches of `STRETCH`, each with its own initial state."""
    count = round(STRETCH / table.step)
    errors = []
    for first in range(0, len(table.time) - count + 1, count):
        own = slice(first, first + count)
        part = Table(
            table.time[own], {k: v[own] for k, v in table.columns.items()}, table.source
        )
        errors.append(free_run_error(network, part, window))
    return rms(np.concatenate(errors))


def force_error(network: Network, train: Path, test: Path) -> float:
    """Return the RMS error of a force that is computed from a motion, over the deviation of the force.

    Motion, measured force and computed force pass the low-pass that the diagnosis chooses for the training record. Its ends, where the
    filter extrapolates, are not scored.
    """
    first, record = (read_record(path, network, [], ("all",)) for path in (train, test))
    (filtered,) = differentiate_inputs([first], network)
    taps = np.ones(1) if filtered.taps is None else filtered.taps
    moved = {c.name: low_pass(record.inputs[c.name], taps) for c in network.moving}
    slopes = {name: differences(x, record.step) for name, x in moved.items()}
    fixed = replace(
        network, outputs=tuple(replace(c, offset=None) for c in network.outputs)
    )
    smooth = replace(record, inputs=dict(record.inputs) | moved, slopes=slopes)
    computed = low_pass(Problem(fixed, [smooth]).simulate([fixed], 0)[:, 0, 0], taps)
    measured = low_pass(record.measured[:, 0], taps)
    scored = slice(len(taps), len(measured) - len(taps))
    return rms((measured - computed)[scored]) / float(np.std(measured[scored]))


def law_of(network: Network, yardstick: Yardstick) -> dict[str, Any]:
    """Return the static force between two nodes over their distance or their rate, for the picture."""
    pair, reach, plane, label = yardstick.picture
    axis = np.linspace(-reach, reach, 201)
    here = [
        e
        for e in network.elements
        if e.place == "between" and set(e.where) == set(pair)
    ]
    force = np.sum(
        [e.curve(axis) for e in here if e.plane == plane and any(e.curve(axis))], axis=0
    )
    return {"axis": axis.tolist(), "force": force.tolist(), "label": label}


def measure(name: str, folder: Path, out: Path) -> dict[str, Any]:
    """Diagnose the training record of a benchmark, and score the completed model on the test records.

    Args:
        name: Key of `YARDSTICKS`.
        folder: Folder of the records.
        out: Folder of the diagnosis.

    Returns:
        Entry of the JSON file.
    """
    y = YARDSTICKS[name]
    wall, used = diagnose(y, folder, out)
    said = read_json(out / "diagnosis.json")
    network, nominal = Network.load(out / "model.json"), Network.load(y.model)
    changed = {
        path: value
        for path, value in network.parameters.items()
        if path in y.model["uncertainty"] or path not in nominal.parameters
    }
    figures: dict[str, float] = {}
    for test in y.tests:
        path = folder / y.folder / f"{test}.csv"
        if y.window:
            table = read_table(path)
            figures[test] = y.factor * rms(free_run_error(network, table, y.window))
            if name == "emps":
                figures["test, stretches of 1 s"] = y.factor * stretch_error(
                    network, table, y.window
                )
        else:
            figures[test] = y.factor * force_error(
                network, folder / y.folder / "train.csv", path
            )
    return {
        "unit": y.unit,
        "verdict": said["verdict"],
        "effects": [e["effect"] for e in said["effects"]],
        "confidence": [e["confidence"] for e in said["effects"]],
        "parameters": changed,
        "figures": figures,
        "seconds": wall,
        "processor_seconds": used,
        "law": law_of(network, y),
        "version": importlib.metadata.version("isd-gym"),
        "date": datetime.date.today().isoformat(),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument(
        "--only", nargs="+", choices=list(YARDSTICKS), default=list(YARDSTICKS)
    )
    parser.add_argument("--json", type=Path, default=JSON)
    given = parser.parse_args()
    found = read_json(given.json) if given.json.exists() else {}
    with tempfile.TemporaryDirectory() as temporary:
        records = given.folder or Path(temporary)
        if given.folder is None:
            download(records)
        for key in given.only:
            found[key] = measure(key, records, Path(temporary) / f"found-{key}")
            print(key, found[key]["figures"], found[key]["unit"], flush=True)
    ordered = {key: found[key] for key in YARDSTICKS if key in found}
    save_json(given.json, ordered)
