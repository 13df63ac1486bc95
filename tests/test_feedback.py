"""Inputs that follow from outputs: detected, told, and no reason for a name."""

from dataclasses import replace

import builders
import numpy as np
import pytest
from builders import channel, damper, element
from scipy.signal import cont2discrete, lfilter

from isd_gym import Network, Table, diagnose
from isd_gym.diagnosis import CRITERIA
from isd_gym.diagnosis._records.feedback import find_feedback
from isd_gym.diagnosis._simulation.problem import Problem, Record
from isd_gym.diagnosis._verdict.closed_loop import imitated_share

STEP, SAMPLES = 0.01, 4000


def cart(stiffness=0.0, *more):
    """A mass on a guide with viscous damping, pushed by a known force; with a spring to the ground, or more, where asked."""
    elements = [damper("cart", "ground", 2.0, "guide"), *more]
    if stiffness:
        elements.append(builders.spring("cart", "ground", stiffness))
    seen = channel("position", "displacement", "cart", offset="free")
    known = {"cart.mass": 0.1, "guide.damping": 1.0}
    return Network.load(
        builders.cart(*elements, outputs=[seen], mass=1.0, uncertainty=known)
    )


def march(push, stiffness, seed):
    """Positions of the cart under a given push, exactly discretised by scipy, with white noise of 0.5 %."""
    A, B, C, D, _ = cont2discrete(
        (np.array([[0.0, 1.0], [-stiffness, -2.0]]), np.array([[0.0], [1.0]]), np.eye(2)[:1], np.zeros((1, 1))), STEP
    )  # fmt: skip
    x, out = np.zeros(2), np.empty(len(push))
    for k, u in enumerate(push):
        out[k] = x[0]
        x = A @ x + B[:, 0] * u
    return out + 0.005 * out.std() * np.random.default_rng(seed).standard_normal(
        len(out)
    )


def controlled(law, stiffness=0.0, seed=0, friction=0.0):
    """(push, position) of the cart under a controller that sees the noisy position, with force disturbances.

    Euler steps of a fiftieth of a sample; friction is projected, so that the cart can stick.
    """
    rng = np.random.default_rng(seed)
    reference = lfilter(
        [2e-5], np.poly([0.98, 0.98, 0.98]), rng.standard_normal(SAMPLES)
    )
    push, seen = np.zeros(SAMPLES), np.zeros(SAMPLES)
    x, v, now, fine = 0.2, 0.0, 1.0, 50
    for k in range(SAMPLES):
        seen[k] = x + 5e-4 * rng.standard_normal()
        slope = (seen[k] - seen[max(k - 3, 0)]) / (3 * STEP)
        if law == "bang-bang":
            error = -seen[k] - 0.05 * slope
            now = now if abs(error) < 0.02 else float(np.sign(error))
        else:
            now = 20.0 * (reference[k] - seen[k]) - 5.0 * slope
        push[k] = now
        force = now + 0.1 * rng.standard_normal()
        for _ in range(fine):
            v += (force - 2.0 * v - stiffness * x) * STEP / fine
            v -= float(np.clip(v, -friction * STEP / fine, friction * STEP / fine))
            x += v * STEP / fine
    return push, seen


def as_record(push, position, name="run"):
    return Record(name, STEP, {"push": push}, position[:, None])


