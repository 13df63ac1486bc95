"""Screening of hypotheses by score test, joint fits of the survivors, and the choice on held-out records."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from .. import elements as el
from ..errors import InputError
from ..network import Channel, Network, assemble
from ..simulate import effective_current
from .fit import Fit, Fitter
from .hypotheses import (
    PROBE,
    SERIES,
    Hypothesis,
    Motion,
    Probe,
    Structure,
    add,
    base_structure,
    hypotheses,
    pairs,
    probes,
    standing,
    twin,
)
from .problem import (
    Array,
    Noise,
    Problem,
    Record,
    Whitener,
    bare,
    innovations,
    motion_rows_of,
    noise_of,
    whitener,
)


@dataclass
class Screened:
    hypothesis: Hypothesis
    start: dict[str, float]
    gain: float  # expected decrease of the whitened sum of squares
    grows: tuple[str, ...] = ()
    inverse: bool = False

    def structure_at(self, fit: Fit) -> Structure:
        return add(advanced(fit), self.hypothesis, self.start)


def motions(problem: Problem, fit: Fit) -> dict[tuple[str, str], Motion]:
    """Elongation and rate of every pair in the fitted simulation of the estimation records."""
    out: dict[tuple[str, str], list[Array]] = {}
    net = fit.network
    where = pairs(net)
    extra = tuple(Channel(f"_{k}", "displacement", "m", between=p) for k, p in enumerate(where))
    steps = []
    for i in problem.estimation:
        record = problem.records[i]
        probe = Problem(
            _with_outputs(net, extra), [replace(record, taps=None, thin=1)], [False], problem.step
        )
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


def together(
    problem: Problem, fit: Fit, networks: Sequence[Network]
) -> Iterator[tuple[list[int], int, Array]]:
    """Outputs of many networks over every estimation record: (which networks, record, outputs (n, channels, lanes)).

    Lanes of one structure run together; what breaks down is left out.
    """
    groups: dict[tuple, list[int]] = {}
    for k, net in enumerate(networks):
        asm = assemble(bare(net))
        outside = tuple(type(e).__name__ for e in net.elements if e.place != "between")
        groups.setdefault((outside, asm.size, tuple(type(e).__name__ for e in asm.laws)), []).append(k)
    for members in groups.values():
        for begin in range(0, len(members), 48):
            chunk = members[begin : begin + 48]
            nets = [networks[k] for k in chunk]
            for i in problem.estimation:
                x0 = np.repeat(fit.initial[i][:, None], len(nets), axis=1)
                try:
                    yield chunk, i, problem.simulate(nets, i, x0, like=fit.network)
                except (InputError, np.linalg.LinAlgError):
                    continue


def unmodelled(problem: Problem, fit: Fit, share: float) -> dict[int, Array]:
    """What each force law of the library, too small to be named, would do: record -> (n, channels, laws).

    Every law at every place gives `share` of the data's typical force.
    """
    motion = motions(problem, fit)
    force = force_scale(problem, fit)
    networks = []
    for h in hypotheses(fit.network):
        if h.place != "between" or h.effect in SERIES or h.effect == "stribeck_friction":
            continue
        tried = probes(h, fit.network, motion.get((h.where[0], h.where[1])), force, 1.0, 1.0)
        for probe in tried[:: max(1, len(tried) // 2)][:2]:
            try:
                built = add(replace(fit.structure, network=fit.network), h, probe.ways[0]).network
                assemble(bare(built))
            except (InputError, np.linalg.LinAlgError):
                continue
            networks.append(built)
    out = {i: np.zeros((*y.shape, len(networks))) for i, y in fit.outputs.items()}
    point = {i: y for _, i, y in together(problem, fit, [fit.network])}
    for chunk, i, y in together(problem, fit, networks):
        change = (y - point[i]) * (share / PROBE)
        out[i][:, :, chunk] = np.where(np.isfinite(change), change, 0.0)
    return out


def screen(
    problem: Problem, fitter: Fitter, fit: Fit, candidates: Sequence[Hypothesis], lost: bool = False
) -> list[Screened]:
    """Score test of every candidate: what its response would take off the residual that the base cannot.

    `lost`: the simulation has lost its phase, so that small effects say nothing about large ones, and nobody is left out.
    """
    structure, net = fit.structure, fit.network
    motion = motions(problem, fit)
    force = force_scale(problem, fit)
    p = len(fit.x)
    columns = p
    parts = []
    for i in problem.estimation:
        y, dp, ds = fitter.lanes(structure, fit.x, i, fit.initial[i])
        const = problem.constants(i)
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
    fitted = replace(structure, network=net)
    for h in candidates:
        pair_motion = motion.get((h.where[0], h.where[1])) if len(h.where) == 2 else None
        current = spread = 1.0
        if h.place == "element":
            name = next(c.name for c in net.inputs if c.quantity == "current" and c.element == h.where[0])
            current = max(
                float(np.std(np.concatenate([problem.records[i].inputs[name] for i in problem.estimation]))),
                1e-9,
            )
        if h.place == "channel":
            column = problem.channels.index(h.where[0])
            spread = max(
                float(
                    np.std(
                        np.concatenate([problem.records[i].measured[:, column] for i in problem.estimation])
                    )
                ),
                1e-12,
            )
        for probe in probes(h, net, pair_motion, force, current, spread):
            try:
                built = [add(fitted, h, v) for v in probe.ways]
                for b in built:
                    assemble(bare(b.network))
            except (InputError, np.linalg.LinAlgError):
                continue
            jobs.append((h, probe, built))
    response = [np.zeros((rows + p, len(built))) for _, _, built in jobs]
    members = [(a, way) for a, (_, _, built) in enumerate(jobs) for way in range(len(built))]
    networks = [jobs[a][2][way].network for a, way in members]
    for chunk, i, out in together(problem, fit, networks):
        start, stop, y = spans[i]
        w = fitter.weights(out - y[:, :, None]).reshape(stop - start, -1)
        for lane, k in enumerate(chunk):
            a, way = members[k]
            response[a][start:stop, way] = w[:, lane]
    found: list[Screened] = []
    for (h, probe, _), s in zip(jobs, response, strict=True):
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
        wrong = not probe.signed and bool(np.any(amplitude <= 0))
        if wrong and h.effect not in SERIES and not lost:
            continue
        # what is put in series changes the order of the equations: a small one says little about a large one
        gain = 0.0 if wrong else float(r @ (s @ amplitude))
        values = dict(probe.values)
        if h.effect == "cogging_force":
            sine, cosine = amplitude * probe.values["amplitude"]
            values["amplitude"], values["phase"] = math.hypot(sine, cosine), math.atan2(cosine, sine)
        elif h.effect == "asymmetric_damping":
            values = {
                k: float(a) * probe.values[k]
                for k, a in zip(("extension", "compression"), amplitude, strict=True)
            }
        elif h.effect == "sensor_gain":
            values["gain"] = 1.0 + 0.05 * float(amplitude[0])
        else:
            factor = 1.0 if wrong else float(np.clip(amplitude[0], -50 if probe.signed else 0.1, 50))
            for key in probe.grows:
                values[key] = values[key] / factor if probe.inverse else values[key] * factor
        found.append(Screened(h, values, gain, probe.grows, probe.inverse))
    found.sort(key=lambda c: -c.gain)
    return found


@dataclass
class Rival:
    """A fitted set of effects and what it says about the held-out records."""

    hypotheses: tuple[Hypothesis, ...]
    fit: Fit
    likelihood: float = math.inf  # -2 log L on the estimation records, each under its own coloured noise
    held: Fit | None = None
    score: float = math.nan  # mean whitened square of the held-out records, all channels
    blocks: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (blocks in time, channels)
    about: dict[int, Array] = field(default_factory=dict)  # initial states of held-out records worth trying

    @property
    def cost(self) -> float:
        return self.fit.cost + self.fit.prior


def noise_levels(problem: Problem, fit: Fit) -> list[Noise]:
    """Every channel's noise, from the residual's spectrum above the motion."""
    out = []
    for j in range(len(problem.channels)):
        series = [problem.records[i].measured[:, j] - y[:, j] for i, y in fit.outputs.items()]
        record = problem.records[next(iter(fit.outputs))]
        out.append(noise_of(series, record.rate, white=record.taps is not None))
    return out


def measured_noise(problem: Problem, records: Sequence[int]) -> Array:
    """Noise of every channel as its spectrum tells, and at least one per cent of the signal: no model is better."""
    out = []
    for j in range(len(problem.channels)):
        series = [problem.records[i].measured[:, j] for i in records]
        first = problem.records[records[0]]
        noise = noise_of(series, first.rate, white=first.taps is not None).deviation
        out.append(max(noise, 0.01 * float(np.std(np.concatenate(series)))))
    return np.array(out)


def residuals(problem: Problem, fit: Fit) -> list[Array]:
    return [problem.records[i].measured - y for i, y in fit.outputs.items()]


def plain(problem: Problem, floors: Array) -> Whitener:
    return Whitener(tuple(np.array([1 / max(h, 1e-300)]) for h in floors))


def trust(problem: Problem, fit: Fit, floors: Array) -> Array:
    """White noise to reckon with when a residual is to be whitened (channels,): the measurement's, or what is unexplained.

    Only noise may be weighed by its spectrum. Missing physics counts as white noise of ten times its power, so that even
    what is crowded in a tenth of the band is not weighed down against what is small and elsewhere.
    """
    square = np.mean(np.concatenate(residuals(problem, fit)) ** 2, axis=0)
    return np.asarray(np.sqrt(np.maximum(floors**2, 10.0 * (square - floors**2))), dtype=np.float64)


def finer(least: Array, floors: Array) -> Array:
    """White noise to reckon with when fits are compared (channels,), a tenth of what their weights reckon with."""
    return np.asarray(np.maximum(floors, 0.1 * least), dtype=np.float64)


def gap(problem: Problem, fit: Fit) -> float:
    """Geometric mean over channels of the residual's power over the signal's: how wide the gap is, whatever its spectrum.

    One channel that drifts does not drown the others.
    """
    r = np.concatenate(residuals(problem, fit))
    y = np.concatenate([problem.records[i].measured for i in fit.outputs])
    share = np.mean(r**2, axis=0) / np.maximum(np.var(y, axis=0), 1e-300)
    return float(np.exp(np.mean(np.log(np.maximum(share, 1e-300)))))


def settled(
    problem: Problem,
    structure: Structure,
    x: Array,
    floors: Array,
    fit: Fit | None = None,
    *,
    rounds: int = 3,
    iterations: int = 6,
    least: Array | None = None,
) -> tuple[Fit, float]:
    """Fit with weights from the fit's own residual, until the likelihood under own coloured noise stops falling.

    `least`: white noise to reckon with; that of `trust` after the first round where it is not given.
    """
    initial = offset = None
    if fit is not None:
        initial, offset = fit.initial, fit.offset
        least = trust(problem, fit, floors) if least is None else least
    W = plain(problem, floors) if fit is None or least is None else whitener(residuals(problem, fit), least)
    best: tuple[Fit, float] | None = None
    for _ in range(rounds):
        f = Fitter(problem, W).fit(structure, x, initial, offset, iterations=iterations)
        least = trust(problem, f, floors) if least is None else least
        value = innovations(residuals(problem, f), finer(least, floors)) + f.prior
        if best is not None and value > best[1] - 2.0:
            if value < best[1]:
                best = f, value
            break
        if best is None or value < best[1]:
            best = f, value
        x, initial, offset = f.x, f.initial, f.offset
        W = whitener(residuals(problem, f), least)
    assert best is not None
    return best


def judge(problem: Problem, W: Whitener, rival: Rival) -> None:
    """Held-out records: parameters as found, initial states and offsets from the record's own samples."""
    f = Fitter(problem, W).follow(
        rival.fit.structure,
        rival.fit.x,
        problem.validation,
        rival.held.initial if rival.held else None,
        rival.about,
    )
    rival.held = f
    blocks = []
    for i, y in f.outputs.items():
        e = W(problem.records[i].measured - y) ** 2
        edges = np.linspace(0, len(e), BLOCKS + 1).astype(int)
        blocks += [e[a:b].mean(axis=0) for a, b in pairwise(edges)]
    rival.blocks = np.array(blocks)
    rival.score = float(rival.blocks.mean())


