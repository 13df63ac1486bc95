"""The diagnosis on small rigs with a hidden effect, made by the independent simulator of `reference`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hidden import make_case

from isd_gym.data import Table
from isd_gym.discrepancy import Diagnosis, diagnose
from isd_gym.discrepancy.problem import Noise, autoregression, noise_of, passed, whitener
from isd_gym.errors import InputError
from isd_gym.network import Network


def table(columns, name: str) -> Table:
    columns = dict(columns)
    return Table(columns.pop("time"), columns, name)


def run(kind: str, seed: int, **choices) -> tuple[Diagnosis, object]:
    case = make_case(kind, seed, **choices)
    d = diagnose(
        [table(case.estimation, "estimation")], case.model, validate=[table(case.validation, "validation")]
    )
    return d, case


def named(d: Diagnosis) -> set[tuple[str, frozenset[str]]]:
    return {(e.effect, frozenset([e.channel] if e.channel else e.between or ())) for e in d.effects}


def test_friction_of_a_sliding_mass_is_named_with_its_level(tmp_path: Path) -> None:
    d, case = run("mass_friction", 3, duration=10.0)
    (what, where), *_ = case.answer
    assert d.verdict == "missing_effect"
    assert named(d) == {(what, frozenset(where))}
    truth = case.truth["hidden"][0]["level"]
    q = d.effects[0].parameters["level"]
    assert q.value == pytest.approx(truth, rel=0.1)
    assert q.low < q.value < q.high
    assert d.closed is not None and d.closed > 0.8
    d.save(tmp_path / "out")
    said = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert said["schema"] == "isd-diagnosis/1"
    assert said["effects"][0]["effect"] == what
    again = Network.load(tmp_path / "out" / "model.json")
    assert again.parameters[f"{d.effects[0].element}.level"] == pytest.approx(q.value)


def test_a_clean_rig_is_left_alone() -> None:
    d, _ = run("mass_none", 1, duration=10.0)
    assert d.verdict in ("no_discrepancy", "parameters_only")
    assert d.effects == ()
    assert d.model.elements == d.refitted.elements


def test_the_same_data_give_the_same_verdict() -> None:
    a, _ = run("mass_none", 2, duration=6.0)
    b, _ = run("mass_none", 2, duration=6.0)
    assert json.dumps(a.to_dict()) == json.dumps(b.to_dict())


def test_bad_data_are_refused_with_one_line() -> None:
    case = make_case("mass_none", 1, duration=6.0)
    good = dict(case.estimation)
    channel = Network.load(case.model).outputs[0].name
    for change in ("gap", "nan", "missing"):
        columns = {k: np.array(v) for k, v in good.items()}
        if change == "gap":
            columns["time"][1000:] += 1.0
        elif change == "nan":
            columns[channel][500] = np.nan
        else:
            del columns[channel]
        with pytest.raises(InputError) as error:
            diagnose([table(columns, "bench")], case.model)
        assert "\n" not in str(error.value)


def test_whitener_makes_coloured_noise_white() -> None:
    rng = np.random.default_rng(0)
    e = rng.standard_normal((20000, 1))
    x = np.zeros_like(e)
    for k in range(1, len(x)):
        x[k] = 0.9 * x[k - 1] + 3.0 * e[k]
    a, sigma = autoregression([x[:, 0]], 5)
    assert a[1] == pytest.approx(-0.9, abs=0.03)
    assert sigma == pytest.approx(3.0, rel=0.03)
    w = whitener([x], np.array([1e-3]))(x)[50:, 0]
    assert np.std(w) == pytest.approx(1.0, rel=0.03)
    assert abs(np.mean(w[1:] * w[:-1])) < 0.03


def test_noise_is_told_from_motion_by_its_spectrum() -> None:
    rng = np.random.default_rng(1)
    n, step = 20000, 2e-3
    noise = 0.05 * rng.standard_normal(n)
    motion = np.sin(2 * np.pi * 1.3 * step * np.arange(n)) + 0.5 * np.sin(2 * np.pi * 9 * step * np.arange(n))
    assert noise_of([motion + noise], step).deviation == pytest.approx(0.05, rel=0.1)


def test_what_noise_leaves_behind_a_filter_is_predicted() -> None:
    rng = np.random.default_rng(2)
    x = rng.standard_normal((50000, 1))
    W = whitener([x], np.array([1e-3]))
    assert passed(W, [Noise(1.0, 0.0, 0.0)])[0] == pytest.approx(float(np.mean(W(x) ** 2)), rel=0.03)
