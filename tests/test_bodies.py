"""Rigid bodies: their points move as geometry says, and half and full cars are what the quarter car and the textbook make of them."""

import copy
import json
from importlib import resources

import builders
import numpy as np
import pytest
from builders import decoupled_half_car
from program import refused
from rigs import reference

import isd_gym.physics.simulate
from isd_gym import Network, simulate
from isd_gym.physics._kernel.layout import GENERAL
from isd_gym.physics.network import assemble, builtin_networks, cut, rejoin

SIGNALS = ("suspension_travel", "tyre_force", "device_travel", "body_acceleration")


def uneven(seed, samples=4001, step=1e-3):
    """Height [m] of a rough road, white in velocity."""
    return (
        0.08
        * np.sqrt(step)
        * np.cumsum(np.random.default_rng(seed).standard_normal(samples))
    )


@pytest.fixture(scope="module")
def drive():
    """Time, roads under front and rear axle, and two currents."""
    t = np.arange(4001) * 1e-3
    roads = {"time": t, "road_front": uneven(1), "road_rear": uneven(2)}
    return roads | {
        "current_front": 4.0 * np.sin(8.1 * t),
        "current_rear": 3.0 * np.sin(13.2 * t + 1.0),
    }


def inputs(drive, *sides):
    names = [n for n in drive if n != "time"]
    return {f"{n}{side}": drive[n] for n in names for side in sides or ("",)}


def largest(a, b):
    return np.abs(a - b).max() / np.abs(b).max()


@pytest.mark.parametrize("end", ["front", "rear"])
def test_with_a_pitch_inertia_of_m_a_b_each_corner_is_a_quarter_car(
    drive, end, monkeypatch
):
    """Friction sticks and slips, end stops are hit; both cars law by law, and each on its own way through a step."""
    own = {"road": drive[f"road_{end}"], "current": drive[f"current_{end}"]}
    half = simulate(decoupled_half_car(), drive["time"], inputs(drive))
    quarter = simulate("quarter-car-isd", drive["time"], own)
    for name in SIGNALS:
        assert np.std(half[f"{name}_{end}"]) == pytest.approx(
            np.std(quarter[name]), rel=1e-3
        )
    numbers = isd_gym.physics.simulate._law_numbers
    monkeypatch.setattr(
        isd_gym.physics.simulate, "_law_numbers", lambda *a: (GENERAL, *numbers(*a)[1:])
    )
    half = simulate(decoupled_half_car(), drive["time"], inputs(drive))
    quarter = simulate("quarter-car-isd", drive["time"], own)
    assert np.abs(quarter["device_travel"]).max() > 0.02465  # the end stop acts
    for name in SIGNALS:
        assert largest(half[f"{name}_{end}"], quarter[name]) < 1e-9


@pytest.mark.parametrize("name", ["half-car-isd", "full-car-isd"])
def test_the_kernel_agrees_with_an_integrator_that_shares_nothing_with_it(name, drive):
    """Four and eight coupled contacts, all roads and currents different."""
    network, t = Network.load(name), drive["time"]
    u = {c.name: 0.5 * uneven(10 + k) for k, c in enumerate(network.moving)}
    currents = [c.name for c in network.inputs if c.quantity == "current"]
    for k, c in enumerate(currents):  # as a controller gives it, held for 5 ms
        u[c] = np.repeat(np.random.default_rng(k).uniform(-5, 5, 801), 5)[: len(t)]
    shipped, fine = simulate(network, t, u), simulate(network, t, u, step=1e-4)
    for channel, values in reference.simulate(network.to_dict(), t, u).items():
        # the place at which a device sticks hangs on the last sliding step
        allowed = 5e-3 if "device" in channel else 1e-3
        assert np.std(fine[channel] - values) < allowed * np.std(values), channel
        if "device" not in channel:
            assert np.std(shipped[channel]) == pytest.approx(
                np.std(values), rel=1e-3
            ), channel


@pytest.mark.parametrize("name", builtin_networks())
def test_a_network_is_written_as_it_was_read(name):
    network = Network.load(name)
    text = (
        resources.files("isd_gym.physics") / "networks" / f"{name}.json"
    ).read_text()
    assert json.dumps(network.to_dict()) == json.dumps(json.loads(text))
    assert network.dumps() == text or not network.bodies
    again = Network.from_dict(json.loads(network.dumps()))
    assert again == network


def test_numbers_of_a_body_are_parameters():
    half = Network.load("half-car-isd")
    assert (
        half.parameters["body.mass"] == 690.0
        and half.parameters["body.inertia.pitch"] == 1222.0
    )
    assert (
        half.unit_of("body.mass") == "kg"
        and half.unit_of("body.inertia.pitch") == "kg m^2"
    )
    heavy = half.with_parameters(
        {"body.mass": 800.0, "body.inertia.pitch": 1500.0, "wheel_rear.mass": 50.0}
    )
    built = half.to_dict()
    built["bodies"]["body"] |= {"mass": 800.0, "inertia": {"pitch": 1500.0}}
    built["masses"]["wheel_rear"] = 50.0
    assert np.array_equal(assemble(heavy).rate, assemble(Network.from_dict(built)).rate)
    assert not np.array_equal(assemble(heavy).rate, assemble(half).rate)
    refused("positive", half.with_parameters, {"body.mass": -1.0})