BLOCKS = 20


def shortlist(found: Sequence[Screened], limit: int, moved: Sequence[str]) -> list[list[Screened]]:
    """The best hypotheses, each with its probes, best first."""
    groups: dict[Hypothesis, list[Screened]] = {}
    for s in found:
        always = s.hypothesis.effect in SERIES and bool(set(s.hypothesis.where) & set(moved))
        if s.hypothesis in groups or len(groups) < limit or always:
            groups.setdefault(s.hypothesis, []).append(s)
    return list(groups.values())


def advanced(fit: Fit) -> Structure:
    """The structure with the effects found so far at their fitted values, the base at its prior."""
    found = {f.path: f.back(float(v)) for f, v in zip(fit.structure.free, fit.x, strict=True) if f.owner >= 0}
    return (
        replace(fit.structure, network=fit.structure.network.with_parameters(found))
        if found
        else fit.structure
    )


#: multiples of the amplitude that the score test gives, and of a compliance, which it says little about
AMPLITUDES, LARGE = (0.5, 1.0, 2.0, 5.0, 12.0, 30.0), (80.0,)


def starts(
    problem: Problem, current: Fit, group: list[Screened], floors: Array, lost: bool = False
) -> list[tuple[Structure, Array]]:
    """Where joint fits begin: the screened probes at several amplitudes, base at its prior, simulated and compared.

    The score test looks at small effects; a large one is found by trying. Residuals are compared by the logarithm of
    their variance, channel by channel, so that one that drifts does not drown the others.
    """
    h = group[0].hypothesis
    if h.effect == "cogging_force":  # a step too far leads to another period: from the base as fitted
        known = dict(zip((f.path for f in current.structure.free), current.x, strict=True))
        near = [s.structure_at(current) for s in group[:3]]
        return [
            (t, np.array([known.get(f.path, v) for f, v in zip(t.free, t.start, strict=True)])) for t in near
        ]
    trials: list[Structure] = []
    for s in group[:6]:
        for factor in (1.0,) if not s.grows else AMPLITUDES + LARGE * (s.inverse or lost):
            values = dict(s.start)
            for key in s.grows:
                values[key] *= factor if not s.inverse else 1 / factor
            try:
                trials.append(add(advanced(current), h, values))
            except InputError:
                continue
    if not trials:
        return []
    scores = np.zeros(len(trials))
    nets = [t.network for t in trials]
    for i in problem.estimation:
        x0 = np.stack([carried(problem, current, t)[i] for t in trials], axis=1)
        try:
            y = problem.simulate(nets, i, x0, like=nets[0])
        except (InputError, np.linalg.LinAlgError):
            return [(t, t.start) for t in trials[:1]]
        r = problem.records[i].measured[:, :, None] - y
        with np.errstate(over="ignore", invalid="ignore"):
            v = np.var(r, axis=0) + floors[:, None] ** 2
        scores += np.where(
            np.isfinite(v).all(axis=0), np.sum(np.log(np.where(np.isfinite(v), v, 1.0)), axis=0), math.inf
        )
    order = np.argsort(scores)
    picked = [trials[0]] if 0 in order[:1] else [trials[order[0]], trials[0]]
    if group[0].hypothesis.effect in ("bump_stop", "hysteresis", "gas_spring", "backlash") and len(order) > 2:
        other = next((trials[k] for k in order[1:] if trials[k] not in picked), None)
        picked += [other] if other is not None else []
    return [(t, t.start) for t in picked]


