"""What moves in a fitted simulation, and what many variants of it would do: the ground under screening and small effects."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..elements import PROBE, Motion, Setting
from ..errors import InputError
from ..network import Channel, Network, assemble
from ..simulate import side_by_side
from .fit import Fit
from .hypotheses import hypotheses, pairs
from .problem import Array, Problem, bare, pace
from .structure import Hypothesis, add

LANES = 48  # variants that run in one call of the kernel


def motions(
    problem: Problem, fit: Fit, also: tuple[tuple[str, str], ...] = ()
) -> dict[tuple[str, str], Motion]:
    """Elongation and rate of every pair (`also` of others) in the fitted simulation of the records that are fitted by."""
    out: dict[tuple[str, str], list[Array]] = {}
    net = fit.network
    where = [*pairs(net), *(p for p in also if p not in pairs(net))]
    extra = tuple(net.probe(f"_{k}", "displacement", between=p) for k, p in enumerate(where))
    probe = problem.watching(watching(net, extra))
    begun = {i: fit.initial[i][:, None] for i in problem.estimation}
    seen = probe.simulate_all([probe.network], problem.estimation, begun, like=net)
    for i in problem.estimation:
        for k, p in enumerate(where):
            out.setdefault(p, []).append(seen[i][:, k, 0])
    steps = [problem.records[i].step for i in problem.estimation]
    motion = {}
    for p, parts in out.items():
        v = [np.gradient(d, h) for d, h in zip(parts, steps, strict=True)]
        a = [np.gradient(x, h) for x, h in zip(v, steps, strict=True)]
        motion[p] = Motion(np.concatenate(parts), np.concatenate(v), np.concatenate(a))
    return motion


def watching(net: Network, outputs: tuple[Channel, ...]) -> Network:
    """The network with other outputs, and so without what its sensors do."""
    kept = tuple(e for e in net.elements if e.place != "channel")
    return replace(net, outputs=outputs, elements=kept)


def force_scale(problem: Problem) -> float:
    """A typical force of the data [N]: the largest of what is measured, what accelerates the masses, what bends the springs."""
    net, time = problem.network, problem.time
    y = problem.measured() / problem.factors
    mass = max(net.masses.values(), default=0.0)
    spring = max((e.linear()[0] for e in net.elements if e.place == "between"), default=0.0)
    scale, moved = 0.0, 0.0
    for j, c in enumerate(net.outputs):
        s = float(np.std(y[:, j]))
        if c.quantity == "force":
            scale = max(scale, s if c.at is not None else 0.5 * s)
        elif c.quantity == "acceleration":
            scale = max(scale, s * mass)
        else:  # of a displacement or a rate
            d = s if c.quantity == "displacement" else s * time
            moved = max(moved, min(d * spring, 10 * mass * d / time**2) or mass * d / time**2)
    for c in net.inputs:  # what is known to push
        if c.quantity in ("force", "current"):
            pushed = np.concatenate([problem.records[i].inputs[c.name] for i in problem.estimation])
            gain = 1.0
            if c.quantity == "current":
                motor = net.element(c.elements[0])
                gain = float(np.prod(motor.law_parameters()))
            scale = max(scale, gain * float(np.std(pushed)))
    return scale or moved or 1.0


def setting(
    problem: Problem, network: Network, h: Hypothesis, motion: Motion | None, force: float
) -> Setting:
    """What the effect of a hypothesis may look at when it says from which values its fit begins."""
    signal, time = 1.0, problem.time
    if h.place == "element":
        name = next(c.name for c in network.inputs if c.quantity == "current" and c.element == h.where[0])
        current = np.concatenate([problem.records[i].inputs[name] for i in problem.estimation])
        signal = max(float(np.std(current)), 1e-9)
    elif h.place == "channel":
        j = problem.channels.index(h.where[0])
        y = problem.measured()[:, j]
        signal = max(float(np.std(y)), 1e-12)
        time = pace(
            problem.records[problem.estimation[0]].measured[:, j], problem.records[problem.estimation[0]].rate
        )
    return Setting(network, h.where, motion, force, signal, time, dict(h.options))


def together(
    problem: Problem, fit: Fit, networks: Sequence[Network]
) -> Iterator[tuple[list[int], int, Array]]:
    """Outputs of many networks over every record to fit by: (which networks, record, outputs (n, channels, lanes)).

    Lanes of one structure run together; what breaks down is left out.
    """
    groups: dict[tuple[object, ...], list[int]] = {}
    for k, net in enumerate(networks):
        asm = assemble(bare(net))
        outside = tuple(type(e).__name__ for e in net.elements if e.place != "between")
        groups.setdefault((outside, *side_by_side(asm)), []).append(k)
    chunks = [m[k : k + LANES] for m in groups.values() for k in range(0, len(m), LANES)]
    while chunks:
        chunk = chunks.pop(0)
        nets = [networks[k] for k in chunk]
        begun = {i: np.repeat(fit.initial[i][:, None], len(nets), axis=1) for i in problem.estimation}
        try:
            seen = problem.simulate_all(nets, problem.estimation, begun, like=fit.network)
        except (InputError, np.linalg.LinAlgError):
            half = len(chunk) // 2  # one that breaks down does not take the others along
            chunks = [part for part in (chunk[:half], chunk[half:]) if 0 < len(part) < len(chunk)] + chunks
            continue
        for i, y in seen.items():
            yield chunk, i, y


def unmodelled(problem: Problem, fit: Fit, share: float) -> dict[int, Array]:
    """What each force law of the library, too small to be named, would do: record -> (n, channels, laws).

    Every law that acts beside what stands at its place gives `share` of the data's typical force.
    """
    motion, force = motions(problem, fit), force_scale(problem)
    networks = []
    for h in hypotheses(fit.network):
        simpler = set(h.kind.contains) & {e.type for e in fit.network.elements} or h.kind.replaces
        if h.place != "between" or h.kind.series or simpler:
            continue
        tried = h.kind.starts(setting(problem, fit.network, h, motion.get((h.where[0], h.where[1])), force))
        for start in tried[:: max(1, len(tried) // 2)][:2]:
            try:
                built = add(replace(fit.structure, network=fit.network), h, start.ways[0]).network
                assemble(bare(built))
            except (InputError, np.linalg.LinAlgError):
                continue
            networks.append(built)
    out = {i: np.zeros((*y.shape, len(networks))) for i, y in fit.outputs.items()}
    point = {i: y for _, i, y in together(problem, fit, [fit.network])}
    for chunk, i, y in together(problem, fit, networks):
        with np.errstate(over="ignore", invalid="ignore"):
            change = (y - point[i]) * (share / PROBE)
            most = np.abs(change).max(axis=(0, 1))
        # one that breaks down says nothing, however large its numbers become on the way
        out[i][:, :, chunk] = np.where(most < 1e6 * np.abs(point[i]).max(), change, 0.0)
    return out
