"""Motion of every pair of nodes in a fitted simulation, and simulation of many variants of a fitted network side by side."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import cumulative_trapezoid

from ..._common.arrays import rms
from ...physics.elements import Motion, Setting
from ...physics.network import MOTIONS, Channel, Network, assemble, assemble_all
from ...physics.network.frames import order_told
from ...physics.simulate import pace, side_by_side
from .._simulation.problem import BROKEN, Problem
from .library import pairs

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from ..._common.arrays import Array
    from .._estimation.gauss_newton import Fit
    from .._estimation.structure import Hypothesis
    from .._simulation.problem import Problem


LANES = 48  # number of variants per call of the kernel


def motions(
    problem: Problem, fit: Fit, also: tuple[tuple[str, str], ...] = ()
) -> dict[tuple[str, str], Motion]:
    """Return elongation and rate of every pair in the fitted simulation of the training records; elongations that only rates tell count
    from its start."""
    return {p: joined(own) for p, own in motions_by_record(problem, fit, also).items()}


def joined(parts: Mapping[int, Motion]) -> Motion:
    """Return the motions of several records, one after the other."""
    return Motion(
        *(np.concatenate([getattr(m, k) for m in parts.values()]) for k in "dva")
    )


def motions_by_record(
    problem: Problem, fit: Fit, also: tuple[tuple[str, str], ...] = ()
) -> dict[tuple[str, str], dict[int, Motion]]:
    """Return `motions` by training record."""
    out: dict[tuple[str, str], dict[int, Motion]] = {}
    net = fit.network
    known = {p: order_told(net, p) for p in (*pairs(net), *also)}
    where = [p for p, order in known.items() if order < 2]
    extra = tuple(
        net.probe(f"_{k}", MOTIONS[known[p]], between=p) for k, p in enumerate(where)
    )
    seen = watched(problem, fit, extra)
    for i in problem.estimation:
        step = problem.records[i].step
        for k, p in enumerate(where):
            y = seen[i][:, k]
            d, v = (
                (cumulative_trapezoid(y, dx=step, initial=0.0), y)
                if known[p]
                else (y, np.gradient(y, step))
            )
            out.setdefault(p, {})[i] = Motion(d, v, np.gradient(v, step))
    return out


def watched(
    problem: Problem, fit: Fit, outputs: tuple[Channel, ...]
) -> dict[int, Array]:
    """Return other outputs of a fitted simulation by training record (samples, outputs); the latest are kept."""

    def make() -> tuple[Array, ...]:
        probe = problem.watching(with_outputs(fit.network, outputs))
        begun = {i: fit.initial[i][:, None] for i in problem.estimation}
        found = probe.simulate_all(
            [probe.network], problem.estimation, begun, like=fit.network
        )
        return tuple(found[i][:, :, 0].copy() for i in problem.estimation)

    seen = problem.memory.made(("watched", id(fit), outputs), fit, make)
    return dict(zip(problem.estimation, seen, strict=True))


def with_outputs(net: Network, outputs: tuple[Channel, ...]) -> Network:
    """Return the network with other outputs, without effects of sensors."""
    kept = tuple(e for e in net.elements if e.place != "channel")
    return replace(net, outputs=outputs, elements=kept)


def setting(
    problem: Problem,
    network: Network,
    h: Hypothesis,
    motion: Motion | None,
    force: float,
    load: Sequence[Array] | None = None,
) -> Setting:
    """Return the setting from which an effect derives its start values: the motion of the place, its typical force [N], and loads (samples,) [N]."""
    signal, time, samples = 1.0, problem.time, None
    if h.place == "element":
        name = next(
            c.name
            for c in network.inputs
            if c.quantity == "current" and c.element == h.where[0]
        )
        current = np.concatenate(
            [problem.records[i].inputs[name] for i in problem.estimation]
        )
        signal, samples = max(float(np.std(current)), 1e-9), current
    elif h.place == "channel":
        j = problem.channels.index(h.where[0])
        y = problem.measured()[:, j]
        signal, samples = max(float(np.std(y)), 1e-12), y
        time = pace(
            problem.records[problem.estimation[0]].measured[:, j],
            problem.records[problem.estimation[0]].interval,
        )
    elif h.kind.scheduled:
        channel = dict(h.options)["channel"]
        samples = np.concatenate(
            [problem.records[i].inputs[channel] for i in problem.estimation]
        )
    elif load is not None:
        samples = np.concatenate(load)
    return Setting(
        network, h.where, motion, force, signal, time, dict(h.options), samples
    )


def _assembled(networks: Sequence[Network], which: Sequence[int]) -> list[int]:
    """Return those of some networks that have equations of motion, which are made side by side."""
    try:
        assemble_all([networks[k].mechanical for k in which])
    except BROKEN:
        half = len(which) // 2  # isolate the network without
        parts = (which[:half], which[half:]) if half else ()
        return [k for part in parts for k in _assembled(networks, part)]
    return list(which)


def simulate_variants(
    problem: Problem, fit: Fit, networks: Sequence[Network]
) -> Iterator[tuple[list[int], dict[int, Array]]]:
    """Yield the outputs of many networks over the training records, with the states of a fit: indices, and outputs (samples, channels,
    lanes) by record; what breaks down is left out."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for k in _assembled(networks, range(len(networks))):
        net = networks[k]
        alike = side_by_side(assemble(net.mechanical))
        outside = tuple(type(e).__name__ for e in net.elements if e.place != "between")
        groups.setdefault((outside, *alike), []).append(k)
    chunks = [
        m[k : k + LANES] for m in groups.values() for k in range(0, len(m), LANES)
    ]
    while chunks:
        chunk = chunks.pop(0)
        nets = [networks[k] for k in chunk]
        begun = {
            i: np.repeat(fit.initial[i][:, None], len(nets), axis=1)
            for i in problem.estimation
        }
        try:
            yield (
                chunk,
                problem.simulate_all(nets, problem.estimation, begun, like=fit.network),
            )
        except BROKEN:
            half = len(chunk) // 2  # isolate a variant that diverges
            chunks = [
                part
                for part in (chunk[:half], chunk[half:])
                if 0 < len(part) < len(chunk)
            ] + chunks


#: smallest difference of the magnitudes of two mean loads, as a share of the largest RMS load of a record
LEAST_DIFFERENCE = 0.3


def loads_of(
    problem: Problem, fit: Fit, candidates: Collection[Hypothesis]
) -> dict[str, list[Array]]:
    """Return the load of each training record (samples,) [N], or [N m] where nodes turn, by loading element of the candidates, as a
    fitted simulation computes it; empty where the simulation breaks down."""
    names = list(
        dict.fromkeys(dict(h.options)["load"] for h in candidates if h.kind.loaded)
    )
    if not names:
        return {}
    probes = tuple(fit.network.probe(f"_{n}", "force", element=n) for n in names)
    try:
        seen = watched(problem, fit, probes)
    except BROKEN:
        return {}
    return {n: [seen[i][:, k] for i in problem.estimation] for k, n in enumerate(names)}


def tell_gain(loads: Sequence[Array]) -> bool:
    """Return whether the loads of the records tell the level of a friction from its gain: the mean loads of two records must differ
    in magnitude."""
    means = [abs(float(np.mean(x))) for x in loads]
    return max(means) - min(means) > LEAST_DIFFERENCE * max(rms(x) for x in loads)