#: gap from which on a simulation that no input ties to the record has lost its phase
LOST = 0.5
SHORTEST = 64  # samples of a beginning


def compete(problem: Problem, current: Fit, floors: Array) -> tuple[list[Rival], Array]:
    """One stage of forward addition: screen, fit jointly, fit the best ones to self-consistency.

    Returns the rivals, best first, and the white noise (channels,) under which their likelihoods were taken. A free decay
    whose frequency the model misses is compared on its beginning, which then grows: later on the phase is anything.
    """
    if problem.network.inputs or gap(problem, current) < LOST:
        return race(problem, current, floors)

    def beginning(share: float) -> Problem:
        records = [_beginning(r, int(share * len(r)), SHORTEST) for r in problem.records]
        return Problem(problem.network, records, problem.held, problem.step)

    share, part, fit = 1.0, problem, current
    while gap(part, fit) >= LOST and share * max(map(len, problem.records)) > SHORTEST:
        share /= 2
        part = beginning(share)
        # from the state as measured: the one that fits a wrong frequency best is nobody's
        fit = Fitter(part, plain(part, floors)).fit(current.structure, current.x, iterations=0)
    rivals, _ = race(part, fit, floors, limit=100, finals=8, lost=True)
    while share < 1.0:
        share = min(1.4 * share, 1.0)
        part = beginning(share) if share < 1.0 else problem
        for r in list(rivals):
            try:
                longer = Fitter(part, plain(part, floors))
                r.fit = longer.fit(r.fit.structure, r.fit.x, r.fit.initial, r.fit.offset)
            except (InputError, np.linalg.LinAlgError):
                rivals.remove(r)
    least = np.min([trust(problem, r.fit, floors) for r in rivals], axis=0) if rivals else floors
    for r in list(rivals):
        try:
            r.fit, r.likelihood = settled(problem, r.fit.structure, r.fit.x, floors, r.fit, least=least)
        except (InputError, np.linalg.LinAlgError):
            rivals.remove(r)
    return simplest_first(sorted(rivals, key=lambda r: r.likelihood)), least


