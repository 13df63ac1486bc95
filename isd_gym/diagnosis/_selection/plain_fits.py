"""Plain fits: every law at every place, fitted to the training records by simulation error with white noise.

A stage adds one law to a fitted set. All starts of all laws are simulated first, as variants of one structure side by side. The misfit of a
start is what the parameters, initial states and offsets of the set cannot absorb to first order. The best starts of each law are
fitted: from the states of the set, or from states that the first samples tell.
"""

from __future__ import annotations

import contextlib
import math
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ..._common.errors import InputError
from ...physics.elements import beside
from .._estimation.gauss_newton import Fit, Fitter
from .._estimation.initial_states import transfer_states
from .._estimation.structure import FALL, RISE, WIDE, add, parameter_values
from .._hypotheses.law_matching import residual_of, starts_of
from .._hypotheses.library import hypotheses
from .._hypotheses.motion import motions, simulate_variants
from .._simulation.problem import BROKEN
from .._simulation.time_limit import adopt, running
from .admissibility import is_admissible, travels

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from ..._common.arrays import Array
    from ...physics.elements import Start as Proposal
    from .._estimation.structure import Hypothesis, Structure
    from .._hypotheses.law_matching import Residual
    from .settings import SearchSettings

I = TypeVar("I")
O = TypeVar("O")
FAILS = (*BROKEN, ValueError, InputError)


@dataclass(frozen=True, eq=False)
class Start:
    """A law with start values in a structure."""

    law: Hypothesis
    #: what the element proposed
    proposal: Proposal
    #: start values of the law
    values: Mapping[str, float]
    #: known parameters beside it by path, transformed
    known: Mapping[str, float]
    structure: Structure
    #: start values (parameters,), transformed
    x: Array


def freed(structure: Structure, law: Hypothesis) -> Structure:
    """Return the structure in which a law may take the place of an element of its kind that the law contains: the element's parameters
    are free."""
    here = beside(structure.network, law.where) if law.place == "between" else []
    names = {
        e.name
        for e in here
        if e.type in law.kind.contains and e.mechanism == law.kind.mechanism
    }
    free = tuple(
        replace(f, sigma=WIDE, low=f.mean - FALL, high=f.mean + RISE)
        if f.log and f.path.rpartition(".")[0] in names
        else f
        for f in structure.free
    )
    return replace(structure, free=free)


def try_fit(
    fitter: Fitter,
    structure: Structure,
    x: Array,
    states: dict[int, Array] | None,
    offset: dict[int, Array] | None,
    steps: int,
) -> Fit | None:
    """Return a fit; None where the simulation breaks down."""
    try:
        fit = fitter.fit(structure, x, states, offset, iterations=steps)
    except FAILS:
        return None
    return fit if math.isfinite(fit.cost) else None


def go_on(fitter: Fitter, fit: Fit, steps: int) -> Fit | None:
    """Return a further fit from the values and states of a fit; None where the simulation breaks down."""
    return try_fit(fitter, fit.structure, fit.x, fit.initial, fit.offset, steps)


