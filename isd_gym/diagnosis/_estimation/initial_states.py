"""Initial states: prior, first guess from the first samples, and transfer between structures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...physics.network import GROUND, Channel, Network, assemble
from .._simulation.node_motion import motion_rows_of
from .structure import Structure, offsets_of, twin

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from ...physics.network import Assembly
    from .._simulation.problem import Problem, Record


def motion_rows(problem: Problem, network: Network) -> Array:
    """Return the rows from states to displacements, and to velocities times the time scale."""
    return motion_rows_of(assemble(network.mechanical), problem.time)


def led(network: Network, record: Record) -> tuple[Array, Array]:
    """Return displacement and velocity of the moved nodes (samples, moved nodes); zero where the inputs do not tell."""
    still = np.zeros(record.samples)
    r, v = [], []
    for c in network.moving:
        u = record.inputs[c.name]
        told = c.quantity == "displacement"
        r.append(u if told else still)
        v.append(
            np.gradient(u, record.step)
            if told
            else u
            if c.quantity == "velocity"
            else still
        )
    shape = (record.samples, len(r))
    return np.stack(r, axis=1) if r else np.zeros(shape), np.stack(
        v, axis=1
    ) if v else np.zeros(shape)


def guess(
    problem: Problem,
    network: Network,
    index: int,
    about: Array | None = None,
    offsets: Sequence[float] | None = None,
) -> Array:
    """Return an initial state from the first samples: displacements and slopes as measured beside known offsets (channels,), the rest
    small, or near the state `about`."""
    record = problem.records[index]
    pure = network.mechanical
    asm = assemble(pure)
    n0 = asm.size[0]
    if not n0:
        return np.zeros(0)
    rows = motion_rows_of(asm, problem.time)
    scale = problem.span(index) * (1.0 if about is None else 0.05)
    centre = np.zeros(n0) if about is None else about
    A, b = [rows / scale], [rows @ centre / scale]
    # over a fifth of the time in which the motion changes it is a line
    count = min(max(5, int(0.2 * problem.time / record.interval)), len(record))
    t = np.arange(count) * record.interval
    x, r, f = asm.columns("x"), asm.columns("r"), asm.columns("f")
    road = led(pure, record)[0][0]
    for j, c in enumerate(pure.outputs):
        if (
            c.quantity == "acceleration"
            or asm.outputs_by_difference[j]
            or np.any(asm.outputs[j, f])
        ):
            continue
        shift = offsets[j] if offsets is not None else 0.0
        shift += sum(e.bias for e in offsets_of(network, c))
        y = (record.measured[:count, j] - shift) / problem.factors[j]
        slope = float((t - t.mean()) @ y / np.sum((t - t.mean()) ** 2))
        value = float(y.mean()) - slope * float(t.mean())
        sigma = float(np.std(record.measured[:, j])) / problem.factors[j] * 0.02 + 1e-12
        A.append(asm.outputs[j : j + 1, x] / sigma)
        b.append(np.array([(value - asm.outputs[j, r] @ road) / sigma]))
        rate = _rate_row(asm, c) if c.quantity == "displacement" else None
        if rate is not None:
            wide = sigma / max(t[-1], 1e-9) * 2
            A.append(rate[None, x] / wide)
            b.append(np.array([slope / wide]))
    x0 = np.linalg.lstsq(np.vstack(A), np.concatenate(b), rcond=None)[0]
    return x0 if np.isfinite(x0).all() else np.zeros(n0)


def _rate_row(asm: Assembly, channel: Channel) -> Array | None:
    """Return the rate of a displacement output over the base vector (columns,); None at an algebraic node, whose rate no state tells."""
    every = [
        *(n for n in asm.network.nodes if n not in asm.network.moved_nodes),
        *asm.network.moved_nodes,
    ]
    row = np.zeros(asm.velocity.shape[1])
    for node, sign in zip(
        channel.between or (str(channel.at),), (1.0, -1.0), strict=False
    ):
        if node == GROUND:
            continue
        own = asm.velocity[every.index(node)]
        if not own.any():
            return None
        row += sign * own
    return row


def transfer_states(
    problem: Problem, network: Network, initial: dict[int, Array], structure: Structure
) -> dict[int, Array]:
    """Return initial states in the coordinates of another structure: nodes keep their motion, a split node moves like its origin."""
    source, target = (
        assemble(network.mechanical),
        assemble(structure.network.mechanical),
    )
    before, net, time = source.network, target.network, problem.time
    free = [n for n in net.nodes if n not in net.moved_nodes]
    own = [n for n in before.nodes if n not in before.moved_nodes]
    if not target.size[0]:
        return {i: np.zeros(0) for i in initial}
    rows, known = motion_rows_of(target, time), motion_rows_of(source, time)
    inputs = {node: j for j, node in enumerate(net.moved_nodes)}
    out: dict[int, Array] = {}
    for i, x0 in initial.items():
        record = problem.records[i]
        motion = known @ x0
        want = np.zeros((2, len(free)))
        for k, node in enumerate(free):
            like = twin(node, before.nodes)
            if like in own:
                want[:, k] = motion[own.index(like)], motion[len(own) + own.index(like)]
            elif like in inputs:
                r, v = led(net, record)
                want[:, k] = r[0, inputs[like]], time * v[0, inputs[like]]
        out[i] = np.asarray(
            np.linalg.lstsq(rows, want.ravel(), rcond=None)[0], dtype=np.float64
        )
    return out