def race(
    problem: Problem, current: Fit, floors: Array, *, limit: int = 8, finals: int = 4, lost: bool = False
) -> tuple[list[Rival], Array]:
    """`compete` over the whole of the records; `limit` places in the heats, `finals` in the final."""
    hot = trust(problem, current, floors)
    W = whitener(residuals(problem, current), hot)
    found = screen(problem, Fitter(problem, W), current, list(hypotheses(current.structure.network)), lost)
    chosen = shortlist(found, limit, problem.network.moved_nodes)
    # heats are run over that part of every record where the gap is widest, the final over all of it
    left = dict(zip(problem.estimation, residuals(problem, current), strict=True))
    windows = {i: _heat(problem.records[i], W(left[i])) for i in problem.estimation}
    short = Problem(
        problem.network,
        [windows[i].of(r) if i in windows else r for i, r in enumerate(problem.records)],
        problem.held,
        problem.step,
    )
    heat = Fitter(short, W)
    begin = {
        i: current.initial[i]
        if w.first == 0
        else heat.guess(
            current.network,
            i,
            Fitter(problem, W).along(current.structure, current.x, i, current.initial[i], [w.first])[0],
        )
        for i, w in windows.items()
    }
    shortened = replace(current, initial=begin)

    def one(group: list[Screened]) -> Rival | None:
        tries: list[tuple[float, Fit]] = []
        for structure, x in starts(problem, current, group, floors, lost):
            known = carried(short, shortened, structure)
            try:
                # which of its rests holds is to be seen first
                if structure.hypotheses[-1].effect == "cogging_force":
                    seen = {i: heat.guess(structure.at(x), i) for i in short.estimation}
                    known = min(
                        (known, seen),
                        key=lambda s: heat.cost(structure, x, s, current.offset, short.estimation),
                    )
                f = heat.fit(structure, x, known, current.offset, iterations=3)
            except (InputError, np.linalg.LinAlgError):
                continue
            tries.append((innovations(residuals(short, f), finer(hot, floors)) + f.prior, f))
        if not tries:
            return None
        value, f = min(tries, key=lambda t: t[0])
        try:
            f = heat.fit(f.structure, f.x, f.initial, f.offset, iterations=4)
        except (InputError, np.linalg.LinAlgError):
            return None
        return Rival(
            f.structure.hypotheses, f, innovations(residuals(short, f), finer(hot, floors)) + f.prior
        )

    def lengthen(r: Rival) -> Rival:
        """From the heat to the whole of the records, with the heat's coarse weights."""
        try:
            W = whitener(residuals(short, r.fit), trust(short, r.fit, floors))
            known = carried(problem, current, r.fit.structure)
            known |= {i: r.fit.initial[i] for i, w in windows.items() if w.first == 0}
            r.fit = Fitter(problem, W).fit(r.fit.structure, r.fit.x, known, r.fit.offset, iterations=5)
            r.likelihood = innovations(residuals(problem, r.fit), finer(hot, floors)) + r.fit.prior
        except (InputError, np.linalg.LinAlgError):
            r.likelihood = math.inf
        return r

    def polish(r: Rival) -> Rival:
        try:
            r.fit, r.likelihood = settled(
                problem, r.fit.structure, r.fit.x, floors, r.fit, rounds=3, iterations=4, least=cold
            )
            if r.hypotheses[-1].effect == "cogging_force":
                for _ in range(3):
                    W = whitener(residuals(problem, r.fit), cold)
                    f = comb(problem, Fitter(problem, W), r.fit, r.fit.structure.names[-1])
                    f, value = settled(
                        problem, f.structure, f.x, floors, f, rounds=2, iterations=4, least=cold
                    )
                    if value > r.likelihood - 5:
                        break
                    r.fit, r.likelihood = f, value
        except (InputError, np.linalg.LinAlgError):
            r.likelihood = math.inf
        return r

    def elsewhere(r: Rival, factor: float) -> tuple[Fit, float] | None:
        """The fit begun again with another shape: from one start a fit may end in a place of its own."""
        x = r.fit.x.copy()
        path = f"{r.fit.structure.names[-1]}.{SHAPE[r.hypotheses[-1].effect]}"
        x[[f.path for f in r.fit.structure.free].index(path)] += math.log(factor)
        try:
            begun = Fitter(problem, plain(problem, cold)).fit(
                r.fit.structure, x, r.fit.initial, r.fit.offset, iterations=5
            )
            return settled(problem, r.fit.structure, begun.x, floors, begun, iterations=4, least=cold)
        except (InputError, np.linalg.LinAlgError):
            return None

    rivals: dict[tuple[Hypothesis, ...], Rival] = {}
    with ThreadPoolExecutor(2) as pool:
        for r in pool.map(one, chosen):
            if r is not None and math.isfinite(r.likelihood):
                rivals[r.hypotheses] = r
        ranked = sorted(rivals.values(), key=lambda r: r.likelihood)[:finals]
        # a likelihood under coloured noise may miss who closes most of the gap
        closest = min(rivals.values(), key=lambda r: gap(short, r.fit), default=None)
        ranked += [closest] if closest is not None and closest not in ranked else []
        ranked = [r for r in pool.map(lengthen, ranked) if math.isfinite(r.likelihood)]
        if not ranked:
            return [], hot
        # what the best of them leaves is what is trusted now
        leaves = [trust(problem, r.fit, floors) for r in ranked]
        cold = np.min(leaves, axis=0)
        ranked = [r for r in pool.map(polish, ranked) if math.isfinite(r.likelihood)]
        ranked.sort(key=lambda r: r.likelihood)
        trials = [
            (r, factor) for r in ranked[:2] if r.hypotheses[-1].effect in SHAPE for factor in (0.5, 2.0)
        ]
        for (r, _), again in zip(trials, pool.map(lambda t: elsewhere(*t), trials), strict=True):
            if again is not None and again[1] < r.likelihood:
                r.fit, r.likelihood = again
    ranked.sort(key=lambda r: r.likelihood)
    widths = [gap(problem, r.fit) for r in ranked]
    closest = ranked[int(np.argmin(widths))] if ranked else None
    half = 0.5 * gap(problem, current)
    if closest is not None and min(widths) < half < widths[0]:
        ranked = [closest, *(r for r in ranked if r is not closest)]
    return simplest_first(ranked), cold


