"""An FMU as the model of a diagnosis: opened on trust alone and refitted."""

import json
import zipfile

import builders
import numpy as np
import pytest
from builders import channel, damper, element, spring
from program import refused
from typer.testing import CliRunner

from isd_gym import _commands as cli
from isd_gym._common.errors import InputError
from isd_gym.contrib.fmi.cosimulation import Unit
from isd_gym.contrib.fmi.export import export_fmu
from isd_gym.contrib.fmi.identification import diagnose_unit
from isd_gym.contrib.fmi.identification.comparison import FmuComparison
from isd_gym.contrib.fmi.identification.diagnosis import _read
from isd_gym.physics.simulate import simulate
from isd_gym.records.data import Table, write_table

pytest.importorskip("pythonfmu")
pytest.importorskip("fmpy")

STEP = 5e-3
FREE = {"mass.mass": 0.2, "damper.damping": 0.2}
SHAKEN = [spring("mass", "base", 2e4), damper("mass", "ground", 200.0)]
BASE = channel("base", "displacement", "base", unit="mm")
SEEN = ["acc acceleration mass", "travel displacement mass base"]
RIG = builders.network("one-mass", SHAKEN, [BASE], SEEN, masses={"mass": 40.0})


def record(network, seed, name, samples=900):
    """A shaken rig, measured with 1 % noise."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(samples)
    base = builders.sines(t, rng.uniform(0.5, 8, 12), rng.uniform(0, 6, 12), 3.0)
    out = simulate(network, t, {"base": base})
    noisy = {k: v + 0.01 * v.std() * rng.normal(size=samples) for k, v in out.items()}
    return Table(t, {"base": base, **noisy}, name, {"base": "mm", "acc": "m/s^2", "travel": "m"})


@pytest.fixture(scope="module")
def unit_file(tmp_path_factory):
    return export_fmu(RIG, tmp_path_factory.mktemp("unit") / "rig.fmu", step=STEP)


@pytest.fixture(scope="module")
def unit(unit_file):
    with Unit(unit_file, trust=True) as opened:
        yield opened


def test_without_trust_nothing_is_opened(unit_file, tmp_path, monkeypatch):
    write_table(tmp_path / "a.csv", record(RIG, 1, "a", 400))
    args = ["diagnose", str(tmp_path / "a.csv"), "--model", str(unit_file), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(cli.app, args)
    assert isinstance(done.exception, InputError)
    assert "--trust-fmu" in str(done.exception) and "your rights" in str(done.exception)
    assert not (tmp_path / "out").exists()
    refused("compiled code", Unit, unit_file)
    monkeypatch.setenv("ISD_GYM_READ_LIMIT_GB", "1e-6")  # nor is a bomb
    refused("the limit is", Unit, unit_file, trust=True)


CHANGED = RIG.with_parameters({"mass.mass": 46.0, "damper.damping": 150.0})


def test_a_hidden_change_of_parameters_is_found_through_the_unit(unit):
    """The unit as its owner exported it, a record of a rig that differs in two parameters."""
    said = diagnose_unit([record(CHANGED, 1, "a")], unit, uncertainty=FREE)
    assert said.verdict == "parameters_only"
    for path, true in (("mass.mass", 46.0), ("damper.damping", 150.0)):
        q = said.parameters[path]
        assert q.value == pytest.approx(true, rel=0.02) and q.low < q.value < q.high


@pytest.mark.slow
def test_the_same_by_way_of_the_command(unit_file, tmp_path):
    files = []
    for seed in (1, 2):
        files.append(str(tmp_path / f"{seed}.csv"))
        write_table(files[-1], record(CHANGED, seed, f"record {seed}"))
    out = tmp_path / "out"
    free = [f"--uncertain={k}={v}" for k, v in FREE.items()]
    args = ["diagnose", *files, "--model", str(unit_file), "--out", str(out), "--trust-fmu", *free]
    done = CliRunner().invoke(cli.app, args)
    assert done.exit_code == 0, done.exception
    assert "warning" in done.stderr and "your rights" in done.stderr
    said = json.loads((out / "diagnosis.json").read_text())
    assert said["verdict"] == "parameters_only" and said["effects"] == []
    for path, true in (("mass.mass", 46.0), ("damper.damping", 150.0)):
        q = said["parameters"][path]
        assert q["value"] == pytest.approx(true, rel=0.01) and q["low"] < q["value"] < q["high"]
    gap = said["gap"]["held_out"]
    assert all(gap["before"][c] > 0.05 and gap["refit"][c] < 0.015 for c in ("acc", "travel"))
    values = (out / "parameters.ssv").read_text()
    assert 'name="mass.mass"' in values and not (out / "model.json").exists()
    page = (out / "report.html").read_text()
    assert "Diagnosis of the FMU" in page and "parameters.ssv" in page and "model.json" not in page


def test_what_agrees_is_left_alone_and_what_the_unit_hides_is_not_named(unit):
    """A single record; then one of a rig whose spring hardens: no value of a parameter explains that."""
    hard = element("hard", "cubic_stiffness", "mass", "base", stiffness=2e7)
    same = diagnose_unit([record(RIG, 3, "a")], unit, uncertainty=FREE)
    other = diagnose_unit([record(RIG.with_element(hard), 3, "b")], unit, uncertainty=FREE)
    assert same.verdict == "no_discrepancy"
    assert other.verdict == "unknown_effect" and other.effects == () and other.closed is None
    assert "inside an FMU are hidden" in other.summary and other.where[0].share > 0.3
    assert other.gap["refit"]["travel"] > 3 * other.gap["noise_floor"]["travel"]


def test_the_unit_is_stepped_so_that_its_inputs_are_not_late(unit):
    """A unit knows an input at the beginning of a step alone: run naively it would be a step late, 1 % noise or none."""
    r, ports = _read(record(RIG, 4, "a", 800), unit.model, [], [])
    c = FmuComparison(unit, unit.model, [r], ports)
    c.settle(lambda line: None)
    assert c.lead == {"base": 1.0}  # ours goes there while the step lasts
    error = (r.measured - c.simulate(unit.model, 0))[200:].std(axis=0) / r.measured.std(axis=0)
    c.lead, c.steps_per_sample = {"base": 0.0}, 1
    late = (r.measured - c.run(unit.model, 0))[200:].std(axis=0) / r.measured.std(axis=0)
    assert np.all(error < 0.015) and np.all(late > 5 * error)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"no archive", "is no FMU"),
        ({"a.txt": b"x"}, "no modelDescription.xml"),
        ({"modelDescription.xml": b"<fmiModelDescription"}, "broken.fmu: "),
    ],
)
def test_what_is_no_unit_is_one_line(tmp_path, content, says):
    path = tmp_path / "broken.fmu"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in content.items():
                archive.writestr(name, data)
    refused(says, Unit, path, trust=True)


def test_a_unit_that_brings_its_process_down_is_one_line(unit_file, tmp_path):
    """Its own code, as it were: what a master sees is a process that has gone."""
    with Unit(unit_file, trust=True) as unit:
        unit._process.process.kill()
        refused("broke down", unit.run, {"base": np.zeros(10)}, 10, STEP, ["acc"], {})
        # and goes on in a new one
        assert unit.run({"base": np.zeros(10)}, 10, STEP, ["acc"], {}).shape == (10, 1)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"columns": ["base"]}, "none of the FMU's outputs"),
        ({"columns": ["acc"]}, "input 'base' is no column"),
        ({"uncertainty": {"mass.weight": 0.1}}, "no parameter 'mass.weight'"),
        ({"uncertainty": {"mass.mass": -1.0}}, "must be a share"),
        ({"accept": ["everything"]}, "no check 'everything'"),
    ],
)
def test_bad_input_names_what_helps(unit, change, says):
    table = record(RIG, 5, "a", 400)
    if "columns" in change:
        table = Table(table.time, {k: table[k] for k in change["columns"]}, "a")
    options = {k: v for k, v in change.items() if k != "columns"}
    refused(says, diagnose_unit, [table], unit, **options)
