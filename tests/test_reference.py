"""The reference simulator against analytic limits, and the kernel against the reference."""

import ast
from pathlib import Path

import builders
import numpy as np
import pytest
from builders import element, rms
from rigs import laws, reference
from rigs.reference import simulate

from isd_gym.physics.elements import TYPES
from isd_gym.physics.simulate import simulate as kernel


def model(masses, *elements, inputs=(), outputs=()):
    return {
        "masses": masses,
        "elements": list(elements),
        "inputs": list(inputs),
        "outputs": list(outputs),
    }


def moved(node, name="motion"):
    return builders.channel(name, "displacement", node)


def sines(duration, interval):
    """Return time, and displacement, velocity and acceleration of three sines."""
    t = np.arange(round(duration / interval) + 1) * interval
    x, v, a = np.zeros((3, len(t)))
    for f, level, phase in ((1.3, 0.02, 0.0), (3.1, 0.01, 2.0), (9.0, 0.004, 0.5)):
        w = 2 * np.pi * f
        x += level * np.sin(w * t + phase)
        v += level * w * np.cos(w * t + phase)
        a -= level * w**2 * np.sin(w * t + phase)
    return t, x, v, a


def test_shares_nothing_with_the_package():
    tree = ast.parse(Path(reference.__file__).read_text())
    names = {
        a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names
    }
    names |= {n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    assert names and not any(name.split(".")[0] == "isd_gym" for name in names)


def test_free_decay_of_one_mass_is_the_damped_oscillation():
    m, c, k = 3.0, 2.0, 500.0
    parts = [builders.spring("m", "ground", k), builders.damper("m", "ground", c)]
    seen = [
        builders.channel(q, q, "m")
        for q in ("displacement", "velocity", "acceleration")
    ]
    rig, t = model({"m": m}, *parts, outputs=seen), np.arange(2001) * 1e-3
    y = simulate(rig, t, {}, initial={"m": (0.02, 0.3)})
    decay, w = c / (2 * m), np.sqrt(k / m - (c / (2 * m)) ** 2)
    b = (0.3 + decay * 0.02) / w
    x = np.exp(-decay * t) * (0.02 * np.cos(w * t) + b * np.sin(w * t))
    np.testing.assert_allclose(y["displacement"], x, atol=2e-9)
    np.testing.assert_allclose(
        y["acceleration"], -(c * y["velocity"] + k * x) / m, atol=2e-4
    )


def test_load_cell_of_a_fully_prescribed_rig_reads_equation_6():
    t, x, v, a = sines(1.0, 2e-3)
    b, f, k, c, mass = 95.0, 500.0, 709e3, 1293.0, 20.0
    laws = (
        element("b", "inertance", "top", "ground", inertance=b),
        element(
            "n", "terminal_inertia", "ground", "top", mass=mass
        ),  # its second terminal is what moves
        element("k", "linear_stiffness", "top", "ground", stiffness=k),
        element("c", "linear_damping", "ground", "top", damping=c),
        element("f", "coulomb_friction", "top", "ground", level=f),
    )
    rig = model(
        {},
        *laws,
        inputs=[moved("top")],
        outputs=[{"name": "F", "quantity": "force", "at": "top"}],
    )
    y = simulate(rig, t, {"motion": x}, derivatives={"motion": (v, a)})["F"]
    expected = (b - mass) * a + f * np.sign(v) + k * x + c * v
    assert np.abs(y - expected)[np.abs(v) > 1e-3].max() < 1e-3
    # Without the derivatives, inertia works on the spline of the samples.
    y = simulate(rig, t, {"motion": x})["F"]
    inner = (np.abs(v) > 1e-2) & (t > 0.05) & (t < 0.95)
    assert np.abs(y - expected)[inner].max() < 2e-4 * np.abs(expected).max()


def test_every_element_type_is_in_a_seeded_rig():
    assert set(laws.ELEMENTS) == set(TYPES)


@pytest.mark.parametrize("kind", sorted(laws.ELEMENTS))
def test_the_kernel_agrees_on_every_element_type(kind):
    model, time, inputs = laws.draw(kind)
    ours = kernel(model, time, inputs)
    theirs = simulate(model, time, inputs, step=2e-5)
    for name, values in ours.items():
        error = rms(values - theirs[name])
        assert error < 0.005 * rms(values), (name, error)
