"""Roads with a left and a right track, and wheels that pass them one after the other."""

import math
from dataclasses import replace

import numpy as np
import pytest
from program import refused
from scipy.special import kv

from isd_gym.physics import tracks
from isd_gym.physics.road import (
    Road,
    bump,
    iso_road,
    on_side,
    paper_road,
    pothole,
    road,
)
from isd_gym.physics.tracks import SUM_STATES, WheelPositions

CAR = WheelPositions((1.35, 1.35, -1.35, -1.35), (0.75, -0.75, 0.75, -0.75))
AXLE = WheelPositions((0.0, 0.0), (0.75, -0.75))
HALF_CAR = WheelPositions((1.35, -1.35), (0.0, 0.0))
ROADS = (paper_road(), iso_road("C"))


def formula(n, width, cutoff=0.0):
    """Normalised cross-spectral density of an isotropic surface; without cut-off that of Dodds and Robson for waviness 2."""
    x = 2 * np.pi * np.hypot(n, cutoff) * width
    return x * kv(1, x)


def responses(ground, width, speed, step, n):
    """Frequency responses of the filters of half the sum and half the difference (n,)."""
    poles, gains = ground.track_filters(width, speed, step)
    z = np.exp(2j * np.pi * np.asarray(n)[:, None] * speed * step)
    parts = gains / (1 - poles / z)
    return parts[:, :SUM_STATES].sum(axis=1), parts[:, SUM_STATES:].sum(axis=1)


@pytest.mark.parametrize("ground", ROADS, ids=lambda g: g.name)
@pytest.mark.parametrize("speed", [2.0, 20.0, 50.0])
@pytest.mark.parametrize("step", [1e-4, 1e-3, 5e-3])
@pytest.mark.parametrize("width", [0.5, 1.5, 2.5])
def test_density_of_each_track_is_that_of_the_single_track(ground, speed, step, width):
    """To rounding: the approximation of the coherence does not touch the tracks' own densities."""
    n = np.geomspace(1e-4, 0.499 / (speed * step), 300)
    half_sum, half_difference = responses(ground, width, speed, step, n)
    gain, pole = ground.noise(speed, step)
    single = gain**2 / np.abs(1 - pole * np.exp(-2j * np.pi * n * speed * step)) ** 2
    np.testing.assert_allclose(
        np.abs(half_sum) ** 2 + np.abs(half_difference) ** 2, single, rtol=1e-9
    )


@pytest.mark.parametrize("ground", ROADS, ids=lambda g: g.name)
@pytest.mark.parametrize(("speed", "step"), [(10.0, 1e-3), (20.0, 1e-3), (40.0, 5e-4)])
@pytest.mark.parametrize("width", [1.2, 1.5, 2.0])
def test_coherence_of_the_filters(ground, speed, step, width):
    """Within 0.011 of the formula from 0.01 to 10 cycle/m; 1 - gamma, the density of the difference, within 1.5 %."""
    n = np.geomspace(0.01, 10.0, 400)
    half_sum, half_difference = (
        np.abs(h) ** 2 for h in responses(ground, width, speed, step, n)
    )
    gamma = (half_sum - half_difference) / (half_sum + half_difference)
    np.testing.assert_allclose(gamma, formula(n, width), atol=0.011)
    np.testing.assert_allclose(
        1 - gamma, 1 - formula(n, width, ground.cutoff), rtol=0.015
    )


@pytest.mark.parametrize("speed", [3.7, 11.3, 20.0, 23.456, 41.0])
def test_rear_wheel_passes_the_same_road_at_any_speed(speed):
    """A sine over distance: the rear height is that of the place 2.7 m back, but for the interpolation's error."""
    x = np.arange(0.0, 200.0, 0.001)
    ground = Road("sine", abscissa=x, profile=0.01 * np.sin(2 * np.pi * 0.5 * x))
    _, rear = ground.wheel_heights(
        HALF_CAR, 4.0, speed=speed, rng=np.random.default_rng(0)
    )
    place = speed * np.arange(4001) * 1e-3 - 2.7
    wanted = np.where(place > 0, 0.01 * np.sin(2 * np.pi * 0.5 * place), 0.0)
    curvature = 0.01 * (2 * np.pi * 0.5 * speed * 1e-3) ** 2
    away = (
        np.abs(place) > speed * 1e-3
    )  # the kink at the start is met between two steps
    np.testing.assert_allclose(
        rear[away], wanted[away], rtol=0, atol=curvature / 8 + 2e-8
    )


@pytest.mark.parametrize("shape", [bump, pothole])
@pytest.mark.parametrize("side", ["left", "right"])
def test_bump_of_one_side(shape, side):
    name = f"{shape().name}-{side}"
    z = road(name).wheel_heights(CAR, 2.0, rng=np.random.default_rng(0))
    one = shape().heights(2.0, rng=np.random.default_rng(0))
    hit, free = (0, 1) if side == "left" else (1, 0)
    np.testing.assert_array_equal(z[hit], one)
    np.testing.assert_array_equal(z[hit + 2, 135:], one[:-135])
    assert not z[[free, free + 2]].any()


