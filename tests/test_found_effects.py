"""The diagnosis finds effects of drives, sensors and positions on small rigs with noise, and closes the loop of control."""

from pathlib import Path

import builders
import numpy as np
import pytest
from builders import channel, damper, element, named, spring
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from isd_gym import Table, diagnose


def values(found):
    return {k: q.value for e in found.effects for k, q in e.parameters.items()}


def rod(damping, known):
    """Return a rod that a rig moves against a damper, with a force cell."""
    parts, moved, seen = (
        [damper("rod", "ground", damping)],
        ["travel displacement rod"],
        ["force force rod"],
    )
    return builders.network(
        "rod", parts, moved, seen, uncertainty={"damper.damping": known}
    )


PULLED = rod(200.0, 0.2)
STEP = 5e-3


def pulled(seed, amplitude=3.0, pitch=3.1e-3, seconds=20.0):
    """A rod pulled to and fro by 0.3 m, with a detent force of nearly a hundred periods."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds, STEP)
    w, phase = 2 * np.pi * 0.1, rng.uniform(0, 6)
    d = 0.15 * np.sin(w * t + phase)
    v = 0.15 * w * np.cos(w * t + phase)
    force = 205.0 * v + amplitude * np.sin(2 * np.pi * d / pitch + 0.7)
    return Table(
        t,
        {"travel": d, "force": force + 0.2 * rng.normal(size=len(t))},
        f"pulled{seed}",
    )


@pytest.mark.slow
def test_a_detent_force_of_nearly_a_hundred_periods_is_named():
    found = diagnose([pulled(1), pulled(2)], PULLED, validate=[pulled(3), pulled(4)])
    assert named(found) == {("cogging_force", frozenset({"rod", "ground"}))}
    assert values(found)["pitch"] == pytest.approx(3.1e-3, rel=1e-3)


def sines(rng, t, band=(0.3, 3.0), count=8):
    """A sum of sines with its derivative, of deviation one."""
    x, v = np.zeros((2, len(t)))
    for f in np.geomspace(*band, count):
        phase = rng.uniform(0, 2 * np.pi)
        x += np.sin(2 * np.pi * f * t + phase) / f
        v += 2 * np.pi * np.cos(2 * np.pi * f * t + phase)
    return x / x.std(), v / x.std()


@pytest.mark.slow
def test_a_damper_that_gives_way_at_speed_is_named():
    def record(seed):
        rng, t = np.random.default_rng(seed), np.arange(0, 20, 2e-3)
        x, v = sines(rng, t)
        x, v = 0.01 * x, 0.01 * v
        force = 2000.0 * v / (1 + np.abs(v) / 0.08)
        return Table(
            t,
            {"travel": x, "force": force + 1.5 * rng.normal(size=len(t))},
            f"damper{seed}",
        )

    found = diagnose([record(1)], rod(900.0, 0.3), validate=[record(2)])
    assert named(found) == {("degressive_damping", frozenset({"ground", "rod"}))}
    assert values(found)["damping"] == pytest.approx(2000.0, rel=0.05)
    assert values(found)["knee"] == pytest.approx(0.08, rel=0.1)


BELT = spring("cart", "ground", 40.0, "belt")
CART = builders.cart(
    element("drive", "motor", "cart", "ground", thrust_constant=5.0),
    damper("cart", "ground", 6.0, "guide"),
    BELT,
    inputs=[channel("current", "current", element="drive")],
    uncertainty={
        "guide.damping": 0.2,
        "drive.thrust_constant": 0.1,
        "belt.stiffness": 0.1,
    },
)


def driven(
    seed, law=lambda u: u, sense=lambda y: y, band=(0.2, 2.0), noise=2e-3, late=0
):
    """A cart on a belt whose drive makes `law` of the current and whose sensor makes `sense` of the speed, `late` samples late."""
    rng, t = np.random.default_rng(seed), np.arange(0, 30, 5e-3)
    u = sines(rng, t, band)[0]
    place = np.zeros(len(t))
    w = law(u)
    A = np.array([[0.0, 1.0], [-40.0 / 2.0, -6.3 / 2.0]])
    big = np.zeros((3, 3))
    big[:2, :2], big[1, 2] = A, -5.0 / 2.0
    E = expm(
        big * 5e-3
    )  # the current is held over a step; the motor pulls its terminals together
    x, speed = np.zeros(2), np.zeros(len(t))
    for k in range(len(t)):
        place[k], speed[k] = x
        x = E[:2, :2] @ x + E[:2, 2] * w[k]
    inside = slice(20, len(t) - 20)
    y = sense(np.roll(speed, late)) + noise * rng.normal(size=len(t))
    place = place + 0.3 * noise * rng.normal(size=len(t))
    return Table(
        t[inside],
        {"current": u[inside], "speed": y[inside], "place": place[inside]},
        f"cart{seed}",
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "place", "how", "expected"),
    [
        (
            "drive_dead_zone",
            {"cart", "ground"},
            {"law": lambda u: u - np.clip(u, -0.4, 0.4)},
            ("threshold", 0.4),
        ),
        (
            "quadratic_thrust",
            {"cart", "ground"},
            {"law": lambda u: u * np.abs(u) / 1.5},
            ("reference", 1.5),
        ),
        ("sensor_magnitude", {"speed"}, {"sense": np.abs}, None),
        (
            "sensor_dead_zone",
            {"speed"},
            {"sense": lambda y: y - np.clip(y, -0.05, 0.05)},
            ("width", 0.05),
        ),
    ],
)
def test_a_law_of_the_drive_or_of_the_sensor_is_named(effect, place, how, expected):
    found = diagnose([driven(1, **how)], CART, validate=[driven(2, **how)])
    assert named(found) == {(effect, frozenset(place))}
    if expected:
        assert values(found)[expected[0]] == pytest.approx(expected[1], rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [6, -6])
def test_a_channel_that_lags_or_leads_is_named_with_its_delay(samples):
    # a second channel without a lag excludes the drive
    place = channel("place", "displacement", "cart")
    model = {**CART, "outputs": [*CART["outputs"], place]}
    found = diagnose(
        [driven(1, late=samples)], model, validate=[driven(2, late=samples)]
    )
    assert named(found) == {("sensor_delay", frozenset({"speed"}))}
    assert values(found)["delay"] == pytest.approx(samples * 5e-3, rel=0.1)


def warmed(seed, kind):
    """The cart's belt rig pushed by a force while its oil warms up; damping or friction falls with the temperature."""
    rng, t = np.random.default_rng(seed), np.arange(0, 30, 5e-3)
    push = 8.0 * sines(rng, t, (0.2, 2.0))[0]
    oil = 20.0 + rng.uniform(30, 40) * (1 - np.exp(-t / 12.0))
    damping = 9.0 - 0.12 * (oil - 30.0) * (kind == "damping")
    level = (3.0 - 0.05 * (oil - 30.0)) * (kind == "friction")
    x, v, speed, parts = 0.0, 0.0, np.zeros(len(t)), 5
    h = 5e-3 / parts
    for k in range(len(t)):
        speed[k] = v
        for j in range(parts):
            pushed = (
                push[k] + (push[min(k + 1, len(t) - 1)] - push[k]) * (j + 0.5) / parts
            )
            free = v + h / 2.0 * (pushed - damping[k] * v - 40.0 * x)
            v = free - np.clip(
                free, -h / 2.0 * level[k], h / 2.0 * level[k]
            )  # friction holds, or slides
            x += h * v
    noisy = speed + 2e-3 * rng.normal(size=len(t))
    return Table(
        t, {"push": push, "oil": np.round(oil, 1), "speed": noisy}, f"warm{seed}"
    )


