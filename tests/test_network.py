"""Models: reading, refusing, writing; and the equations assembled from them, against hand-derived ones."""

import copy

import numpy as np
import pytest
from builders import channel, element
from program import refused

from isd_gym import Network, linearise
from isd_gym.physics.network import assemble, assemble_all


def car(name="quarter-car-isd"):
    return Network.load(name).to_dict()


def test_assembly_equals_equation_8_written_by_hand():
    """Equation (8): z_b eliminated by hand in the frequency domain."""
    p = Network.load("quarter-car-eq8").parameters
    f = np.logspace(-1, 2, 40)
    s = 2j * np.pi * f
    Ze = p["oil.stiffness"] + p["leak.damping"] * s + p["inerter.inertance"] * s**2
    Zc = p["damper.damping"] * s
    series = Ze * Zc / (Ze + Zc)  # force per travel of device and damper in series
    Y = p["main_spring.stiffness"] + series
    ms, mu, kt = p["body.mass"], p["wheel.mass"], p["tyre.stiffness"]
    # [ms s^2 + Y, -Y; -Y, mu s^2 + Y + kt] [zs, zu] = [0, kt zr]
    det = (ms * s**2 + Y) * (mu * s**2 + Y + kt) - Y**2
    zs, zu = kt * Y / det, kt * (ms * s**2 + Y) / det
    H = linearise("quarter-car-eq8", damping={"seal": 0.0}).response(f)
    np.testing.assert_allclose(H[:, 0, 0], s**2 * zs, rtol=1e-9)
    np.testing.assert_allclose(H[:, 1, 0], zs - zu, rtol=1e-9)
    np.testing.assert_allclose(H[:, 2, 0], kt * (zu - 1), rtol=1e-8)


def test_no_inertance_leaves_spring_and_dampers_in_series():
    """b -> 0: the device is its leak; the piston-joint direction loses its momentum and a state with it."""
    net = (
        Network.load("quarter-car-isd")
        .without_element("seal")
        .without_element("end_stop")
    )
    bare = net.without_element("inerter")
    small = net.with_parameters({"inerter.inertance": 1e-6})
    f = np.logspace(-1, 1.5, 20)
    assert assemble(bare).size[0] == assemble(net).size[0] - 1
    one, other = (linearise(network).response(f) for network in (bare, small))
    np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    "path", ["body.mass", "wheel.mass", "inerter.inertance", "leak.damping"]
)
def test_a_state_means_the_same_motion_for_the_next_digit_of_a_parameter(path):
    """Fits keep a state while they move a parameter: it must not turn about, not even where two inertias are the same."""
    net = Network.load("quarter-car-isd")
    nodes = len(net.nodes) - 1  # the road is told
    for value in np.geomspace(0.05, 20.0, 60) * net.parameters[path]:
        here, near = (
            assemble(net.with_parameters({path: value * k})) for k in (1.0, 1.0 + 1e-7)
        )
        x = here.columns("x")
        np.testing.assert_allclose(
            here.position[:nodes, x], near.position[:nodes, x], atol=1e-4
        )
        # of rates, the largest is that with which the oil's spring moves what has no mass
        largest = np.abs(here.velocity[:, x]).max()
        np.testing.assert_allclose(
            here.velocity[:nodes, x], near.velocity[:nodes, x], atol=1e-5 * largest
        )


@pytest.mark.parametrize("name", ["quarter-car-isd", "half-car-isd"])
def test_networks_side_by_side_are_assembled_as_each_alone(name):
    net = Network.load(name)
    paths = [p for p, value in net.parameters.items() if value > 0]
    lanes = [net, *(net.with_parameters({p: 1.3 * net.parameters[p]}) for p in paths)]
    # without an assembly of their own
    alone = [assemble(copy.copy(n)._with_values()) for n in lanes]
    parts = ["rate", "elongation", "elongation_rate", "outputs", "position", "velocity"]
    for together, own in zip(assemble_all(lanes), alone, strict=True):
        for part in parts:
            here, there = getattr(together, part), getattr(own, part)
            close = {"rtol": 1e-12, "atol": 1e-12 * np.abs(there).max(initial=0.0)}
            np.testing.assert_allclose(here, there, **close)


def test_force_at_a_moved_node_is_equation_6():
    f = np.array([0.5, 3.0, 10.0])
    w = 2 * np.pi * f
    space = linearise("force-rig-eq6", damping={"seal": 0.0})
    H = space.response(f)[:, 0, :]
    total = H[:, 0] + 1j * w * H[:, 1] - w**2 * H[:, 2]
    np.testing.assert_allclose(total, 709e3 + 1293j * w - 95 * w**2, rtol=1e-12)


def test_terminal_inertia_is_the_term_equation_4_drops():
    """F = m n [n (a2 - a1) + a1] of equation (3), against the reciprocal inerter plus the absolute term."""
    net = car("force-rig-eq6")
    net["elements"] = [e for e in net["elements"] if e["name"] == "inerter"]
    net["uncertainty"] = {}
    net["elements"].append(
        element(
            "term", "terminal_inertia", "top", "ground", mass=23.0, terminal="first"
        )
    )
    space = linearise(Network.from_dict(net))
    np.testing.assert_allclose(space.D[0], [0.0, 95.0 + 23.0])
    assert space.inputs == ("displacement", "displacement''")


LAG = {"name": "lag", "type": "actuator_lag", "element": "oil", "time_constant": 0.01}
BAD = {
    "not finite": (
        lambda m: m["elements"][0].update(stiffness=float("nan")),
        "main_spring.*finite",
    ),
    "unknown node": (
        lambda m: m["outputs"][0].update(at="roof"),
        "body_acceleration.*no node 'roof'",
    ),
    "unknown unit": (
        lambda m: m["outputs"][0].update(unit="furlong"),
        "acceleration.*unknown unit 'furlong'",
    ),
    "floating node": (
        lambda m: m["elements"][8].update(between=["joint", "air"]),
        "node 'air' floats",
    ),
    "twice": (
        lambda m: m["elements"][1].update(name="main_spring"),
        "two elements are called 'main_spring'",
    ),
    "massless acceleration": (
        lambda m: m["outputs"].append(channel("x", "acceleration", "joint")),
        "acceleration of a massless node",
    ),
    "current without motor": (
        lambda m: m["inputs"][1].update(element="oil"),
        "current.*name of a motor",
    ),
    "uncertainty of nothing": (
        lambda m: m["uncertainty"].update({"roof.mass": 0.1}),
        "no parameter 'roof",
    ),
    "effect of no motor": (lambda m: m["elements"].append(LAG), "lag.*no motor 'oil'"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_models_are_one_line(case):
    change, message = BAD[case]
    model = copy.deepcopy(car())
    change(model)
    refused(message, lambda: assemble(Network.from_dict(model)))


def test_singular_massless_part_names_the_nodes():
    model = car("quarter-car-passive")
    a, b = ["body", "hook"], ["hook", "wheel"]
    law = {"type": "quadratic_damping", "damping": 100.0}
    model["elements"] += [
        {"name": "a", "between": a, **law},
        {"name": "b", "between": b, **law},
    ]
    refused("nothing holds 'hook'", lambda: assemble(Network.from_dict(model)))


def test_unreadable_files(tmp_path):
    (tmp_path / "x.json").write_text('{"schema": ')
    refused("not JSON, line 1", Network.load, tmp_path / "x.json")
    refused("neither a file nor one of force-rig", Network.load, "no-such-car")