def recording(path, header, *heights):
    x = np.arange(0, 100, 0.1)
    lines = (",".join([f"{a:.1f}", *(f"{h(a):.9f}" for h in heights)]) for a in x)
    path.write_text("\n".join([header, *lines]))
    return path


@pytest.mark.parametrize(
    "header",
    [
        "distance [m],height_left [m],height_right [m]",
        "distance [m],Height Left [m],Height Right [m]",
        "distance [m],left_height,right_height",
        "distance [m],road_l,road_r",
        "distance [m],height_1,height_2",
        "distance [m],height,height.1",
    ],
)
def test_recorded_profile_of_two_tracks(tmp_path, header):
    left, right = lambda a: 0.01 * math.sin(a), lambda a: 0.02 * math.cos(0.7 * a)
    path = recording(tmp_path / "lanes.csv", header, left, right)
    z = road(path).wheel_heights(AXLE, 2.0, speed=20.0, rng=np.random.default_rng(3))
    start = np.random.default_rng(3)
    start.integers(0, 2**64, size=2, dtype=np.uint64)
    x = start.uniform(0.0, 99.9 - 40.0) + 20.0 * np.arange(2001) * 1e-3
    expected = np.array([0.01 * np.sin(x), 0.02 * np.cos(0.7 * x)])
    np.testing.assert_allclose(z, expected - expected[:, :1], atol=3e-5)


def test_right_column_before_the_left_one_in_millimetres(tmp_path):
    right, left = lambda a: 20 * math.cos(0.7 * a), lambda a: 10 * math.sin(a)
    path = recording(
        tmp_path / "r.csv",
        "distance [m],height_right [mm],height_left [mm]",
        right,
        left,
    )
    profile = road(path).profile
    assert profile.shape == (2, 1000)
    assert np.abs(profile).max(axis=1) == pytest.approx([0.01, 0.02], rel=1e-3)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (
            "distance,height_1,height_2,height_3",
            "three tracks .*: keep one column 'height', or 'height_left'",
        ),
        ("distance,height,height_left,height_right", "has three tracks"),
        ("distance,height_left", "has no left and right in 'height_left'"),
        ("place,height_left,height_right", "needs a header with 'distance' or 'time'"),
    ],
)
def test_bad_columns(tmp_path, header, message):
    zeros = [lambda a: 0.0] * header.count(",")
    refused(message, road, recording(tmp_path / "r.csv", header, *zeros))
    flat, steep = lambda a: 0.0, lambda a: 10 * math.sin(3 * a)
    path = recording(
        tmp_path / "r.csv", "distance,height_left,height_right", flat, steep
    )
    refused("is the height in mm", road, path)


@pytest.mark.parametrize("name", ["bump-left", "pothole-right", "C+bump-right"])
@pytest.mark.parametrize("wheels", [tracks.ONE_WHEEL, HALF_CAR])
def test_road_with_sides_needs_a_car_with_two_tracks(name, wheels):
    message = (
        f"road '{name}'".replace("+", r"\+")
        + " has a left and a right track, the car has one: choose"
    )
    refused(
        message, road(name).wheel_heights, wheels, 1.0, rng=np.random.default_rng(0)
    )
    refused(message, road(name).heights, 1.0, rng=np.random.default_rng(0))


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        ((), (), "0 positions x and 0 positions y"),
        ((0.0, math.nan), (0.0, 0.0), "not finite"),
        ((0.0, 2700.0), (0.0, 0.0), "a kilometre away; give metres"),
        ((0.0, 0.0, 0.0), (0.7, 0.0, -0.7), "one track or a left .* '-0.7, 0, 0.7' m"),
    ],
)
def test_bad_wheels(x, y, message):
    refused(message, WheelPositions, x, y)


def test_bad_widths_sides_and_profiles():
    refused(
        r"track width 0\.01 m: give 0.1 to 10 m",
        paper_road().track_filters,
        0.01,
        20.0,
        1e-3,
    )
    refused("no side 'middle': left or right", on_side, bump(), "middle")
    refused("road 'C' has no profile", on_side, iso_road("C"), "left")
    refused(r"no road 'bump-middle': paper.*bump-left", road, "bump-middle")
    refused(
        r"shape \(2,\) or \(2, 2\) for left and right, not \(3, 2\)",
        Road,
        "three",
        abscissa=np.arange(2.0),
        profile=np.zeros((3, 2)),
    )
    refused("both abscissa and profile", replace, bump(), abscissa=None)


def test_rear_axle_may_be_narrower():
    wheels = WheelPositions((1.3, 1.3, -1.3, -1.3), (0.76, -0.76, 0.74, -0.74))
    assert (
        wheels.tracks == 2
        and wheels.width == pytest.approx(1.5)
        and wheels.track == (0, 1, 0, 1)
    )
    assert wheels.behind == (0.0, 0.0, 2.6, 2.6)