def simplest_first(ranked: list[Rival]) -> list[Rival]:
    """Of relatives that fit as well, the one with fewer parameters leads (half of 2 log L per parameter is chance)."""
    if not ranked:
        return ranked
    best = ranked[0]
    for r in ranked[1:]:
        h, b = r.hypotheses[-1], best.hypotheses[-1]
        if not itself(best.fit, -1) and itself(r.fit, -1) and r.likelihood - best.likelihood < 60.0:
            return [r, *(q for q in ranked if q is not r)]
        relative = h.effect in CONTAINS.get(b.effect, ()) and set(h.where) == set(b.where)
        if relative and r.likelihood - best.likelihood < 30.0:
            return [r, *(q for q in ranked if q is not r)]
    return ranked


def itself(fit: Fit, which: int | None = None) -> bool:
    """Whether the effects (or that one) are what their names say: a Stribeck curve falls with speed.

    One that rises mimics damping. It may be a step on the way, but is never named.
    """
    names = fit.structure.names if which is None else fit.structure.names[which:]
    found = (fit.network.element(name) for name in names)
    return all(not isinstance(e, el.StribeckFriction) or e.level <= e.static_level for e in found)


#: the parameter that shapes a law (on a logarithmic scale): where fits have several optima
SHAPE = {
    "stribeck_friction": "stribeck_velocity",
    "bump_stop": "clearance",
    "hysteresis": "stiffness",
    "gas_spring": "length",
    "backlash": "gap",
    "thrust_saturation": "current",
}

