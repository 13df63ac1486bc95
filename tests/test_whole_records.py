"""A candidate simulates every record of the user, and a finished diagnosis is never lost; the order of files decides nothing."""

from dataclasses import replace

import builders
import numpy as np
import pytest
from builders import friction
from program import read_json, refused

from isd_gym import InputError, Table, diagnose, simulate
from isd_gym.diagnosis import _result_builder as builder
from isd_gym.diagnosis import hypotheses
from isd_gym.diagnosis._estimation.gauss_newton import Fitter
from isd_gym.diagnosis._estimation.noise import white_weights
from isd_gym.diagnosis._estimation.structure import add, base_structure
from isd_gym.diagnosis._records.splitting import split_records
from isd_gym.diagnosis._selection.held_out import HeldOutEvaluator
from isd_gym.diagnosis._selection.held_out_table import row_of
from isd_gym.diagnosis._simulation.problem import Problem, Record
from isd_gym.view import write_report

STEP = 0.01


def swing(moved=False):
    """A mass on a spring, with its speed measured; hung from a moving base or from the ground."""
    known = {"damper.damping": 0.5, "spring.stiffness": 0.05}
    parts = {
        "mass": 1.0,
        "stiffness": 100.0,
        "damping": 0.4,
        "base": "base" if moved else "",
    }
    network = builders.oscillator("speed velocity mass", uncertainty=known, **parts)
    return network if moved else replace(network, inputs=())


def decay():
    network, time = swing(), STEP * np.arange(3000)
    speed = simulate(network, time, {}, initial=np.array([0.0, 3.0]))["speed"]
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(time))
    return Record("decay", STEP, {}, (speed + noise)[:, None])


def softening(problem, stiffness):
    """A cubic spring that turns the spring over at a travel that only the start of the whole record reaches."""
    kind = next(h for h in hypotheses(problem.network) if h.effect == "cubic_stiffness")
    structure = add(base_structure(problem.network), kind, {"stiffness": stiffness})
    return Fitter(problem, white_weights(np.array([0.01]))).fit(structure, iterations=0)


def test_a_candidate_that_does_not_simulate_a_record_of_the_user_is_not_scored():
    network, whole = swing(), decay()
    later = [whole.part(a, a + 500, whole.name) for a in (1500, 2000, 2500)]
    problem = Problem(network, later, ["fit", "choose", "report"])
    strong = softening(problem, -4000.0)
    known = HeldOutEvaluator(problem, whole=Problem(network, [whole], ["fit"]))
    refused("breaks down on the record decay", row_of, known, strong)
    # the pieces alone, and a weaker spring, say nothing against it
    alone = HeldOutEvaluator(problem)
    assert np.isfinite(row_of(alone, strong).error)
    weak = softening(problem, -400.0)
    assert np.isfinite(row_of(known, weak).error)
    # a record that the nominal model cannot simulate either is held against nobody
    spoiled = replace(
        whole, measured=np.where(np.arange(3000)[:, None] < 5, 1e90, whole.measured)
    )
    blind = HeldOutEvaluator(problem, whole=Problem(network, [spoiled], ["fit"]))
    assert np.isfinite(row_of(blind, strong).error)


def tables(count, samples=600):
    """Short records of the swing on a moving base, with dry friction at its mass."""
    network = swing(moved=True)
    rub = friction("mass", "base", 0.6)
    truth, out = network.with_element(rub), []
    for k in range(count):
        rng, time = np.random.default_rng(k), STEP * np.arange(samples)
        f = np.array([0.7, 1.3, 2.1, 3.3])
        base = builders.sines(time, f, 6.0 * rng.random(4), 0.02 / f)
        base = base - base[0]
        speed = simulate(truth, time, {"base": base})["speed"]
        speed = speed + 0.01 * speed.std() * rng.standard_normal(samples)
        out.append(Table(time, {"base": base, "speed": speed}, f"run{k}"))
    return network, out


def test_a_finished_diagnosis_is_not_lost_where_a_model_does_not_simulate_a_whole_record(
    monkeypatch, tmp_path
):
    network, runs = tables(2)

    class Breaking(Fitter):
        def follow(self, *args, **options):
            raise InputError("the simulation breaks down at the start values")

    def breaks(*args, **options):
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(builder, "Fitter", Breaking)
    monkeypatch.setattr(builder.Finder, "find", breaks)
    for name in ("intervals", "next_experiment"):
        monkeypatch.setattr(builder, name, breaks)
    result = diagnose(runs[:1], network, validate=runs[1:])
    assert (
        result.verdict == "missing_effect"
        and result.effects[0].effect == "coulomb_friction"
    )
    assert all(np.isnan(y).all() for t in result.traces for y in t.after.values())
    assert any("no curve is drawn" in n for n in result.notes)
    page = write_report(result, tmp_path / "found")
    assert page.exists() and read_json(tmp_path / "found" / "diagnosis.json")["effects"]


def test_every_held_out_record_with_inputs_gives_segments_to_both_roles():
    records = [
        Record(t.source, STEP, {"base": t["base"]}, t["speed"][:, None])
        for t in tables(4, 250)[1]
    ]
    pieces, roles = split_records(records[:1], records[1:], [], 10.0)
    for r in records[1:]:
        own = [
            role
            for piece, role in zip(pieces, roles, strict=True)
            if piece.name == r.name
        ]
        assert sorted(own) == ["choose", "report"]
    # beginnings and ends of runs serve both purposes
    assert set(roles[roles.count("fit") :: 2]) == {"choose", "report"}
    # a decay in one piece, whose tail tells little, is pooled
    decays = [decay(), replace(decay(), name="other")]
    _, roles = split_records(decays[:1], decays, [], 1.0)
    assert roles == ["fit", "choose", "choose"]


@pytest.mark.slow
def test_the_order_of_validation_files_of_one_segment_changes_nothing():
    network, runs = tables(4)
    told = []
    for order in ((1, 2, 3), (3, 1, 2), (2, 3, 1)):
        result = diagnose(runs[:1], network, validate=[runs[k] for k in order])
        document = result.to_dict()
        keys = ("verdict", "effects", "gap", "gates", "parameters", "evidence")
        told.append({k: document[k] for k in keys})
    assert told[0] == told[1] == told[2]
    assert told[0]["verdict"] == "missing_effect"
