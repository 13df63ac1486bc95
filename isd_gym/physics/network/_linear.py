"""Linear state space of a network about rest with named signals, for controllers and frequency responses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError
from ..._common.units import HELD
from ._assembly import TOO_FAR_APART, assemble
from ._model import MOTIONS, Channel, Network

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from .. import elements as el


@dataclass(frozen=True)
class StateSpace:
    """Linear system ``dx/dt = A x + B u``, ``y = C x + D u`` in SI units with named signals."""

    A: np.ndarray  # state matrix (states, states)
    B: np.ndarray  # input matrix (states, inputs)
    C: np.ndarray  # output matrix (outputs, states)
    D: np.ndarray  # feedthrough matrix (outputs, inputs)
    inputs: tuple[str, ...]  # names of the inputs u
    outputs: tuple[str, ...]  # names of the outputs y

    def response(self, frequency: np.ndarray) -> np.ndarray:
        """Return the complex frequency response.

        Args:
            frequency: Frequencies (n,) [Hz].

        Returns:
            Response (n, outputs, inputs).
        """
        s = 2j * np.pi * np.asarray(frequency, float)
        eye = np.eye(len(self.A))
        return np.array(
            [self.C @ np.linalg.solve(si * eye - self.A, self.B) + self.D for si in s]
        )


def slopes(
    laws: Sequence[el.Element], damping: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return stiffness [N/m] and damping [N s/m] of laws at rest, (laws,) each; `damping` [N s/m] by name
    replaces the slopes of a law.

    Laws that read a logged channel have the slope at the reference of the channel.
    """
    slopes_k = np.zeros(len(laws))
    slopes_c = np.zeros(len(laws))
    for j, e in enumerate(laws):
        if e.name in damping:
            slopes_c[j] = damping[e.name]
        elif e.law is not None:
            p = np.array(e.law_parameters())
            d = 1e-7
            h = 1e-9
            slopes_k[j] = (
                e.law(p, d, 0.0, 0.0, 0.0, h)[0] - e.law(p, -d, 0.0, 0.0, 0.0, h)[0]
            ) / (2 * d)
            at = getattr(e, "reference", 0.0) if e.scheduled else 0.0
            slopes_c[j] = (
                e.law(p, at, d, 0.0, 0.0, h)[0] - e.law(p, at, -d, 0.0, 0.0, h)[0]
            ) / (2 * d)
    return slopes_k, slopes_c


#: share of the fastest pole below which a pole is that of a free motion
FREE = 1e-9


def own_time(network: Network) -> float | None:
    """Return the time constant of a network: one over the circular frequency of the slowest oscillation about rest.

    Args:
        network: The model.

    Returns:
        Time constant [s]; None without oscillations.
    """
    poles = _poles(network)
    swings = poles[poles.imag > 1e-6 * np.abs(poles)]
    return float(1.0 / np.abs(swings).min()) if len(swings) else None


def slowest_time(network: Network) -> float | None:
    """Return the time constant of the slowest oscillation or relaxation of a network about rest.

    Args:
        network: The model.

    Returns:
        Time constant [s]; infinite if the network only moves freely, or if all its motion is prescribed; None without a state space.
    """
    poles = np.abs(_poles(network))
    if len(poles):
        return float(1.0 / poles.min())
    try:
        linearise(network.with_outputs(()))
    except InputError:
        return None
    return np.inf


def _poles(network: Network) -> np.ndarray:
    """Return the poles of a network about rest [rad/s], without those of free motions; empty where there is no state space."""
    try:
        poles = np.linalg.eigvals(linearise(network.with_outputs(())).A)
    except (InputError, np.linalg.LinAlgError):
        return np.zeros(0, complex)
    size = np.abs(poles)
    return poles[size > FREE * size.max(initial=0.0)].astype(complex)


def natural_frequencies(network: Network) -> np.ndarray:
    """Return the natural frequencies of the oscillations of a network about rest.

    Args:
        network: The model.

    Returns:
        Frequencies [Hz], ascending; empty without oscillations.
    """
    poles = _poles(network)
    return np.sort(np.abs(poles[poles.imag > 1e-6 * np.abs(poles)])) / (2 * np.pi)


