"""The band that is compared where inputs are differentiated: it holds the measured signal, and derivatives without most of their noise."""

import builders
import numpy as np
import pytest
from builders import channel, damper, friction
from scipy.signal import butter, sosfiltfilt, welch

from isd_gym import Network, simulate
from isd_gym.diagnosis._records.filtering import (
    count_derivatives,
    differentiate_inputs,
)
from isd_gym.diagnosis._simulation.problem import Problem, Record

SAMPLES = 12_000
OUTPUT_NOISE = 0.01  # RMS of a sensor's noise, relative to the deviation of its signal


def shaken(natural, quantity="displacement", damping_ratio=0.03):
    """A mass of 1 kg on a spring and a damper whose base is moved."""
    stiffness = (2 * np.pi * natural) ** 2
    y = channel(
        "y",
        quantity,
        "mass",
        unit={"displacement": "mm", "acceleration": "g"}[quantity],
    )
    damping = 2 * damping_ratio * np.sqrt(stiffness)
    return builders.oscillator(
        y, mass=1.0, stiffness=stiffness, damping=damping, base="base"
    )


def base_motion(kind, natural, rate, rng):
    """Displacement [m] of the base: mostly far below resonance, or a sine near it."""
    t = np.arange(SAMPLES) / rate
    slow = natural * np.array([0.02, 0.053, 0.11])
    slow = builders.sines(t, slow, rng.uniform(0, 6, 3), (8e-3, 4e-3, 2e-3))
    if kind == "slow and broadband":
        return slow + band_limited(0.3 * natural, 2.5 * natural, rate, rng, 3e-5)
    if kind == "slow and steps":
        steps = np.zeros(SAMPLES)
        for at in rng.integers(0, SAMPLES, 12):
            steps[at:] += 2e-4 * rng.choice([-1, 1])
        window = np.hanning(2 * int(0.05 * rate / natural) + 5)
        return slow + np.convolve(steps, window / window.sum(), mode="same")
    if kind == "random":
        return band_limited(0.05 * natural, 1.5 * natural, rate, rng, 3e-3)
    ratio = {"sine at resonance": 1.0, "sine above resonance": 1.8}[kind]
    return (
        1e-3
        * np.sin(2 * np.pi * ratio * natural * t)
        * np.minimum(1.0, natural * t / 3)
    )


def band_limited(low, high, rate, rng, deviation):
    x = rng.standard_normal(SAMPLES + 2000)
    x = sosfiltfilt(
        butter(3, [low, min(high, 0.45 * rate)], "band", fs=rate, output="sos"), x
    )[1000:-1000]
    return deviation * x / x.std()


def measured(network, motion, rate, rng, noise):
    """A record of a rig, with sensor noise, the base's `noise` [m] included; and the outputs without noise."""
    (moved,) = network.inputs
    out = simulate(network, np.arange(SAMPLES) / rate, {moved.name: motion})
    clean = np.stack([out[c.name] for c in network.outputs], axis=1)
    noisy = clean + OUTPUT_NOISE * clean.std(axis=0) * rng.standard_normal(clean.shape)
    seen = motion + noise * rng.standard_normal(SAMPLES)
    return Record("rig", 1 / rate, {moved.name: seen}, noisy), clean


def share_kept(record, clean, low=0.0, high=np.inf):
    """Share of the power of a signal without noise between two frequencies [Hz] that the low-pass of a record keeps."""
    if record.taps is None:
        return 1.0
    f, s = welch(clean - clean.mean(), 1 / record.step, nperseg=4096)
    gain = np.abs(
        np.exp(-2j * np.pi * np.outer(f * record.step, np.arange(len(record.taps))))
        @ record.taps
    )
    band = (f >= low) & (f <= high)
    return float((gain**2 * s)[band].sum() / s[band].sum())


