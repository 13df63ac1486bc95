"""Linearised responses of the outputs to small effects, and distances between effects.

The response to a small effect is linear in the effect's size. One matrix of products per channel therefore gives the
distances between all effects after a refit of parameters and initial states. An additional sensor adds one matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from isd_gym._common.errors import InputError, shown
from isd_gym.diagnosis._estimation.sensitivities import tangents
from isd_gym.diagnosis._estimation.structure import Hypothesis, Structure, add, in_line, twin
from isd_gym.diagnosis._hypotheses.library import hypotheses
from isd_gym.diagnosis._hypotheses.motion import setting, simulate_variants
from isd_gym.diagnosis._selection.candidate import is_special_case
from isd_gym.diagnosis._selection.criteria import LEAST_NOISE
from isd_gym.diagnosis._simulation.problem import BROKEN, Problem, bare, deviation_within
from isd_gym.physics.elements import Start, parameter_fields
from isd_gym.physics.network import Channel, Network, assemble

from .virtual_bench import REQUIRED_DEVIANCE

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Mapping, Sequence

    from isd_gym._common.arrays import Array
    from isd_gym.diagnosis._estimation.gauss_newton import Fit

    from .virtual_bench import VirtualBench

STARTS = 5  # of a hypothesis at most; refits find the shapes between
NEGLIGIBLE = 1e-3  # share of a response that may be rounding
FARTHEST = 20.0  # largest size of interest, as a multiple of the start's size


# --------------------------------------------------------------------------------------------------- hypotheses


@dataclass(frozen=True, eq=False)
class ChosenStart:
    """A start of a hypothesis."""

    hypothesis: Hypothesis
    start: Start
    is_typical: bool  # whether results are reported for the start


@dataclass(frozen=True, eq=False)
class LawShape(ChosenStart):
    """A start of a hypothesis with the columns of its responses."""

    columns: tuple[int, ...]


def choose_starts(bench: VirtualBench, wanted: Sequence[Hypothesis], most: int = STARTS) -> list[ChosenStart]:
    """Choose some starts of each hypothesis, scaled to the motion on the bench; the middle start is typical.

    Args:
        bench: The virtual bench.
        wanted: The hypotheses.
        most: Starts per hypothesis at most, beside the typical start.

    Returns:
        The starts in the order of the hypotheses.
    """
    out = []
    for h in wanted:
        pair = bench.motion.get((h.where[0], h.where[1])) if len(h.where) == 2 else None
        load = bench.load_of(h) if h.kind.loaded else None
        try:
            at = setting(bench.problem, bench.network, h, pair, bench.forces.at(h.where), load=load)
            starts = h.kind.starts(at)
        except (InputError, ValueError, ZeroDivisionError):
            continue
        if starts:
            middle, last = len(starts) // 2, len(starts) - 1
            spread = np.linspace(0, last, min(most, len(starts))).astype(int).tolist() if most > 1 else []
            out += [ChosenStart(h, starts[k], k == middle) for k in sorted({middle, *spread})]
    return out


def select_hypotheses(network: Network, only: Sequence[str]) -> list[Hypothesis]:
    """Select the hypotheses that contain all given words.

    Args:
        network: The nominal model.
        only: Effects, nodes or channels.

    Returns:
        The hypotheses with one of the effects, if any, and all of the nodes and channels.

    Raises:
        InputError: No hypothesis contains a word.
    """
    every = list(hypotheses(network))
    known = {word for h in every for word in (h.effect, *h.where)}
    for word in only:
        if word not in known:
            raise InputError(
                f"--only: no effect, node or channel {shown(word)} among the hypotheses (there are: {', '.join(sorted(known))})"
            )
    effects = {h.effect for h in every}.intersection(only)
    places = set(only) - effects
    return [h for h in every if (not effects or h.effect in effects) and places <= set(h.where)]


def is_rival(network: Network, rival: Hypothesis, truth: Hypothesis) -> bool:
    """Return whether a diagnosis that names `rival` instead of `truth` would be wrong but plausible.

    Returns:
        False for equal laws along one force path, for generalisations of the truth, and for laws with more parameters.
    """
    if rival.effect == truth.effect:
        links = (tuple(twin(n, network.nodes) for n in h.where) for h in (rival, truth))
        if rival.where == truth.where or (rival.kind.series and in_line(network, *links)):
            return False
    elif is_special_case(rival, truth):
        return False
    return _count_parameters(network, rival) <= _count_parameters(network, truth)


def _count_parameters(network: Network, h: Hypothesis) -> int:
    """Return the number of free parameters of a hypothesis."""
    tied = h.kind.tied(network, h.where) if h.place == "between" else {}
    return sum(not f.metadata["fixed"] and f.name not in tied for f in parameter_fields(h.kind))


# ----------------------------------------------------------------------------------------------------- responses


@dataclass(frozen=True, eq=False)
class Distances:
    """Linearised distances [standard deviations of the noise], for typical shapes at the size of the start."""

    response: Array  # norm of the response (typical,)
    remainder: Array  # norm of the response after a refit of the nominal model (typical,)
    to_shape: Array  # distance from each refitted shape (typical, shapes)
    amplitude: Array  # amplitudes of the refitted shapes (typical, shapes, 2)


class Sensitivities:
    """Responses of existing and additional channels to all hypotheses and to the nominal model's parameters.

    Args:
        bench: The virtual bench.
        starts: Starts of the hypotheses. Default: `choose_starts` for all hypotheses.
        more: Additional channels.
        progress: Function that receives the finished share.
    """

    def __init__(
        self,
        bench: VirtualBench,
        starts: Sequence[ChosenStart] | None = None,
        more: Sequence[Channel] = (),
        progress: Callable[[float], None] = lambda share: None,
    ):
        self.bench = bench
        self.more = tuple(more)
        starts = choose_starts(bench, list(hypotheses(bench.network))) if starts is None else starts
        network = replace(bench.network, outputs=(*bench.network.outputs, *self.more))
        base = bench.structure
        wide = Structure(network, base.free, base.hypotheses, base.names, base.ties)
        self.shapes: list[LawShape] = []
        networks: list[Network] = []
        for s in starts:
            built = _build_ways(wide, s)
            columns = tuple(range(len(networks), len(networks) + len(built)))
            if built:
                self.shapes.append(LawShape(s.hypothesis, s.start, s.is_typical, columns))
                networks += built
        p, records = bench.problem, []
        for i in p.estimation:
            r = p.records[i]
            records.append(replace(r, measured=np.hstack([r.measured, np.zeros((len(r), len(self.more)))])))
        problem = Problem(network, records, step=p.step, time=p.time)
        self._compute_products(problem, wide, networks, progress)

    def _compute_products(
        self,
        problem: Problem,
        structure: Structure,
        networks: Sequence[Network],
        progress: Callable[[float], None],
    ) -> None:
        """Compute the products of all columns: parameters, initial states and offsets, responses."""
        bench, channels = self.bench, len(problem.channels)
        initial = dict(enumerate(bench.nominal.initial[i] for i in bench.problem.estimation))
        nominal = {
            k: problem.simulate([problem.network], k, x0[:, None], like=problem.network)
            for k, x0 in initial.items()
        }
        fit = replace(bench.training_fit, structure=structure, initial=initial, outputs={})
        responses = _simulate_responses(problem, fit, nominal, networks, progress)
        #: columns whose simulation fails
        self.broken = {
            c for y in responses.values() for c in np.flatnonzero(~np.isfinite(y).all(axis=(0, 1))).tolist()
        }
        slopes = tangents(problem, structure, bench.structure.start, initial)
        self._products: list[Array] = []  # (channels, columns, columns) per record
        self._nuisances: list[int] = []  # number of initial states and offsets per record
        self._power = np.zeros((channels, len(networks)))  # sum of squares of the responses
        for k, y in responses.items():
            y[:, :, sorted(self.broken)] = 0.0
            by_state = slopes[k].by_state
            free = problem.nuisances(k, nominal[k][:, :, 0])
            common = problem.common(nominal[k][:, :, 0])
            X = np.concatenate([slopes[k].by_parameter, common, by_state, free, y], axis=2)
            self._nuisances.append(by_state.shape[2] + free.shape[2])
            self._products.append(np.stack([X[:, j].T @ X[:, j] for j in range(channels)]))
            self._power += np.sum(y**2, axis=0)
        self._shared = int(problem.shared_offset.sum())  # offsets that all records share
        names = [problem.records[k].name for k in nominal]
        deviation = deviation_within([y[:, :, 0] for y in nominal.values()], names)
        own = len(bench.noise)
        more = [self._assumed_noise(c, d) for c, d in zip(self.more, deviation[own:], strict=True)]
        #: RMS noise (channels,) [unit of the channel], of existing and additional channels
        self.noise = np.concatenate([bench.noise, more])
        self._weighting_noise = np.hypot(self.noise, np.maximum(self.noise, LEAST_NOISE * deviation))

    def _assumed_noise(self, c: Channel, deviation: float) -> float:
        """Return the RMS noise of an additional channel: as in channels of the same kind, at least 1 %."""
        bench = self.bench
        kind = (c.quantity, c.unit)
        like = [
            s for s, o in zip(bench.noise, bench.network.outputs, strict=True) if (o.quantity, o.unit) == kind
        ]
        return float(max([*like, LEAST_NOISE * deviation])) or 1.0

    # -- distances ------------------------------------------------------------------------------------------
    @cached_property
    def typical(self) -> list[int]:
        """Indices of the typical shapes."""
        return [k for k, s in enumerate(self.shapes) if s.is_typical and s.columns[0] not in self.broken]

    @cached_property
    def by_hypothesis(self) -> dict[Hypothesis, list[int]]:
        """Indices of the shapes of each hypothesis."""
        out: dict[Hypothesis, list[int]] = {}
        for k, s in enumerate(self.shapes):
            if not self.broken.intersection(s.columns):
                out.setdefault(s.hypothesis, []).append(k)
        return out

    def _project(self, channels: Sequence[int]) -> Array:
        """Return products (responses, responses) after a refit of the nominal model, in units of the noise."""
        bench = self.bench
        weight = 1.0 / self._weighting_noise[channels] ** 2
        sigma = bench.structure.sigma
        p = len(sigma) + self._shared
        total: Array | float = 0.0
        for products, n in zip(self._products, self._nuisances, strict=True):
            gram = np.tensordot(weight, products[channels], axes=1) * bench.length_factor
            kept = [*range(p), *range(p + n, len(gram))]
            total = _eliminate(gram, range(p, p + n), kept) + total
        total = np.asarray(total)
        own = np.arange(len(sigma))
        total[own, own] += 1.0 / sigma**2
        return _eliminate(total, range(p), range(p, len(total)))

    def distances(self, additional: int | None = None) -> Distances:
        """Compute the distances of typical shapes from all refitted shapes.

        Args:
            additional: Index of an additional channel in `more` that is measured, too.

        Returns:
            The distances; the amplitudes are zero for shapes that do not reduce the distance.
        """
        channels = list(range(len(self.bench.noise)))
        if additional is not None:
            channels.append(len(channels) + additional)
        left = self._project(channels)
        power = self._power[channels] / self._weighting_noise[channels, None] ** 2
        size = np.sqrt(self.bench.length_factor * np.sum(power, axis=0))
        truths = np.array([self.shapes[k].columns[0] for k in self.typical], dtype=int)
        whole = np.maximum(np.diag(left)[truths], 0.0)
        rest = np.repeat(whole[:, None], len(self.shapes), axis=1)
        amplitude = np.zeros((*rest.shape, 2))
        for k, s in enumerate(self.shapes):
            columns = list(s.columns)
            block, products = left[np.ix_(columns, columns)], left[columns][:, truths]
            scale = np.sqrt(np.maximum(np.diag(block), 1e-300))
            if self.broken.intersection(columns) or np.any(scale < NEGLIGIBLE * size[columns]):
                continue
            inverse = np.linalg.pinv(block / np.outer(scale, scale), rcond=1e-9, hermitian=True)
            own = (inverse @ (products / scale[:, None]) / scale[:, None]).T
            fits = np.ones(len(truths), bool) if s.start.signed else (own > 0).all(axis=1)
            rest[fits, k] = (whole - np.einsum("ij,ji->i", own, products))[fits]
            amplitude[fits, k, : len(columns)] = own[fits]
        return Distances(size[truths], np.sqrt(whole), np.sqrt(np.maximum(rest, 0.0)), amplitude)

    def smallest_sizes(
        self, additional: int | None = None, wanted: Container[Hypothesis] | None = None
    ) -> Array:
        """Compute the smallest size at which noise permits to distinguish a typical shape from all rivals.

        Args:
            additional: Index of an additional channel in `more` that is measured, too.
            wanted: Hypotheses to be considered. Default: all.

        Returns:
            Sizes (typical,) as multiples of the start's size; infinite for shapes that cannot be distinguished.
        """
        d, network, out = self.distances(additional), self.bench.network, []
        for t, k in enumerate(self.typical):
            h = self.shapes[k].hypothesis
            if wanted is not None and h not in wanted:
                continue
            groups = [own for r, own in self.by_hypothesis.items() if is_rival(network, r, h)]
            rivals = [j for own in groups for j in own]
            least = min(float(d.remainder[t]), *d.to_shape[t, rivals].tolist(), math.inf)
            is_distinct = least > NEGLIGIBLE * d.response[t] and least > 0
            out.append(math.sqrt(REQUIRED_DEVIANCE) / least if is_distinct else math.inf)
        return np.array(out)


def _build_ways(structure: Structure, s: ChosenStart) -> list[Network]:
    """Add an effect to a structure in each of the start's ways; return no network if an addition fails."""
    first = [s.hypothesis.kind.grown(s.start, 1.0)] if s.is_typical else [s.start.ways[0]]
    try:
        built = [add(structure, s.hypothesis, way).network for way in (*first, *s.start.ways[1:])]
        for network in built:
            assemble(bare(network))
    except BROKEN:
        return []
    return built