#: effects that contain another as a special case
CONTAINS = {
    "stribeck_friction": ("coulomb_friction",),
    "hysteresis": ("coulomb_friction", "linear_stiffness"),
    "asymmetric_damping": ("linear_damping",),
    "backlash": ("series_compliance",),
    "gas_spring": ("linear_stiffness",),  # long
    "bump_stop": ("linear_stiffness",),  # without clearance
    "cogging_force": ("linear_stiffness",),  # of a pitch longer than the travel
}


def simpler(problem: Problem, rival: Rival) -> list[tuple[Hypothesis, Structure]]:
    """What a set of effects becomes with one of them left out, or replaced by a special case of it.

    Each with the hypothesis that went, starting from the values found.
    """
    structure = rival.fit.structure
    network = rival.fit.network
    found = [
        (
            h,
            {
                f.name: getattr(network.element(name), f.name)
                for f in el.parameter_fields(type(network.element(name)))
            },
        )
        for h, name in zip(structure.hypotheses, structure.names, strict=True)
    ]
    motion = motions(problem, rival.fit)
    out = []
    for k, (h, values) in enumerate(found):
        swaps: list[list[tuple[Hypothesis, dict[str, float]]]] = [[]] if len(found) > 1 else []
        m = motion.get((h.where[0], h.where[-1]))
        beside = {e.type for e in standing(network, h.where)}
        for effect in CONTAINS.get(h.effect, ()):
            if effect in beside:  # that would be another value of a parameter which is known
                continue
            rate = float(np.sqrt(np.mean(m.v**2))) if m is not None else 0.0
            swaps.append([(Hypothesis(effect, h.where), _special(h.effect, effect, values, rate))])
        for swap in swaps:
            try:
                out.append((h, rebuilt(problem.network, [*found[:k], *swap, *found[k + 1 :]])))
            except (InputError, KeyError, StopIteration):
                continue
    return out


