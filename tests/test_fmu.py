"""A network as an FMU for co-simulation: FMPy validates it and simulates it to the result of the kernel."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from builders import oscillator, rms
from program import printed, python, refused, save_json

from isd_gym import Network, simulate
from isd_gym.physics.elements import ActuatorLag, SensorGain
from isd_gym.physics.fmu import Running, export_fmu

STEP = 5e-3
T = STEP * np.arange(120)
ROAD = 0.012 * np.sin(2 * np.pi * 1.3 * T) * np.minimum(T / 0.2, 1)
CURRENT = 2.0 * np.sin(9.0 * T)
#: a displacement is known at the beginning of a step alone: the unit is there when the step ends
LATE = np.concatenate([ROAD[:1], ROAD[:-1]])


def simulated(unit, **settings):
    """FMPy's simulation, in a process of its own: the unit brings a second Python along, which this one may not survive.

    Now and then (once in some hundred runs, in the library that loads it) that process is taken down by a signal: then again.
    """
    told, found = unit.with_suffix(".pickle"), unit.with_suffix(".npy")
    told.write_bytes(pickle.dumps(settings))
    run = """import fmpy, numpy, os, pickle, sys; unit, told, found = sys.argv[1:]
numpy.save(found, fmpy.simulate_fmu(unit, **pickle.load(open(told, 'rb')))); os._exit(0)"""
    for _ in range(3):
        done = python(run, unit, told, found)
        if done.returncode >= 0:
            break
    assert done.returncode == 0, done.stderr
    return np.load(found)


def test_units_are_loaded_again_and_beside_one_another(tmp_path):
    """In one process: the same unit three times, and a unit of the same name with another model between them."""
    pytest.importorskip("pythonfmu")
    pytest.importorskip("fmpy")
    car = Network.load("quarter-car-passive")
    heavy = car.with_parameters({"body.mass": 600.0})
    for number, network in enumerate((car, heavy)):
        (tmp_path / str(number)).mkdir()
        export_fmu(network, tmp_path / str(number) / "car.fmu")
    run = """import fmpy, numpy, os, sys
inputs = numpy.array([(0.0, 0.01), (1.0, 0.01)], [('time', float), ('road', float)])
for k in (0, 1, 0, 1, 0):
    found = fmpy.simulate_fmu(f'{k}/car.fmu', stop_time=0.1, output_interval=0.01, input=inputs)
    print(k, found[found.dtype.names[1]].tolist(), flush=True)
os._exit(0)"""
    done = python(run, cwd=tmp_path)
    lines = done.stdout.splitlines()
    assert len(lines) == 5, done.stdout + done.stderr
    assert lines[0] == lines[2] == lines[4] and lines[1] == lines[3]
    assert lines[0][1:] != lines[1][1:]


def stepped(network, **inputs):
    """Outputs of a `Running` network at the times of the samples, as a master would gather them."""
    running = Running(network)
    rows = [running.start({k: v[0] for k, v in inputs.items()})]
    rows += [
        running.advance({k: v[i] for k, v in inputs.items()}, STEP)
        for i in range(len(T) - 1)
    ]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


@pytest.mark.parametrize("change", ["as it is", "drive and sensor", "half car"])
def test_stepping_is_the_kernels_own_simulation(change):
    car = Network.load("half-car-isd" if change == "half car" else "quarter-car-isd")
    roads, currents = (
        [c.name for c in car.inputs if c.name.startswith(n)]
        for n in ("road", "current")
    )
    if change == "drive and sensor":
        car = car.with_element(ActuatorLag("lag", ("motor",), time_constant=0.02))
        car = car.with_element(SensorGain("gain", ("tyre_force",), gain=1.25))
    driven = {name: CURRENT / (k + 1) for k, name in enumerate(currents)}
    own = stepped(
        car, **driven, **{name: ROAD / (k + 1) for k, name in enumerate(roads)}
    )
    whole = simulate(
        car, T, driven | {name: LATE / (k + 1) for k, name in enumerate(roads)}
    )
    for name, values in whole.items():
        assert np.abs(own[name] - values).max() < 1e-9 * np.abs(values).max(), name


def test_a_shaken_base_is_followed_through_its_damper():
    """Where velocity and acceleration of what is moved matter, a cubic through the last samples stands for the spline."""
    rig = oscillator(
        "acc acceleration mass", mass=10.0, stiffness=4e3, damping=60.0, base="base"
    )
    own = stepped(rig, base=ROAD)["acc"]
    whole = simulate(rig, T, {"base": LATE})["acc"]
    assert rms((own - whole)[20:]) < 0.02 * whole.std()


def test_bad_inputs_are_one_line():
    running = Running(Network.load("quarter-car-passive"))
    refused("'road' is missing", running.start, {})
    refused("not finite", running.start, {"road": float("nan")})


@pytest.mark.parametrize(
    ("name", "says"), [("car.zip", r"\.fmu"), ("no/such/car.fmu", "no folder")]
)
def test_export_refuses_bad_input(tmp_path, monkeypatch, name, says):
    monkeypatch.chdir(tmp_path)
    refused(says, export_fmu, "quarter-car-isd", name)
    assert list(tmp_path.iterdir()) == []


def test_the_unit_validates_and_simulates_to_the_kernels_result(tmp_path):
    pytest.importorskip("pythonfmu")
    fmpy = pytest.importorskip("fmpy")
    from fmpy.validation import validate_fmu

    out = tmp_path / "car.fmu"
    model = replace(
        Network.load("quarter-car-isd"), description='odd "names" & <marks>'
    )
    save_json(tmp_path / "model.json", model.to_dict())
    printed("export", tmp_path / "model.json", "--fmu", out)
    assert validate_fmu(str(out)) == []
    described = fmpy.read_model_description(str(out))
    known = {v.name: v for v in described.modelVariables}
    assert set(known) == {c.name for c in (*model.inputs, *model.outputs)} | set(
        model.parameters
    )
    assert (
        known["road"].causality == "input" and known["tyre_force"].causality == "output"
    )
    for path, value in model.parameters.items():
        assert (
            known[path].causality == "parameter" and float(known[path].start) == value
        )
        unit = model.unit_of(path)
        assert known[path].unit == (None if unit in ("", "-") else unit)
    given = np.array(
        list(zip(T, ROAD, CURRENT, strict=True)),
        [("time", float), ("road", float), ("current", float)],
    )
    light = {"body.mass": 300.0}
    result = simulated(
        out, stop_time=T[-1], step_size=STEP, output_interval=STEP, input=given, start_values=light,
        output=[c.name for c in model.outputs],
    )  # fmt: skip
    whole = simulate(
        model.with_parameters(light), T, {"road": LATE, "current": CURRENT}
    )
    n = min(len(T), len(result))
    assert n > 100
    for name, values in whole.items():
        assert (
            np.abs(result[name][:n] - values[:n]).max() < 1e-6 * np.abs(values).max()
        ), name
