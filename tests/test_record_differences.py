"""Parameters that differ between records, on rigs whose truth is known."""

import json
from dataclasses import replace

import builders
import jsonschema
import numpy as np
import pytest
from builders import damper, element, oscillator, recorded, sines

from isd_gym.diagnosis import diagnose
from isd_gym.diagnosis._estimation.gauss_newton import Fitter
from isd_gym.diagnosis._estimation.noise import white_weights
from isd_gym.diagnosis._estimation.structure import Hypothesis, add, base_structure
from isd_gym.diagnosis._selection.record_differences import (
    RecordwiseFitter,
    find_record_differences,
    group_values,
)
from isd_gym.diagnosis._selection.settings import SearchSettings
from isd_gym.diagnosis._simulation.problem import Problem, Record
from isd_gym.diagnosis._verdict.wording import statements_of
from isd_gym.diagnosis.result import is_far_better
from isd_gym.records import schemas
from isd_gym.records.data import Table

STEP, SAMPLES, NOISE = 2e-3, 4000, 1e-5  # [s], -, [m]


def rig(*extra, **values):
    """Return a mass on a spring and a damper to the ground, pushed by a force; values of parameters have "__" in place of "."."""
    known = {"mass.mass": 0.2, "spring.stiffness": 0.2, "damper.damping": 0.5}
    parts = {"mass": 2.0, "stiffness": 900.0, "damping": 9.0, "beside": extra}
    network = oscillator("position displacement mass", uncertainty=known, **parts)
    return network.with_parameters({k.replace("__", "."): v for k, v in values.items()})


def push(seed, size=20.0):
    """Return a multisine force (samples,) [N] of some size from 0.5 to 8 Hz."""
    rng, t = np.random.default_rng(seed), STEP * np.arange(SAMPLES)
    lines = np.arange(0.5, 8.0, 0.5)
    return sines(t, lines, rng.uniform(0.0, 2.0 * np.pi, len(lines)), size / len(lines) ** 0.5)


def measure(network, name, seed, size=20.0):
    """Return a record of a rig from rest, with sensor noise."""
    made = recorded(network, STEP, {"push": push(seed, size)})
    noise = NOISE * np.random.default_rng(1000 + seed).standard_normal(made.measured.shape)
    return replace(made, name=name, measured=made.measured + noise)


def search(records, laws=()):
    """Return the differences between records for the nominal model."""
    network = rig()
    structure = base_structure(network)
    problem, noise = Problem(network, records), np.array([NOISE])
    return find_record_differences(problem, structure, structure.start, noise, laws)


@pytest.fixture(scope="module")
def loaded():
    """Three records, the second with a payload of 0.5 kg."""
    heavy = rig(mass__mass=2.5)
    return [measure(rig(), "a", 1), measure(heavy, "b", 2), measure(rig(), "c", 3)]


def test_a_payload_of_one_of_three_records_is_found(loaded):
    found = search(loaded)
    (mass,) = found.parameters
    assert mass.path == "mass.mass" and found.records == ("a", "b", "c") and mass.groups == (0, 1, 0)
    for q, true in zip(mass.values, (2.0, 2.5, 2.0), strict=True):
        assert q.value == pytest.approx(true, rel=2e-3) and q.low < true < q.high
    assert found.explained > 0.99
    assert found.error["differing"]["position"] < 0.1 * found.error["joint"]["position"]


@pytest.mark.parametrize(
    ("path", "values", "groups"),
    [
        ("damper.damping", (9.0, 9.0, 14.0, 14.0), (0, 0, 1, 1)),
        ("spring.stiffness", (1000.0, 900.0, 900.0, 800.0), (2, 1, 1, 0)),
    ],
)
def test_damping_and_stiffness_that_differ_are_found(path, values, groups):
    rigs = [rig(**{path.replace(".", "__"): v}) for v in values]
    found = search([measure(r, "abcd"[k], 10 + k) for k, r in enumerate(rigs)])
    (p,) = found.parameters
    assert p.path == path and p.groups == groups
    assert [q.value for q in p.values] == pytest.approx(values, rel=1e-2)


def test_a_coast_down_that_slows_faster_is_found():
    """A flywheel whose bearing drags more in one record; its motion has no period."""

    def wheel(damping):
        parts, known = [damper("wheel", "ground", damping, "bearing")], {"bearing.damping": 0.5}
        speed = ["speed angular_velocity wheel"]
        return builders.network("wheel", parts, [], speed, inertias={"wheel": 2.0}, uncertainty=known)

    records, rng = [], np.random.default_rng(5)
    for k, damping in enumerate((0.02, 0.02, 0.03)):
        time = 0.5 * np.arange(800)
        speed = (60.0 - 5.0 * k) * np.exp(-damping / 2.0 * time) + 0.02 * rng.standard_normal(len(time))
        records.append(Record("abc"[k], 0.5, {}, speed[:, None]))
    network = wheel(0.024)
    structure = base_structure(network)
    found = find_record_differences(Problem(network, records), structure, structure.start, np.array([0.02]))
    (p,) = found.parameters
    assert p.path == "bearing.damping" and p.groups == (0, 0, 1)
    assert [q.value for q in p.values] == pytest.approx([0.02, 0.02, 0.03], rel=5e-3)