def _simulate_responses(
    problem: Problem,
    fit: Fit,
    nominal: Mapping[int, Array],
    networks: Sequence[Network],
    progress: Callable[[float], None],
) -> dict[int, Array]:
    """Simulate the change of the outputs by small effects.

    Args:
        problem: The nominal model with all channels.
        fit: The fit with the initial states.
        nominal: Outputs of the nominal model (samples, channels, 1) by record.
        networks: The nominal model with one effect each.
        progress: Function that receives the finished share.

    Returns:
        Changes (samples, channels, networks) by record; NaN if a simulation fails.
    """
    out = {k: np.full((*y.shape[:2], len(networks)), np.nan) for k, y in nominal.items()}
    done = 0
    for chunk, k, y in simulate_variants(problem, fit, networks):
        with np.errstate(over="ignore", invalid="ignore"):
            out[k][:, :, chunk] = y - nominal[k]
        done += len(chunk)
        progress(min(1.0, done / max(1, len(networks) * len(out))))
    for k, y in out.items():  # a failed simulation may have stopped the networks beside it
        single = problem.with_records([problem.records[k]], ["fit"])
        own = replace(fit, initial={0: fit.initial[k]})
        for c in np.flatnonzero(np.isnan(y).all(axis=(0, 1))).tolist():
            for _, _, alone in simulate_variants(single, own, [networks[c]]):
                y[:, :, c] = alone[:, :, 0] - nominal[k][:, :, 0]
    return out


def _eliminate(gram: Array, gone: Sequence[int], kept: Sequence[int]) -> Array:
    """Return the products of the kept columns after a least-squares fit by the other columns (Schur complement)."""
    if not len(gone):
        return gram[np.ix_(kept, kept)]
    own, cross = gram[np.ix_(gone, gone)], gram[np.ix_(gone, kept)]
    scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
    own = own / np.outer(scale, scale) + 1e-11 * np.eye(len(own))
    cross = cross / scale[:, None]
    return np.asarray(gram[np.ix_(kept, kept)] - cross.T @ np.linalg.solve(own, cross), dtype=np.float64)