def _special(effect: str, simple: str, values: dict[str, float], rate: float) -> dict[str, float]:
    """Start values of a special case; `rate` [m/s]: RMS of the rate of elongation."""
    if effect == "stribeck_friction":
        share = math.exp(-((rate / values["stribeck_velocity"]) ** 2))
        return {"level": values["level"] + (values["static_level"] - values["level"]) * share}
    if simple == "linear_damping":
        return {"damping": 0.5 * (values["extension"] + values["compression"])}
    if effect == "gas_spring":
        return {"stiffness": values["force"] * values["exponent"] / values["length"]}
    if effect == "cogging_force":
        slope = 2 * math.pi * values["amplitude"] / values["pitch"] * math.cos(values["phase"])
        return {"stiffness": max(slope, 1.0)}
    return {
        key: values[key]
        for key in ("level", "stiffness")
        if key in {f.name for f in el.parameter_fields(el.TYPES[simple])}
    }


def rebuilt(network: Network, effects: Sequence[tuple[Hypothesis, dict[str, float]]]) -> Structure:
    """The owner's model with `effects` added one after the other; nodes that are not there any more are their twins."""
    structure = base_structure(network)
    for h, values in effects:
        known = {
            *structure.network.nodes,
            *(e.name for e in structure.network.elements),
            *(c.name for c in network.outputs),
        }
        where = tuple(twin(node, known) for node in h.where)
        structure = add(structure, replace(h, where=where), values)
    return structure


def carried(problem: Problem, fit: Fit, structure: Structure) -> dict[int, Array]:
    """Initial states of a fit in the coordinates of another structure: nodes move as they did.

    A node that came in between moves like the terminal it was split from.
    """
    source, target = assemble(bare(fit.network)), assemble(bare(structure.network))
    before, net = source.network, target.network
    free = [n for n in net.nodes if n not in net.moved_nodes]
    own = [n for n in before.nodes if n not in before.moved_nodes]
    if not target.size[0]:
        return {i: np.zeros(0) for i in fit.initial}
    rows = motion_rows_of(target)
    inputs = {str(c.at): c.name for c in net.inputs if c.quantity == "displacement"}
    known = motion_rows_of(source)
    out: dict[int, Array] = {}
    for i, x0 in fit.initial.items():
        record = problem.records[i]
        motion = known @ x0
        want = np.zeros((2, len(free)))
        for k, node in enumerate(free):
            like = twin(node, before.nodes)
            if like in own:
                want[:, k] = motion[own.index(like)], motion[len(own) + own.index(like)]
            elif like in inputs:
                r = record.inputs[inputs[like]]
                want[:, k] = r[0], 0.05 * (r[1] - r[0]) / record.step
        out[i] = np.asarray(np.linalg.lstsq(rows, want.ravel(), rcond=None)[0], dtype=np.float64)
    return out


@dataclass(frozen=True)
class Window:
    """Samples first..first+size-1 of a record."""

    first: int
    size: int

    def of(self, record: Record) -> Record:
        return record.part(self.first, self.first + self.size, record.name)


def _heat(record: Record, residual: Array) -> Window:
    """The stretch of a record, two fifths of it, in which the whitened residual (n, channels) is largest.

    In a sweep an effect may be silent for most of the time.
    """
    size = min(max(int(0.4 * len(record)), 2000), len(record))
    energy = np.concatenate([[0.0], np.cumsum(np.sum(residual**2, axis=1))])
    gain = energy[size:] - energy[:-size]
    # a start from rest is known, one in mid-motion must be fitted: the beginning wins where it is nearly as good
    return Window(0 if gain[0] > 0.7 * gain.max() else int(np.argmax(gain)), size)


def _beginning(record: Record, count: int, least: int) -> Record:
    """The first `count` samples of a record, and at least `least` where it has them."""
    return record.part(0, max(count, min(len(record), least)), record.name)


