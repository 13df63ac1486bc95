"""The workflow from records and a model to a verdict (DESIGN section 9)."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import elements as el
from ..data import Table, check, read_table
from ..errors import InputError
from ..network import Network
from ..simulate import SI
from ..units import convert
from .choose import CONTAINS, Rival, share_of_force, compete, judge, measured_noise, noise_levels, plain, residuals, settled
from .fit import Fit, Fitter
from .hypotheses import Hypothesis, Structure, add, base_structure
from .problem import Array, Noise, Problem, Record, Whitener, innovations, passed, whitener
from .result import Contender, Diagnosis, Effect, Gate, Place, Quantity, Trace

#: a gap below this share of a channel's standard deviation is not worth a name: few per cent are everybody's nuisance
MATERIAL = 0.03
#: share of the held-out excess error that what is named must remove
HALF = 0.5
#: share of it that must be removed before the rest may be called nuisances
ADEQUATE = 0.75
#: a rival is beaten when its excess is larger by this factor
AHEAD = 1.1
STRETCH = 5.0  # [s] held-out records are judged in stretches, each from an initial state of its own
DEPTH = 3  # effects at once

#: a nuisance is a few per cent of the force (current, signal) at its place; what is named must be more
SHARE = 0.05


def diagnose(
    data: Sequence[Table | str | Path],
    model: Network | str | Path | Mapping[str, Any],
    *,
    validate: Sequence[Table | str | Path] = (),
    progress: Callable[[str], None] | None = None,
    seed: int = 0,
) -> Diagnosis:
    """Find where simulation and measurement disagree, and name the physical effect that is missing.

    data: records to fit by (tables or files). model: the owner's model. validate: records to choose and judge by; without
    them whole records of `data` are held out, or the last third of a single one. progress: called with a line now and
    then. seed: of the bootstrap. Raises `InputError` with one line for data that cannot be used.
    """
    begun = clock.perf_counter()
    say = progress or (lambda line: None)
    network = Network.load(model)
    if not network.outputs:
        raise InputError(f"model '{network.name}' has no outputs to compare with")
    notes: list[str] = []
    estimation = [read(d, network, notes) for d in _several(data, "data")]
    held = [read(d, network, notes) for d in _several(validate, "validate")] if len(validate) else []
    estimation, held = split_records(estimation, held, notes)
    records = [*estimation, *held]
    whole = Problem(network, records, [False] * len(estimation) + [True] * len(held))
    cut = [piece for r in held for piece in stretches(r)]
    problem = Problem(network, [*estimation, *cut], [False] * len(estimation) + [True] * len(cut))
    return Workflow(problem, whole, say, seed, notes, begun).run()


def _several(data: Any, name: str) -> list[Any]:
    out = [data] if isinstance(data, Table | str | Path) else list(data)
    if not out:
        raise InputError(f"{name}: no records")
    return out


# ------------------------------------------------------------------------------------------------ records


def read(source: Table | str | Path, network: Network, notes: list[str]) -> Record:
    """A checked record, inputs in SI, outputs in the channels' units. Raises `InputError` where it cannot be used."""
    expected = {c.name: c.unit for c in (*network.inputs, *network.outputs)}
    table = source if isinstance(source, Table) else read_table(source, expected=expected)
    for name in expected:
        table[name]  # raises with the nearest name
    findings = check(
        table,
        inputs={c.name: c.quantity for c in network.inputs},
        outputs={c.name: c.quantity for c in network.outputs},
    )
    for f in findings:
        if f.level == "error":
            raise InputError(f"{table.source}: {f.channel + ': ' if f.channel else ''}{f.message}")
        notes.append(f"{Path(table.source).name}: {f}")
    table = table.uniform()

    def values(name: str, unit: str) -> Array:
        return convert(np.asarray(table[name]), table.units.get(name) or expected[name], unit)

    inputs = {c.name: values(c.name, SI[c.quantity]) for c in network.inputs}
    measured = np.stack([values(c.name, c.unit) for c in network.outputs], axis=1)
    name = Path(table.source).stem
    return derivatives(Record(name, table.step, inputs, measured, {}, float(table.time[0])), network)


