"""Roads against the standard: amplitude does not depend on the step nor the speed."""

import numpy as np
import pytest
from program import refused
from scipy.signal import welch

from isd_gym.physics.road import (
    ISO_CLASSES,
    PAPER_KAPPA,
    bump,
    iso_road,
    paper_road,
    pothole,
    road,
    sweep,
)


def spatial_psd(ground, speed, step, roads=40, length=4000.0):
    """Welch estimate of the one-sided PSD over spatial frequency [m^3], averaged over roads."""
    segment = int(1000.0 / (speed * step))
    total = 0.0
    for seed in range(roads):
        z = ground.heights(
            length / speed, speed=speed, step=step, rng=np.random.default_rng(seed)
        )
        n, p = welch(
            z, 1.0 / (speed * step), nperseg=segment, detrend="linear", window="hann"
        )
        total = total + p
    return n, total / roads


@pytest.mark.parametrize(("speed", "step"), [(10.0, 1e-3), (30.0, 5e-4)])
def test_iso_8608_over_the_band(speed, step):
    """Within 5 % in octave bands of ISO 8608's range, 0.011 to 2.83 cycle/m, for two steps and two speeds."""
    ground = iso_road("C")
    n, p = spatial_psd(ground, speed, step)
    target = ISO_CLASSES["C"] * (n[1:] / 0.1) ** -2.0
    ratio = p[1:] / target
    edges = 0.011 * 2.0 ** np.arange(9)
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        band = (n[1:] >= low) & (n[1:] < min(high, 2.83))
        if band.sum() >= 4:
            assert ratio[band].mean() == pytest.approx(1.0, abs=0.05), (low, high)


def test_the_papers_road_is_class_b():
    assert paper_road().roughness == pytest.approx(1e-4)
    assert 32e-6 < paper_road().roughness < 128e-6


@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_velocity_of_the_papers_road_is_white_with_the_stated_intensity(step):
    z = paper_road().heights(200.0, speed=20.0, step=step, rng=np.random.default_rng(0))
    increments = np.diff(z)
    assert increments.var() == pytest.approx(
        (2 * np.pi) ** 2 * PAPER_KAPPA * 20.0 * step, rel=0.03
    )
    assert abs(np.corrcoef(increments[1:], increments[:-1])[0, 1]) < 0.01
    blocks = increments[: len(increments) // 20 * 20].reshape(-1, 20).sum(axis=1)
    assert (
        abs(np.mean((blocks / blocks.std()) ** 4) - 3.0) < 0.2
    )  # a sum of twenty is as good as normal


def test_profiles():
    rng = np.random.default_rng(0)
    z = bump(height=0.06, length=3.0, at=10.0).heights(2.0, speed=20.0, rng=rng)
    assert z.max() == pytest.approx(0.06, rel=1e-3) and z[0] == z[-1] == 0.0
    assert np.argmax(z) * 1e-3 * 20.0 == pytest.approx(11.5, abs=0.02)
    assert pothole(depth=0.04).heights(2.0, rng=rng).min() == pytest.approx(-0.04)
    s = sweep(amplitude=0.01, start=1.0, stop=1.0).heights(3.0, rng=rng)
    np.testing.assert_allclose(
        s, 0.01 * np.sin(2 * np.pi * np.arange(3001) * 1e-3), atol=2e-7
    )
    assert not road("flat").heights(1.0, rng=rng).any()


def test_recorded_profile_over_distance(tmp_path):
    x = np.arange(0, 100, 0.1)
    path = tmp_path / "lane.csv"
    path.write_text(
        "distance [m],height [m]\n"
        + "\n".join(f"{a:.1f},{0.01 * np.sin(a):.9f}" for a in x)
    )
    z = road(path).heights(2.0, speed=20.0, rng=np.random.default_rng(3))
    start = np.random.default_rng(3)
    start.integers(0, 2**64, dtype=np.uint64)
    begin = start.uniform(0.0, x[-1] - 40.0)
    expected = 0.01 * (np.sin(begin + 20.0 * np.arange(2001) * 1e-3) - np.sin(begin))
    np.testing.assert_allclose(z, expected, atol=3e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("distance,height\n0,0\n1,x\n", "line 3, column 'height': 'x' is not a number"),
        ("distance,height\n0,0\n1,0\n1,0\n", "line 4: 'distance' does not increase"),
        (
            "distance,height\n" + "".join(f"{i},0\n" for i in range(9)) + "500,0\n",
            "line 11: gap of 492",
        ),
        ("distance,height\n0,0\n1,nan\n", "line 3: not finite"),
        ("distance,height\n0,0\n", "fewer than two points"),
    ],
)
def test_bad_recordings(tmp_path, text, message):
    (tmp_path / "r.csv").write_text(text)
    refused(message, road, tmp_path / "r.csv")
