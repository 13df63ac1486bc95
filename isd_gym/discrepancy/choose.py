"""Screening of hypotheses by score test, joint fits of the survivors, and the choice on held-out records."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .. import elements as el
from ..errors import InputError
from ..network import Channel, Network, assemble
from ..simulate import Plant
from .fit import Fit, Fitter
from .hypotheses import Hypothesis, Motion, Probe, Structure, add, hypotheses, pairs, probes
from .problem import Array, Problem, Whitener, bare, carry, noise_of, whitener


@dataclass
class Screened:
    hypothesis: Hypothesis
    start: dict[str, float]
    gain: float  # expected decrease of the whitened sum of squares
    structure: Structure


def motions(problem: Problem, fit: Fit) -> dict[tuple[str, str], Motion]:
    """Elongation and rate of every pair in the fitted simulation of the estimation records."""
    out: dict[tuple[str, str], list[Array]] = {}
    net = fit.network
    where = pairs(net)
    extra = tuple(Channel(f"_{k}", "displacement", "m", between=p) for k, p in enumerate(where))
    steps = []
    for i in problem.estimation:
        record = problem.records[i]
        probe = Problem(_with_outputs(net, extra), [record], [False], problem.step)
        y = probe.simulate([probe.network], 0, fit.initial[i][:, None], like=net)[:, :, 0]
        for k, p in enumerate(where):
            out.setdefault(p, []).append(y[:, k])
        steps.append(record.step)
    motion = {}
    for p, parts in out.items():
        v = [np.gradient(d, h) for d, h in zip(parts, steps, strict=True)]
        a = [np.gradient(x, h) for x, h in zip(v, steps, strict=True)]
        motion[p] = Motion(np.concatenate(parts), np.concatenate(v), np.concatenate(a))
    return motion


def _with_outputs(net: Network, outputs: tuple[Channel, ...]) -> Network:
    from dataclasses import replace

    kept = tuple(e for e in net.elements if e.place != "channel")
    return replace(net, outputs=outputs, elements=kept)


def force_scale(problem: Problem, fit: Fit) -> float:
    """A typical force of the data [N]: measured, or mass times measured acceleration, or spring times travel."""
    scale = 0.0
    net = problem.network
    for i in problem.estimation:
        for j, c in enumerate(net.outputs):
            s = float(np.std(problem.records[i].measured[:, j] / problem.factors[j]))
            if c.quantity == "force":
                scale = max(scale, s if c.at is not None else 0.5 * s)
            elif c.quantity == "acceleration":
                scale = max(scale, s * max(net.masses.values(), default=0.0))
            elif c.quantity in ("displacement", "velocity") and not scale:
                k = max((e.linear()[0] for e in net.elements if e.place == "between"), default=0.0)
                scale = max(scale, s * k) if c.quantity == "displacement" else scale
    return scale or 1.0


def screen(problem: Problem, fitter: Fitter, fit: Fit, candidates: Sequence[Hypothesis]) -> list[Screened]:
    """Score test of every candidate: what its response would take off the residual that the base cannot."""
    structure, net = fit.structure, fit.network
    motion = motions(problem, fit)
    force = force_scale(problem, fit)
    basis: dict[int, tuple[Array, Array]] = {}
    p = len(fit.x)
    blocks, rows0 = [], []
    total_n0 = {}
    columns = p
    parts = []
    for i in problem.estimation:
        y, dp, ds = fitter.lanes(structure, fit.x, i, fit.initial[i])
        free = np.flatnonzero(problem.free_offset)
        const = np.zeros((len(y), y.shape[1], len(free)))
        for k, j in enumerate(free):
            const[:, j, k] = 1.0
        r = problem.records[i].measured - y - fit.offset[i]
        W = fitter.weights(np.concatenate([r[:, :, None], dp, ds, const], axis=2))
        parts.append((i, y, W.reshape(-1, W.shape[2])))
        columns += W.shape[2] - 1 - p
    rows = sum(len(w) for _, _, w in parts)
    J, r = np.zeros((rows + p, columns)), np.zeros(rows + p)
    at, col = 0, p
    spans = {}
    for i, y, W in parts:
        n, extra = len(W), W.shape[1] - 1 - p
        r[at : at + n] = W[:, 0]
        J[at : at + n, :p] = W[:, 1 : 1 + p]
        J[at : at + n, col : col + extra] = W[:, 1 + p :]
        spans[i] = (at, at + n, y)
        at, col = at + n, col + extra
    sigma = np.array([f.sigma for f in structure.free])
    mean = np.array([f.mean for f in structure.free])
    J[rows + np.arange(p), np.arange(p)] = 1 / sigma
    r[rows:] = (mean - fit.x) / sigma
    norm = np.linalg.norm(J, axis=0)
    Q, R = np.linalg.qr(J / np.where(norm > 0, norm, 1))
    keep = np.abs(np.diag(R)) > 1e-7
    Q = Q[:, keep]
    r = r - Q @ (Q.T @ r)

    jobs: list[tuple[Hypothesis, Probe, list[Structure]]] = []
    for h in candidates:
        pair_motion = motion.get((h.where[0], h.where[1])) if len(h.where) == 2 else None
        current = spread = 1.0
        if h.place == "element":
            name = next(c.name for c in net.inputs if c.quantity == "current" and c.element == h.where[0])
            current = max(float(np.std(np.concatenate([problem.records[i].inputs[name] for i in problem.estimation]))), 1e-9)
        if h.place == "channel":
            j = problem.channels.index(h.where[0])
            spread = max(float(np.std(np.concatenate([problem.records[i].measured[:, j] for i in problem.estimation]))), 1e-12)
        for probe in probes(h, net, pair_motion, force, current, spread):
            try:
                built = [add(Structure(net, structure.free, structure.hypotheses, structure.names, structure.ties), h, v) for v in probe.ways]
                for b in built:
                    assemble(bare(b.network))
            except (InputError, np.linalg.LinAlgError):
                continue
            jobs.append((h, probe, built))
    # lanes of one structure run together
    groups: dict[tuple, list[tuple[int, int]]] = {}
    for a, (h, _, built) in enumerate(jobs):
        for b, s in enumerate(built):
            asm = assemble(bare(s.network))
            kinds = tuple(type(e).__name__ for e in asm.laws)
            groups.setdefault((h.effect if h.place != "between" else "", asm.size, kinds), []).append((a, b))
    response = [np.zeros((rows + p, len(built))) for _, _, built in jobs]
    for members in groups.values():
        for first in range(0, len(members), 48):
            chunk = members[first : first + 48]
            nets = [jobs[a][2][b].network for a, b in chunk]
            for i, (start, stop, y) in spans.items():
                x0 = np.repeat(fit.initial[i][:, None], len(nets), axis=1)
                try:
                    out = problem.simulate(nets, i, x0, like=net)
                except (InputError, np.linalg.LinAlgError):
                    continue
                w = fitter.weights(out - y[:, :, None]).reshape(stop - start, -1)
                for lane, (a, b) in enumerate(chunk):
                    response[a][start:stop, b] = w[:, lane]
    best: dict[Hypothesis, Screened] = {}
    found: list[Screened] = []
    for (h, probe, built), s in zip(jobs, response, strict=True):
        if not np.isfinite(s).all():
            continue
        size = np.linalg.norm(s, axis=0)
        if not np.all(size > 0):
            continue
        s = s - Q @ (Q.T @ s)
        left = np.linalg.norm(s, axis=0)
        if np.any(left < 1e-3 * size):
            continue
        amplitude, *_ = np.linalg.lstsq(s, r, rcond=None)
        if not probe.signed and np.any(amplitude <= 0):
            continue
        gain = float(r @ (s @ amplitude))
        start = dict(probe.values)
        if h.effect == "cogging_force":
            A, B = amplitude * probe.values["amplitude"]
            start["amplitude"], start["phase"] = math.hypot(A, B), math.atan2(B, A)
        elif h.effect == "asymmetric_damping":
            start = {k: float(a) * probe.values[k] for k, a in zip(("extension", "compression"), amplitude, strict=True)}
        elif h.effect == "sensor_gain":
            start["gain"] = 1.0 + 0.05 * float(amplitude[0])
        else:
            a = float(np.clip(amplitude[0], -50, 50)) if probe.signed else float(np.clip(amplitude[0], 0.1, 50))
            for key in probe.grows:
                start[key] = start[key] / a if probe.inverse else start[key] * a
        found.append(Screened(h, start, gain, built[0]))
    found.sort(key=lambda c: -c.gain)
    return found


@dataclass
class Rival:
    """A fitted set of effects and what it says about the held-out records."""

    hypotheses: tuple[Hypothesis, ...]
    fit: Fit
    held: Fit | None = None
    score: float = math.nan  # mean whitened square of the held-out records, all channels
    blocks: Array = field(default_factory=lambda: np.zeros(0))  # the same, block by block in time

    @property
    def cost(self) -> float:
        return self.fit.cost + self.fit.prior


def floor_of(problem: Problem, fits: Sequence[Fit]) -> Array:
    """Noise standard deviation of every channel, from the spectrum of residuals above the motion."""
    out = []
    for j in range(len(problem.channels)):
        series, step = [], 1.0
        for f in fits:
            for i, y in f.outputs.items():
                series.append(problem.records[i].measured[:, j] - y[:, j])
                step = problem.records[i].step
        out.append(noise_of(series, step))
    return np.array(out)


def residuals(problem: Problem, fit: Fit) -> list[Array]:
    return [problem.records[i].measured - y for i, y in fit.outputs.items()]


def refit(problem: Problem, structure: Structure, *, rounds: int = 3, start: Fit | None = None) -> tuple[Fit, Whitener]:
    """Fit a structure with weights that come from its own residuals, to self-consistency."""
    floors = np.array(
        [noise_of([problem.records[i].measured[:, j] for i in problem.estimation], problem.records[0].step) for j in range(len(problem.channels))]
    )
    W = Whitener(tuple(np.array([1 / max(h, 1e-300)]) for h in floors))
    fit = start
    if fit is not None:
        W = whitener(residuals(problem, fit), floors)
    for k in range(rounds):
        fit = Fitter(problem, W).fit(structure, fit.x if fit else None, fit.initial if fit else None, fit.offset if fit else None, iterations=5)
        W = whitener(residuals(problem, fit), floors)
    assert fit is not None
    return fit, W


def settle(problem: Problem, W: Whitener, rival: Rival) -> Rival:
    """Held-out records: parameters as found, initial states and offsets from the record's own samples."""
    fitter = Fitter(problem, W)
    f = fitter.fit(rival.fit.structure, rival.fit.x, rival.held.initial if rival.held else None, rival.held.offset if rival.held else None, records=problem.validation, frozen=True, iterations=3)
    rival.held = f
    weigh(problem, W, rival)
    return rival


