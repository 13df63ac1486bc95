"""Levers: a ratio between two nodes moves forces, springs and inertias as mechanics says."""

import json

import builders
import numpy as np
import pytest
from builders import channel, friction, spring
from program import refused
from rigs import reference

from isd_gym import Network, simulate
from isd_gym.physics.network import assemble, transfer
from isd_gym.view.report.schematic import draw

FREQUENCY = np.geomspace(0.05, 60.0, 60)


def lever(name, first, second, ratio, unit="m/m"):
    return {"name": name, "between": [first, second], "ratio": ratio, "unit": unit}


def model(masses, elements, inputs, outputs, levers=(), **more):
    out = builders.model("", elements, inputs, outputs, masses=masses)
    return Network.from_dict(out | {"levers": list(levers)} | more)


PUSH, SPRING = channel("push", "force", "mass"), spring("mass", "ground", 5e3)
MOTION = ["place displacement mass", "shock acceleration mass"]


def rack(mass=2.0, inertia=0.003, ratio=0.012):
    """An inerter as built: rod and pinion, a flywheel on the shaft."""
    pinion = lever("pinion", "mass", "shaft", ratio, "m/rad")
    more = {
        "inertias": {"shaft": inertia},
        "uncertainty": {"pinion.ratio": 0.01, "shaft.inertia": 0.1},
    }
    return model(
        {"mass": mass},
        [SPRING],
        [PUSH],
        [*MOTION, "turn angle shaft"],
        [pinion],
        **more,
    )


def test_a_flywheel_on_a_rack_is_a_mass_of_its_inertia_over_the_ratio_squared():
    built = rack()
    heavy = model({"mass": 2.0 + 0.003 / 0.012**2}, [SPRING], [PUSH], MOTION)
    a, b = transfer(built, FREQUENCY), transfer(heavy, FREQUENCY)
    assert np.abs(a[:, :2] / b - 1.0).max() < 1e-9
    assert (
        np.abs(0.012 * a[:, 2] / a[:, 0] - 1.0).max() < 1e-9
    )  # x_rod = ratio times angle
    assert "shaft" in built.rotating and "mass" not in built.rotating
    assert built.unit_of("pinion.ratio") == "m/rad"


def test_the_kernel_agrees_with_another_integrator_on_an_inerter_as_built():
    """Rack, pinion and flywheel with friction at the shaft: 0.1 % of the motion's deviation."""
    data = rack().to_dict()
    data["elements"].append(friction("shaft", "ground", 6.0))
    t = np.arange(0.0, 2.0, 1e-3)
    push = {"push": 900.0 * np.sin(6.0 * t) + 300.0 * np.sin(17.0 * t)}
    got, wanted = (
        simulate(data, t, push, step=2.5e-4),
        reference.simulate(data, t, push),
    )
    for name in (
        "place",
        "turn",
    ):  # the acceleration jumps where the sliding reverses, within a sample
        assert np.std(got[name] - wanted[name]) < 1e-3 * np.std(wanted[name])


def test_a_lever_is_kept_by_file_copy_and_parameters():
    network = rack()
    assert Network.from_dict(json.loads(network.dumps())) == network
    assert network.to_dict()["levers"] == [
        lever("pinion", "mass", "shaft", 0.012, "m/rad")
    ]
    longer = network.with_parameters({"pinion.ratio": 0.02})
    assert longer.levers[0].ratio == 0.02 and network.levers[0].ratio == 0.012
    built = network.to_dict()
    built["levers"][0]["ratio"] = 0.02
    assert np.array_equal(
        assemble(longer).rate, assemble(Network.from_dict(built)).rate
    )
    assert network.free_name("pinion") == "pinion_2"
    refused("other than zero", network.with_parameters, {"pinion.ratio": 0.0})


def test_a_lever_is_drawn_between_its_nodes():
    made = draw(rack())
    assert {"el:pinion", "node:shaft", "node:mass", "node:ground"} <= set(made.parts)
    assert "ratio 0.012 m/rad" in "".join(made.parts["el:pinion"])


def _with(*levers, **more):
    data = rack().to_dict()
    data["levers"] += levers
    return data | more


def _bare(**more):
    return {"name": "x", "between": ["mass", "b"], **more}


ENDS = [channel(n, "displacement", n) for n in ("one", "other")]
BAD = [
    (_with(_bare(ratio=1.0)), r"lever 'x': 'unit' is missing"),
    (_with(_bare(between=["mass"], ratio=1.0, unit="m/m")), r"two node names"),
    (
        _with(lever("x", "mass", "b", 1.0, "mm/rad")),
        r"lever 'x': unit 'mm/rad' is not that of a ratio",
    ),
    (_with(lever("x", "mass", "ground", 1.0)), r"lever 'x': the ground does not move"),
    (_with(lever("x", "mass", "mass", 1.0)), r"lever 'x': it couples 'mass' to itself"),
    (_with(lever("spring", "mass", "b", 1.0)), r"two elements are called 'spring'"),
    (
        _with(lever("x", "b", "mass", 2.0), lever("y", "mass", "b", 0.5)),
        r"lever 'y' closes a loop: other levers and bodies say the same; leave it out",
    ),
    (
        _with(lever("x", "b", "mass", 2.0), lever("y", "mass", "b", 0.6)),
        r"lever 'y' contradicts the other levers and bodies: together they hold 'mass' still",
    ),
    (
        _with(lever("x", "one", "other", 2.0), inputs=[PUSH, *ENDS]),
        r"lever 'x': inputs move 'one', 'other', which it ties together",
    ),
    # a turning node as a line
    (
        _with(lever("x", "mass", "shaft", 1.0)),
        r"lever 'x': 'shaft' turns, and the unit 'm/m' of the ratio has it move along a line",
    ),
    (_with(lever("x", "b", "c", 1.0)), r"node 'b' floats"),
]


@pytest.mark.parametrize(("data", "message"), BAD)
def test_bad_levers_are_refused_in_a_line(data, message):
    refused(message, Network.from_dict, data)


@pytest.mark.parametrize("quantity", ["velocity", "acceleration"])
def test_a_lever_needs_the_displacement_of_what_it_couples(quantity):
    data = rack().to_dict()
    unit = {"velocity": "m/s", "acceleration": "m/s^2"}[quantity]
    data["inputs"] = [channel("drive", quantity, "base", unit=unit)]
    data["elements"][0]["between"] = ["mass", "base"]
    refused(
        "lever 'pinion' needs the displacement",
        lambda: assemble(Network.from_dict(data)),
    )