def derivatives(record: Record, network: Network) -> Record:
    """Velocity and acceleration of moved nodes from noisy displacement, where forces need them."""
    from .problem import low_pass

    needs = [c for c in network.inputs if c.quantity == "displacement" and _drives_inertia(network, str(c.at))]
    if not needs:
        return record
    cutoff = min(_bandwidth(record.inputs[c.name], record.step) for c in needs)
    nyquist = 0.5 / record.step
    if cutoff > 0.7 * nyquist:
        return record
    from scipy.signal import firwin

    size = 2 * math.ceil(2.0 / (cutoff * record.step)) + 1
    size = min(size, 2 * (record.samples // 8) + 1)
    taps = firwin(size, cutoff, fs=1 / record.step, window=("kaiser", 6.0))
    thin = max(1, int(nyquist / (1.6 * cutoff)))
    inputs, slopes = dict(record.inputs), {}
    for c in needs:
        x = low_pass(record.inputs[c.name], taps)
        v = np.gradient(x, record.step, edge_order=2)
        inputs[c.name] = x
        slopes[c.name] = (v, np.gradient(v, record.step, edge_order=2))
    return replace(record, inputs=inputs, slopes=slopes, measured=low_pass(record.measured, taps, thin), taps=taps, thin=thin)


def _drives_inertia(network: Network, node: str) -> bool:
    """Whether a force hangs on the velocity or acceleration of a moved node."""
    outputs = any(c.quantity == "force" and c.at == node for c in network.outputs)
    return outputs or any(
        e.place == "between" and node in e.where and (e.linear()[1] or e.linear()[2]) for e in network.elements
    )


def _bandwidth(x: Array, step: float) -> float:
    """Frequency [Hz] up to which the displacement's second derivative is signal, not noise."""
    from scipy.signal import welch

    n = min(2048, len(x) // 4)
    f, s = welch(x - x.mean(), 1 / step, nperseg=n, window=("kaiser", 14.0))
    top = f > 0.6 * f[-1]
    floor = float(np.median(s[top])) * 3.0
    if floor <= 1e-14 * s.max():
        return float(f[-1])
    above = np.flatnonzero(s > floor)
    low = f[above[-1]] if len(above) else f[1]
    # the last frequency of an unbroken run of signal
    broken = np.flatnonzero(s[1:] < floor)
    low = f[broken[0] + 1] if len(broken) else low
    return float(max(low, 10 * f[1]))


def split_records(estimation: list[Record], held: list[Record], notes: list[str]) -> tuple[list[Record], list[Record]]:
    if held:
        return estimation, held
    if len(estimation) > 1:
        count = max(1, len(estimation) // 3)
        notes.append(f"held out: {', '.join(r.name for r in estimation[-count:])}")
        return estimation[:-count], estimation[-count:]
    record = estimation[0]
    at = (2 * len(record)) // 3
    notes.append("held out: the last third of the only record")
    return [record.part(0, at, record.name)], [record.part(at, len(record), f"{record.name} (last third)")]


def stretches(record: Record) -> list[Record]:
    count = max(1, int(len(record) * record.rate / STRETCH))
    count = min(count, max(1, len(record) // 400))
    edges = np.linspace(0, len(record), count + 1).astype(int)
    return [record.part(a, b, record.name) for a, b in zip(edges[:-1], edges[1:], strict=True)]


# ----------------------------------------------------------------------------------------------- the workflow


@dataclass
class Standing:
    """A rival on held-out data: whitened score by block, plain NRMSE by channel."""

    rival: Rival
    score: float
    blocks: Array
    nrmse: Array


class Workflow:
    def __init__(self, problem: Problem, whole: Problem, say: Callable[[str], None], seed: int, notes: list[str], begun: float):
        self.problem, self.whole, self.say, self.notes, self.begun = problem, whole, say, notes, begun
        self.rng = np.random.default_rng(seed)
        self.network = problem.network
        self.floors = measured_noise(problem, problem.estimation)
        held = np.concatenate([problem.records[i].measured for i in problem.validation])
        self.spread = np.maximum(held.std(axis=0), 1e-300)

    # -- judging ------------------------------------------------------------------------------------------
    def plain_error(self, fit: Fit, structure: Structure, x: Array, frozen_state: dict[int, Array] | None = None) -> tuple[Array, Fit]:
        """NRMSE of every channel on the held-out stretches, initial states by plain least squares."""
        W = plain(self.problem, self.floors)
        f = Fitter(self.problem, W).fit(structure, x, frozen_state, records=self.problem.validation, frozen=True, iterations=4)
        r = np.concatenate(residuals(self.problem, f))
        return np.sqrt(np.mean(r**2, axis=0)) / self.spread, f

    def stand(self, rival: Rival, W: Whitener) -> Standing:
        judge(self.problem, W, rival)
        assert rival.held is not None
        nrmse, f = self.plain_error(rival.fit, rival.fit.structure, rival.fit.x, rival.held.initial)
        return Standing(rival, rival.score, rival.blocks, nrmse)

    def run(self) -> Diagnosis:
        p, say = self.problem, self.say
        say(f"{len(p.estimation)} record(s) to fit, {len(self.whole.validation)} held out; refitting the model within its stated uncertainty")
        structure = base_structure(self.network)
        fit, value = settled(p, structure, structure.start, self.floors)
        base = Rival((), fit, value)
        stages: list[list[Rival]] = []
        path = [base]
        while len(path) <= DEPTH:
            now = path[-1]
            W = whitener(residuals(p, now.fit), self.floors)
            here = self.stand(now, W)
            noise = noise_levels(p, now.held)  # type: ignore[arg-type]
            left = np.sqrt(np.maximum(here.nrmse**2 - (np.array([n.deviation for n in noise]) / self.spread) ** 2, 0.0))
            if left.max() < MATERIAL:
                break
            say(f"looking for what is missing ({'; '.join(h.label for h in now.hypotheses) or 'refitted model'}: excess up to {100 * left.max():.1f} %)")
            rivals = compete(p, now.fit, self.floors)
            if not rivals:
                break
            stages.append(rivals)
            best = rivals[0]
            gain = now.likelihood - best.likelihood
            say(f"  best: {best.hypotheses[-1].label} (2 log L +{gain:.0f})")
            if gain < 60.0:
                break
            path.append(best)
            then = self.stand(best, W)
            moved = float(np.sqrt(np.maximum(here.nrmse**2 - then.nrmse**2, 0.0)).max())
            if moved < MATERIAL or share_of_force(p, best.fit, best.fit.structure.names[-1]) < SHARE:
                break
        return self.conclude(base, path, stages)

    # -- conclusion ---------------------------------------------------------------------------------------
    def conclude(self, base: Rival, path: list[Rival], stages: list[list[Rival]]) -> Diagnosis:
        p = self.problem
        final = path[-1]
        W = whitener(residuals(p, final.fit), self.floors)
        stood: dict[int, Standing] = {}

        def stand(r: Rival) -> Standing:
            if id(r) not in stood:
                stood[id(r)] = self.stand(r, W)
            return stood[id(r)]

        stand(final)
        noise = noise_levels(p, final.held)  # type: ignore[arg-type]
        floor = np.array([n.deviation for n in noise]) / self.spread
        floor = np.minimum(floor, stand(final).nrmse)
        quiet = min(float(passed(W, noise).mean()), 0.999 * stand(final).score)
        # the owner's model as it is
        owner = base_structure(self.network)
        before, _ = self.plain_error(base.fit, owner, owner.start)

        # walk back: an effect that does not earn its place goes
        depth = len(path) - 1
        table: list[str] = []
        while depth > 0:
            now, last = stand(path[depth]), stand(path[depth - 1])
            share = (last.score - now.score) / max(last.score - quiet, 1e-12)
            shares = self.plain_share(last.nrmse, now.nrmse, floor)
            moved = float(np.sqrt(np.maximum(last.nrmse**2 - now.nrmse**2, 0.0)).max())
            table.append(f"{path[depth].hypotheses[-1].label}: share {share:.2f} / {shares:.2f}, moved {moved:.3f}")
            size = share_of_force(p, path[depth].fit, path[depth].fit.structure.names[-1])
            table[-1] += f", size {size:.3f}"
            if max(share, shares) >= HALF and moved >= MATERIAL and share > 0 and size >= SHARE:
                break
            depth -= 1
        chosen = path[depth]
        self.notes += [f"tried {t}" for t in table]
        rivals = [r for r in stages[depth - 1][:6] if r is not chosen] if depth else []
        for r in [base, chosen, *rivals]:
            stand(r)
        refit, after = stand(base), stand(chosen)
        explained = max((refit.score - after.score) / max(refit.score - quiet, 1e-12), self.plain_share(refit.nrmse, after.nrmse, floor))
        gap_before = float(np.sqrt(np.maximum(before**2 - floor**2, 0)).max())
        gap_refit = float(np.sqrt(np.maximum(refit.nrmse**2 - floor**2, 0)).max())
        gap_after = float(np.sqrt(np.maximum(after.nrmse**2 - floor**2, 0)).max())
        # simpler relatives first, then who is still abreast
        abreast: list[Rival] = []
        if depth:
            for r in sorted(rivals, key=lambda r: len(r.fit.x)):
                if len(r.fit.x) < len(chosen.fit.x) and r.hypotheses[-1].effect in CONTAINS.get(chosen.hypotheses[-1].effect, ()) and not self.beaten(stand(r), stand(chosen), quiet):
                    chosen = r
                    break
            for r in stages[depth - 1][:6]:
                if r is chosen or self.beaten(stand(r), stand(chosen), quiet) or self.same(r, chosen, W):
                    continue
                abreast.append(r)
        if gap_refit < MATERIAL:
            verdict = "no_discrepancy" if gap_before < MATERIAL else "parameters_only"
        elif depth == 0:
            verdict = "unknown_effect"
        elif explained < ADEQUATE:
            verdict = "unknown_effect"
        elif abreast:
            verdict = "ambiguous"
        else:
            verdict = "missing_effect"
        self.detail = dict(share=explained, before=before, refit=refit.nrmse, after=after.nrmse, floor=floor, quiet=quiet, V=(refit.score, after.score), table=table, chosen=chosen, abreast=abreast, gaps=(gap_before, gap_refit, gap_after), stages=stages, standing=stood)
        return self.report(verdict, base, chosen, rivals, abreast, W, floor, before, stood, quiet, explained)

    def plain_share(self, last: Array, now: Array, floor: Array) -> float:
        f = np.maximum(floor, 1e-12)
        top = float(np.sum((last**2 - now**2) / f**2))
        return top / max(float(np.sum(np.maximum(last**2 - floor**2, 0.0) / f**2)), 1e-12)

    def beaten(self, rival: Standing, best: Standing, quiet: float) -> bool:
        """Whether the rival's held-out excess is larger by a tenth, and not by chance."""
        excess = max(best.score - quiet, 0.003)
        if rival.score - quiet < AHEAD * excess:
            return False
        d = (rival.blocks - best.blocks).mean(axis=1)
        t = d.mean() / max(d.std(ddof=1) / math.sqrt(len(d)), 1e-12) if len(d) > 1 else 0.0
        return bool(t > 2.0 or rival.rival.likelihood - best.rival.likelihood > 50.0)

    def same(self, rival: Rival, best: Rival, W: Whitener) -> bool:
        """Whether the rival is no alternative: more parameters without gain, the best as a special case, or equal outputs."""
        a, b = rival.hypotheses[-1], best.hypotheses[-1]
        if b.effect in CONTAINS.get(a.effect, ()) and set(a.where) == set(b.where):
            return True
        if a.effect == b.effect and a.where == b.where:
            return True
        return False

    def report(self, verdict, base, chosen, rivals, abreast, W, floor, before, stood, quiet, explained) -> Diagnosis:
        p = self.problem
        names = p.channels
        named = verdict == "missing_effect"
        final = chosen if verdict == "missing_effect" else base
        shown = chosen if len(chosen.hypotheses) else base
        refit, after = stood[id(base)], stood.get(id(final)) or stood[id(base)]
        rows = {"before": before, "refit": refit.nrmse, "after": after.nrmse, "noise_floor": floor}
        gap = {k: {n: float(v) for n, v in zip(names, row, strict=True)} for k, row in rows.items()}
        top = float(np.sum(refit.nrmse**2 - after.nrmse**2))
        bottom = float(np.sum(np.maximum(refit.nrmse**2 - floor**2, 0.0)))
        closed = min(1.0, top / bottom) if named and bottom > 0 else None
        model = final.fit.network
        fitted = intervals(p, final, self.floors)
        base_parameters = {path: q for path, q in fitted.items() if path in self.network.parameters}
        effects = []
        if named:
            for h, element in zip(final.hypotheses, final.fit.structure.names, strict=True):
                own = {path.rpartition(".")[2]: q for path, q in fitted.items() if path.rpartition(".")[0] == element}
                effects.append(Effect(h.effect, owner_pair(self.network, h), h.where[0] if h.place == "channel" else None, 0.99, own, element))
        contenders = [
            Contender(
                tuple(h.effect for h in r.hypotheses),
                tuple(h.where for h in r.hypotheses),
                (stood[id(r)].score - quiet) / max(refit.score - quiet, 1e-12),
                r.likelihood - chosen.likelihood,
                "cannot be told apart on these data" if r in abreast else "explains less of the held-out records",
            )
            for r in ([chosen, *abreast] if verdict == "ambiguous" else rivals)
            if id(r) in stood
        ]
        where = ()
        summary = verdict + (": " + " and ".join(h.label for h in final.hypotheses) if named else "")
        return Diagnosis(
            verdict=verdict,
            summary=summary,
            effects=tuple(effects),
            contenders=tuple(contenders),
            where=where,
            parameters=base_parameters,
            gap=gap,
            closed=closed,
            gates=(),
            next_experiment=None,
            base=self.network,
            refitted=base.fit.network,
            model=model,
            traces=(),
            notes=tuple(self.notes),
            seconds=clock.perf_counter() - self.begun,
            units={c.name: c.unit for c in self.network.outputs},
        )


def owner_pair(network: Network, h: Hypothesis) -> tuple[str, str] | None:
    """The terminals of an effect in the owner's words: a motor's, and a node that was put in by the one it split off."""
    if h.place == "channel":
        return None
    if h.place == "element":
        return network.element(h.where[0]).between
    known = {*network.nodes, "ground"}
    out = []
    for n in h.where:
        while n not in known:
            n = n.rsplit("_", 1)[0] if "_" in n else next(iter(known))
        out.append(n)
    return out[0], out[1]


def intervals(problem: Problem, rival: Rival, floors: Array) -> dict[str, Quantity]:
    """Every free parameter with its 95 % interval, from the curvature under the residual's own coloured noise."""
    fit = rival.fit
    W = whitener(residuals(problem, fit), floors)
    f = Fitter(problem, W).fit(fit.structure, fit.x, fit.initial, fit.offset, iterations=3)
    out: dict[str, Quantity] = {}
    if f.hessian is None or not len(f.x):
        return out
    sigma = np.array([q.sigma for q in f.structure.free])
    H = f.hessian + np.diag(1 / sigma**2)
    covariance = np.linalg.inv(H)
    known = problem.network.parameters
    for k, q in enumerate(f.structure.free):
        s = math.sqrt(max(covariance[k, k], 0.0)) * 1.5
        x = f.x[k]
        unit = fit.network.unit_of(q.path)
        out[q.path] = Quantity(q.back(x), q.back(x - 1.96 * s), q.back(x + 1.96 * s), unit, known.get(q.path))
    return out