class Stage:
    """Plain fits of all laws beside a fitted set."""

    def __init__(self, full: Fitter, base: Fit, rules: SearchSettings):
        self.full, self.rules = full, rules
        self.whole = full.problem
        self.base = base
        self.coarse, self.now = full, base
        if self.whole.rough is not self.whole:
            coarse = Fitter(self.whole.rough, full.weights)
            now = go_on(coarse, base, 0)
            if now is not None:  # with large steps a law may break down
                self.coarse, self.now = coarse, now
        self.problem = self.coarse.problem

    def run(self) -> list[Fit]:
        """Return the fits with one more law, smallest cost first: all laws with one more parameter or none, and the best laws with several."""
        rules, is_first = self.rules, not self.base.structure.hypotheses
        shortlist, kept = (
            (rules.shortlist, rules.kept)
            if is_first
            else (rules.shortlist_further, rules.kept_further)
        )
        starts = self.starts()
        misfit, rows = self.misfits(starts)
        more = [*self.sized(starts, rows), *self.beside_nominal(starts)]
        starts, misfit = self.with_more(starts, misfit, more)
        more = self.varied(starts, misfit)
        starts, misfit = self.with_more(starts, misfit, more)
        best: dict[Hypothesis, Start] = {}
        for k in np.argsort(misfit, kind="stable"):
            if math.isfinite(misfit[k]):
                best.setdefault(starts[k].law, starts[k])
        laws = self.with_special_cases(list(best)[:shortlist], best)
        begun = self.each(self.first_fit, [best[law] for law in laws])
        found = [fit for fit in begun if fit is not None]
        return self.finish(sorted(found, key=lambda fit: fit.cost), kept)

    def each(self, work: Callable[[I], O], items: Sequence[I]) -> list[O]:
        """Return what a function makes of each item, in threads: the kernel does not hold the interpreter."""
        with ThreadPoolExecutor(
            self.rules.jobs, initializer=adopt, initargs=(running(),)
        ) as pool:
            return list(pool.map(work, items))

    @staticmethod
    def with_special_cases(
        laws: Sequence[Hypothesis], every: Iterable[Hypothesis]
    ) -> list[Hypothesis]:
        """Return laws and the special cases of them that were simulated."""
        simple = {(name, law.where) for law in laws for name in law.kind.contains}
        return [
            *laws,
            *(
                law
                for law in every
                if law not in laws and (law.effect, law.where) in simple
            ),
        ]

    @cached_property
    def residual(self) -> Residual:
        """The residual of the set, and what the set absorbs of a residual."""
        return residual_of(self.problem, self.coarse, self.now)

    # -- starts -------------------------------------------------------------------------------------------
    def starts(self) -> list[Start]:
        """Return the starts of all admissible laws that the elements propose."""
        base, network = self.base, self.base.structure.network
        have = {
            (h.kind.mechanism, frozenset(h.where)) for h in base.structure.hypotheses
        }
        motion = motions(self.whole, base)
        known = travels(self.whole, base.network, motion)
        laws = [
            h
            for h in hypotheses(network)
            if (h.kind.mechanism, frozenset(h.where)) not in have
            and is_admissible(h, known)
        ]
        out = []
        for law, proposal in starts_of(self.whole, base, motion, laws):
            out += [
                self.start(law, proposal, way, base.values) for way in proposal.ways
            ]
        return [start for start in out if start is not None]

    def start(
        self,
        law: Hypothesis,
        proposal: Proposal,
        values: Mapping[str, float],
        known: Mapping[str, float],
    ) -> Start | None:
        """Return a start with values of a law beside known parameters; None where the law fits nowhere in the model."""
        try:
            built = add(freed(self.base.structure, law), law, values)
            x = built.start_from(known)
        except FAILS:
            return None
        return Start(law, proposal, values, known, built, x)

    def with_more(
        self, starts: list[Start], misfit: Array, more: Sequence[Start]
    ) -> tuple[list[Start], Array]:
        """Return starts and further starts, with their misfits."""
        if not more:
            return starts, misfit
        return [*starts, *more], np.append(misfit, self.misfits(more)[0])

    def sized(self, starts: Sequence[Start], rows: Mapping[int, Array]) -> list[Start]:
        """Return the starts with the size that the residual asks for to first order: the combination of the responses of what an element
        proposed that leaves least of the residual, the best ones of each law. `rows`: what the starts leave (rows,)."""
        out, left = [], self.residual.left
        ways: dict[int, list[int]] = defaultdict(list)
        for k, start in enumerate(starts):
            ways[id(start.proposal)].append(k)
        found: dict[Hypothesis, list[tuple[float, Proposal, Array]]] = defaultdict(list)
        for own in ways.values():
            law, proposal = starts[own[0]].law, starts[own[0]].proposal
            if len(own) < len(proposal.ways) or not rows.keys() >= set(own):
                continue  # a way broke down
            responses = np.stack([left - rows[k] for k in own], axis=1)
            amplitude = np.asarray(
                np.linalg.lstsq(responses, left, rcond=None)[0], dtype=np.float64
            )
            if proposal.signed or amplitude[0] > 0.0:
                cost = self.cost_of((left - responses @ amplitude)[:, None])[0]
                found[law].append((float(cost), proposal, amplitude))
        for law, tried in found.items():
            tried.sort(key=lambda item: item[0])
            for _, proposal, amplitude in tried[: self.rules.varied]:
                values = law.kind.sized(proposal, amplitude)
                out.append(self.start(law, proposal, values, self.base.values))
        return [start for start in out if start is not None]

    def beside_nominal(self, starts: Sequence[Start]) -> list[Start]:
        """Return the starts of a first law beside the nominal parameters: refitted ones imitate what is missing."""
        base = self.base
        if base.structure.hypotheses:
            return []
        nominal = {f.path: f.mean for f in base.structure.free}
        found = [
            self.start(s.law, s.proposal, s.values, nominal)
            for s in starts
            if len(s.proposal.ways) == 1
        ]
        return [start for start in found if start is not None]

    def varied(self, starts: Sequence[Start], misfit: Array) -> list[Start]:
        """Return other sizes of the best starts of each law."""
        out: list[Start | None] = []
        count: dict[Hypothesis, int] = defaultdict(int)
        for k in np.argsort(misfit, kind="stable"):
            law, proposal = starts[k].law, starts[k].proposal
            if count[law] == self.rules.varied or not math.isfinite(misfit[k]):
                continue
            count[law] += 1
            values = starts[k].values
            for size in self.rules.sizes if proposal.grows else ():
                by = 1.0 / size if proposal.inverse else size
                grown = {name: values[name] * by for name in proposal.grows}
                known = starts[k].known
                out.append(self.start(law, proposal, {**values, **grown}, known))
        return [start for start in out if start is not None]

    def misfits(self, starts: Sequence[Start]) -> tuple[Array, dict[int, Array]]:
        """Return the misfits of the starts (starts,), with the states of the set: the sum over channels of the logarithm of the residual's
        variance after first-order changes of what the set has free; infinite where the simulation breaks down. The second value are
        these residuals (rows,) by start, where it does not."""
        p, now = self.problem, self.now
        residual = self.residual
        misfit = np.full(len(starts), math.inf)
        left_by: dict[int, Array] = {}
        networks = [start.structure.at(start.x) for start in starts]
        for chunk, seen in simulate_variants(p, now, networks):
            rows = np.zeros((len(residual.left), len(chunk)))
            for i, y in seen.items():
                offset = np.repeat(now.offset[i][:, None], y.shape[2], axis=1)
                with np.errstate(over="ignore", invalid="ignore"):
                    left = p.records[i].measured[:, :, None] - y - offset[None]
                    weighted = self.coarse.weights(left)
                rows[residual.rows[i]] = weighted.reshape(-1, len(chunk))
            is_finite = np.asarray((np.abs(rows) < 1e100).all(axis=0))
            rows[:, ~is_finite] = 0.0
            own = len(now.x)
            for lane, k in enumerate(chunk):
                x = starts[k].x[:own] if own else np.zeros(0)
                structure = now.structure
                if own and len(x) == own:
                    rows[len(rows) - own :, lane] = (
                        structure.mean - x
                    ) / structure.sigma
            left = residual.without(rows)
            misfit[chunk] = np.where(is_finite, self.cost_of(left), math.inf)
            left_by |= {
                k: left[:, lane] for lane, k in enumerate(chunk) if is_finite[lane]
            }
        return misfit, left_by

    def cost_of(self, left: Array) -> Array:
        """Return the sum over channels of the logarithm of the variance of residuals (rows, lanes), those of the parameters' prior left
        out."""
        rows = len(left) - len(self.now.x)
        square = left[:rows].reshape(-1, len(self.problem.channels), left.shape[1]) ** 2
        return np.asarray(np.sum(np.log(square.mean(axis=0) + 1.0), axis=0))

    # -- fits ---------------------------------------------------------------------------------------------
    def first_fit(self, start: Start) -> Fit | None:
        """Return a fit of a few steps, from the states of the set or from those that the first samples tell, whichever cost less; the
        offsets are those of the set where the states are."""
        now, fitter, structure = self.now, self.coarse, start.structure
        records = self.problem.estimation
        begun: list[tuple[dict[int, Array] | None, dict[int, Array] | None]]
        begun = [(None, None)]
        try:
            with contextlib.suppress(*FAILS):
                states = transfer_states(
                    self.problem, now.network, now.initial, structure
                )
                begun.append((states, now.offset))
            points = [fitter.begin(structure, start.x, *at, records) for at in begun]
            points = fitter.seen_all(structure, points, records)
        except FAILS:
            return None
        at = min(points, key=lambda at: at.total)
        steps = self.rules.first_steps
        return try_fit(fitter, structure, start.x, at.initial, at.offset, steps)

    def finish(self, begun: Sequence[Fit], kept: int) -> list[Fit]:
        """Return fits to the end from first fits, with their costs on all samples, smallest cost first."""
        chosen: list[Fit] = []
        is_further = bool(self.base.structure.hypotheses)
        for fit in begun:
            is_small = len(fit.x) <= len(self.base.x) + 1
            # few steps say little about a law with one parameter while the set still misses much
            is_hopeless = is_further and fit.cost > self.rules.hopeless * begun[0].cost
            if len(chosen) < kept or (is_small and not is_hopeless):
                chosen.append(fit)
        out = self.continued(self.coarse, chosen, self.rules.further_steps)
        out += self.special_cases(out)
        out.sort(key=lambda f: f.cost)
        if self.problem is not self.whole:
            out = self.continued(self.full, out, 0)
            out.sort(key=lambda f: f.cost)
        return out

    def continued(self, fitter: Fitter, fits: Sequence[Fit], steps: int) -> list[Fit]:
        """Return further fits from the values and states of fits."""
        found = self.each(lambda fit: go_on(fitter, fit, steps), fits)
        return [fit for fit in found if fit is not None]

    def special_cases(self, fits: Sequence[Fit]) -> list[Fit]:
        """Return fits of special cases of the last law from the values of the law, where the law costs less than the special case: the
        special case may be in another local optimum."""
        costs = {f.structure.hypotheses[-1]: f.cost for f in reversed(fits)}
        out = []
        for fit in fits:
            law = fit.structure.hypotheses[-1]
            for name in law.kind.contains:
                plainer = replace(law, effect=name, options=())
                if costs.get(plainer, -math.inf) > fit.cost:
                    more = self.special_case(fit, plainer)
                    out += [more] if more is not None else []
        return out

    def special_case(self, fit: Fit, plainer: Hypothesis) -> Fit | None:
        """Return a fit of a special case of the last law of a fit, from the values of that law; None where the simulation breaks down."""
        law, name = fit.structure.hypotheses[-1], fit.structure.names[-1]
        values = parameter_values(fit.network.element(name))
        motion = motions(self.problem, fit).get((law.where[0], law.where[-1]))
        kept = {
            path: v for path, v in fit.values.items() if path.rpartition(".")[0] != name
        }
        try:
            special = law.kind.special(plainer.effect, values, motion)
            structure = add(freed(self.base.structure, plainer), plainer, special)
        except FAILS:
            return None
        x = structure.start_from(kept)
        return try_fit(self.coarse, structure, x, None, None, self.rules.further_steps)
