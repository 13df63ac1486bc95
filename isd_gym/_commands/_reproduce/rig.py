"""The force tests of section 3 in simulation: a rig with a moved terminal, and the identification of its oil."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import least_squares

from ...physics.simulate import simulate
from .study import AMPLITUDE, FREQUENCIES

if TYPE_CHECKING:
    from ...physics.network import Network


def triangle(time: np.ndarray, frequency: float) -> np.ndarray:
    """Return a triangle wave of Table 2's amplitude, rising from 0.

    Args:
        time: Time (n,) [s].
        frequency: Frequency [Hz].

    Returns:
        Displacement (n,) [m].
    """
    return AMPLITUDE * 2 / math.pi * np.arcsin(np.sin(2 * math.pi * frequency * time))


def force_test(
    network: Network | str,
    frequency: float,
    *,
    periods: int = 3,
    wave: str = "sine",
    step: float = 2.5e-4,
    sampling: float | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Simulate a force test, and return its last periods.

    At least two periods and 1.5 s are omitted first, since the inerter on its oil spring rings for 0.15 s.

    Args:
        network: The rig.
        frequency: Frequency [Hz].
        periods: Number of returned periods.
        wave: 'sine' or 'triangle'.
        step: Physics step [s].
        sampling: Sampling step [s]; None for the physics step.

    Returns:
        Time [s], displacement [m] and force [N], (n,) each.
    """
    dt = 1 / (frequency * math.ceil(1 / (frequency * (sampling or step))))
    settle = max(2, math.ceil(1.5 * frequency))
    time = np.arange(round((periods + settle) / frequency / dt) + 1) * dt
    x = (
        triangle(time, frequency)
        if wave == "triangle"
        else AMPLITUDE * np.sin(2 * math.pi * frequency * time)
    )
    force = simulate(network, time, {"displacement": x}, step=step)["force"]
    keep = slice(round(settle / frequency / dt), None)
    return time[keep], x[keep], force[keep]


def fundamental(time: np.ndarray, signal: np.ndarray, frequency: float) -> complex:
    """Return the complex amplitude of the first harmonic of whole periods, with the phase relative to a sine.

    Args:
        time: Time (n,) [s].
        signal: Signal (n,).
        frequency: Frequency [Hz].

    Returns:
        Amplitude in the unit of the signal.
    """
    turn = np.exp(-2j * math.pi * frequency * time[:-1])
    return complex(2j * np.mean(signal[:-1] * turn))


def identify(
    truth: Network, model: Network, level: float, *, noise: float, seed: int = 0
) -> dict[str, float]:
    """Repeat the identification of section 3.2 (Table 4): k_e and c_e from sines of 2 to 10 Hz, with given friction.

    Least squares with the trust region reflective method, tolerances 0.01 (Table 3), objective (7), from the
    best of eight start stiffnesses: the resonance of inerter and oil is within the test frequencies, so that
    the objective has several valleys.

    Args:
        truth: Network that generates the measurements.
        model: Network to identify.
        level: Level of the friction [N].
        noise: Noise of the measured force as a share of its RMS.
        seed: Seed of the noise.

    Returns:
        oil.stiffness [N/m], leak.damping [N s/m], and RMS error [N] and share.
    """
    rng = np.random.default_rng(seed)
    step = 5e-4
    tests = []
    for f in FREQUENCIES:
        _, _, force = force_test(truth, f, step=step, sampling=1e-3)
        tests.append(
            (
                f,
                force
                + noise * np.sqrt(np.mean(force**2)) * rng.standard_normal(len(force)),
            )
        )
    base = model.with_parameters({"seal.level": level})
    total = sum(len(force) for _, force in tests)
    scale = np.array([1e5, 1e3])

    def error(p: np.ndarray) -> np.ndarray:
        k, c = p * scale
        guess = base.with_parameters(
            {"oil.stiffness": float(k), "leak.damping": float(c)}
        )
        parts = [
            force_test(guess, f, step=step, sampling=1e-3)[2] - force
            for f, force in tests
        ]
        return np.concatenate(parts) / math.sqrt(total)

    starts = [np.array([k, 0.8]) for k in (0.1, 1.0, 2.0, 4.0, 6.0, 8.0, 12.0, 20.0)]
    fit = least_squares(
        error, min(starts, key=lambda p: float(np.sum(error(p) ** 2))), bounds=([0.01, 0.0], [100.0, 100.0]),
        method="trf", ftol=0.01, xtol=0.01, gtol=1e-12, diff_step=1e-3,
    )  # fmt: skip
    rms = float(np.sqrt(np.sum(fit.fun**2)))
    size = math.sqrt(sum(float(np.sum(force**2)) for _, force in tests) / total)
    return {
        "oil.stiffness": float(fit.x[0] * scale[0]),
        "leak.damping": float(fit.x[1] * scale[1]),
        "rms_error": rms,
        "share": rms / size,
    }
