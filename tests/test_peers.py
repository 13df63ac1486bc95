"""What the terms of a sparse regression are taken to name, and the model behind a row of the benchmark's file."""

from __future__ import annotations

import importlib
from pathlib import Path

import builders
import numpy as np
import pytest
from builders import channel, damper, element

from isd_gym.physics.network import Network
from isd_gym.physics.simulate import simulate
from isd_gym.records.data import Table

pytestmark = pytest.mark.tools

RIG = builders.model(
    "rig",
    [
        element("inerter", "inertance", "top", "ground", inertance=90.0),
        damper("top", "ground", 1300.0, "leak"),
    ],
    [channel("x", "displacement", "top")],
    [channel("force", "force", "top")],
)
SEAL = builders.friction("top", "ground", 200.0, "seal")


@pytest.fixture
def peers(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "benchmarks")
    return importlib.import_module("peers")


def test_terms_name_what_the_model_lacks(peers):
    """A force that stands at the pair is a parameter, elsewhere it is an effect; a current has no effect's name."""
    car = Network.load("quarter-car-isd")
    device, tyre = ("piston", "joint"), ("wheel", "road")
    terms = [
        (device, "sign(v)"),
        (device, "v|v|"),
        (device, "I"),
        (tyre, "d"),
        (tyre, "v"),
        (tyre, "sign(v)"),
    ]
    assert peers.effects_of(terms, car) == {
        ("quadratic_damping", device),
        ("linear_damping", tyre),
        ("coulomb_friction", tyre),
    }


def test_known_forces_are_those_of_the_elements(peers):
    """Inertance, damping and friction of a pair, from its motion; a force that nobody knows stays in the balance."""
    rig = Network.load({**RIG, "elements": [*RIG["elements"], SEAL]})
    motion = {"d": np.zeros(3), "v": np.array([-1.0, 0.0, 2.0]), "a": np.array([0.0, 1.0, 1.0])}
    assert peers.known(rig, ("top", "ground"), motion) == pytest.approx([-1500.0, 90.0, 2890.0])


def test_row_of_the_benchmark_gives_its_model(peers):
    friction = {
        "effect": "coulomb_friction",
        "between": ["ground", "top"],
        "parameters": {"level": {"value": 201.0}},
    }
    row = {"diagnosis": {"effects": [friction], "parameters": {"inerter.inertance": {"value": 92.0}}}}
    network = peers.diagnosed(Network.load(RIG), row)
    assert network.element("inerter").inertance == 92.0
    assert network.element("coulomb_friction").level == 201.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_pysindy_names_plain_friction(peers):
    """Where everything is measured and quiet, sparse regression finds the friction, and finds nothing where is none."""
    pytest.importorskip("pysindy")
    rng = np.random.default_rng(1)
    time = 0.002 * np.arange(5000)

    def record(model):
        phase = rng.uniform(0, 2 * np.pi, 8)
        x = sum(
            2e-3 * np.sin(2 * np.pi * f * time + p)
            for f, p in zip(np.linspace(0.5, 5, 8), phase, strict=True)
        )
        force = simulate(model, time, {"x": x})["force"]
        return Table(time, {"x": x, "force": force + 2.0 * rng.standard_normal(len(time))})

    owner = Network.load(RIG)
    truth = Network.load({**RIG, "elements": [*RIG["elements"], SEAL]})
    assert ("coulomb_friction", ("top", "ground")) in peers.sindy_names(owner, [record(truth), record(truth)])
    assert peers.sindy_names(owner, [record(owner), record(owner)]) == []