def test_two_parameters_that_differ_are_found():
    second = rig(mass__mass=2.5, damper__damping=16.0)
    found = search([measure(rig(), "a", 1), measure(second, "b", 2), measure(rig(), "c", 3)])
    assert {p.path for p in found.parameters} == {"mass.mass", "damper.damping"}
    assert all(p.groups == (0, 1, 0) for p in found.parameters)


def test_the_order_of_the_records_changes_nothing(loaded):
    forward, backward = (json.dumps(search(r).to_dict()) for r in (loaded, loaded[::-1]))
    assert forward == backward


def test_records_of_one_rig_do_not_differ():
    assert search([measure(rig(), "abc"[k], 20 + k) for k in range(3)]) is None


@pytest.mark.parametrize(
    "law",
    [
        {"type": "cubic_stiffness", "stiffness": 4e6},
        {"type": "coulomb_friction", "level": 4.0},
        {"type": "quadratic_damping", "damping": 150.0},
    ],
    ids=lambda law: law["type"],
)
def test_a_missing_law_is_no_difference_between_records_of_like_motion(law):
    network = rig({"name": "law", "between": ["mass", "ground"], **law})
    assert search([measure(network, "abc"[k], 30 + k) for k in range(3)]) is None


def test_a_law_that_explains_records_of_unlike_amplitude_goes_before_a_difference():
    network = rig(element("law", "quadratic_damping", "mass", "ground", damping=15.0))  # fmt: skip
    records = [measure(network, "a", 1, 4.0), measure(network, "b", 2, 40.0), measure(network, "c", 3, 4.0)]
    # a damping that grows with the amplitude is a difference as long as no law is known
    assert [p.path for p in search(records).parameters] == ["damper.damping"]
    structure = add(base_structure(rig()), Hypothesis("quadratic_damping", ("mass", "ground")), {"damping": 5.0})  # fmt: skip
    assert search(records, [("quadratic damping", structure, structure.start)]) is None


def test_short_records_are_not_compared(loaded):
    assert search([r.part(0, 150, r.name) for r in loaded]) is None


def test_fits_of_groups_are_those_of_all_records_and_of_each_alone():
    network, true = rig(), rig(mass__mass=2.2, damper__damping=7.0)
    records = [measure(true, "abc"[k], 40 + k) for k in range(3)]
    structure, problem, filters = base_structure(network), Problem(network, records), white_weights([NOISE])
    fitter, one = RecordwiseFitter(problem, filters), Fitter(problem, filters)
    shared, every = np.zeros(3, bool), np.ones(3, bool)
    groups = [[0], [1], [2]]
    joint = fitter.fit_groups(structure, structure.start, groups, shared, iterations=20, tolerance=1e-9)
    expected = one.fit(structure, iterations=20, tolerance=1e-9)
    assert np.ptp(joint.x, axis=0).max() == 0.0
    assert joint.x[0] == pytest.approx(expected.x, rel=1e-6)
    alone = fitter.fit_groups(structure, structure.start, groups, every, iterations=20, tolerance=1e-9)
    for k in range(3):
        expected = one.fit(structure, records=[k], iterations=20, tolerance=1e-9)
        assert alone.x[k] == pytest.approx(expected.x, rel=1e-6)


def test_an_explanation_that_halves_the_error_of_another_is_far_better():
    assert is_far_better(0.99, 0.8) and not is_far_better(0.99, 0.97)
    assert not is_far_better(0.42, 0.41) and not is_far_better(0.41, 0.42)
    assert is_far_better(1.02, 0.95) and not is_far_better(1.02, 0.97)  # no better than noise


def test_records_with_one_name_are_kept_apart(loaded):
    found = search([replace(r, name="run") for r in loaded])
    (mass,) = found.parameters
    assert found.records == ("run", "run", "run") and sorted(mass.groups) == [0, 0, 1]
    assert len(found.to_dict()["amplitude"]) == 3


def test_neighbouring_values_that_do_not_differ_have_one_group():
    deviations, freedom = np.full(4, 0.1), np.full(4, 7.0)
    assert group_values(np.array([5.0, 1.0, 1.1, 5.1]), deviations, freedom) == (1, 0, 0, 1)
    assert group_values(np.array([1.0, 1.2, 0.9, 1.1]), deviations, freedom) == (0, 0, 0, 0)


@pytest.mark.slow
def test_a_diagnosis_states_the_payload(loaded, tmp_path):
    tables = [Table(r.time, {"push": r.inputs["push"], "position": r.measured[:, 0]}, r.name) for r in loaded]
    found = diagnose(tables, rig(), settings=SearchSettings(depth=1))
    assert found.verdict == "unknown_effect" and found.reason == "records_differ"
    (mass,) = found.record_differences.parameters
    assert mass.path == "mass.mass" and mass.groups == (0, 1, 0)
    document = found.to_dict()
    assert jsonschema.Draft202012Validator(schemas.load("isd-diagnosis/1")).is_valid(document)
    told = statements_of(document)
    assert told.title == "The records differ: mass of mass changes from record to record"
    assert "2 kg in a and c and 2.5 kg in b" in told.text
    found.save(tmp_path / "found")
    page = (tmp_path / "found" / "report.html").read_text()
    assert "Parameters that differ between records" in page and "2.5" in page