def test_a_body_without_inertia_does_not_turn(drive):
    """Two quarter cars of half the body's mass each, on one road, are a body that only moves up and down."""
    data = Network.load("half-car-passive").to_dict()
    del data["bodies"]["body"]["inertia"], data["uncertainty"]["body.inertia.pitch"]
    data["outputs"] = [c for c in data["outputs"] if "axis" not in c]
    stiff = Network.from_dict(data)
    assert "body.pitch" not in stiff.nodes
    road = {"road_front": drive["road_front"], "road_rear": drive["road_front"]}
    got = simulate(stiff, drive["time"], road)
    quarter = simulate(
        "quarter-car-passive", drive["time"], {"road": drive["road_front"]}
    )
    assert largest(got["body_acceleration_rear"], quarter["body_acceleration"]) < 1e-9
    uneven_road = simulate(
        stiff, drive["time"], inputs(drive) | road | {"road_rear": drive["road_rear"]}
    )
    assert np.array_equal(
        uneven_road["body_acceleration_front"], uneven_road["body_acceleration_rear"]
    )


def test_a_half_car_is_cut_at_one_wheel_and_at_both(drive):
    """The sensor of a wheel replaces its tyre and road; the other road stays until that wheel is cut, too."""
    data = Network.load("half-car-isd").to_dict()
    hubs = (
        builders.channel(f"hub_{end}", "displacement", f"wheel_{end}")
        for end in ("front", "rear")
    )
    data["outputs"] += hubs
    whole = Network.from_dict(data)
    got = simulate(whole, drive["time"], inputs(drive))
    one = cut(whole, "wheel_front")
    assert (
        one.moved_nodes == ("wheel_front", "road_rear") and one.bodies == whole.bodies
    )
    assert (
        "body.inertia.pitch" in one.uncertainty
        and "tyre_front.stiffness" not in one.uncertainty
    )
    both = cut(one, "wheel_rear")
    assert both.moved_nodes == ("wheel_rear", "wheel_front")
    measured = inputs(drive) | {name: got[name] for name in ("hub_front", "hub_rear")}
    for part in (one, both):
        out = simulate(part, drive["time"], measured)
        assert {"pitch_acceleration", "driver_acceleration"} <= set(out)
        for name in (
            "pitch_acceleration",
            "suspension_travel_rear",
            "device_travel_front",
        ):
            assert np.std(out[name] - got[name]) < 0.01 * np.std(got[name])
    heavy = one.with_parameters({"body.inertia.pitch": 1300.0})
    assert rejoin(whole, heavy).parameters == whole.parameters | {
        "body.inertia.pitch": 1300.0
    }
    refused("cut: 'body_front' is part of body 'body'", cut, whole, "body_front")


def _change(data, path, value):
    """Set the value at a path such as 'bodies.body.mass'; None deletes the key."""
    *outer, last = (int(key) if key.isdigit() else key for key in path.split("."))
    for key in outer:
        data = data[key]
    if value is None:
        del data[last]
    else:
        data[last] = value


ABOUT = builders.channel("pitch", "acceleration", body="body", axis="pitch")
ENDS = [
    builders.channel(n, "displacement", n)
    for n in ("body_front", "body_rear", "driver")
]
BAD = [
    ("bodies.body.mass", None, r"body 'body': 'mass' is missing"),
    ("bodies.body.inertia.pitch", 0.0, r"inertia 'pitch' must be a positive number of kg m\^2.*leave it out"),
    ("bodies.body.inertia.yaw", 1.0, r"body 'body': \"inertia\": unknown key 'yaw'"),
    ("bodies.body.inertia", {"pitch": None}, r"not null; leave it out"),
    ("outputs.1.body", "chassis", r"output 'pitch_acceleration': no body 'chassis' \(bodies: body\)"),
    ("outputs.1.axis", "roll", r"body 'body' does not turn about its roll axis: give it an inertia"),
    ("outputs.1.at", "body", r"leave out \"at\""),
    ("bodies.body.points.wheel_front", {}, r"point 'wheel_front' of body 'body' has the name of a mass"),
    ("bodies.body.points.body", {}, r"point 'body' of body 'body' has the name of a node of body 'body'"),
    ("bodies.body.points.driver", {"z": 1.0}, r"body 'body': point 'driver': unknown key 'z'"),
    ("bodies.body.points.driver.x", "front", r"body 'body': x of point 'driver' must be a number of m"),
    ("bodies", [], r"bodies must be an object of body by name"),
    ("masses.body", 690.0, r"bodies: body 'body' has the name of a mass: give it another"),
    ("uncertainty.body.inertia.roll", 0.1, r"uncertainty: no parameter 'body.inertia.roll'"),
    ("outputs.1", ABOUT, r"output 'pitch': \"acceleration\" is no motion about an axis.*\"at\": \"body\""),
    ("inputs", ENDS, r"body 'body': inputs move 'body_front', 'body_rear', 'driver', which it ties together: let one of them"),
    ("inputs", [builders.channel("spin", "angle", "driver")], r"'body' moves along a line, and is tied to what turns"),
]  # fmt: skip


@pytest.mark.parametrize(("path", "value", "message"), BAD)
def test_bad_bodies_are_refused_in_a_line(path, value, message):
    data = copy.deepcopy(Network.load("half-car-isd").to_dict())
    if path.startswith("uncertainty."):
        data["uncertainty"][path.removeprefix("uncertainty.")] = value
    elif path == "inputs":
        data["inputs"] += value
    else:
        _change(data, path, value)
    refused(message, Network.from_dict, data)
