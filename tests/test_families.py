"""The families: their integrator against what can be worked out by hand, and what a case promises; cars with hidden effects."""

import json

import numpy as np
import pytest
from builders import damper, element, model, rms, spring
from rigs import hidden
from rigs.families import FAMILIES, make_case
from rigs.families.plant import Signal, integrate
from rigs.reference import simulate

pytestmark = pytest.mark.tools


@pytest.mark.parametrize(
    "kind, parameters",
    [
        ("coulomb_friction", {"level": 4.0}),
        (
            "stribeck_friction",
            {"level": 3.0, "static_level": 6.0, "stribeck_velocity": 0.03},
        ),
        ("quadratic_damping", {"damping": 60.0}),
        ("asymmetric_damping", {"extension": 0.0, "compression": 20.0}),
        ("cubic_stiffness", {"stiffness": 2e6}),
        ("gas_spring", {"force": 8.0, "length": 0.08, "exponent": 1.3}),
        ("bump_stop", {"clearance": 0.006, "stiffness": 4000.0, "side": "compression"}),
        (
            "hysteresis",
            {"level": 5.0, "stiffness": 3000.0, "exponent": 1.0, "shape": 0.5},
        ),
        ("cogging_force", {"amplitude": 3.0, "pitch": 0.011, "phase": 0.4}),
        ("inertance", {"inertance": 0.7}),
    ],
)
def test_every_law_moves_a_mass_as_the_other_integrator_says(kind, parameters):
    elements = [spring("mass", "base", 800.0), damper("mass", "base", 8.0)]
    extra = element("extra", kind, "mass", "base", **parameters)
    moved, seen = ["base displacement base"], ["x displacement mass"]
    without = model("rig", elements, moved, seen, masses={"mass": 2.0})
    rig = {**without, "elements": [*elements, extra]}
    T = 0.002
    t = np.arange(1001) * T
    w = np.array([9.0, 17.0, 26.0])
    x, v, a = (
        0.004 * np.sum(w**p * np.sin(np.outer(t, w) + p * np.pi / 2), axis=1)
        for p in (0, 1, 2)
    )
    ran = integrate(rig, {"base": Signal(x, v, a)}, len(t), T, speed=0.1)
    other = simulate(rig, t, {"base": x}, step=2e-5, derivatives={"base": (v, a)})["x"]
    plain = simulate(without, t, {"base": x}, step=2e-5, derivatives={"base": (v, a)})[
        "x"
    ]
    error = rms(ran.position["mass"] - other)
    assert error < 0.002 * np.std(other)
    assert rms(plain - other) > 20 * error  # the law is felt


QUICK = "decay.none decay.friction decay.friction_and_sine spin.quadratic dyno.asymmetric cart.friction pushed.delay"


@pytest.mark.parametrize("kind", [*QUICK.split(), "dyno.unknown_position_damping"])
def test_what_is_hidden_is_there_and_cannot_be_had_by_moving_parameters(kind):
    case = make_case(kind, 4)
    family = kind.split(".")[0]
    assert family in FAMILIES
    channels = [c["name"] for c in case.model["inputs"] + case.model["outputs"]]
    for table in (case.estimation, case.validation):
        if table is None:
            assert family == "spin"
            continue
        assert list(table) == ["time", *channels]
        assert all(
            300 <= len(c) <= 20000 and np.isfinite(c).all() for c in table.values()
        )
    believed = {e["name"] for e in case.model["elements"]}
    assert not [n for n in believed if n.startswith(("hidden", "nuisance"))]
    if kind.endswith("none"):
        assert case.answer == [] and max(case.irreducible.values()) < 0.03
    else:
        assert max(case.irreducible.values()) > 0.04
        assert max(case.irreducible.values()) > 2 * 10 ** (-case.snr_db / 20)
        assert max(case.irreducible.values()) < 1.2 * max(case.visibility.values())
    json.dumps([case.model, case.answer, case.truth])


def test_seeds_decide_everything():
    one, same, other = (make_case("decay.friction", s) for s in (1, 1, 2))
    for k in one.estimation:
        np.testing.assert_array_equal(one.estimation[k], same.estimation[k])
    assert one.model == same.model != other.model


def gaps(model, case):
    record = case.estimation
    y = simulate(model, record["time"], record, step=2e-5)
    return {k: float(rms(y[k] - record[k]) / np.std(record[k])) for k in y}


@pytest.mark.parametrize("kind", hidden.ALL_KINDS)
def test_every_kind_makes_records(kind):
    case = hidden.make_case(kind, 1, duration=1.0, step=1e-4, moving=False)
    channels = [c["name"] for c in case.model["inputs"] + case.model["outputs"]]
    for table in (case.estimation, case.validation):
        assert list(table) == ["time", *channels]
        assert all(
            len(column) == 501 and np.isfinite(column).all()
            for column in table.values()
        )
        np.testing.assert_allclose(np.diff(table["time"]), 2e-3)
    assert set(case.model["uncertainty"].values()) == {case.spread}
    clean = kind.split("_")[-1] == "none" or kind.startswith("none")
    assert (case.answer == []) == clean
    assert (case.answer == "unknown") == ("out" in kind.split("_"))
    json.dumps([case.model, case.answer, case.truth])


@pytest.mark.parametrize(
    "kind",
    [
        "friction_strut",
        "current_lag",
        "sensor_delay_acc",
        "rig_stribeck",
        "mass_cubic",
        "two_mass_inertance",
    ],
)
def test_the_truth_explains_the_record_to_the_noise_and_the_owners_model_does_not(kind):
    case = hidden.make_case(
        kind, 3, duration=6.0, snr_db=30.0, spread=0.02, moving=False
    )
    floor = 10 ** (-30 / 20)
    explained, believed = gaps(case.truth["model"], case), gaps(case.model, case)
    # the owner's record of the current is late by up to one sample, which the device's travel feels
    assert max(explained.values()) < 1.5 * floor
    assert max(believed.values()) > 2.0 * floor
    assert max(case.visibility.values()) > 1.5


def test_a_force_cell_reads_what_stands_beside_its_element():
    case = hidden.make_case(
        "damping_tyre", 4, duration=3.0, snr_db=60.0, moving=False, nuisances=0
    )
    record, true = case.estimation, case.truth["model"]
    cell = {"name": "tyre_force", "quantity": "force", "element": ["tyre", "hidden_1"]}
    both = simulate({**true, "outputs": [cell]}, record["time"], record, step=2e-5)[
        "tyre_force"
    ]
    alone = simulate(true, record["time"], record, step=2e-5)["tyre_force"]
    near, far = (
        np.std(record["tyre_force"] - y) / np.std(record["tyre_force"])
        for y in (both, alone)
    )
    assert near < 0.04 < 0.08 < far
