"""One table of sets of laws: errors and log predictive densities on the same blocks of the same records, with one noise level."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from .._estimation.gauss_newton import Fitter, residuals
from .._estimation.noise import independent_share, white_weights
from .._estimation.structure import owner_pair
from .contradictions import find_contradiction
from .held_out import BLOCKS, LEAST_BLOCK, block_edges

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from ...physics.network import Network
    from .._estimation.gauss_newton import Fit
    from .._estimation.structure import Hypothesis
    from .held_out import HeldOutEvaluator


@dataclass(frozen=True)
class Member:
    """A law of a set, as it is compared with the laws of other sets."""

    effect: str
    #: terminals in alphabetical order, or the channel or motor
    place: tuple[str, ...]
    mechanism: str
    #: 'between', 'element' or 'channel'
    level: str
    is_series: bool

    @property
    def kind(self) -> tuple[str, tuple[str, ...]]:
        """Kind and place."""
        return self.mechanism, self.place


@dataclass(frozen=True, eq=False)
class Blocks:
    """Mean squared residuals of blocks of records (blocks, channels), and the samples that each block stands for (blocks,)."""

    power: Array
    samples: Array

    def log_density(self, level: Array, share: Array, least: Array) -> Array:
        """Return the log predictive density of each block (blocks,) [nats], without constants: Student's t, with the noise `level`, the
        `share` of independent samples and the smallest noise `least` (channels,)."""
        floor = np.minimum(share * (least / level) ** 2, 1.0)
        ratio = share * self.power / level**2 / floor
        return np.asarray(-np.sum(self.samples[:, None] * share * np.log1p(ratio), axis=1))


@dataclass(frozen=True, eq=False)
class Row:
    """A set of laws with its errors on training, validation and test records."""

    fit: Fit
    #: simulation of the held-out records
    held: Fit
    members: tuple[Member, ...]
    #: number of fitted parameters
    parameters: int
    #: number of initial states of a record
    states: int
    #: errors as shares of the deviation (channels,)
    validation: Array
    test: Array
    training: Array
    validation_blocks: Blocks
    training_blocks: Blocks
    #: level of the training residuals (channels,), and share of independent samples
    level: Array
    share: Array
    #: how the values of a law contradict its name; empty where they do not
    contradiction: str

    @property
    def error(self) -> float:
        """Error on the validation records, root of the mean square over channels."""
        return float(np.sqrt(np.mean(self.validation**2)))

    @property
    def kinds(self) -> frozenset[tuple[str, tuple[str, ...]]]:
        """Kinds and places of the members."""
        return frozenset(m.kind for m in self.members)

    @property
    def is_sound(self) -> bool:
        """Whether no value contradicts its law's name, and no two laws of a kind make a curve fit at one place."""
        return not self.contradiction and len(self.kinds) == len(self.members)

    @property
    def blames(self) -> bool:
        """Whether a member is a fault of a sensor or a drive."""
        return any(m.level != "between" for m in self.members)

    def log_density(self, best: Row, least: Array) -> Array:
        """Return the log predictive density of the blocks of validation and training records (blocks,) [nats], with the noise level of the
        set `best` and the smallest noise `least` (channels,); less one nat per parameter (Akaike 1974)."""
        parts = [
            x.log_density(best.level, best.share, least)
            for x in (self.validation_blocks, self.training_blocks)
        ]
        parts[1] = parts[1] - self.parameters / len(parts[1])
        return np.concatenate(parts)


def row_of(evaluator: HeldOutEvaluator, fit: Fit) -> Row:
    """Return the row of a fitted set; raise InputError where a record cannot be simulated."""
    p = evaluator.problem
    fitter = Fitter(p, white_weights(evaluator.least_noise))
    after = evaluator._states_after_training(fit)
    held = fitter.follow(fit.structure, fit.x, p.held, None, (after,))
    evaluator._check_whole_records(fit, held)
    left = residuals(p, fit)
    level = np.maximum(np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0)), evaluator.least_noise)
    network = p.network
    contradictions = [find_contradiction(p, fit, fit.network.element(n)) for n in fit.structure.names]
    return Row(
        fit=fit,
        held=held,
        members=tuple(_member(network, h) for h in fit.structure.hypotheses),
        parameters=len(fit.x),
        states=max((len(s) for s in fit.initial.values()), default=0),
        validation=evaluator.nrmse(held, p.choosing, evaluator.validation_deviation),
        test=evaluator.nrmse(held, p.reporting, evaluator.test_deviation),
        training=evaluator.nrmse(fit, p.estimation, evaluator.training_deviation),
        validation_blocks=_blocks(evaluator, held, p.choosing),
        training_blocks=_blocks(evaluator, fit, p.estimation),
        level=level,
        share=independent_share(left),
        contradiction="; ".join(c for c in contradictions if c),
    )


def _member(network: Network, h: Hypothesis) -> Member:
    pair = owner_pair(network, h)
    place = tuple(sorted(pair)) if pair else h.where
    return Member(h.effect, place, h.kind.mechanism, h.place, h.kind.series)


def _blocks(evaluator: HeldOutEvaluator, fit: Fit, records: Sequence[int]) -> Blocks:
    power, samples = [], []
    for i in records:
        y = evaluator.problem.records[i].measured
        square = (y - fit.outputs[i]) ** 2
        edges = block_edges(y, BLOCKS, LEAST_BLOCK)
        for a, b in pairwise(edges):
            power.append(square[a:b].mean(axis=0))
            samples.append(len(y) / (len(edges) - 1))
    return Blocks(np.array(power), np.array(samples))