BLOCKS = 20


def weigh(problem: Problem, W: Whitener, rival: Rival) -> None:
    assert rival.held is not None
    blocks = []
    for i, y in rival.held.outputs.items():
        e = W(problem.records[i].measured - y) ** 2
        edges = np.linspace(0, len(e), BLOCKS + 1).astype(int)
        blocks += [e[a:b].mean(axis=0) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    rival.blocks = np.array(blocks)  # (blocks, channels)
    rival.score = float(rival.blocks.mean())


def shortlist(found: Sequence[Screened], limit: int) -> list[Screened]:
    """The best starts of the best hypotheses: several for laws whose scale is not found from one start."""
    starts = {"cogging_force": 5, "bump_stop": 2, "hysteresis": 2, "gas_spring": 1}
    count: dict[Hypothesis, int] = {}
    out = []
    for s in found:
        n = count.get(s.hypothesis, 0)
        if n == 0 and len(count) >= limit:
            continue
        if n < starts.get(s.hypothesis.effect, 1):
            count[s.hypothesis] = n + 1
            out.append(s)
    return out


def compete(problem: Problem, current: Fit, W: Whitener, *, limit: int = 12, finals: int = 6) -> tuple[list[Rival], Whitener]:
    """One stage of forward addition: screen, fit jointly, weigh anew by the best, judge on held-out records."""
    fitter = Fitter(problem, W)
    found = screen(problem, fitter, current, list(hypotheses(current.structure.network)))
    chosen = shortlist(found, limit)
    base = current.structure

    def one(s: Screened) -> Rival | None:
        try:
            structure = add(base, s.hypothesis, s.start)
            x = structure.start
            f = fitter.fit(structure, x, carried(current, structure), current.offset, iterations=8)
        except (InputError, np.linalg.LinAlgError):
            return None
        return Rival(structure.hypotheses, f)

    rivals: dict[tuple[Hypothesis, ...], Rival] = {}
    with ThreadPoolExecutor(2) as pool:
        for r in pool.map(one, chosen):
            if r is not None and math.isfinite(r.cost) and (r.hypotheses not in rivals or r.cost < rivals[r.hypotheses].cost):
                rivals[r.hypotheses] = r
    ranked = sorted(rivals.values(), key=lambda r: r.cost)[:finals]
    return ranked, W


def carried(fit: Fit, structure: Structure) -> dict[int, Array]:
    source, target = assemble(bare(fit.network)), assemble(bare(structure.network))
    return {i: carry(source, target, x0) for i, x0 in fit.initial.items()}


def reweigh(problem: Problem, rivals: list[Rival], rounds: int = 2) -> Whitener:
    """Refit rivals under weights from the best of them, until the weights settle; judge all on held-out records."""
    best = min(rivals, key=lambda r: r.cost)
    W = None
    for _ in range(rounds):
        floors = floor_of(problem, [best.fit])
        W = whitener(residuals(problem, best.fit), floors)
        fitter = Fitter(problem, W)

        def again(r: Rival) -> None:
            r.fit = fitter.fit(r.fit.structure, r.fit.x, r.fit.initial, r.fit.offset, iterations=6)

        with ThreadPoolExecutor(2) as pool:
            list(pool.map(again, rivals))
        rivals.sort(key=lambda r: r.cost)
        best = rivals[0]
    assert W is not None
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda r: settle(problem, W, r), rivals))
    return W