def comb(problem: Problem, fitter: Fitter, fit: Fit, name: str) -> Fit:
    """A periodic law has one optimum per period: scan pitch and phase around the fit, and fit again from the best.

    The span of travel holds n periods; a pitch that is off by one part in 2n fits the middle but not the ends.
    """
    motion = motions(problem, fit)
    element = fit.network.element(name)
    d = motion[element.between].d
    span = float(np.ptp(d))
    paths = {f.path: k for k, f in enumerate(fit.structure.free)}
    kp, kf = paths[f"{name}.pitch"], paths[f"{name}.phase"]
    centre = float(np.exp(fit.x[kp]))
    middle = float(np.median(d))
    step = 0.12 * centre / span  # relative: an eighth of a period over the span
    trials = []
    for k in range(-20, 21):
        pitch = centre * (1 + k * step)
        if pitch <= 0:
            continue
        for phase in np.arange(6) * (math.pi / 3):
            x = fit.x.copy()
            x[kp] = math.log(pitch)
            # keep the phase in the middle of the travel, and turn it through a whole period
            x[kf] = fit.x[kf] + 2 * math.pi * middle * (1 / centre - 1 / pitch) + phase
            trials.append(x)
    costs = np.zeros(len(trials))
    net = fit.network
    # enough to tell pitches apart: the travel's span does it, not the time
    window = [_beginning(r, len(r) // 3, 2000) for r in problem.records]
    short = Problem(problem.network, window, problem.held, problem.step)
    for first in range(0, len(trials), 41):
        chunk = trials[first : first + 41]
        nets = [fit.structure.at(x) for x in chunk]
        for i in problem.estimation:
            x0 = np.repeat(fit.initial[i][:, None], len(nets), axis=1)
            y = short.simulate(nets, i, x0, like=net)
            r = window[i].measured[:, :, None] - y - fit.offset[i][None, :, None]
            r = r - np.where(problem.free_offset[:, None], r.mean(axis=0), 0.0)
            costs[first : first + len(nets)] += np.sum(fitter.weights(r) ** 2, axis=(0, 1))
    best = fit
    seen: list[tuple[float, float]] = []
    for k in np.argsort(costs):
        if len(seen) >= 4:
            break
        x = trials[k]
        if any(
            abs(x[kp] - a) < 2.5 * step and abs((x[kf] - b + math.pi) % (2 * math.pi) - math.pi) < 1.2
            for a, b in seen
        ):
            continue
        seen.append((x[kp], x[kf]))
        f = fitter.fit(fit.structure, x, fit.initial, fit.offset, iterations=6)
        if f.cost + f.prior < best.cost + best.prior:
            best = f
    return best


def share_of_force(problem: Problem, fit: Fit, name: str) -> float:
    """RMS of what an effect does over RMS of what is there: force between its terminals, current, or signal."""
    net = fit.network
    e = net.element(name)
    i = problem.estimation[0]
    record = problem.records[i]
    rms = lambda x: float(np.sqrt(np.mean(np.square(x))))  # noqa: E731
    if e.place == "channel":
        j = problem.channels.index(e.where[0])
        without = problem.simulate([net.without_element(name)], i, fit.initial[i][:, None], like=net)[:, j, 0]
        change = fit.outputs[i][:, j] - fit.offset[i][j] - without
        return rms(change) / max(float(np.std(record.measured[:, j])), 1e-300)
    if e.place == "element":
        command = next(c.name for c in net.inputs if c.quantity == "current" and c.element == e.where[0])
        current = record.inputs[command]
        others = effective_current(net.without_element(name), e.where[0], current[:, None], record.step)[:, 0]
        return rms(effective_current(net, e.where[0], current[:, None], record.step)[:, 0] - others) / max(
            rms(others), 1e-300
        )
    if isinstance(e, el.SeriesCompliance | el.Backlash):
        return 1.0  # force and deflection are shared in series: what it changes in the outputs decides
    pair = set(e.where)
    here = [x for x in net.elements if x.place == "between" and set(x.where) == pair]
    extra = tuple(Channel(f"_{x.name}", "force", "N", element=x.name) for x in here)
    probe = Problem(_with_outputs(net, extra), [replace(record, taps=None, thin=1)], [False], problem.step)
    try:
        y = probe.simulate([probe.network], 0, fit.initial[i][:, None], like=net)[:, :, 0]
    except InputError:
        return 1.0
    sign = np.array([1.0 if x.where == e.where else -1.0 for x in here])
    own = y[:, [x.name for x in here].index(name)]
    if isinstance(e, el.AsymmetricDamping) and any(isinstance(x, el.LinearDamping) for x in here):
        # what both directions have in common is that damper's
        own = own * abs(e.extension - e.compression) / (2 * rms([e.extension, e.compression]))
    return rms(own) / max(rms(y @ sign), 1e-300)
