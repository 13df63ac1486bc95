"""The workflow from records and a model to a verdict."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..data import Table
from ..errors import InputError
from ..network import Network, assemble
from .choose import (
    CONTAINS,
    Rival,
    carried,
    compete,
    finer,
    gap,
    itself,
    judge,
    measured_noise,
    noise_levels,
    plain,
    residuals,
    screen,
    settled,
    share_of_force,
    simpler,
    trust,
    unmodelled,
)
from .explain import law, next_experiment, places
from .fit import Fit, Fitter
from .hypotheses import SERIES, Hypothesis, Structure, base_structure, hypotheses, in_line, twin
from .problem import Array, Problem, Whitener, bare, innovations, passed, whitener
from .records import derivatives, read, split_records, stretches
from .result import Contender, Diagnosis, Effect, Gate, Place, Quantity, Trace

#: a gap below this share of a channel's standard deviation is not worth a name: few per cent are everybody's nuisance
MATERIAL = 0.03
#: share of the held-out excess error that what is named must remove
HALF = 0.5
#: share from which on what is named counts as the missing effect, whatever the rest is; up to there, what is left may be
#: no more than several small effects make, whose powers add up
ADEQUATE, SEVERAL = 0.85, 3
#: a rival is beaten when its excess is larger by this factor
AHEAD = 1.1
BRIEF = 0.5  # [s] stretches over which detents are looked for
DEPTH = 3  # effects at once
TURNS = 2  # runners-up that are tried first where one effect is not enough

#: share of the typical force that each small effect, unmodelled, may have (one sigma)
SMALL = 0.005
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
    filtered = derivatives([*estimation, *held], network)
    estimation, held = filtered[: len(estimation)], filtered[len(estimation) :]
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


# ----------------------------------------------------------------------------------------------- the workflow


@dataclass
class Standing:
    """A rival on held-out data: whitened score by block, plain NRMSE by channel."""

    rival: Rival
    score: float
    blocks: Array
    nrmse: Array


@dataclass
class Weighed:
    """A set of effects on trial: what was chosen, what it explains of the held-out records, and who is abreast of it."""

    verdict: str
    chosen: Rival
    rivals: list[Rival]
    abreast: list[Rival]
    whitener: Whitener
    floor: Array  # noise of every channel, as a share of its deviation
    worth: Array  # excess of every channel that small effects do not make
    quiet: float  # score of pure noise
    before: Array  # NRMSE of the owner's model
    explained: float  # share of the refitted model's excess error
    adequate: bool  # whether that is dominant, or what is left is what small effects make
    gaps: tuple[float, float, float]  # largest excess NRMSE before, refitted, after
    table: list[str]
    stages: list[list[Rival]]
    stood: dict[int, Standing]


class Workflow:
    def __init__(
        self,
        problem: Problem,
        whole: Problem,
        say: Callable[[str], None],
        seed: int,
        notes: list[str],
        begun: float,
    ):
        self.problem, self.whole, self.say, self.notes, self.begun = problem, whole, say, notes, begun
        self.seed, self.rng = seed, np.random.default_rng(seed)
        self.network = problem.network
        self.floors = measured_noise(problem, problem.estimation)
        held = np.concatenate([problem.records[i].measured for i in problem.validation])
        self.spread = np.maximum(held.std(axis=0), 1e-300)
        self._worth: Array | None = None

    # -- judging ------------------------------------------------------------------------------------------
    def plain_error(
        self, fit: Fit, structure: Structure, x: Array, frozen_state: dict[int, Array] | None = None
    ) -> tuple[Array, Fit]:
        """NRMSE of every channel on the held-out stretches, initial states by plain least squares."""
        W = plain(self.problem, self.floors)
        f = Fitter(self.problem, W).follow(structure, x, self.problem.validation, frozen_state)
        r = np.concatenate(residuals(self.problem, f))
        return np.sqrt(np.mean(r**2, axis=0)) / self.spread, f

    def stand(self, rival: Rival, W: Whitener) -> Standing:
        judge(self.problem, W, rival)
        assert rival.held is not None
        nrmse, f = self.plain_error(rival.fit, rival.fit.structure, rival.fit.x, rival.held.initial)
        return Standing(rival, rival.score, rival.blocks, nrmse)

    def run(self) -> Diagnosis:
        self.say(
            f"{len(self.whole.estimation)} record(s) to fit, {len(self.whole.validation)} held out; refitting the model within its stated uncertainty"
        )
        base = self.refitted()
        path, stages = self.walk([base], [])
        best = self.weigh(base, path, stages)
        found = self.detents() if best.verdict == "unknown_effect" else None
        return found or self.conclude(base, self.runners_up(base, best, stages))

    def refitted(self) -> Rival:
        """The owner's model with the parameters that it holds moved within their stated uncertainty."""
        structure = base_structure(self.network)
        return Rival((), *settled(self.problem, structure, structure.start, self.floors))

    def runners_up(self, base: Rival, best: Weighed, stages: list[list[Rival]]) -> Weighed:
        """What comes first may lead astray where it is not enough: the runners-up get their turn."""
        fine = best.verdict in ("no_discrepancy", "parameters_only")
        if not stages or fine or (best.adequate and len(best.chosen.hypotheses) < 2):
            return best
        for runner in stages[0][1 : 1 + TURNS]:
            self.say(f"starting over with {runner.hypotheses[-1].label}")
            try:
                other = self.weigh(base, *self.walk([base, runner], stages[:1]))
                best = other if self.better(other, best) else best
            except (InputError, np.linalg.LinAlgError):  # it breaks down on the held-out records
                continue
        return best

    def detents(self) -> Diagnosis | None:
        """What has many rests cannot be followed for long, so it is looked for over brief stretches, each from its own state."""
        p = self.problem
        if not self.network.inputs or not assemble(bare(self.network)).size[0]:
            return None
        pieces = [(q, h) for r, h in zip(p.records, p.held, strict=True) for q in stretches(r, BRIEF)]
        brief = Problem(self.network, [q for q, _ in pieces], [h for _, h in pieces], p.step)
        self.say(f"looking for detents over stretches of {BRIEF} s")
        flow = Workflow(brief, self.whole, self.say, self.seed, list(self.notes), self.begun)
        base = flow.refitted()
        W = whitener(residuals(brief, base.fit), trust(brief, base.fit, flow.floors))
        screened = screen(brief, Fitter(brief, W), base.fit, list(hypotheses(self.network)))
        foremost = list(dict.fromkeys(s.hypothesis for s in screened))[:3]
        if not any(h.effect == "cogging_force" for h in foremost):
            return None
        try:
            best = flow.weigh(base, *flow.walk([base], [], depth=1))
        except (InputError, np.linalg.LinAlgError):  # it breaks down on the held-out records
            return None
        if best.verdict != "missing_effect" or best.chosen.hypotheses[0].effect != "cogging_force":
            return None
        said = flow.conclude(base, best)
        why = f"Compared over stretches of {BRIEF} s: between detents no simulation stays with a record for long."
        return replace(said, summary=f"{said.summary} {why}")

    def excess(self, rival: Rival) -> Array:
        """Excess (channels,) of the held-out error over noise, as a share of a channel's deviation."""
        p = self.problem
        W = whitener(residuals(p, rival.fit), trust(p, rival.fit, self.floors))
        here = self.stand(rival, W)
        noise = np.array([n.deviation for n in noise_levels(p, rival.held)]) / self.spread  # type: ignore[arg-type]
        return np.asarray(np.sqrt(np.maximum(here.nrmse**2 - noise**2, 0.0)), dtype=np.float64)

    def worth(self, base: Rival) -> Array:
        """Excess (channels,), as a share of a channel's deviation, that no small effect makes once the model is refitted.

        Where a coordinate drifts, a force of two per cent may show up large: that is everybody's.
        """
        if self._worth is None:
            p = self.problem
            small = unmodelled(p, base.fit, 4 * SMALL)
            self._worth = np.full(len(p.channels), MATERIAL)
            if next(iter(small.values())).shape[2]:
                _, left = Fitter(p, plain(p, self.floors)).refit(base.fit, small)
                r = np.concatenate([*left.values()]) * self.floors[:, None]
                y = np.concatenate([p.records[i].measured for i in left])
                shares = np.sqrt(np.mean(r**2, axis=0)) / np.maximum(y.std(axis=0), 1e-300)[:, None]
                self._worth = np.maximum(MATERIAL, np.quantile(shares, 0.95, axis=1))
        return self._worth

    def sizes(self, rival: Rival) -> list[float]:
        """What each of its effects does, as a share of the force, current or signal at its place."""
        return [share_of_force(self.problem, rival.fit, name) for name in rival.fit.structure.names]

    def better(self, other: Weighed, best: Weighed) -> bool:
        """Whether the excess that `other` leaves on the held-out records is smaller by a tenth, or as small with fewer effects."""
        a = self.stand(other.chosen, other.whitener)
        b = self.stand(best.chosen, other.whitener)
        mine, theirs = (max(r.score - other.quiet, 0.01 * other.quiet) for r in (a, b))
        fewer = len(other.chosen.hypotheses) < len(best.chosen.hypotheses)
        return mine < AHEAD * theirs if fewer else AHEAD * mine < theirs

    def walk(
        self, path: list[Rival], stages: list[list[Rival]], depth: int = DEPTH
    ) -> tuple[list[Rival], list[list[Rival]]]:
        """Forward addition, one effect at a time, from the last rival of `path` on."""
        p, say = self.problem, self.say
        path, stages = list(path), list(stages)
        while len(path) <= depth:
            now = path[-1]
            left = self.excess(now)
            if left.max() < MATERIAL or (len(path) > 1 and np.all(left < self.worth(path[0]))):
                break
            say(
                f"looking for what is missing ({'; '.join(h.label for h in now.hypotheses) or 'refitted model'}: excess up to {100 * left.max():.1f} %)"
            )
            rivals, least = compete(p, now.fit, self.floors)
            if not rivals:
                break
            level = innovations(residuals(p, now.fit), finer(least, self.floors)) + now.fit.prior
            # one that cannot be named gives way to one that can, where that gains half as much
            if self.sizes(rivals[0])[-1] < SHARE:
                reach = level - HALF * (level - rivals[0].likelihood)
                able = [r for r in rivals if r.likelihood < reach and self.sizes(r)[-1] >= SHARE]
                rivals = able[:1] + [r for r in rivals if r not in able[:1]]
            best = rivals[0]
            gain = level - best.likelihood
            say(f"  best: {best.hypotheses[-1].label} (2 log L {gain:+.0f})")
            stages.append(rivals)
            if gain < 60.0 and HALF * gap(p, now.fit) < gap(p, best.fit):
                break
            W = whitener(residuals(p, now.fit), trust(p, now.fit, self.floors))
            try:
                here, then = self.stand(now, W), self.stand(best, W)
            except (InputError, np.linalg.LinAlgError):  # it breaks down on the held-out records
                break
            path.append(best)
            moved = float(np.sqrt(np.maximum(here.nrmse**2 - then.nrmse**2, 0.0)).max())
            if moved < MATERIAL or self.sizes(best)[-1] < SHARE:
                break
        return path, stages

    # -- conclusion ---------------------------------------------------------------------------------------
    def weigh(self, base: Rival, path: list[Rival], stages: list[list[Rival]]) -> Weighed:
        """Of the effects added on the way, those that earn their place, and who else explains as much."""
        p = self.problem
        final = path[-1]
        W = whitener(residuals(p, final.fit), trust(p, final.fit, self.floors))
        stood: dict[int, Standing] = {}

        def stand(r: Rival) -> Standing:
            if id(r) not in stood:
                stood[id(r)] = self.stand(r, W)
            return stood[id(r)]

        stand(final)
        noise = noise_levels(p, final.held)  # type: ignore[arg-type]
        floor = np.array([n.deviation for n in noise]) / self.spread
        self.floor = floor = np.minimum(floor, stand(final).nrmse)
        quiet = min(float(passed(W, noise).mean()), 0.999 * stand(final).score)
        # the owner's model as it is
        owner = base_structure(self.network)
        before, _ = self.plain_error(base.fit, owner, owner.start)

        worth = self.worth(base)
        # walk back: an effect that does not earn its place goes
        depth = len(path) - 1
        table: list[str] = []
        while depth > 0:
            now, last = stand(path[depth]), stand(path[depth - 1])
            share = (last.score - now.score) / max(last.score - quiet, 1e-12)
            shares = self.plain_share(last.nrmse, now.nrmse, floor)
            moved = float(np.sqrt(np.maximum(last.nrmse**2 - now.nrmse**2, 0.0)).max())
            size = self.sizes(path[depth])[-1]
            table.append(
                f"{path[depth].hypotheses[-1].label}: "
                f"{f'removes {max(share, shares):.0%} of' if share > 0 else 'adds to'} the held-out excess error "
                f"(needed {HALF:.0%}), moves a channel by {moved:.1%} of its deviation (needed {MATERIAL:.0%}), "
                f"gives {size:.1%} of the force, current or signal at its place (needed {SHARE:.0%})"
            )
            if max(share, shares) >= HALF and moved >= MATERIAL and share > 0 and size >= SHARE:
                break
            depth -= 1
        chosen = path[depth]
        if depth and not itself(chosen.fit, -1):
            known = [r for r in stages[depth - 1] if itself(r.fit)][:1]
            plainer = (self.anew(s, chosen) for _, s in simpler(p, chosen) if len(s.hypotheses) == depth)
            known += [r for r in plainer if r is not None and itself(r.fit)]
            chosen = min(known, key=lambda r: self.level(r, chosen), default=chosen)
        elif 0 < depth < len(path) - 1:
            self.settle_again(chosen, path[-1])
            stood.pop(id(chosen), None)
        if depth:
            known = [r for stage in stages for r in stage]
            chosen = self.prune(chosen, known, stand, quiet, worth, table)
        stand(base)
        rivals: list[Rival] = []
        for r in stages[depth - 1][:6] if depth else []:
            try:
                stand(r)
            except (InputError, np.linalg.LinAlgError):  # it breaks down on the held-out records
                continue
            rivals += [r] if r is not chosen else []
        refit, after = stand(base), stand(chosen)
        excess_before, excess_refit, excess_after = (
            np.maximum(e**2 - floor**2, 0.0) for e in (before, refit.nrmse, after.nrmse)
        )
        explained = max(
            (refit.score - after.score) / max(refit.score - quiet, 1e-12),
            self.plain_share(refit.nrmse, after.nrmse, floor),
        )
        # the channel in which the gap is widest has to agree, too
        widest = int(np.argmax(excess_refit))
        explained = min(explained, 1.0 - float(excess_after[widest] / max(excess_refit[widest], 1e-12)))
        gap_before, gap_refit, gap_after = (
            math.sqrt(e.max()) for e in (excess_before, excess_refit, excess_after)
        )
        # who is still abreast
        abreast = [
            r
            for r in rivals
            if itself(r.fit) and not self.beaten(stand(r), stand(chosen), quiet) and not self.same(r, chosen)
        ]
        few = math.inf if explained >= ADEQUATE else SEVERAL
        adequate = depth > 0 and bool(np.all(excess_after < few * worth**2))
        # nothing is worth a name: small effects would make the gap, or do close it
        closed = np.maximum(stand(final).nrmse ** 2 - floor**2, 0.0)
        little = np.all(excess_refit < worth**2) or (
            np.all(closed < worth**2) and max(self.sizes(final), default=1.0) < SHARE
        )
        if gap_refit < MATERIAL or (depth == 0 and little):
            verdict = "no_discrepancy" if np.all(excess_before < worth**2) else "parameters_only"
        elif not adequate or not itself(chosen.fit):
            verdict = "unknown_effect"
        elif abreast:
            verdict = "ambiguous"
        else:
            verdict = "missing_effect"
        return Weighed(
            verdict=verdict,
            chosen=chosen,
            rivals=rivals,
            abreast=abreast,
            whitener=W,
            floor=floor,
            worth=worth,
            quiet=quiet,
            before=before,
            explained=explained,
            adequate=adequate,
            gaps=(gap_before, gap_refit, gap_after),
            table=table,
            stages=stages,
            stood=stood,
        )

    def conclude(self, base: Rival, w: Weighed) -> Diagnosis:
        self.notes += [f"tried {t}" for t in w.table]
        self.weighed = w
        return self.report(base, w)

    def settle_again(self, rival: Rival, richer: Rival) -> None:
        """Fit once more from where the fit with more effects went: it may have led out of a place of its own."""
        p = self.problem
        there = dict(zip((f.path for f in richer.fit.structure.free), richer.fit.x, strict=True))
        x = np.array(
            [there.get(f.path, v) for f, v in zip(rival.fit.structure.free, rival.fit.x, strict=True)]
        )
        least = trust(p, rival.fit, self.floors)
        fine = finer(least, self.floors)
        try:
            fit, _ = settled(p, rival.fit.structure, x, self.floors, rounds=2, least=least)
        except (InputError, np.linalg.LinAlgError):
            return
        likelihood, old = (innovations(residuals(p, f), fine) + f.prior for f in (fit, rival.fit))
        if likelihood < old:
            rival.fit, rival.held = fit, None
            rival.likelihood += likelihood - old

    def level(self, rival: Rival, best: Rival) -> float:
        """-2 log L of a rival, with the noise that `best` leaves to be reckoned with."""
        least = finer(trust(self.problem, best.fit, self.floors), self.floors)
        return innovations(residuals(self.problem, rival.fit), least) + rival.fit.prior

    def anew(self, structure: Structure, like: Rival) -> Rival | None:
        """A fit from the start values of `structure`, a simpler form of `like`; None where it breaks down."""
        p = self.problem
        try:
            least = trust(p, like.fit, self.floors)
            fit, value = settled(p, structure, structure.start, self.floors, rounds=2, least=least)
        except (InputError, np.linalg.LinAlgError):
            return None
        # the held-out records begin as they did: where motion is rough, a guess may end elsewhere
        about = carried(p, like.held, structure) if like.held else {}
        return Rival(structure.hypotheses, fit, value, about=about)

    def prune(
        self,
        chosen: Rival,
        known: list[Rival],
        stand: Callable[[Rival], Standing],
        quiet: float,
        worth: Array,
        table: list[str],
    ) -> Rival:
        """Try each effect's removal, and each one's special cases, anew: what was named first may have stood for another.

        The parameters that a special case lacks must earn more than small effects make.
        """
        p = self.problem
        while True:
            now = stand(chosen)
            level = self.level(chosen, chosen)
            for gone, structure in simpler(p, chosen):
                swapped = len(structure.hypotheses) == len(chosen.hypotheses)
                r = next((r for r in known if r.hypotheses == structure.hypotheses), None)
                if r is None or (swapped and self.level(r, chosen) > level + 30.0):
                    r = min(
                        (q for q in (r, self.anew(structure, chosen)) if q is not None),
                        key=lambda q: self.level(q, chosen),
                        default=None,
                    )
                if r is None:
                    continue
                try:
                    then = stand(r)
                except (InputError, np.linalg.LinAlgError):
                    continue
                loss = self.level(r, chosen) - level
                change = np.sqrt(np.maximum(then.nrmse**2 - now.nrmse**2, 0.0))
                wider = gap(p, r.fit) / gap(p, chosen.fit)
                if swapped:
                    better = (
                        self.beaten(then, now, quiet)
                        and bool(np.any(change > worth))
                        and (loss > 30.0 or wider > 1.5)
                    )
                else:
                    share = max(
                        (then.score - now.score) / max(then.score - quiet, 1e-12),
                        self.plain_share(then.nrmse, now.nrmse, self.floor),
                    )
                    size = self.sizes(chosen)[chosen.hypotheses.index(gone)]
                    better = (
                        share >= HALF
                        and change.max() >= MATERIAL
                        and size >= SHARE
                        and (loss > 60.0 or wider > 2.0)
                    )
                if not better:
                    table.append(
                        f"{gone.label}: not needed (without it, twice the log likelihood: {-loss:+.0f})"
                    )
                    chosen = r
                    break
            else:
                return chosen

    def plain_share(self, last: Array, now: Array, floor: Array) -> float:
        f = np.maximum(floor, 1e-12)
        top = float(np.sum((last**2 - now**2) / f**2))
        return top / max(float(np.sum(np.maximum(last**2 - floor**2, 0.0) / f**2)), 1e-12)

    def beaten(self, rival: Standing, best: Standing, quiet: float) -> bool:
        """Whether the rival's held-out excess is larger by a tenth, and not by chance."""
        excess = max(best.score - quiet, 0.01 * quiet)
        if rival.score - quiet < AHEAD * excess:
            return False
        d = (rival.blocks - best.blocks).mean(axis=1)
        t = d.mean() / max(d.std(ddof=1) / math.sqrt(len(d)), 1e-12) if len(d) > 1 else 0.0
        return bool(t > 2.0 or rival.rival.likelihood - best.rival.likelihood > 50.0)

    def same(self, rival: Rival, best: Rival) -> bool:
        """Whether the rival is no alternative.

        It has more parameters without gain, the best as a special case, or is in series somewhere else along the same force.
        """
        a, b = rival.hypotheses[-1], best.hypotheses[-1]
        inside = b.effect in CONTAINS.get(a.effect, ()) and set(a.where) == set(b.where)
        # more parameters, a worse fit, and nothing gained on the held-out records: a mimic
        wordy = len(rival.fit.x) > len(best.fit.x) and rival.likelihood - best.likelihood > 30.0
        if a.effect == b.effect:
            known = self.network.nodes
            links = (tuple(twin(n, known) for n in h.where) for h in (a, b))
            return a.where == b.where or (a.effect in SERIES and in_line(self.network, *links))
        return inside or wordy

    def confidence(self, best: Standing, refit: Standing, others: list[Standing], quiet: float) -> float:
        """Share of block resamplings of the held-out records in which the choice stays what it is, never quite 1."""
        count = len(best.blocks)
        hits = 0
        rounds = 500
        for _ in range(rounds):
            pick = self.rng.integers(0, count, count)
            b, r = best.blocks[pick].mean(), refit.blocks[pick].mean()
            hits += bool(
                r - b >= HALF * max(r - quiet, 0.0) and all(o.blocks[pick].mean() > b for o in others)
            )
        return (hits + 0.5) / (rounds + 1.0)

    def gates(self, base: Rival, w: Weighed, others: list[Standing]) -> tuple[Gate, ...]:
        """The five gates with their figures."""
        chosen, quiet = w.chosen, w.quiet
        best, refit = w.stood[id(chosen)], w.stood[id(base)]
        gain = self.level(base, chosen) - self.level(chosen, chosen)
        halved = gap(self.problem, chosen.fit) < HALF * gap(self.problem, base.fit)
        moved = float(np.sqrt(np.maximum(refit.nrmse**2 - best.nrmse**2, 0.0)).max())
        size = min(self.sizes(chosen))
        lead = min((o.score - quiet for o in others), default=math.inf) / max(
            best.score - quiet, 0.01 * quiet
        )
        blocks = (refit.blocks - best.blocks).mean(axis=1)
        again = float(np.mean(blocks > 0))
        return (
            Gate(
                "significant",
                gain > 60.0 or halved,
                gain,
                60.0,
                "twice the log likelihood gained over the refitted model, its own coloured noise allowed for"
                + (" (or half of the gap's power closed, as here)" if halved else ""),
            ),
            Gate(
                "material",
                moved >= MATERIAL and size >= SHARE,
                moved,
                MATERIAL,
                f"share of a channel's standard deviation that it moves; {size:.0%} of the force, current or signal at its place",
            ),
            Gate(
                "adequate",
                w.adequate,
                w.explained,
                ADEQUATE,
                "share of the held-out excess error removed, and of that in the channel with the widest gap; what is left is "
                + ("no more" if w.adequate else "more")
                + " than effects of a few per cent make",
            ),
            Gate(
                "ahead",
                lead >= AHEAD,
                min(lead, 1e3),
                AHEAD,
                "excess error of the nearest rival over its own",
            ),
            Gate(
                "replicated",
                again > 0.5,
                again,
                0.5,
                "share of held-out stretches where it does better than the refitted model",
            ),
        )

    def traces(self, base: Rival, final: Rival) -> tuple[Trace, ...]:
        """Every record, whole, with what the three models say; initial states and offsets from the record itself."""
        out = []
        W = plain(self.whole, self.floors)
        owner = base_structure(self.network)
        for i, record in enumerate(self.whole.records):
            says = []
            for structure, x in (
                (owner, owner.start),
                (base.fit.structure, base.fit.x),
                (final.fit.structure, final.fit.x),
            ):
                f = Fitter(self.whole, W).fit(structure, x, records=[i], frozen=True, iterations=3)
                says.append({c: f.outputs[i][:, j] for j, c in enumerate(self.whole.channels)})
            measured = {c: record.measured[:, j] for j, c in enumerate(self.whole.channels)}
            thin = {k: record.seen(v) for k, v in record.inputs.items()}
            out.append(Trace(record.name, self.whole.held[i], record.time, thin, measured, *says))
        return tuple(out)

    def report(self, base: Rival, w: Weighed) -> Diagnosis:
        p, names = self.problem, self.problem.channels
        verdict, chosen, abreast, floor, stood = w.verdict, w.chosen, w.abreast, w.floor, w.stood
        others = [stood[id(r)] for r in w.rivals if id(r) in stood and not self.same(r, chosen)]
        confidence = self.confidence(stood[id(chosen)], stood[id(base)], others, w.quiet)
        gates = self.gates(base, w, others) if chosen.hypotheses else ()
        named = verdict == "missing_effect"
        final = chosen if named else base
        refit, after = stood[id(base)], stood.get(id(final)) or stood[id(base)]
        rows = {"before": w.before, "refit": refit.nrmse, "after": after.nrmse, "noise_floor": floor}
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
                own = {
                    path.rpartition(".")[2]: q
                    for path, q in fitted.items()
                    if path.rpartition(".")[0] == element
                }
                effects.append(
                    Effect(
                        h.effect,
                        owner_pair(self.network, h),
                        h.where[0] if h.place == "channel" else None,
                        confidence,
                        own,
                        element,
                    )
                )
        contenders = [
            Contender(
                tuple(h.effect for h in r.hypotheses),
                tuple(h.where for h in r.hypotheses),
                (stood[id(r)].score - w.quiet) / max(refit.score - w.quiet, 1e-12),
                r.likelihood - chosen.likelihood,
                "cannot be told apart on these data"
                if r in abreast
                else "errs more on the held-out records than the old model does"
                if stood[id(r)].score > refit.score
                else "explains less of the held-out records",
            )
            for r in ([chosen, *abreast] if verdict == "ambiguous" else w.rivals)
            if id(r) in stood
        ]
        where = places(p, base.fit, floor * self.spread) if verdict != "no_discrepancy" else ()
        laws = []
        for e in effects:
            drawn = law(p, final.fit, e.element, e.parameters)
            if drawn is not None:
                laws.append(drawn)
        following = (
            next_experiment(p, [chosen, *abreast], floor * self.spread) if verdict == "ambiguous" else None
        )
        summary = sentence(verdict, effects, [chosen, *abreast], where, gap)
        return Diagnosis(
            verdict=verdict,
            summary=summary,
            effects=tuple(effects),
            contenders=tuple(contenders),
            where=where,
            parameters=base_parameters,
            gap=gap,
            closed=closed,
            gates=gates,
            next_experiment=following,
            base=self.network,
            refitted=base.fit.network,
            model=model,
            traces=self.traces(base, final),
            laws=tuple(laws),
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
    first, second = (twin(n, known) for n in h.where)
    return first, second


def intervals(problem: Problem, rival: Rival, floors: Array) -> dict[str, Quantity]:
    """Every free parameter with its 95 % interval.

    Noise counts by the curvature under the residual's own coloured noise; the small effects that every rig has and no
    model holds count by how far each of them, `SMALL` of the force, would drag the parameter.
    """
    fit = rival.fit
    W = whitener(residuals(problem, fit), trust(problem, fit, floors))
    f = Fitter(problem, W).fit(fit.structure, fit.x, fit.initial, fit.offset, iterations=0)
    out: dict[str, Quantity] = {}
    if f.hessian is None or not len(f.x):
        return out
    sigma = np.array([q.sigma for q in f.structure.free])
    H = f.hessian + np.diag(1 / sigma**2)
    variance = np.maximum(np.diag(np.linalg.inv(H)), 0.0)
    try:
        dragged, _ = Fitter(problem, W).refit(f, unmodelled(problem, f, SMALL))
        variance = variance + np.sum(dragged**2, axis=1)
    except (InputError, np.linalg.LinAlgError):
        pass
    # no wider than what was known before
    variance = np.minimum(variance, sigma**2)
    known = problem.network.parameters
    for k, q in enumerate(f.structure.free):
        s, x = math.sqrt(variance[k]), f.x[k]
        unit = fit.network.unit_of(q.path)
        out[q.path] = Quantity(q.back(x), q.back(x - 1.96 * s), q.back(x + 1.96 * s), unit, known.get(q.path))
    return out


def plain_number(value: float) -> str:
    """Four significant digits, without an exponent where one can do without."""
    text = f"{value:.4g}"
    return np.format_float_positional(float(text), trim="-") if 1e4 <= abs(value) < 1e7 else text


def sentence(
    verdict: str,
    effects: list[Effect],
    contenders: list[Rival],
    where: tuple[Place, ...],
    gap: dict[str, dict[str, float]],
) -> str:
    """The verdict in a sentence a person can repeat."""

    # the channel that gains most, or, where nothing is named, the one that is off most
    worst = max(gap["refit"], key=lambda c: gap["refit"][c] ** 2 - (gap["after"][c] ** 2 if effects else 0.0))

    def percent(row: str) -> str:
        return f"{100 * gap[row][worst]:.1f} %"

    wide = any(gap["refit"][c] ** 2 - gap["noise_floor"][c] ** 2 > MATERIAL**2 for c in gap["refit"])
    if verdict in ("no_discrepancy", "parameters_only") and wide:
        return f"Nothing worth a name is missing: what is left in {worst} ({percent('before')} before, {percent('refit')} refitted, noise {percent('noise_floor')}) is what effects of a few per cent of the force make, as every rig has them."
    if verdict == "no_discrepancy":
        return "The model agrees with the measurement within noise; nothing is missing."
    if verdict == "parameters_only":
        return f"Parameters within their stated uncertainty explain the difference ({worst}: {percent('before')} before, {percent('refit')} refitted); nothing is missing."
    if verdict == "missing_effect":
        parts = []
        for e in effects:
            spot = f"in channel {e.channel}" if e.channel else f"between {' and '.join(e.between or ())}"
            what = e.effect.replace("_", " ")
            if e.effect in SERIES:
                what, spot = f"{what},", f"in series with what stands {spot}"
            figures = ", ".join(
                f"{k.replace('_', ' ')} {plain_number(q.value)} {q.unit}" for k, q in e.parameters.items()
            )
            parts.append(f"{what} {spot} ({figures})")
        return f"The model lacks {' and '.join(parts)}; with it the error in {worst} on held-out data falls from {percent('refit')} to {percent('after')} (noise {percent('noise_floor')})."
    if verdict == "ambiguous":
        names = " or ".join(" and ".join(h.label.replace("_", " ") for h in r.hypotheses) for r in contenders)
        return f"Something is missing, and these data cannot tell which: {names}."
    spot = f"; it lives mostly in {where[0].channel}, {where[0].when}" if where else ""
    return f"Something is missing that no known effect explains{spot}."
