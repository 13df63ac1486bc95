"""The missing force between two nodes over time, from the residuals of the outputs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError
from ..._common.units import convert
from ...physics import elements as el
from ...physics.network import GROUND, Channel, Network, linearise
from ...physics.network._frames import frames, order_told
from ...physics.simulate import pace

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from ..._common.arrays import Array

HIGHEST = 8.0  # times the frequency of the motion


@dataclass(frozen=True)
class Deconvolution:
    """Response of the outputs of a model to a force between two nodes, and its inverse."""

    names: list[str]
    frequency: Array  # [Hz] of the band that is used
    first: int  # index of the first of them in a Fourier transform
    gain: NDArray[np.complex128]  # (frequencies, outputs), SI per N
    moved: NDArray[np.complex128]  # (frequencies, 2): travel and rate of the pair, per N
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
        seen = _moved_by_a_force(network, pair)
        for c in network.outputs:
            if c.name in names:
                beside = c.element is not None and any(network.element(e).where == pair for e in c.elements)
                outputs.append(replace(c, element=(*c.elements, name)) if beside else c)
        factors = {c.name: convert(1.0, c.unit, c.si) for c in outputs}
        if seen is not None:
            outputs += [network.probe(f"_{q}", q, between=seen) for q in ("displacement", "velocity")]
        motor = el.Motor(name, pair, thrust_constant=1.0, ratio=1.0)  # type: ignore[call-arg]
        probe = replace(
            network,
            elements=(*(e for e in network.elements if e.place == "between"), motor),
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
        low, high = 0.5 / (samples * step), min(highest / (2 * math.pi * scale), 0.4 / step)
        band = np.flatnonzero((frequency >= low) & (frequency <= high))
        if len(band) < 10:
            raise InputError("the record is too short to look for a force in it")
        answer = space.response(frequency[band])[:, :, space.inputs.index(name)]
        order = [space.outputs.index(n) for n in names]
        two = answer[:, len(order) :] if seen is not None else np.zeros((len(band), 2), complex)
        units = np.array([factors[n] for n in names])
        return cls(names, frequency[band], int(band[0]), answer[:, order], two, units, samples)

    def force(self, residual: Mapping[str, Array], noise: Mapping[str, float]) -> tuple[Array, Array]:
        """Return the force [N] (n,) that explains a residual best under white noise, and the motion it makes (n, 2), by Wiener's filter
        with the force's own spectrum as prior (expectation maximisation)."""
        from scipy.ndimage import uniform_filter1d
        from scipy.signal.windows import tukey

        taper = tukey(self.samples, 0.1)
        band = slice(self.first, self.first + len(self.frequency))
        spectra = [np.fft.rfft((residual[n] - residual[n].mean()) * taper)[band] for n in self.names]
        R = np.stack(spectra, axis=1) * self.factors
        S = (np.maximum([noise[n] for n in self.names], 1e-12) * self.factors) ** 2 * float(np.sum(taper**2))
        seen = np.sum(np.abs(self.gain) ** 2 / S, axis=1)
        sought = np.sum(self.gain.conj() * R / S, axis=1)
        prior = np.abs(sought / np.maximum(seen, 1e-300)) ** 2
        width = max(3, len(prior) // 40)
        for _ in range(12):
            prior = np.maximum(uniform_filter1d(prior, width, mode="nearest"), 1e-30)
            w = sought / (seen + 1.0 / prior)
            prior = np.abs(w) ** 2 + 1.0 / (seen + 1.0 / prior)
        whole = np.zeros((self.samples // 2 + 1, 3), complex)
        whole[band, 0] = w
        whole[band, 1:] = w[:, None] * self.moved
        out = np.fft.irfft(whole, self.samples, axis=0)
        return out[:, 0], out[:, 1:]


def _moved_by_a_force(network: Network, pair: tuple[str, str]) -> tuple[str, str] | None:
    """Return the two nodes whose distance a force between a pair changes, the ground in place of nodes with prescribed rates; None
    without any."""
    if not order_told(network, pair):
        return pair
    riding = frames(network)
    first, second = ((network.moved_nodes[riding[n]] if n in riding else n) for n in pair)
    out = (pair[0], first) if pair[1] == GROUND else (second, pair[1])
    return out if out[0] != out[1] else None
