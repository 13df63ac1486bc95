"""Forces of laws along a given motion of two nodes, and the response of a fitted model to a force between two nodes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import dct, idct
from scipy.ndimage import uniform_filter1d
from scipy.signal import fftconvolve

from ...physics import elements as el
from ...physics.network import GROUND, Channel, Network, assemble
from ...physics.network._frames import order_told
from ...physics.simulate import Plant, side_by_side
from .._estimation.structure import Structure, add, cells_beside
from .._simulation.problem import BROKEN, Problem, bare
from .missing_force import Deconvolution
from .motion import motions_by_record

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics.elements import Motion
    from .._estimation.gauss_newton import Fit
    from .._estimation.structure import Hypothesis
    from .._simulation.problem import Record

    Pair = tuple[str, str]

#: names of the force in a model, and of the travel of a bench
PUSH, TRAVEL = "_push", "_travel"
#: samples of a record below which its simulated motion is used
LEAST = 16


def measured_motions(problem: Problem, fit: Fit, noise: Array) -> dict[Pair, dict[int, Motion]]:
    """Return the motion of every pair of nodes in the training records as far as the outputs tell it: the simulated one, and the distance
    or the motion by the force that explains the residual above the noise (channels,)."""
    out: dict[Pair, dict[int, Motion]] = {}
    for pair, simulated in motions_by_record(problem, fit).items():
        told = _told_distance(problem, fit.network, pair)
        out[pair] = {}
        for i, m in simulated.items():
            record = problem.records[i]
            moved = None
            if record.reading is None and len(record) > LEAST:
                residual = record.measured - fit.outputs[i]
                if told is not None:
                    moved = _without_noise(
                        residual @ told, float(np.hypot.reduce(noise * told)), record.interval
                    )
                else:
                    moved = _moved(fit.network, pair, record, problem.channels, residual, noise)
            out[pair][i] = m if moved is None else _corrected(m, record, moved)
    return out


def _told_distance(problem: Problem, network: Network, pair: Pair) -> Array | None:
    """Return the factors (channels,) with which outputs sum up to the distance of a pair; None where they do not."""
    if order_told(network, pair):
        return None
    pure = bare(network)
    asm = assemble(replace(pure, outputs=(*pure.outputs, pure.probe("_d", "displacement", between=pair))))
    free = np.concatenate([np.arange(s.start, s.stop) for s in (asm.columns("x"), asm.columns("f"))])
    rows, wanted = asm.outputs[:-1][:, free], asm.outputs[-1, free]
    size = np.maximum(np.linalg.norm(rows, axis=1), 1e-300)
    factors = np.linalg.lstsq((rows / size[:, None]).T, wanted, rcond=1e-9)[0] / size
    is_told = np.allclose(factors @ rows, wanted, atol=1e-6 * (float(np.linalg.norm(wanted)) + 1e-300))
    return factors / problem.factors if is_told and np.any(wanted) else None


def _without_noise(signal: Array, noise: float, step: float) -> Array:
    """Return a signal (n,) without white noise and its rate (n, 2), by a Wiener filter over cosines."""
    lines = dct(signal, norm="ortho")
    power = uniform_filter1d(lines**2, max(3, len(lines) // 40), mode="nearest")
    gain = np.maximum(1.0 - noise**2 / np.maximum(power, 1e-300), 0.0)
    smooth = idct(gain * lines, norm="ortho")
    return np.stack([smooth, np.gradient(smooth, step)], axis=1)


def _moved(
    network: Network, pair: Pair, record: Record, names: Sequence[str], residual: Array, noise: Array
) -> Array | None:
    """Return the motion (n, 2) of a pair by the force that explains a residual; None where no force does."""
    measured, left = (dict(zip(names, values.T, strict=True)) for values in (record.measured, residual))
    sizes = dict(zip(names, noise.tolist(), strict=True))
    try:
        _, moved = Deconvolution.of(network, pair, record.time, measured).force(left, sizes)
    except (ValueError, *BROKEN):
        return None
    return moved if np.isfinite(moved).all() else None


def _corrected(m: Motion, record: Record, moved: Array) -> Motion:
    fine, at = (
        np.arange(record.samples) * record.step,
        (np.arange(len(record)) + record.before) * record.interval,
    )
    d, v = (np.interp(fine, at, moved[:, k]) for k in range(2))
    return el.Motion(m.d + d, m.v + v, m.a)


def law_forces(
    network: Network,
    pair: Pair,
    motion: Motion,
    step: float,
    ways: Sequence[tuple[Hypothesis, Mapping[str, float]]],
) -> Array:
    """Return the force that each law adds between two nodes along a motion with a sampling step [s] (samples, laws) [N]; NaN where a law
    has no force there. The elements between the nodes are simulated alone."""
    driven, held = pair if pair[0] != GROUND else pair[::-1]
    sign = 1.0 if driven == pair[0] else -1.0
    alone = _bench(network, driven, held)
    groups: dict[tuple[object, ...], list[tuple[int, Network]]] = {}
    for k, (h, values) in enumerate([(None, {}), *ways]):
        try:
            built = alone
            if h is not None:
                where = tuple(GROUND if n == held else n for n in h.where)
                built = add(Structure(alone, ()), replace(h, where=where), values).network
            here = [e for e in built.elements if GROUND in e.where]
            probes = tuple(built.probe(f"_{e.name}", "force", element=e.name) for e in here)
            built = bare(replace(built, outputs=probes))
            along = tuple(1.0 if e.where[1] == GROUND else -1.0 for e in here)
            groups.setdefault((along, *side_by_side(assemble(built))), []).append((k, built))
        except (ValueError, *BROKEN):
            continue
    out = np.full((len(motion.d), 1 + len(ways)), np.nan)
    travel = {TRAVEL: sign * motion.d}
    rates = {TRAVEL: (sign * motion.v, sign * motion.a)}
    for key, members in groups.items():
        try:
            plant = Plant([n for _, n in members], step)
            y = plant.run(travel, samples=len(motion.d), derivatives=rates)
        except BROKEN:
            continue
        out[:, [k for k, _ in members]] = sign * np.einsum("ijk,j->ik", y, np.array(key[0]))
    return out[:, 1:] - out[:, :1]


def _bench(network: Network, driven: str, held: str) -> Network:
    """Return the elements between two nodes alone, without those that read other channels or elements."""
    here: list[el.Element] = [
        replace(e, where=tuple(GROUND if n == held else n for n in e.where))
        for e in el.beside(network, (driven, held))
        if not (isinstance(e, el.Motor) or e.loaded or e.scheduled)
    ]
    if not here:  # a network has at least one element
        here = [el.LinearStiffness("_none", (driven, GROUND), stiffness=0.0)]  # type: ignore[call-arg]
    return Network("bench", {}, tuple(here), (Channel(TRAVEL, "displacement", "m", at=driven),))


def force_responses(problem: Problem, fit: Fit, pair: Pair, forces: Mapping[int, Array]) -> dict[int, Array]:
    """Return the change of the outputs of a fitted model by forces (samples, forces) [N] between two nodes, by training record; a linear
    model is simulated once with a pulse."""
    network = fit.network
    motor = el.Motor(PUSH, pair, thrust_constant=1.0)  # type: ignore[call-arg]
    pushed = replace(
        network,
        elements=(*network.elements, motor),
        inputs=(*network.inputs, Channel(PUSH, "current", "A", element=PUSH)),
        outputs=cells_beside(network, motor),
    )
    is_linear = not any(e.place == "between" and e.parts() for e in network.elements)
    out = {}
    for i, columns in forces.items():
        record = problem.records[i]
        if not is_linear or record.reading is not None:
            y = _pushed(problem, pushed, fit, i, record, columns)
            out[i] = y - problem.simulate([network], i, fit.initial[i][:, None])
            continue
        pulse = np.zeros((record.samples, 1))
        pulse[1] = 1.0
        still = replace(
            record.unread(),
            inputs={k: np.zeros_like(v) for k, v in record.inputs.items()},
            slopes={k: (np.zeros_like(v), np.zeros_like(a)) for k, (v, a) in record.slopes.items()},
        )
        answer = _pushed(problem, pushed, None, i, still, pulse)
        whole = fftconvolve(columns[:, None, :], answer, axes=0)[1 : record.samples + 1]
        out[i] = record.read(whole)
    return out


def _pushed(
    problem: Problem, network: Network, fit: Fit | None, i: int, record: Record, forces: Array
) -> Array:
    mean = 0.5 * (
        forces + np.append(forces[1:], forces[-1:], axis=0)
    )  # an input of a motor is held over a step
    records = [record.with_inputs({**record.inputs, PUSH: column}) for column in mean.T]
    whole = Problem(network, records, None, problem.step, problem.time)
    begun = None if fit is None else {k: fit.initial[i][:, None] for k in range(len(records))}
    seen = whole.simulate_all(
        [network], range(len(records)), begun, like=None if fit is None else fit.network
    )
    return np.concatenate([seen[k] for k in range(len(records))], axis=2)
