"""One hypothesis at one size, before the test: the evidence that a diagnosis would have, and the smallest size that it names."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from .candidate import BROKEN, relative
from .criteria import decide
from .evidence import EffectEvidence, Evidence, row
from .fit import Fit, Fitter
from .initial import carried
from .judge import BLOCKS, share_at_place
from .measure import complaint, difference, spread_of
from .noise import lagged, plain, predicted
from .result import Quantity
from .settings import SearchSettings
from .structure import Hypothesis, Structure, add, in_line, twin

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from .. import elements as el
    from .problem import Array, Problem
    from .stand import Refit, Stand

ORDER = 20  # of the filters that make coloured noise white, as in the diagnosis
#: sizes at which a prospect is asked what it would be, as multiples of the one that was simulated
SMALLEST, LARGEST = 0.02, 30.0


class Coherent:
    """What a fit leaves, free of noise, as far as a likelihood reads it: it scales with the size of the effect."""

    def __init__(self, stand: Stand, refit: Refit):
        self.stand, self.prior, self.parameters = stand, refit.fit.prior, len(refit.fit.x)
        left, held = refit.left, refit.held
        self.lags = []
        for j in range(left[0].shape[1]):
            series = [r[:, j] - r[:, j].mean() for r in left]
            self.lags.append(lagged(series, min(ORDER, min(map(len, series)) // 8)))
        self.samples = sum(map(len, left))
        self.fit_power = np.mean(np.concatenate(left) ** 2, axis=0)
        self.held_power = np.mean(np.concatenate(held) ** 2, axis=0)
        blocks = []
        for r in held:
            square = np.mean((r / stand.level) ** 2, axis=1)
            edges = np.linspace(0, len(square), BLOCKS + 1).astype(int)
            blocks += [(float(square[a:b].mean()), b - a) for a, b in pairwise(edges) if b > a]
        self.blocks = np.array([s for s, _ in blocks])
        self.sizes = np.array([n for _, n in blocks]) * len(stand.level)

    def gain(self, k: float) -> float:
        """-2 log L that noise with k times what is left has more than noise alone."""
        total = 0.0
        for (gram, rhs, power, count), white in zip(self.lags, self.stand.level, strict=True):
            _, sigma = predicted(k * k * gram, k * k * rhs, k * k * power, count, float(white))
            total += 2 * self.samples * math.log(max(sigma / white, 1.0))
        return self.stand.repeat * total + k * k * self.prior

    def excess(self, k: float) -> float:
        """Of the score on the held-out records."""
        return k * k * float(self.blocks.mean())

    def lead(self, k: float, quiet: float) -> float:
        """Standard errors, over blocks, by which noise with k times this is behind noise alone."""
        d = k * k * self.blocks
        variance = (
            float(d.var(ddof=1)) + float(np.mean(4 * d * quiet / self.sizes)) if len(d) > 1 else math.inf
        )
        return float(d.mean() / math.sqrt(max(variance / (len(d) * self.stand.repeat), 1e-300)))

    def again(self, k: float, quiet: float) -> float:
        """The same by the logarithm of the ratio."""
        d = k * k * self.blocks
        ratio = np.log1p(d / quiet)
        chance = np.mean(4 * d * quiet / self.sizes / (quiet + d) ** 2)
        variance = float(ratio.var(ddof=1)) + float(chance) if len(d) > 1 else math.inf
        return float(ratio.mean() / math.sqrt(max(variance / (len(d) * self.stand.repeat), 1e-300)))


@dataclass(frozen=True, eq=False)
class Opponent:
    """A rival as it was refitted to a truth."""

    hypothesis: Hypothesis
    left: Coherent


@dataclass(eq=False)
class Prospect:
    """A hypothesis at the values that were simulated, and what of it the refitted model and the rivals leave."""

    stand: Stand
    hypothesis: Hypothesis
    truth: Problem
    structure: Structure
    fit: Fit  # of its own structure: the truth
    base: Coherent
    share: float
    covariance: Array  # of its free parameters, transformed
    complaint: str
    rivals: list[Opponent]

    # -- at k times the size ----------------------------------------------------------------------------------
    @property
    def element(self) -> el.Element:
        return self.structure.network.element(self.structure.names[-1])

    @property
    def quiet(self) -> float:
        """The score of noise alone, and at least a hundredth of it is any candidate's excess."""
        return float(np.mean((self.stand.noise / self.stand.level) ** 2))

    @property
    def spread(self) -> Array:
        y = self.truth.measured(self.truth.choosing)
        return np.asarray(np.sqrt(y.var(axis=0) + self.stand.noise**2))

    def spread_at(self, k: float) -> float:
        """How undetermined its values are: the criterion's logarithm of a factor."""
        e, out, free = self.element, {}, self.structure.free
        for q, variance in zip(free, np.diag(self.covariance), strict=True):
            if q.owner < 0:
                continue
            s = min(math.sqrt(max(float(variance), 0.0)) / k, q.sigma)
            x = q.forward(getattr(e, q.path.rpartition(".")[2]))
            ends = (
                q.back(max(x - 1.96 * s, -700.0)),
                q.back(min(x + 1.96 * s, 700.0)) if q.log else x + 1.96 * s,
            )
            out[q.path] = Quantity(q.back(x), *ends, self.structure.network.unit_of(q.path))
        at, network = self.structure.start, self.stand.network
        return spread_of(e, out, difference(network, self.structure, at, e, self.covariance / k**2))

    def told(self, rival: Opponent, k: float) -> bool:
        """Whether a diagnosis would tell it, k times as large, from the rival."""
        c, s, n = self.stand.criteria, SearchSettings(), self.base.samples * self.stand.repeat
        delta, theirs = rival.left.gain(k), rival.left.excess(k)
        own = 0.01 * self.quiet
        more = rival.left.parameters - len(self.structure.free)
        if more > 0:  # what has more parameters and gains nothing by them is beaten
            return delta + more * math.log(n) > c.decisive
        beaten = theirs >= c.ahead * own and (delta > 50.0 or rival.left.lead(k, self.quiet) > c.replicated)
        if not beaten:
            return False
        if relative(
            self.hypothesis, rival.hypothesis
        ):  # its own special case does as well, unless more is needed
            change = k * np.sqrt(rival.left.held_power) / self.spread
            wider = self._wider(rival.left, k)
            return bool(np.any(change > self.stand.worth)) and (delta > s.chance or wider > 1.5)
        left = max(theirs, 0.005 * self.base.excess(k))
        as_much = more < 0 and left < c.ahead * max(own, 0.005 * self.base.excess(k))
        return not (as_much and delta + more * math.log(n) < 0)

    def _wider(self, left: Coherent, k: float) -> float:
        noise = self.stand.noise**2
        return float(np.exp(np.mean(np.log1p(k * k * left.fit_power / noise))))

    def evidence(self, k: float = 1.0, rivals: bool = True) -> Evidence:
        """What a diagnosis would have to decide by, were the effect k times as large."""
        s, base, quiet = self.stand, self.base, self.quiet
        floor = s.noise / self.spread
        refit = np.sqrt(k * k * base.held_power / self.spread**2 + floor**2)
        own = 0.01 * quiet
        against = self.rivals if rivals else []
        sensor = self.hypothesis.place == "channel"
        scaled = self.share if self.hypothesis.kind.series else k * self.share
        effect = EffectEvidence(
            label=self.hypothesis.label,
            share=scaled,
            spread=self.spread_at(k),
            complaint=self.complaint,
            sensor=sensor,
            fault=k * self.element.fault(self.stand.problem.time),
        )
        excesses = [base.excess(k), *(r.left.excess(k) for r in against)]
        forces = [base.excess(k), *(r.left.excess(k) for r in against if r.hypothesis.place != "channel")]
        return Evidence(
            channels=tuple(s.problem.channels),
            before=row(refit),
            refit=row(refit),
            after=row(floor),
            floor=row(floor),
            floor_known=tuple(True for _ in floor),
            worth=row(s.worth),
            effects=(effect,),
            gain=base.gain(k),
            power_left=1.0 / self._wider(base, k),
            again=base.again(k, quiet),
            explained=1.0,
            lead=min(excesses) / own,
            abreast=tuple(r.hypothesis.label for r in against if not self.told(r, k)),
            force_lead=min(forces) / own,
            closest=row(floor),
            closest_share=scaled,
        )

    def named(self, k: float = 1.0, rivals: bool = True) -> bool:
        return decide(self.evidence(k, rivals), self.stand.criteria).verdict == "missing_effect"

    def smallest(self, passes: Callable[[float], bool]) -> float:
        """The smallest multiple of its size that passes, of what passes from there on; infinite where none does."""
        if not passes(LARGEST):
            return math.inf
        low, high = math.log(SMALLEST), math.log(LARGEST)
        if passes(SMALLEST):
            return SMALLEST
        while high - low > 0.02:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if passes(math.exp(middle)) else (middle, high)
        return math.exp(high)