#: inputs of open-loop tests
KINDS = {
    "square": lambda t, rng: np.sign(np.sin(2 * np.pi * 1.0 * t + 0.1)),
    "square between samples": lambda t, rng: np.sign(
        np.sin(2 * np.pi * 0.937 * t + 0.3)
    ),
    "pseudo-random binary": lambda t, rng: np.repeat(
        rng.choice([-1.0, 1.0], SAMPLES // 25), 25
    ),
    "telegraph": lambda t, rng: np.sign(
        lfilter([1.0], [1.0, -0.95], rng.standard_normal(SAMPLES))
    ),
    "square sweep": lambda t, rng: np.sign(np.sin(2 * np.pi * (0.2 * t + 0.02 * t**2))),
    "sine": lambda t, rng: np.round(np.sin(2 * np.pi * 0.937 * t), 6),
    "sweep": lambda t, rng: np.round(np.sin(2 * np.pi * (0.2 * t + 0.02 * t**2)), 6),
    "white": lambda t, rng: rng.standard_normal(SAMPLES),
    "coloured, measured": lambda t, rng: lfilter(
        [0.1], [1.0, -0.9], rng.standard_normal(SAMPLES)
    ),
    "sines, measured": lambda t, rng: builders.sines(
        t, np.arange(0.2, 2.2, 0.13), rng.uniform(0, 6, 16)
    ),
    "step": lambda t, rng: np.where(t > 10.0, 1.0, 0.0),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("stiffness", [0.0, 40.0])
def test_an_open_loop_is_no_feedback(kind, stiffness):
    """A clock, a sweep or noise is no answer to the output, although the output follows the input."""
    for seed in range(3):
        push = KINDS[kind](STEP * np.arange(SAMPLES), np.random.default_rng(seed))
        position = march(push, stiffness, seed)
        # the sensor of the input has noise, too: the output knows more of the true input
        if kind.endswith("measured"):
            push = push + 0.02 * push.std() * np.random.default_rng(9).standard_normal(
                len(push)
            )
        assert find_feedback([as_record(push, position)], cart(stiffness)) == ()


@pytest.mark.slow
@pytest.mark.parametrize("law", ["bang-bang", "linear"])
@pytest.mark.parametrize("stiffness", [0.0, 20.0])
def test_feedback_is_found(law, stiffness):
    for seed in range(2):
        runs = [
            as_record(*controlled(law, stiffness, 10 * seed + k), f"run {k}")
            for k in range(2)
        ]
        (found,) = find_feedback(runs, cart(stiffness))
        assert found.input == "push"
        assert found.outputs == ("position",)
        assert 0.05 < found.share < 1.0
        assert found.significance < 1e-3
    assert find_feedback([as_record(*(x[:100] for x in controlled(law)))], cart()) == ()


def test_a_spring_imitates_a_controller_and_friction_does_not():
    """Friction is half a multiple of the input of a linear controller, and a third of one given travel and rate."""

    def imitated(law, name, network):
        push, position = controlled(law, seed=1, friction=0.3 * (law == "linear"))
        problem = Problem(network, [as_record(push, position)], ["fit"])
        fit = builders.followed(problem, 0.01)
        share = imitated_share(problem, fit, network.element(name), "push")
        return share, push, position, fit.outputs[0][:, 0]

    share, push, position, moved = imitated("bang-bang", "spring", cart(stiffness=4.0))
    assert np.corrcoef(push, np.sign(np.gradient(position, STEP)))[0, 1] ** 2 < 0.5
    assert (
        share == pytest.approx(np.corrcoef(push, moved)[0, 1] ** 2, abs=0.02)
        and share > 0.5
    )
    dry = element("dry", "coulomb_friction", "cart", "ground", level=0.3)
    share, push, position, _ = imitated("linear", "dry", cart(0.0, dry))
    rate = np.gradient(np.convolve(position, np.ones(9) / 9, "same"), STEP)
    assert np.corrcoef(push, np.sign(rate))[0, 1] ** 2 > 0.5 and share < 0.4


@pytest.mark.slow
def test_friction_under_feedback_is_named_and_whole_records_are_not_compared():
    """The drive works against friction, half of which is a multiple of the push; under the second limits brief stretches decide nothing."""

    def run(seed):
        push, position = controlled("linear", seed=seed, friction=0.3)
        return Table(
            np.arange(1500) * STEP,
            {"push": push[:1500], "position": position[:1500]},
            f"run{seed}",
        )

    records = [run(0), run(1)], cart()
    d = diagnose(*records, validate=[run(2), run(3)])
    assert [e.effect for e in d.effects] == ["coulomb_friction"]
    assert d.effects[0].parameters["level"].value == pytest.approx(0.3, rel=0.1)
    assert d.findings[0].laws[0].probability == pytest.approx(
        d.effects[0].confidence, abs=0.01
    )
    d = diagnose(
        *records,
        validate=[run(2), run(3)],
        criteria=replace(CRITERIA, least_removed=0.0),
    )
    assert d.verdict == "unknown_effect"
    assert d.stretches is not None and d.stretches.reason == "feedback"
    assert "open loop" not in {g.name for g in d.gates}
