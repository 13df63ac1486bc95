"""Dry friction whose level grows with the load that a gear or a screw transmits."""

import builders
import numpy as np
import pytest
from builders import channel, damper, element
from program import refused

from isd_gym import Network, Table, diagnose, simulate
from isd_gym.diagnosis import SearchSettings
from isd_gym.physics import elements as el

LEVEL, GAIN = 2.0, 0.15


def under(load):
    """Return friction whose level grows with the force of an element."""
    return {
        "type": "load_dependent_friction",
        "level": LEVEL,
        "gain": GAIN,
        "load": load,
    }


def joint(*more, friction=None, **changes):
    """Return a drive: a rotor, a gear as a spring, and a link that a weight pulls."""
    gear = [
        builders.spring("rotor", "link", 4000.0, "gear"),
        damper("rotor", "link", 8.0, "oil"),
    ]
    rub = {"name": "rub", "between": ["rotor", "ground"], **(friction or under("gear"))}
    forces = [
        channel("load", "force", element="gear"),
        channel("friction", "force", element="rub"),
    ]
    model = builders.model(
        "joint",
        [*gear, damper("link", "ground", 6.0, "bearing"), rub, *more],
        ["drive force rotor", "weight force link"],
        ["speed velocity rotor", "place displacement link", *forces],
        masses={"rotor": 1.0, "link": 3.0},
    )
    return Network.load(model | changes)


def driven(seconds=4.0, step=1e-3, size=30.0, weight=0.0):
    """Return time (n,) [s] and inputs: a drive [N] with reversals, and a weight [N] that grows from zero."""
    time = np.arange(0.0, seconds, step)
    drive = size * np.sin(2.0 * np.pi * 0.7 * time) + 0.6 * size * np.sin(
        2.0 * np.pi * 1.9 * time
    )
    return time, {
        "drive": drive - weight * np.minimum(time, 1.0),
        "weight": weight * np.minimum(time, 1.0),
    }


def test_the_force_of_a_motor_is_a_load():
    time, place = np.arange(0.0, 8.0, 1e-3), ("cart", "ground")
    parts = [
        element("motor", "motor", *place, thrust_constant=5.0),
        damper(*place, 4.0, "guide"),
    ]
    rub = {"name": "rub", "between": [*place], **under("motor")}
    spindle = builders.cart(
        *parts, rub, inputs=[channel("current", "current", element="motor")]
    )
    for current in (-4.0, 2.0, 4.0):
        inputs = {"current": np.full(len(time), current)}
        speed = simulate(spindle, time, inputs)["speed"][-1]
        thrust = 5.0 * abs(current)
        assert abs(speed) == pytest.approx(
            (thrust - LEVEL - GAIN * thrust) / 4.0, rel=1e-4
        )


def test_the_load_of_a_law_that_is_not_linear():
    """Behind a hardening gear the level follows the force of the law."""
    time, inputs = driven(size=60.0, weight=30.0)
    hard = element("stop", "cubic_stiffness", "rotor", "link", stiffness=4e7)
    forces = [
        channel("load", "force", element="stop"),
        channel("friction", "force", element="rub"),
    ]
    outputs = [channel("speed", "velocity", "rotor"), *forces]
    seen = simulate(joint(hard, friction=under("stop"), outputs=outputs), time, inputs)
    sliding = np.abs(seen["speed"]) > 1e-2
    level = np.abs(seen["friction"])
    assert np.ptp(seen["load"]) > 10.0
    assert level[sliding] == pytest.approx(
        LEVEL + GAIN * np.abs(seen["load"][sliding]), rel=1e-6
    )


@pytest.mark.parametrize(
    ("load", "extra"),
    [
        ("", ()),
        ("nothing", ()),
        ("rub", ()),
        ("brake", (builders.friction("link", "ground", 1.0, "brake"),)),
        ("flywheel", (element("flywheel", "inertance", "link", "ground", inertance=1.0),)),
    ],
)  # fmt: skip
def test_a_load_is_a_spring_a_damper_a_motor_or_a_smooth_law(load, extra):
    words = '"load" must name a spring, a damper, a motor or a smooth law'
    refused(words, joint, *extra, friction=under(load))


def test_a_torque_under_a_force_is_refused():
    shaft = builders.spring("wheel", "ground", 10.0, "shaft")
    options = {"friction": under("shaft"), "inertias": {"wheel": 1.0}}
    refused('"load" must name a force, as the friction is', joint, shaft, **options)


def test_a_model_file_keeps_the_load():
    network = joint()
    assert Network.from_dict(network.to_dict()).element("rub") == network.element("rub")
    assert network.unit_of("rub.gain") == "-" and network.unit_of("rub.level") == "N"
    with pytest.raises(NotImplementedError, match="is no curve"):
        network.element("rub").curve(np.zeros(2))


def test_loads_of_a_place():
    """Springs and weights at one of its nodes, and a motor at the place."""
    hang = element("hang", "constant_force", "link", "ground", force=5.0)
    network = joint(hang, friction={"type": "coulomb_friction", "level": 1.0})
    assert el.LoadDependentFriction.variants(network, ("rotor", "ground")) == [
        {"load": "gear"}
    ]
    assert el.LoadDependentFriction.variants(network, ("link", "ground")) == [
        {"load": "gear"}
    ]
    assert el.LoadDependentFriction.variants(network, ("rotor", "link")) == [
        {"load": "hang"}
    ]


SENSORS = [
    channel("speed", "velocity", "rotor"),
    channel("place", "displacement", "link"),
]


def measured(name, weight, seed, friction):
    """Return a record of a drive that carries a weight [N] and moves by a multisine about it."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 12.0, 4e-3)
    lines = np.arange(0.15, 4.0, 0.35)
    drive = builders.sines(time, lines, rng.uniform(0.0, 2.0 * np.pi, len(lines)), 10.0)
    inputs = {"drive": drive - weight, "weight": np.full(len(time), weight)}
    seen = simulate(joint(friction=friction, outputs=SENSORS), time, inputs, step=5e-4)
    noise = {"speed": 2e-3, "place": 2e-4}
    noisy = {n: seen[n] + s * rng.standard_normal(len(time)) for n, s in noise.items()}
    return Table(time, inputs | noisy, name)


def nominal():
    model = joint(outputs=SENSORS).to_dict()
    model["elements"] = [e for e in model["elements"] if e["name"] != "rub"]
    model["uncertainty"] = {
        "gear.stiffness": 0.1,
        "oil.damping": 0.3,
        "bearing.damping": 0.3,
    }
    return model


def diagnosed(friction, loads):
    """Return the diagnosis of four records under loads [N], the last two held out."""
    records = [measured(f"r{k}", w, k, friction) for k, w in enumerate(loads)]
    return diagnose(
        records[:2], nominal(), validate=records[2:], settings=SearchSettings(depth=1)
    )


@pytest.mark.slow
def test_two_loads_name_the_friction_with_its_gain():
    found = diagnosed(under("gear"), (5.0, 60.0, 30.0, 60.0))
    (effect,) = found.effects
    assert (effect.effect, set(effect.between)) == (
        "load_dependent_friction",
        {"rotor", "ground"},
    )
    assert effect.parameters["gain"].value == pytest.approx(GAIN, rel=0.1)
    assert effect.parameters["level"].low < LEVEL < effect.parameters["level"].high
    assert found.model.element(effect.element).load == "gear"
    assert found.closed > 0.95
