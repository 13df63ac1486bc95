"""Networks drawn at random: finite or one line that says when; energy, and the laws, on them."""

import builders
import numpy as np
import pytest
from builders import damper, element, friction, spring
from program import refused
from rigs import random_networks

from isd_gym import InputError, Network, simulate
from isd_gym.physics import elements as el
from isd_gym.physics.network import Channel
from isd_gym.physics.simulate import Plant

STEP = 2.5e-5  # a Stribeck bound is that at the start of a step: energy closes with the first power of it
LOSSY = ("linear_damping", "quadratic_damping", "asymmetric_damping")


def elongations(net):
    """Displacement, velocity and force of every element, as far as the network defines them."""
    out = []
    for e in net.elements:
        for quantity, unit in (
            ("displacement", "m"),
            ("velocity", "m/s"),
            ("force", "N"),
        ):
            where = (
                {"element": e.name} if quantity == "force" else {"between": e.between}
            )
            channel = Channel(f"{e.name} {quantity}", quantity, unit, **where)
            try:
                Plant(net, STEP, extra=[channel])
            except InputError:  # of a massless node
                continue
            out.append(channel)
    return out


@pytest.mark.parametrize("block", range(4))
def test_a_result_is_finite_or_there_is_one_line(block):
    """Every law, plausible values, at 1 ms: nothing that is not finite is handed out, and most of it is a result."""
    time, results, kinds = np.arange(301) * 1e-3, 0, set()
    with np.errstate(all="ignore"):
        for seed in range(25):
            rng = np.random.default_rng([block, seed])
            first = random_networks.BETWEEN[
                (25 * block + seed) % len(random_networks.BETWEEN)
            ]
            model = random_networks.draw(
                rng, kinds=[first, *rng.choice(random_networks.BETWEEN, 2)]
            )
            kinds |= {e["type"] for e in model["elements"]}
            try:
                out = simulate(model, time, random_networks.moves(rng, model, time))
            except InputError as error:
                assert "\n" not in str(error)
                continue
            results += 1
            assert all(np.isfinite(v).all() for v in out.values()), (block, seed)
    assert results > 15
    assert kinds >= set(random_networks.BETWEEN)


def test_what_breaks_down_says_when():
    """A damper that drives: the motion grows beyond all numbers, and the line has the time."""
    drives = element(
        "c",
        "asymmetric_damping",
        "cart",
        "ground",
        extension=-3000.0,
        compression=-3000.0,
    )
    model = builders.cart(spring("cart", "ground", 1e4, "k"), drives, mass=1.0)
    time = np.arange(2001) * 1e-3
    refused(
        r"fails at t = 0\.\d+ s", simulate, model, time, {"push": np.ones_like(time)}
    )


@pytest.mark.parametrize("seed", range(12))
def test_what_goes_in_is_stored_or_dissipated(seed):
    """Of passive networks: the road's work is what masses and springs hold and what the rest took, within 0.1 %.

    No dissipating element returns more energy than was put in: friction, dampers, stops and hysteresis end with a loss.
    """
    rng = np.random.default_rng([7, seed])
    net = Network.from_dict(random_networks.draw(rng, passive=True))
    channels = elongations(net)
    names = {c.name for c in channels}
    if any(
        f"{e.name} {q}" not in names
        for e in net.elements
        for q in ("displacement", "velocity", "force")
    ):
        pytest.skip("a massless node: a velocity that is only a difference")
    time = np.arange(12001) * STEP
    inputs = random_networks.moves(rng, net.to_dict(), time)
    speeds = [Channel(f"{n} speed", "velocity", "m/s", at=n) for n in net.masses]
    load = Channel("load", "force", "N", at="road")
    out = simulate(net, time, inputs, step=STEP, extra=[*channels, *speeds, load])
    dt = np.diff(time)

    def work(force, rate):  # trapezoidal rule: forces of friction jump
        power = force * rate
        return float(np.sum(0.5 * (power[1:] + power[:-1]) * dt))

    rate = np.gradient(inputs["road"], STEP)
    given = work(out["load"], rate)
    squares = {n: out[f"{n} speed"] ** 2 for n in net.masses}
    moved = sum(
        0.5 * m * (squares[n][-1] - squares[n][0]) for n, m in net.masses.items()
    )
    taken = sum(
        work(out[f"{e.name} force"], out[f"{e.name} velocity"]) for e in net.elements
    )
    scale = float(np.sum(np.abs(out["load"] * rate)) * STEP) + abs(moved)
    for e in net.elements:
        if type(e).bound is not None or e.type in LOSSY:
            assert (
                work(out[f"{e.name} force"], out[f"{e.name} velocity"]) > -1e-3 * scale
            )
    assert abs(given - moved - taken) < 1e-3 * scale