@pytest.mark.parametrize("quantity", ["displacement", "acceleration"])
@pytest.mark.parametrize(
    ("natural", "rate"), [(1.0, 100.0), (3.0, 100.0), (10.0, 300.0), (30.0, 2000.0)]
)
@pytest.mark.parametrize(
    "kind",
    [
        "slow and broadband",
        "slow and steps",
        "random",
        "sine at resonance",
        "sine above resonance",
    ],
)
def test_preparation_keeps_the_measured_power_where_the_model_responds(
    kind, natural, rate, quantity
):
    rng = np.random.default_rng(3)
    network, motion = shaken(natural, quantity), base_motion(kind, natural, rate, rng)
    record, clean = measured(network, motion, rate, rng, noise=3e-3 * motion.std())
    (prepared,) = differentiate_inputs([record], network)
    assert share_kept(prepared, clean[:, 0]) > 0.98
    assert share_kept(prepared, clean[:, 0], 0.5 * natural, 2 * natural) > 0.98


def test_the_harmonics_that_friction_makes_of_a_sine_are_compared():
    natural, rate, rng = 3.0, 100.0, np.random.default_rng(7)
    rub = friction("mass", "base", 0.15)
    network, motion = (
        shaken(natural),
        base_motion("sine above resonance", natural, rate, rng),
    )
    record, clean = measured(
        network.with_element(rub), motion, rate, rng, noise=3e-3 * motion.std()
    )
    (prepared,) = differentiate_inputs([record], network)
    third = 3 * 1.8 * natural
    assert share_kept(prepared, clean[:, 0], 0.95 * third, 1.05 * third) > 0.98


def test_a_resonance_that_friction_holds_is_compared_too():
    # the base shakes the mass at its natural frequency, but the mass sticks to the ground
    natural, rate, rng = 3.0, 100.0, np.random.default_rng(4)
    network, motion = (
        shaken(natural),
        base_motion("slow and broadband", natural, rate, rng),
    )
    record, _ = measured(network, motion, rate, rng, noise=2e-5)
    still = Record(
        "stuck",
        record.step,
        record.inputs,
        0.01 * rng.standard_normal(record.measured.shape),
    )
    (prepared,) = differentiate_inputs([still], network)
    responds = np.sin(2 * np.pi * natural * np.arange(SAMPLES) / rate)
    assert share_kept(prepared, responds, 0.5 * natural, 2 * natural) > 0.98


ROD = damper("rod", "ground", 1000.0)
INERTER = builders.element("inerter", "inertance", "rod", "ground", inertance=90.0)
FRICTION = friction("rod", "ground", 60.0, "seal")


@pytest.mark.parametrize(
    ("element", "highest", "unfiltered"), [(INERTER, 8.0, 1.0), (FRICTION, 2.0, 0.1)]
)
def test_the_noise_that_a_force_makes_of_a_displacement_is_left_out(
    element, highest, unfiltered
):
    """Inertance differentiates noise twice; friction takes the sign of a rate from it."""
    network = builders.network(
        "test bench", [ROD, element], ["x displacement rod"], ["F force rod"]
    )
    rate, rng = 1000.0, np.random.default_rng(5)
    motion = band_limited(0.02, highest, rate, rng, 5e-3)
    record, clean = measured(network, motion, rate, rng, noise=1.5e-5)
    (prepared,) = differentiate_inputs([record], network)
    assert share_kept(prepared, clean[:, 0]) > 0.9

    def error(r):
        """RMS error of the true model, driven by the measured displacement, relative to the force."""
        said = Problem(network, [r], ["fit"]).simulate([network], 0)[:, :, 0]
        return float(np.std(said - r.measured) / np.std(r.measured))

    assert error(record) > unfiltered
    assert error(prepared) < 0.5 * unfiltered


def test_an_input_that_tells_more_is_differentiated_less():
    model = shaken(3.0).to_dict()
    model["elements"].append(
        builders.element("b", "inertance", "mass", "base", inertance=0.5)
    )
    for quantity, unit, orders in (
        ("displacement", "m", {"base": 2}),
        ("velocity", "m/s", {"base": 1}),
        ("acceleration", "m/s^2", {}),
    ):
        model["inputs"][0].update(quantity=quantity, unit=unit)
        model["outputs"][0].update(quantity="acceleration", unit="m/s^2")
        assert count_derivatives(Network.load(model)) == orders
