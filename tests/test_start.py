"""Start of a simulation in mid-motion: every law behind a massless node is in balance with the spring or damper in line with it."""

import numpy as np
import pytest
from builders import channel, damper, element, network, spring

from isd_gym.physics import elements as el
from isd_gym.physics.network import assemble
from isd_gym.physics.simulate import Plant

STEP = 1e-4
#: numbers at which each law acts on the rig below, which moves by some millimetres at some decimetres per second
LAWS = {
    "constant_force": {"force": 12.0},
    "gravity_sine": {"torque": 40.0, "rest": 0.3},
    "quadratic_damping": {"damping": 400.0},
    "degressive_damping": {"damping": 300.0, "knee": 0.05},
    "asymmetric_damping": {"extension": 200.0, "compression": 60.0},
    "cubic_stiffness": {"stiffness": 4e8},
    "gas_spring": {"force": 300.0, "length": 0.03},
    "bump_stop": {"clearance": 1e-3, "stiffness": 5e5},
    "backlash": {"gap": 8e-4, "stiffness": 2e6},
    "hysteresis": {"level": 20.0, "stiffness": 5e5},
    "cogging_force": {"amplitude": 2.0, "pitch": 0.02, "phase": 0.4},
    "tyre_lift_off": {"stiffness": 4000.0, "load": 5.0},
    "coulomb_friction": {"level": 15.0},
    "stribeck_friction": {
        "level": 10.0,
        "static_level": 20.0,
        "stribeck_velocity": 0.2,
    },
    "asymmetric_friction": {"extension": 12.0, "compression": 20.0},
}
#: laws whose force depends on more than the present motion
MEMORY = {"hysteresis"}
DRY = {"coulomb_friction", "stribeck_friction", "asymmetric_friction"}
#: laws of the rate keep a place behind a node that only a spring holds
RATE = {"quadratic_damping", "degressive_damping", "asymmetric_damping"}


def rig(law, damping=0.0):
    """A shaken mass on a spring that ends at a massless node; the law, and perhaps a damper, tie the node to the table."""
    line = [spring("mass", "node", 9000.0), damper("mass", "table", 52.0)]
    line.append(element("law", law, "node", "table", **LAWS[law]))
    if damping:
        line.append(damper("node", "table", damping, "oil"))
    elif law == "gravity_sine":
        line[-1]["torque"] = 1500.0
    beside = ["law", "oil"] if damping else ["law"]
    forces = [channel(n, "force", element=n) for n in ("spring", *beside)]
    motion = ["acc acceleration mass", "place displacement mass", "rate velocity mass"]
    seen = [*motion, "node displacement node"]
    return network(
        "shaker",
        line,
        ["table displacement table"],
        [*seen, *forces],
        masses={"mass": 12.4},
    )


def run(network, begin=0, initial=None):
    """Outputs on a shaking table from sample `begin` on."""
    t, plant = np.arange(begin, 12000) * STEP, Plant(network, STEP)
    waves = [(4e-3, 2 * np.pi * 4.0, 0.0), (2e-3, 2 * np.pi * 7.3, 1.0)]
    table = sum(a * (np.sin(w * t + p) - np.sin(p)) for a, w, p in waves)
    rate = sum(a * w * np.cos(w * t + p) for a, w, p in waves)
    out = plant.run(
        {"table": table},
        samples=len(t),
        initial=initial,
        derivatives={"table": (rate, 0.0 * t)},
    )
    return {c.name: out[:, j, 0] for j, c in enumerate(plant.channels)}


def restarted(network, k):
    """Outputs from sample k on, of one run and of a run that begins there."""
    whole = run(network)
    # the states are the motion of the mass, and the place of a damped node
    states = assemble(network).size[0]
    again = run(
        network, k, np.array([whole[n][k] for n in ("place", "rate", "node")])[:states]
    )
    assert (
        again["place"][0] == whole["place"][k] and again["rate"][0] == whole["rate"][k]
    )
    return {n: y[k:] for n, y in whole.items()}, again


def test_every_law_with_a_force_stands_behind_the_node():
    between = {
        n: c for n, c in el.TYPES.items() if c.place == "between" and (c.law or c.bound)
    }
    laws = {n for n, c in between.items() if not (c.scheduled or c.loaded)}
    assert laws - {"tabulated_force"} <= set(LAWS)


@pytest.mark.parametrize("law", sorted(LAWS))
@pytest.mark.parametrize("damping", [0.0, 150.0])
def test_a_law_is_in_balance_from_the_first_sample_on(law, damping):
    for k in (3000, 4700, 6100):
        _, then = restarted(rig(law, damping), k)
        size = np.ptp(then["spring"]) + 1.0
        assert (
            np.abs(then["spring"] - then["law"] - then.get("oil", 0.0))[:3].max()
            < 1e-6 * size
        )
        # the first sample is no jump: the force moves on by what the motion of a step can do
        usual = np.abs(np.diff(then["acc"])).max()
        assert abs(then["acc"][1] - then["acc"][0]) <= 1.01 * usual
        assert np.abs(then["acc"][0]) <= 1.5 * np.abs(then["acc"]).max()


@pytest.mark.parametrize(
    ("law", "damping"),
    [
        (n, c)
        for n in sorted(LAWS)
        for c in (0.0, 150.0)
        if n not in MEMORY and (c or n not in RATE | DRY)
    ],
)
def test_a_law_without_memory_goes_on_as_if_it_had_not_been_interrupted(law, damping):
    for k in (3000, 4700, 6100):
        whole, then = restarted(rig(law, damping), k)
        for name in ("acc", "node", "spring"):
            size = np.abs(whole[name]).max()
            np.testing.assert_allclose(
                then[name], whole[name], atol=1e-4 * size, err_msg=f"{name} from {k}"
            )
            assert abs(then[name][0] - whole[name][0]) < 1e-6 * size


@pytest.mark.parametrize("law", sorted(MEMORY | RATE | DRY))
def test_a_law_with_memory_is_relaxed_at_the_start(law):
    _, then = restarted(rig(law), 4700)
    lean = (
        0.5 * (LAWS[law]["extension"] - LAWS[law]["compression"])
        if law == "asymmetric_friction"
        else 0.0
    )
    assert then["spring"][0] == pytest.approx(lean, abs=1e-6)