def test_a_motor_on_a_terminal_without_mass():
    """A motor pulls a damper with friction, nothing has mass there: current, rate and forces are of one instant at every sample."""
    thrust, damping, level = 200.0, 1500.0, 300.0
    parts = [
        spring("m", "ground", 2e5, "k"),
        damper("n", "ground", damping, "c"),
        friction("n", "ground", level, "f"),
        element("motor", "motor", "m", "n", thrust_constant=thrust),
    ]
    inputs = [builders.channel("current", "current", element="motor")]
    forces = [builders.channel(e, "force", element=e) for e in ("c", "f")]
    outputs = ["v velocity n", "x displacement n", *forces]
    model = builders.model("driven", parts, inputs, outputs, masses={"m": 300.0})
    time = np.arange(2001) * 1e-3
    current = np.repeat(np.random.default_rng(3).uniform(-5, 5, 101), 20)[: len(time)]
    # no current from the last sample on
    out = {k: v[:-1] for k, v in simulate(model, time, {"current": current}).items()}
    push = thrust * current[:-1]  # on the terminal, towards the mass
    rest = push - damping * out["v"]
    np.testing.assert_allclose(out["c"], damping * out["v"], rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(out["f"], rest, atol=1e-5)
    assert np.abs(rest).max() <= level * (1 + 1e-9)
    slides = np.abs(out["v"]) > 1e-6
    sign = np.sign(out["v"][slides])
    np.testing.assert_allclose(out["f"][slides], level * sign, rtol=1e-6)
    assert 0.2 < slides.mean() < 0.95 and np.abs(push).max() > 2 * level
    # rate held over every step: the displacement is its sum
    travel = np.cumsum(out["v"][:-1]) * 1e-3
    np.testing.assert_allclose(out["x"][1:], travel, atol=1e-9)


def test_smooth_laws_are_of_second_order_and_friction_of_first():
    """Halving the step against a fine one, thirty networks and twenty with friction; first order where a law's rate is only a difference."""
    found = [random_networks.converging(seed, rubs=False) for seed in range(30)]
    smooth = np.array(
        [order for order, differs in found if not differs and np.isfinite(order)]
    )
    rough = np.array(
        [order for order, differs in found if differs and np.isfinite(order)]
    )
    assert len(smooth) > 20 and len(rough) > 2
    assert smooth.min() > 1.8 and rough.min() > 0.9
    # where friction reverses or sticks counts, one network scatters; on the mean it is of first order at least
    rubbing = np.array(
        [random_networks.converging(seed, rubs=True)[0] for seed in range(20)]
    )
    assert np.nanmean(rubbing) > 1.0


def test_hysteresis_with_any_exponent_is_the_integral_of_its_law():
    """Against the differential equation in small steps, and at any length of a step within its bound."""
    law = el.Hysteresis.law
    for exponent in (0.5, 1.0, 1.5, 2.0, 4.0):
        for shape in (0.0, 0.5, 0.9):
            for start in (-0.9, 0.0, 0.5):
                p, way = np.array([100.0, 1e4, exponent, shape]), 2e-3
                z, n = 100.0 * start, 20_000
                for _ in range(n):
                    u = z / 100.0
                    bend = abs(u) ** exponent * (1.0 if u > 0 else 1.0 - 2.0 * shape)
                    m = u + 0.5 * way / n * 100.0 * (1.0 - bend)
                    z += (
                        way
                        / n
                        * 1e4
                        * (
                            1.0
                            - abs(m) ** exponent * (1.0 if m > 0 else 1.0 - 2.0 * shape)
                        )
                    )
                assert law(p, way, 0.0, 0.0, 100.0 * start, 1e-3)[0] == pytest.approx(
                    z, abs=0.1
                )
                for far in (0.1, 10.0, 1e6):
                    assert abs(law(p, far, 0.0, 0.0, 100.0 * start, 1e-3)[0]) <= 100.0
