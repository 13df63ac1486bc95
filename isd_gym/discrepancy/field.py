"""Small effects before the test: what each would do to every channel, and how much of it the others could make up for.

The response to a small effect is linear in its size, so all distances between effects, after the owner's parameters and
the initial states are refitted, follow from one matrix of products per channel; a sensor more is one matrix more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..elements import Start
from ..errors import InputError
from ..network import Channel, Network, assemble
from .hypotheses import hypotheses
from .judge import LEAST_NOISE
from .motion import setting, together
from .problem import Array, Problem, bare
from .structure import Hypothesis, Structure, add
from .tangent import tangents

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from .fit import Fit
    from .stand import Stand

STARTS = 5  # of a hypothesis at most: shapes between them are found by refitting
#: share of a response that, left by a refit, is no more than rounding
NOTHING = 1e-3


@dataclass(frozen=True, eq=False)
class Shape:
    """A start of a hypothesis, and where its ways stand among the columns."""

    hypothesis: Hypothesis
    start: Start
    columns: tuple[int, ...]
    typical: bool  # the shape of which sizes are told


Begun = tuple[Hypothesis, Start, bool]


def starts_of(stand: Stand, wanted: Sequence[Hypothesis], most: int = STARTS) -> list[Begun]:
    """Every hypothesis at a few of its starts, sized by the motion on the stand; of the middle one sizes are told."""
    out = []
    for h in wanted:
        pair = stand.motion.get((h.where[0], h.where[1])) if len(h.where) == 2 else None
        try:
            starts = h.kind.starts(setting(stand.problem, stand.network, h, pair, stand.forces.at(h.where)))
        except (InputError, ValueError, ZeroDivisionError):
            continue
        if not starts:
            continue
        middle, last = len(starts) // 2, len(starts) - 1
        spread = np.linspace(0, last, min(most, len(starts))).astype(int).tolist() if most > 1 else []
        out += [(h, starts[k], k == middle) for k in sorted({middle, *spread})]
    return out


def _built(structure: Structure, h: Hypothesis, start: Start, typical: bool) -> list[Structure] | None:
    """A start built into a structure in each of its ways; the typical one begins with the way of which sizes are told."""
    try:
        ways = [h.kind.grown(start, 1.0), *start.ways[1:]] if typical else start.ways
        built = [add(structure, h, way) for way in ways]
        for b in built:
            assemble(bare(b.network))
    except (InputError, np.linalg.LinAlgError):
        return None
    return built


def sensors(network: Network) -> list[Channel]:
    """What else could be measured: accelerations of masses, elongations and forces of joined pairs."""
    have = {(c.quantity, c.at, frozenset(c.between or ()), frozenset(c.elements)) for c in network.outputs}
    out = [network.probe(f"{m}_acceleration", "acceleration", at=m) for m in network.masses]
    pairs: dict[frozenset[str], list[str]] = {}
    order: dict[frozenset[str], tuple[str, str]] = {}
    for e in network.elements:
        if e.place == "between" and not e.series:
            pairs.setdefault(frozenset(e.where), []).append(e.name)
            order.setdefault(frozenset(e.where), e.between)
    for pair, names in pairs.items():
        first, second = order[pair]
        out.append(network.probe(f"{first}_{second}_travel", "displacement", between=(first, second)))
        same = tuple(n for n in names if network.element(n).where == order[pair])
        cell = network.probe(f"{first}_{second}_force", "force", element=same[0])
        out.append(replace(cell, element=same) if len(same) > 1 else cell)
    moved = {str(c.at) for c in network.inputs if c.quantity == "displacement"}
    out += [network.probe(f"{n}_force", "force", at=n) for n in sorted(moved)]
    taken = {c.name for c in (*network.inputs, *network.outputs)}
    new = []
    for c in out:
        known = (c.quantity, c.at, frozenset(c.between or ()), frozenset(c.elements)) in have
        if known or c.name in taken or (c.between and set(c.between) <= moved | {"ground"}):
            continue
        try:
            assemble(bare(replace(network, outputs=(*network.outputs, c))))
        except (InputError, np.linalg.LinAlgError):
            continue
        new.append(c)
    return new


class Field:
    """The responses of all hypotheses on a stand, and of the owner's parameters, in the channels there are and `more`."""

    def __init__(
        self,
        stand: Stand,
        begun: Sequence[Begun] | None = None,
        more: Sequence[Channel] = (),
        say: Callable[[float], None] = lambda share: None,
    ):
        self.stand = stand
        self.more = tuple(more)
        begun = starts_of(stand, list(hypotheses(stand.network))) if begun is None else begun
        network = replace(stand.network, outputs=(*stand.network.outputs, *self.more))
        base = stand.structure
        wider = Structure(network, base.free, base.hypotheses, base.names, base.ties)
        self.shapes: list[Shape] = []
        built: list[Structure] = []
        for h, start, typical in begun:
            ways = _built(wider, h, start, typical)
            if ways is None:
                continue
            columns = tuple(range(len(built), len(built) + len(ways)))
            self.shapes.append(Shape(h, start, columns, typical))
            built += ways
        records = []
        for i in stand.problem.estimation:
            r = stand.problem.records[i]
            records.append(replace(r, measured=np.hstack([r.measured, np.zeros((len(r), len(self.more)))])))
        wide = Problem(network, records, ["fit"] * len(records), stand.problem.step, stand.problem.time)
        self._products(wide, wider, [b.network for b in built], say)

    def _products(
        self, wide: Problem, s: Structure, networks: Sequence[Network], say: Callable[[float], None]
    ) -> None:
        """Per record and channel the products of all columns: parameters, initial states and offsets, responses."""
        stand, ny = self.stand, len(wide.channels)
        own = dict(zip(range(len(wide.records)), stand.problem.estimation, strict=True))
        initial = {k: stand.base.initial[i] for k, i in own.items()}
        fit = replace(stand.estimated, structure=s, initial=initial, outputs={})
        lanes = {k: np.full((len(r), ny, len(networks)), np.nan) for k, r in enumerate(wide.records)}
        point = {k: wide.simulate([wide.network], k, initial[k][:, None], like=wide.network) for k in lanes}
        done = 0
        for chunk, k, y in together(wide, fit, networks):
            with np.errstate(over="ignore", invalid="ignore"):
                lanes[k][:, :, chunk] = y - point[k]
            done += len(chunk)
            say(min(1.0, done / max(1, len(networks) * len(lanes))))
        for k, y in lanes.items():  # one that breaks down takes those beside it along
            for c in np.flatnonzero(np.isnan(y).all(axis=(0, 1))).tolist():
                for _, _, alone in together(_only(wide, k), _at(fit, k), [networks[c]]):
                    y[:, :, c] = alone[:, :, 0] - point[k][:, :, 0]
        self.broken = {
            c for y in lanes.values() for c in np.flatnonzero(~np.isfinite(y).all(axis=(0, 1))).tolist()
        }
        slopes = tangents(wide, s, stand.structure.start, initial)
        self.grams: list[Array] = []  # a record each: (channels, columns, columns)
        self.nuisance: list[int] = []
        self.power = np.zeros((ny, len(networks)))
        parts, self.deviation = [], np.zeros(ny)
        for k, y in lanes.items():
            y[:, :, sorted(self.broken)] = 0.0
            dp, ds = slopes[k].by_parameter, slopes[k].by_state
            free = wide.nuisances(k, point[k][:, :, 0])
            X = np.concatenate([dp, ds, free, y], axis=2)
            self.nuisance.append(ds.shape[2] + free.shape[2])
            self.grams.append(np.stack([X[:, j].T @ X[:, j] for j in range(ny)]))
            self.power += np.sum(y**2, axis=0)
            parts.append(point[k][:, :, 0])
        self.deviation = np.concatenate(parts).std(axis=0)
        self.samples = sum(map(len, parts))
        self.noise = np.concatenate(
            [stand.noise, [self._noise_of(c, j + len(stand.noise)) for j, c in enumerate(self.more)]]
        )
        self.level = np.hypot(self.noise, np.maximum(self.noise, LEAST_NOISE * self.deviation))

    def _noise_of(self, c: Channel, j: int) -> float:
        """Of a sensor that is not there: as the one of its kind that is, else a hundredth of its deviation."""
        own = self.stand.network.outputs
        like = [
            s
            for s, o in zip(self.stand.noise, own, strict=True)
            if (o.quantity, o.unit) == (c.quantity, c.unit)
        ]
        return float(max([*like, LEAST_NOISE * self.deviation[j]])) or 1.0

    # -- distances --------------------------------------------------------------------------------------------
    def left(self, extra: Sequence[int] = ()) -> Array:
        """Products (responses, responses) of what refitting leaves, in noise units, with some of the sensors `more`."""
        stand = self.stand
        pick = [*range(len(stand.noise)), *(len(stand.noise) + k for k in extra)]
        weight = 1.0 / self.level[pick] ** 2
        p = len(stand.structure.free)
        sigma = np.array([f.sigma for f in stand.structure.free])
        total: Array | None = None
        for G, n in zip(self.grams, self.nuisance, strict=True):
            g = np.tensordot(weight, G[pick], axes=1) * stand.repeat
            rest = [*range(p), *range(p + n, len(g))]
            total = _without(g, range(p, p + n), rest) + (0.0 if total is None else total)
        assert total is not None
        if p:
            total[np.arange(p), np.arange(p)] += 1.0 / sigma**2
        return _without(total, range(p), range(p, len(total)))

    def size(self, extra: Sequence[int] = ()) -> Array:
        """Norm of each response (responses,) in noise units, before anything is refitted."""
        pick = [*range(len(self.stand.noise)), *(len(self.stand.noise) + k for k in extra)]
        return np.asarray(
            np.sqrt(self.stand.repeat * np.sum(self.power[pick] / self.level[pick, None] ** 2, axis=0))
        )

    @cached_property
    def typical(self) -> list[int]:
        """Which shapes sizes are told of."""
        return [k for k, s in enumerate(self.shapes) if s.typical and s.columns[0] not in self.broken]

    def rivals(self) -> dict[Hypothesis, list[int]]:
        """The shapes of every hypothesis that did not break down."""
        out: dict[Hypothesis, list[int]] = {}
        for k, s in enumerate(self.shapes):
            if not set(s.columns) & self.broken:
                out.setdefault(s.hypothesis, []).append(k)
        return out

    def apart(self, left: Array, size: Array) -> tuple[Array, Array]:
        """(distance of each typical shape from the closest that each shape comes, (typical, shapes); its amplitudes
        (typical, shapes, 2)), for truths of the size of their starts; no better than not at all where it breaks down."""
        truths = np.array([self.shapes[k].columns[0] for k in self.typical], dtype=int)
        whole = np.maximum(np.diag(left)[truths], 0.0)
        rest = np.repeat(whole[:, None], len(self.shapes), axis=1)
        amplitude = np.zeros((*rest.shape, 2))
        for k, s in enumerate(self.shapes):
            b = list(s.columns)
            block, row = left[np.ix_(b, b)], left[b][:, truths]
            scale = np.sqrt(np.maximum(np.diag(block), 1e-300))
            if set(b) & self.broken or np.any(scale < NOTHING * size[b]):  # nothing of its own
                continue
            found = np.linalg.pinv(block / np.outer(scale, scale), rcond=1e-9, hermitian=True) @ (
                row / scale[:, None]
            )
            own = (found / scale[:, None]).T
            fits = np.ones(len(truths), bool) if s.start.signed else (own > 0).all(axis=1)
            rest[fits, k] = (whole - np.einsum("ij,ji->i", own, row))[fits]
            amplitude[fits, k, : len(b)] = own[fits]
        return np.sqrt(np.maximum(rest, 0.0)), amplitude


def _only(problem: Problem, index: int) -> Problem:
    return Problem(problem.network, [problem.records[index]], ["fit"], problem.step, problem.time)


def _at(fit: Fit, index: int) -> Fit:
    return replace(fit, initial={0: fit.initial[index]})


def _without(g: Array, gone: Sequence[int], kept: Sequence[int]) -> Array:
    """Products of the kept columns with what the others explain taken out (Schur's complement)."""
    if not len(gone):
        return g[np.ix_(kept, kept)]
    C, B = g[np.ix_(gone, gone)], g[np.ix_(gone, kept)]
    scale = np.sqrt(np.maximum(np.diag(C), 1e-300))
    C = C / np.outer(scale, scale) + 1e-11 * np.eye(len(C))
    B = B / scale[:, None]
    return np.asarray(g[np.ix_(kept, kept)] - B.T @ np.linalg.solve(C, B), dtype=np.float64)


__all__ = ["Begun", "Field", "Shape", "sensors", "starts_of"]