def transfer(network: Network, frequency: np.ndarray) -> np.ndarray:
    """Return the complex frequency response of the outputs of a network to its inputs, about rest.

    If an input acts through its derivatives, their effect is part of the response to the input.

    Args:
        network: The model.
        frequency: Frequencies (n,) [Hz].

    Returns:
        Response (n, outputs, inputs) in SI units.

    Raises:
        InputError: The network has no linear state space.
    """
    space = linearise(network)
    response = space.response(frequency)
    s = 2j * np.pi * np.asarray(frequency, float)
    out = np.zeros((len(s), len(network.outputs), len(network.inputs)), complex)
    for j, c in enumerate(network.inputs):
        for order in range(3):
            label = c.name + "'" * order
            if label in space.inputs:
                out[:, :, j] += (
                    s[:, None] ** order * response[:, :, space.inputs.index(label)]
                )
    return out


def linearise(
    network: Network | str | Path | Mapping[str, Any],
    *,
    outputs: Sequence[Channel] = (),
    damping: Mapping[str, float] | None = None,
    laws: bool = False,
) -> StateSpace:
    """Return the state space of a network about rest, for controllers and frequency responses.

    Velocities and accelerations of moved nodes appear as inputs ``road'`` and ``road''`` if they act on the
    network.

    Args:
        network: The model, or the name of a built-in model, a file, or the content of a file.
        outputs: Further output channels, after those of the network.
        damping: Linear damping [N s/m] by name of a law, instead of the slope of the law at rest (statistical
            linearisation of friction, equation 9).
        laws: Whether the force of each law is an input with the law's name, instead of the slope of the law.

    Raises:
        InputError: The network has no linear state space.
    """
    network = Network.load(network)
    asm = assemble(network, outputs)
    X, f = asm.columns("x"), asm.columns("f")
    rate, out = asm.rate, asm.outputs
    if any(asm.outputs_by_difference):
        raise InputError("the velocity of an algebraic node has no state-space form")
    if not laws and asm.laws:
        try:
            slopes_k, slopes_c = slopes(asm.laws, damping or {})
            # f = Kd d + Kc v with d, v = rows @ base and base containing f: solve for f
            rows = (
                slopes_k[:, None] * asm.elongation
                + slopes_c[:, None] * asm.elongation_rate
            )
            gain = np.linalg.solve(np.eye(len(asm.laws)) - rows[:, f], rows)
        except (
            ArithmeticError,
            np.linalg.LinAlgError,
        ):  # a law without a slope or without support
            raise InputError(TOO_FAR_APART) from None
        rate = rate + rate[:, f] @ gain
        out = out + out[:, f] @ gain
        if not (np.isfinite(rate).all() and np.isfinite(out).all()):
            raise InputError(TOO_FAR_APART)
    names: list[str] = []
    keep: list[int] = []
    told = {c.name: MOTIONS.index(c.quantity) for c in network.moving}
    groups = [
        ("r", [name if at == 0 else "" for name, at in told.items()]),
        ("v", [name + "'" * (1 - at) if at < 2 else "" for name, at in told.items()]),
        ("alpha", [name + "'" * (2 - at) for name, at in told.items()]),
        ("F", [c.name for c in network.inputs if c.quantity == "force"]),
        ("I", [c.name for kind in HELD for c in network.inputs if c.quantity == kind]),
        ("f", [e.name for e in asm.laws] if laws else []),
    ]
    for part, labels in groups:
        for j, label in enumerate(labels):
            column = asm.columns(part).start + j
            derived = label == "" or label.endswith("'")
            if not derived or np.any(rate[:, column]) or np.any(out[:, column]):
                names.append(label)
                keep.append(column)
    return StateSpace(
        A=rate[:, X].copy(),
        B=rate[:, keep],
        C=out[:, X].copy(),
        D=out[:, keep],
        inputs=tuple(names),
        outputs=tuple(c.name for c in (*network.outputs, *outputs)),
    )