OIL = channel("oil", "temperature", unit="degC")
KNOWN = {"guide.damping": 0.2, "belt.stiffness": 0.05}
GUIDE = damper("cart", "ground", 9.0, "guide")
WARM = builders.cart(GUIDE, BELT, inputs=["push force cart", OIL], uncertainty=KNOWN)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "slope"), [("damping", -0.12), ("friction", -0.05), ("nothing", None)]
)
def test_a_law_that_falls_with_a_logged_temperature_is_named_with_its_slope(
    kind, slope
):
    found = diagnose([warmed(1, kind)], WARM, validate=[warmed(2, kind)])
    assert named(found) == (
        {(f"scheduled_{kind}", frozenset({"cart", "ground"}))} if slope else set()
    )
    assert values(found).get("slope") == (
        pytest.approx(slope, rel=0.2) if slope else None
    )
    assert slope or found.verdict in ("no_discrepancy", "parameters_only")


INERTIA, TORQUE, DAMPING = 0.00333, 0.2139, 2e-4  # [kg m^2], [N m], [N m s/rad]
ARM = builders.network(
    "arm",
    [
        spring("arm", "ground", TORQUE, "gravity"),
        damper("arm", "ground", DAMPING, "bearing"),
    ],
    outputs=["angle angle arm", "rate angular_velocity arm"],
    inertias={"arm": INERTIA},
    uncertainty={"gravity.stiffness": 0.05, "bearing.damping": 1.0},
)


def swings(count, seconds=9.0, step=0.01):
    """Return consecutive parts of one free swing of a pendulum from 1.6 rad, simulated by another integrator."""
    size = round(seconds / step)
    time = np.arange(count * size) * step
    start = [1.6, 0.0]

    def motion(_, state):
        angle, rate = state
        return [rate, (-TORQUE * np.sin(angle) - DAMPING * rate) / INERTIA]

    angle, rate = solve_ivp(
        motion, (0.0, time[-1]), start, t_eval=time, rtol=1e-9, atol=1e-11
    ).y
    rng = np.random.default_rng(0)
    angle, rate = (
        y + s * rng.standard_normal(y.size) for y, s in ((angle, 1e-4), (rate, 5e-3))
    )
    parts = [slice(k * size, (k + 1) * size) for k in range(count)]
    return [
        Table(time[:size], {"angle": angle[part], "rate": rate[part]}) for part in parts
    ]


@pytest.mark.slow
def test_the_sine_of_gravity_is_named_where_the_refit_softens_the_spring():
    """Large swings are slower. The refitted stiffness is that of the largest, and the small swings of the validation are far off."""
    records = swings(6)
    found = diagnose(records[:4], ARM, validate=records[4:])
    assert found.gap["refit"]["angle"] > 2.0 * found.gap["before"]["angle"]
    assert [e.effect for e in found.effects] == ["gravity_sine"]
    assert found.effects[0].parameters["torque"].value == pytest.approx(
        TORQUE, rel=1e-3
    )
    assert found.gap["after"]["angle"] < 0.001


@pytest.mark.slow
def test_the_completed_model_drives_the_car_better_than_the_owners(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[1] / "examples")
    from close_the_loop import close

    found, result = close(episodes=4)
    assert found.verdict == "missing_effect"
    assert named(found) == {("coulomb_friction", frozenset({"joint", "piston"}))}
    level = found.effects[0].parameters["level"]
    assert level.value == pytest.approx(500.0, rel=0.03)
    assert (
        found.gap["after"]["device_travel"] < 0.05 < found.gap["refit"]["device_travel"]
    )
    cost = {row["policy"]: row["cost"] for row in result.to_dict()["policies"]}
    assert cost["mpc, new model"]["high"] < cost["mpc, old model"]["low"]
    assert cost["mpc, new model"]["change"] < -0.2