def prospect(stand: Stand, h: Hypothesis, values: dict[str, float]) -> Prospect:
    """A hypothesis at `values`: simulated, and the owner's model refitted to it. Raises where it breaks down."""
    structure = add(stand.structure, h, values)
    truth = stand.measuring(structure.network)
    base = Coherent(stand, stand.refit(truth, stand.structure, stand.structure.start))
    fit, covariance = _own(stand, truth, structure)
    return Prospect(
        stand,
        h,
        truth,
        structure,
        fit,
        base,
        share_at_place(truth, fit, structure.names[-1]),
        covariance,
        complaint(truth, fit, structure.network.element(structure.names[-1])),
        [],
    )


def oppose(p: Prospect, h: Hypothesis, tries: Sequence[dict[str, float]]) -> Opponent | None:
    """A rival refitted to what a prospect does, from several starts; None where all of them break down."""
    best: Coherent | None = None
    for values in tries:
        try:
            structure = add(p.stand.structure, h, values)
            left = Coherent(p.stand, p.stand.refit(p.truth, structure, structure.start))
        except BROKEN:
            continue
        if best is None or left.gain(1.0) < best.gain(1.0):
            best = left
    return None if best is None else Opponent(h, best)


def _own(stand: Stand, truth: Problem, structure: Structure) -> tuple[Fit, Array]:
    """The truth's own fit, and the covariance that its free parameters would have: noise, and what small effects drag."""
    x = structure.start
    known = carried(truth, stand.network, stand.base.initial, structure)
    W = plain(stand.level)
    f = Fitter(truth, W).fit(structure, x, known, iterations=0)
    sigma = np.array([q.sigma for q in structure.free])
    if f.hessian is None or not np.isfinite(f.hessian).all():
        raise InputError("the simulation breaks down beside these values")
    covariance = np.linalg.inv(stand.repeat * f.hessian + np.diag(1 / sigma**2))
    try:
        with np.errstate(invalid="ignore", over="ignore"):
            dragged, _ = Fitter(truth, W).refit(f, stand.small)
        dragged = np.clip(np.nan_to_num(dragged), -1e6, 1e6)
        covariance = covariance + dragged @ dragged.T
    except BROKEN:
        pass
    return f, np.asarray(covariance, dtype=np.float64)


def no_alternative(stand: Stand, rival: Hypothesis, truth: Hypothesis) -> bool:
    """Whether naming the rival would be no mistake: a variant of the truth, more general, or elsewhere along one force."""
    if rival.effect == truth.effect:
        known = stand.network.nodes
        links = (tuple(twin(n, known) for n in h.where) for h in (rival, truth))
        return rival.where == truth.where or (rival.kind.series and in_line(stand.network, *links))
    return relative(rival, truth)


__all__ = ["Coherent", "Opponent", "Prospect", "no_alternative", "oppose", "prospect"]
