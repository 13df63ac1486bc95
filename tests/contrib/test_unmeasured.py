"""A road that nobody measured, in the likelihood: what motion alone determines, what a known force adds, and when there is no name."""

import json
from dataclasses import replace

import numpy as np
import pytest
from builders import channel, element, friction
from program import refused, with_wings
from typer.testing import CliRunner

from isd_gym import _commands as cli
from isd_gym import simulate
from isd_gym._common.errors import InputError
from isd_gym.contrib.no_road import estimation, identification, identify
from isd_gym.contrib.no_road.decision import check_fit, compute_coloured_shares, find_plausible_range
from isd_gym.contrib.no_road.estimation import ModelFit, estimate_uncertainty
from isd_gym.contrib.no_road.identification import prepare_model
from isd_gym.contrib.simulation.command import command as simulate_command
from isd_gym.diagnosis import diagnose
from isd_gym.diagnosis._simulation.time_limit import TimeLimit
from isd_gym.physics.network import Network
from isd_gym.records._loggers import Recording, Signal
from isd_gym.records.data import Table, write_table
from isd_gym.records.schemas import load

jsonschema = pytest.importorskip("jsonschema")

LEVEL = (2 * np.pi) ** 2 * 5e-7 * 20  # two-sided intensity of the road's velocity [m^2/s]
SURE = ("body.mass", "wheel.mass", "main_spring.stiffness", "tyre.stiffness")
FREE = dict.fromkeys(SURE, 0.1) | {"damper.damping": 0.3}


def car(motor):
    data = Network.load("quarter-car-passive").to_dict()
    seen = ("a acceleration body", "w acceleration wheel", "l displacement body wheel")
    data["outputs"] = [channel(*text.split()) for text in seen]
    if motor:
        data["elements"].append(element("motor", "motor", "body", "wheel", thrust_constant=60.0, ratio=4.0))
        data["inputs"].append(channel("current", "current", element="motor"))
    return Network.load({**data, "uncertainty": FREE})


