"""Turned, mislabelled and swapped channels are refused before the refit; defects of a rig are not."""

import builders
import numpy as np
import pytest
from builders import channel, damper, friction, spring
from program import refused

from isd_gym import Network, Table, diagnose, simulate
from isd_gym.diagnosis import _workflow as workflow
from isd_gym.diagnosis._records.agreement import find_misreading
from isd_gym.diagnosis._records.reading import read_record
from isd_gym.diagnosis._simulation.problem import Problem
from isd_gym.records.data._quality import known_check

STRUT = [spring("body", "wheel", 22e3), damper("body", "wheel", 1500.0)]
CAR = builders.model(
    "four-poster",
    [*STRUT, spring("wheel", "platen", 200e3, "tyre")],
    [channel("platen", "displacement", "platen", unit="mm")],
    [
        channel("acc", "acceleration", "body", unit="g"),
        channel("travel", "displacement", "body", "wheel", unit="mm"),
        channel("load", "force", "platen", unit="kN", offset="free"),
    ],
    masses={"body": 340.0, "wheel": 40.0},
    uncertainty={"body.mass": 0.05, "damper.damping": 0.15},
)
STEP, N = 0.005, 6000
TIME = STEP * np.arange(N)


def road(seed=0):
    """Return a rough road [mm] from 0.5 to 15 Hz."""
    f = np.linspace(0.5, 15.0, 120)
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(f))
    return builders.sines(TIME, f, phases, 1 / f) * np.minimum(TIME, 1.0)


def true_rig(level=65.0):
    """Return a rig with other parameters than the model, and friction."""
    rig = Network.load(CAR).to_dict()
    rig["masses"] = {"body": 357.0, "wheel": 40.0}
    rig["elements"][0]["stiffness"] = 21.4e3
    rig["elements"][1]["damping"] = 1300.0
    rig["elements"].append(friction("body", "wheel", level, "seal"))
    return Network.load(rig)


def record(excitation=None, rig=None, **changes):
    """Return a measured record; a change is a factor of a channel, or the channel whose values it gets."""
    x = road() if excitation is None else excitation
    said = simulate(rig or true_rig(), TIME, {"platen": x}, step=1e-3)
    rng = np.random.default_rng(1)
    columns = {"platen": x} | {
        n: y + 0.01 * y.std() * rng.standard_normal(N) for n, y in said.items()
    }
    columns["load"] = columns["load"] + 3.7  # a static load
    changed = {
        n: columns[k] if isinstance(k, str) else k * columns[n]
        for n, k in changes.items()
    }
    units = {"platen": "mm", "acc": "g", "travel": "mm", "load": "kN", "hub": "g"}
    return Table(TIME, columns | changed, units={n: units[n] for n in columns})


def line(*tables, model=CAR):
    network = Network.load(model)
    return find_misreading(
        Problem(network, [read_record(t, network, [], ("all",)) for t in tables])
    )


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        ({"load": -1}, "--sign load=-1"),
        ({"acc": -1}, "--sign acc=-1"),
        ({"platen": -1}, "--sign platen=-1"),
        ({"acc": 9.80665}, "--unit acc=m/s^2"),
        ({"travel": 1e-3}, "--unit travel=m"),
        ({"load": 1e3}, "--unit load=N"),
        ({"platen": 1e-3}, "--unit platen=m"),
        ({"acc": "travel", "travel": "acc"}, "exchange their names"),
    ],
)
def test_a_misread_channel_is_named_with_its_remedy(changes, remedy):
    said = line(record(**changes))
    assert remedy in said


@pytest.mark.parametrize(
    "changes",
    [{}, {"acc": 0.6}, {"travel": 1.3}, {"load": 1.1}, {"acc": 5.0}],
    ids=lambda c: str(c),
)
def test_a_defect_of_a_rig_is_no_misreading(changes):
    """Other parameters, friction of any size, and gains of sensors go on to the diagnosis."""
    for level in (0.0, 65.0, 800.0):
        assert line(record(rig=true_rig(level=level), **changes)) == ""


def test_a_motor_whose_nodes_are_exchanged_has_two_remedies():
    """One output that a motor moves the wrong way: the sensor or the motor may be turned round."""
    outputs = [channel("angle", "angle", "arm")]
    parts = [spring("arm", "ground", 2.0), damper("arm", "ground", 0.02)]
    inputs = [
        {"name": "command", "quantity": "voltage", "element": "drive", "unit": "V"}
    ]
    rigs = []
    for ends in (("ground", "arm"), ("arm", "ground")):
        motor = builders.element("drive", "motor", *ends, thrust_constant=0.1)
        rigs.append(
            builders.network(
                "arm", [*parts, motor], inputs, outputs, inertias={"arm": 0.003}
            )
        )
    rig, model = rigs
    volts = 5.0 * road()
    moved = simulate(rig, TIME, {"command": volts})
    table = Table(TIME, {"command": volts, "angle": moved["angle"]})
    assert line(table, model=rig) == ""
    assert line(table, model=model).endswith(
        "--sign angle=-1, or swap the nodes of motor drive in the model"
    )


def test_a_delayed_sensor_is_no_misreading():
    table = record()
    late = table.columns | {"acc": np.roll(table["acc"], 8)}
    assert line(Table(TIME, late)) == ""


@pytest.mark.parametrize("frequency", [1.35, 1.45, 12.0])
def test_a_sine_between_two_resonances_says_nothing_of_signs(frequency):
    """Between the resonance of the rig and that of the model, every output of a light damper is turned."""
    model = Network.load(CAR).to_dict()
    model["elements"][1]["damping"] = 50.0
    rig = Network.load(model).to_dict()
    rig["elements"][0]["stiffness"] = 30e3
    sine = 5.0 * np.sin(2 * np.pi * frequency * TIME)
    assert line(record(excitation=sine, rig=Network.load(rig)), model=model) == ""


def test_a_free_decay_and_a_short_record_cannot_be_compared():
    still = record(excitation=np.zeros(N) + 1e-9 * road())
    assert line(Table(TIME[:100], {n: x[:100] for n, x in still.columns.items()})) == ""
    free = {**CAR, "inputs": [], "outputs": CAR["outputs"][:2]}
    free["elements"] = [
        *CAR["elements"][:2],
        {**CAR["elements"][2], "between": ["wheel", "ground"]},
    ]
    assert line(Table(TIME, {n: still[n] for n in ("acc", "travel")}), model=free) == ""


def test_the_diagnosis_refuses_at_once_and_goes_on_when_accepted(monkeypatch):
    turned = record(load=-1)
    refused(
        r"load follows the model with r = -0.9\d, turned round: --sign load=-1",
        diagnose,
        [turned],
        CAR,
    )
    known_check("sign")

    class Reached(Exception):
        pass

    def search(*args, **options):
        raise Reached

    monkeypatch.setattr(workflow.Workflow, "run", search)
    for accept in ("sign", "all"):
        with pytest.raises(Reached):
            diagnose([turned], CAR, accept=[accept])
