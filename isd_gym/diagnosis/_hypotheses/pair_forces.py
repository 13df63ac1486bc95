"""Forces between two nodes: the missing one over time, which the residuals of the outputs show, and its periods over travel.

A force that repeats over travel has a line in its spectrum over position, whatever the motion in time (Lomb, Least-squares frequency
analysis of unequally spaced data, Astrophysics and Space Science 39 (1976) 447).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal.windows import tukey

from ..._common.errors import InputError
from ..._common.units import convert
from ...physics import elements as el
from ...physics.network import Channel, Network, linearise
from ...physics.simulate import pace

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from ..._common.arrays import Array
    from ...physics.elements import Motion
    from .._estimation.gauss_newton import Fit
    from .._simulation.problem import Problem

    Pair = tuple[str, str]


HIGHEST = 8.0  # times the frequency of the motion
LINES = 4  # periods that are returned
RESOLUTION = 0.25  # step of the spectrum, in periods over the whole travel
RESOLVED = 2.5  # samples of a period, at the typical speed, below which the period cannot be seen
MOST_PERIODS = 20_000  # over the travel
ALL = 1e9  # no upper limit of the band but the sampling


@dataclass(frozen=True)
class Deconvolution:
    """Response of the outputs of a model to a force between two nodes, and its inverse."""

    names: list[str]
    frequency: Array  # [Hz] of the band that is used
    first: int  # index of the first of them in a Fourier transform
    gain: NDArray[np.complex128]  # (frequencies, outputs), SI per N
    factors: Array  # channel's unit -> SI
    samples: int

    @classmethod
    def of(
        cls,
        network: Network,
        pair: tuple[str, str],
        time: Array,
        measured: Mapping[str, Array],
        highest: float = HIGHEST,
    ) -> Deconvolution:
        """Return the linear response about rest, up to `highest` times the frequency of the measured motion: above it sensors resolve no
        force."""
        step, samples, names = float(time[1] - time[0]), len(time), list(measured)
        name = network.free_name("missing_force")
        outputs = []
        for c in network.outputs:
            if c.name in names:
                beside = c.element is not None and any(
                    network.element(e).where == pair for e in c.elements
                )
                outputs.append(replace(c, element=(*c.elements, name)) if beside else c)
        factors = {c.name: convert(1.0, c.unit, c.si) for c in outputs}
        motor = el.Motor(name, pair, thrust_constant=1.0, ratio=1.0)  # type: ignore[call-arg]
        probe = replace(
            network,
            elements=(*network.mechanical.elements, motor),
            inputs=(
                *(c for c in network.inputs if c.quantity != "current"),
                Channel(name, "current", "A", element=name),
            ),
            outputs=tuple(outputs),
            uncertainty={},
            turning=frozenset(),
        )
        space = linearise(probe)
        scale = float(np.median([pace(y, step) for y in measured.values()]))
        frequency = np.asarray(np.fft.rfftfreq(samples, step), np.float64)
        low, high = (
            0.5 / (samples * step),
            min(highest / (2 * math.pi * scale), 0.4 / step),
        )
        band = np.flatnonzero((frequency >= low) & (frequency <= high))
        if len(band) < 10:
            raise InputError("the record is too short to look for a force in it")
        answer = space.response(frequency[band])[:, :, space.inputs.index(name)]
        gain = answer[:, [space.outputs.index(n) for n in names]]
        units = np.array([factors[n] for n in names])
        return cls(names, frequency[band], int(band[0]), gain, units, samples)

    def force(self, residual: Mapping[str, Array], noise: Mapping[str, float]) -> Array:
        """Return the force [N] (n,) that explains a residual best under white noise, by Wiener's filter with the force's own spectrum as
        prior (expectation maximisation)."""
        taper = tukey(self.samples, 0.1)
        band = slice(self.first, self.first + len(self.frequency))
        spectra = [
            np.fft.rfft((residual[n] - residual[n].mean()) * taper)[band]
            for n in self.names
        ]
        R = np.stack(spectra, axis=1) * self.factors
        S = (
            np.maximum([noise[n] for n in self.names], 1e-12) * self.factors
        ) ** 2 * float(np.sum(taper**2))
        seen = np.sum(np.abs(self.gain) ** 2 / S, axis=1)
        sought = np.sum(self.gain.conj() * R / S, axis=1)
        prior = np.abs(sought / np.maximum(seen, 1e-300)) ** 2
        width = max(3, len(prior) // 40)
        for _ in range(12):
            prior = np.maximum(uniform_filter1d(prior, width, mode="nearest"), 1e-30)
            w = sought / (seen + 1.0 / prior)
            prior = np.abs(w) ** 2 + 1.0 / (seen + 1.0 / prior)
        whole = np.zeros(self.samples // 2 + 1, complex)
        whole[band] = w
        return np.asarray(np.fft.irfft(whole, self.samples))


def typical_advance(travels: Sequence[Array]) -> float:
    """Return the median distance between consecutive samples of travels (n,) each, samples at rest left out."""
    way = np.abs(np.concatenate([np.diff(d) for d in travels]))
    moving = way[way > 1e-3 * way.max(initial=0.0)]
    return float(np.median(moving)) if len(moving) else 0.0


def spectral_pitches(
    problem: Problem, fit: Fit, pair: tuple[str, str], motion: Motion, periods: float
) -> tuple[float, ...]:
    """Return at most `LINES` periods [m, or rad] of the missing force over the travel of two nodes, the strongest line first, of those
    that records show and the travel holds more than `periods` times."""
    span = float(np.ptp(motion.d))
    edges = np.cumsum([problem.records[i].samples for i in problem.estimation])[:-1]
    advance = typical_advance(np.split(motion.d, edges))
    if span <= 0 or advance <= 0:
        return ()
    most = min(span / (RESOLVED * advance), MOST_PERIODS)
    if most <= periods:
        return ()
    power = np.zeros(0)
    first = 0
    for i in problem.estimation:
        record = problem.records[i]
        travel = record.seen(motion.d[first : first + record.samples])
        first += record.samples
        if record.reading is not None or len(travel) != len(record):
            continue
        force = _missing_force(problem, fit, i, pair)
        if force is None:
            continue
        lines = _spectrum((travel - motion.d.min()) / span, force, most)
        power = lines if not len(power) else power + lines
    return tuple(span / p for p in _strongest(power, periods))


def _missing_force(
    problem: Problem, fit: Fit, index: int, pair: tuple[str, str]
) -> Array | None:
    """Return the force [N] (n,) that the residual of a record shows; None for a model without a linear response."""
    record, names = problem.records[index], problem.channels
    residual = record.measured - fit.outputs[index]
    signals = {n: record.measured[:, j] for j, n in enumerate(names)}
    left = {n: residual[:, j] for j, n in enumerate(names)}
    try:
        response = Deconvolution.of(
            fit.network, pair, record.time, signals, highest=ALL
        )
        force = response.force(left, {n: float(np.std(r)) for n, r in left.items()})
    except (InputError, ValueError, np.linalg.LinAlgError):
        return None
    return force if np.isfinite(force).all() else None


def _spectrum(position: Array, force: Array, most: float) -> Array:
    """Compute the power spectrum of a force over a position from 0 to 1, at multiples of `RESOLUTION` up to `most` periods."""
    cells = int(8 * most) + 1
    place = np.minimum((position * cells).astype(int), cells - 1)
    profile = np.bincount(place, force - force.mean(), cells)
    padded = np.zeros(int(cells / RESOLUTION))
    padded[:cells] = profile
    lines = np.abs(np.fft.rfft(padded)[: int(most / RESOLUTION) + 1]) ** 2
    return np.asarray(
        lines / max(float(np.sum((force - force.mean()) ** 2)), 1e-300),
        dtype=np.float64,
    )


def _strongest(power: Array, periods: float) -> list[float]:
    """Return the numbers of periods of the strongest lines of a spectrum that are not beside a stronger one."""
    found: list[float] = []
    left = power.copy()
    left[: int(periods / RESOLUTION) + 1] = 0.0
    apart = int(2 / RESOLUTION)
    while len(found) < LINES and len(left) and left.max() > 0.0:
        k = int(np.argmax(left))
        found.append(k * RESOLUTION)
        left[max(k - apart, 0) : k + apart + 1] = 0.0
    return found