def drives(truth, motor, seconds=20.0, seed=1):
    rng, h, out = np.random.default_rng(seed), 1e-3, []
    for k in range(2):
        t = np.arange(0, seconds, h)
        road = np.concatenate([[0.0], np.cumsum(rng.standard_normal(len(t) - 1) * np.sqrt(LEVEL * h))])
        current = np.repeat(rng.uniform(-4, 4, len(t) // 20), 20)
        y = simulate(truth, t, {"road": road, "current": current})
        columns = {n: (v + 0.01 * np.std(v) * rng.standard_normal(len(t)))[::4] for n, v in y.items()}
        if motor:
            columns["current"] = current[::4]
        out.append(Table(time=t[::4], columns=columns, source=f"drive_{k}"))
    return out


@pytest.mark.slow
@pytest.mark.parametrize("motor", [False, True])
def test_motion_tells_ratios_to_mass_and_a_motor_sets_the_scale(motor):
    truth = car(motor)
    owner = truth.with_parameters({"damper.damping": 1950.0, "tyre.stiffness": 207e3})
    found = identify(drives(truth, motor), owner, effects=False)
    assert found.ratios_only is not motor
    assert found.level.low < LEVEL < found.level.high
    true, got = truth.parameters, {k: q.value for k, q in found.parameters.items()}
    size = got["body.mass"] / true["body.mass"]
    assert motor is (abs(size - 1) < 0.01)
    for path in ("main_spring.stiffness", "damper.damping"):
        assert got[path] / true[path] / size == pytest.approx(1.0, abs=0.01)
    assert ("body.mass" in found.determined) is motor
    for path, q in found.parameters.items():
        assert q.low * 0.98 < true[path] < q.high * 1.02


def test_what_is_asked_for_wrongly_is_said_in_a_line():
    refused("must be one moved node's displacement", identify, [], car(False), road="street")
    refused("data: no records", identify, [], car(False))
    refused("time limit must be > 0 s", identify, [short()], car(True), max_seconds=0.0)
    cell = car(False).to_dict()
    cell["outputs"].append(channel("F", "force", "road"))
    refused("the node whose motion is unknown", identify, [], Network.load(cell))


def unmeasured(**changes):
    data = car(True).to_dict()
    data["inputs"][0] |= {"measured": False, **changes}
    return data


def test_the_model_file_says_which_input_nobody_measures():
    network = Network.load(unmeasured())
    assert [c.name for c in network.inputs if not c.measured] == ["road"]
    assert Network.load(network.to_dict()) == network
    jsonschema.validate(network.to_dict(), load("isd-model/1"))
    refused("true or false", Network.load, unmeasured(measured=0))
    refused("not a force", Network.load, unmeasured(quantity="force", unit="N"))
    output = car(True).to_dict()
    output["outputs"][0]["measured"] = False
    refused("remove the output", Network.load, output)


def short(motor=True):
    t = 4e-3 * np.arange(1000)
    rng = np.random.default_rng(0)
    names = ["a", "w", "l", *(["current"] if motor else [])]
    noise = {n: np.convolve(rng.standard_normal(1000), np.ones(9), "same") for n in names}
    return Table(t, noise | {"l": 0.01 * noise["l"]}, "drive.csv")


def test_a_record_without_its_road_is_told_what_helps():
    refused(r"--cut wheel .* --unmeasured road", diagnose, [short()], car(True))
    with pytest.raises(InputError, match="no column 'current'") as error:
        diagnose([short(motor=False)], replace(car(True), inputs=car(True).inputs[::-1]))
    assert "unmeasured" not in str(error.value)  # a motor's current has no such way


@pytest.mark.parametrize(
    "command", ["diagnose {0}.csv --model {1} --out {0}", "simulate {1} {0}.csv --out {0}"]
)
def test_the_commands_tell_it_too_and_write_nothing(command, tmp_path):
    write_table(tmp_path / "drive.csv", short())
    car(True).save(tmp_path / "car.json")
    words = command.format(tmp_path / "drive", tmp_path / "car.json").split()
    done = CliRunner().invoke(with_wings(simulate=simulate_command), words)
    assert isinstance(done.exception, InputError) and "diagnose --cut wheel" in str(done.exception)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["car.json", "drive.csv"]


def test_rates_of_their_own_are_for_the_cut():
    table, units = short(), {c.name: c.si for c in (*car(True).inputs, *car(True).outputs)}
    signals = {n: Signal(table.time, x, units[n], "box", n) for n, x in table.columns.items()}
    signals["l"] = replace(signals["l"], clock="another")
    refused("one sampling rate and one clock; --cut", identify, [Recording("run", signals)], unmeasured())


@pytest.mark.slow
def test_the_command_writes_what_the_records_tell(tmp_path):
    """The owner's damper is a third off: with the motor's current known it is found, and the model file has it."""
    owner = Network.load(unmeasured()).with_parameters({"damper.damping": 1950.0})
    owner = replace(owner, uncertainty={"damper.damping": 0.3})
    owner.save(tmp_path / "car.json")
    (table, _) = drives(car(True), True, seconds=8.0)
    write_table(tmp_path / "drive.csv", table)
    words = f"diagnose {tmp_path}/drive.csv --model {tmp_path}/car.json --out {tmp_path}/found"
    done = CliRunner().invoke(cli.app, words.split())
    assert done.exit_code == 0, done.output
    assert "Determined without the road: damper.damping." in done.output
    told = json.loads((tmp_path / "found" / "unmeasured.json").read_text())
    jsonschema.validate(told, load("isd-unmeasured/1"))
    assert told["found"] is None and told["road"] == "road" and told["verdict"] == "parameters_only"
    assert "failed gate" not in done.output
    found = Network.load(tmp_path / "found" / "model.json")
    assert found.parameters["damper.damping"] == pytest.approx(1500.0, rel=0.02)
    assert not found.inputs[0].measured


def sealed(outputs, seconds):
    """A drive of the built-in car, and its model without the friction of the seal."""
    data = Network.load("quarter-car-isd").to_dict()
    known = {c["name"]: c for c in data["outputs"]}
    known["wheel_acceleration"] = channel("wheel_acceleration", "acceleration", "wheel")
    data["outputs"] = [known[name] for name in outputs]
    (table, _) = drives(Network.load(data), True, seconds=seconds)
    data["elements"] = [e for e in data["elements"] if e["name"] != "seal"]
    del data["uncertainty"]["seal.level"]
    return table, Network.load(data)


TWO = ("body_acceleration", "suspension_travel")
THREE = (*TWO, "wheel_acceleration")


def kalman_model(table, owner):
    return prepare_model(table, Network.load(owner), "road", (), [])


def test_the_filter_has_a_solution_whatever_the_parameters():
    """The damper in series drifts, and no output sees its elongation: that must not keep the filter from its stationary state."""
    L = kalman_model(*sealed(THREE, 2.0))
    x = np.array([n.mean for n in L.priors])
    for k in range(len(x)):
        for step in (-0.3, -0.01, 0.001, 0.3):
            assert L.predict(x + step * (np.arange(len(x)) == k)) is not None


def test_a_level_of_which_nothing_is_known_has_an_infinite_interval():
    """A road too even to be seen has a level of any size below: its 95 % interval overflowed."""
    L = kalman_model(short(), car(True))
    x = np.array([n.mean for n in L.priors])
    x[len(L.structure.free)] = -70.0
    estimates = estimate_uncertainty(L.structure.network, ModelFit(L, x, L.deviance(x)))
    assert estimates.level.high == np.inf and np.isfinite(estimates.level.value)
    gates = check_fit(L.structure.network, estimates, L.predict(x), np.ones(3))
    (gate,) = [g for g in gates if g.name == "finite"]
    assert not gate.passed and (gate.value, gate.limit) == (1, 0)


def test_the_accelerations_of_rounding_errors_are_not_the_road_s():
    """Gains of 1e-17 of the road's acceleration made a filter impossible, and the inerter of this mass was passed over."""
    data = car(True).to_dict()
    data["elements"].append(element("b", "inertance", "body", "wheel", inertance=20.0))
    L = kalman_model(short(), data)
    x = np.array([p.mean for p in L.priors])
    k = [p.name for p in L.priors].index("wheel.mass")
    for factor in np.linspace(-1.0, 1.0, 41):
        assert L.predict(x + factor * (np.arange(len(x)) == k)) is not None


def test_a_model_that_runs_away_has_no_deviance():
    """Its prediction errors overflow; no warning and no exception comes of that."""
    L = kalman_model(short(), car(True))
    x = np.array([n.mean for n in L.priors])
    (u, y), *_ = L.records
    assert L.predict(x) is not None
    assert replace(L, records=((u, np.full_like(y, np.inf)),)).predict(x) is None
    assert L.predict(x + 800.0) is None  # the value itself overflows


def test_an_effect_is_plausible_in_the_range_of_its_class_or_of_the_model():
    low, high = find_plausible_range(car(True), "linear_stiffness", "stiffness")
    assert low <= 1e3 < high < 4.3e6
    stiff = car(True).with_parameters({"tyre.stiffness": 1e7})
    assert find_plausible_range(stiff, "linear_stiffness", "stiffness")[1] == pytest.approx(1e7)


def test_prediction_errors_that_their_past_predicts_are_told_from_white_ones():
    rng = np.random.default_rng(0)
    white = rng.standard_normal((4000, 2))
    coloured = white.copy()
    for k in range(1, len(white)):
        coloured[k, 0] += 0.8 * coloured[k - 1, 0]
    assert compute_coloured_shares([white], np.ones(2)).max() == 0.0
    assert compute_coloured_shares([coloured], np.ones(2)) == pytest.approx([0.64, 0.0], abs=0.03)
    assert compute_coloured_shares([coloured], np.full(2, 1e3)).max() == 0.0  # too small to matter


def test_wide_uncertainties_do_not_make_friction_linear():
    """Every parameter stays in its range, but the past of the prediction errors predicts them."""
    data = car(True).to_dict()
    data["elements"].append(friction("body", "wheel", 150.0))
    (table, _) = drives(Network.load(data), True, seconds=8.0)
    found = identify(table, car(True), effects=False)
    gates = {g.name: g for g in found.gates}
    assert gates["plausible"].passed and not gates["white"].passed
    assert found.verdict == "unknown_effect" and "the prediction error of a" in found.summary


@pytest.mark.slow
def test_a_missing_inerter_is_named_with_the_gates_that_it_passed():
    data = car(True).to_dict()
    data["elements"].append(element("b", "inertance", "body", "wheel", inertance=60.0))
    (table, _) = drives(Network.load(data), True, seconds=8.0)
    found = identify(table, car(True))
    assert found.verdict == "missing_effect" and all(g.passed for g in found.gates)
    name, where, values = found.found
    assert (name, where) == ("inertance", ("body", "wheel"))
    assert values["inertance"].value == pytest.approx(60.0, rel=0.02)
    assert found.model.parameters["inertance.inertance"] == values["inertance"].value


@pytest.mark.parametrize(
    ("limit", "tried"), [(3.0, "0 of 3"), pytest.param(2.5, "2 of 3", marks=pytest.mark.slow)]
)
def test_the_time_limit_stops_the_search_and_says_so(limit, tried, monkeypatch):
    """A clock that goes on by a second at every reading, or at every effect that was fitted."""
    readings, fitted = iter(range(10**6)), []

    def fit_effect(*args):
        fitted.append(estimation.fit_effect(*args))
        return fitted[-1]

    monkeypatch.setattr(identification, "fit_effect", fit_effect)
    seconds = (lambda _: float(next(readings))) if tried.startswith("0") else (lambda _: float(len(fitted)))
    monkeypatch.setattr(TimeLimit, "seconds", property(seconds))
    data = car(True).to_dict()
    data["elements"].append(element("b", "inertance", "body", "wheel", inertance=60.0))
    (table, _) = drives(Network.load(data), True, seconds=4.0)
    found = identify(table, car(True), max_seconds=limit)
    (note,) = [n for n in found.notes if "time limit" in n]
    assert f"the time limit of {limit:g} s stopped the search: {tried} linear effects were tried" in note
    gates = {g.name: g for g in found.gates}
    assert not gates["complete"].passed and found.found is None
    assert gates["converged"].passed is ("not converged" not in note)
    assert found.verdict == "unknown_effect" and "A longer --max-seconds" in found.summary
    json.dumps(found.to_dict(), allow_nan=False)


def test_one_way_at_a_time(tmp_path):
    car(True).save(tmp_path / "car.json")
    words = ["diagnose", "drive.csv", "--model", str(tmp_path / "car.json"), "--out", str(tmp_path / "found")]
    done = CliRunner().invoke(cli.app, [*words, "--cut", "wheel", "--unmeasured", "road"])
    assert isinstance(done.exception, InputError) and "one of them" in str(done.exception)
