"""The answer of a diagnosis: the band of the sets of laws that the held-out records do not tell apart."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from .held_out_table import Comparison, compare

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..._common.arrays import Array
    from .criteria import Criteria
    from .held_out_table import Row


@dataclass(frozen=True, eq=False)
class Answer:
    """Sets of laws that explain the records, and what they have in common."""

    #: the refitted model without further laws
    refit: Row
    #: the sets of the band, the simplest first; empty where no law is needed
    band: tuple[Row, ...]
    #: weight of each set of the band
    weights: tuple[float, ...]
    #: the set with the smallest error, in the band or not; the refitted model where no set is sound
    best: Row
    #: width of the band, as a share of the deviation
    width: float
    #: the sets of one law
    singles: tuple[Row, ...] = ()
    #: RMS noise over channels as a share of the deviation
    noise: float = 0.0
    #: log predictive density of the foremost set beside that of the refitted model
    gain: Comparison = field(default_factory=Comparison)

    @property
    def foremost(self) -> Row:
        """The simplest set of the band; the best set where the band is empty."""
        return self.band[0] if self.band else self.best

    @property
    def certain(self) -> tuple[bool, ...]:
        """Whether each member of the foremost set has its kind and place in every set of the band; empty without a band."""
        members = self.foremost.members if self.band else ()
        return tuple(all(m.kind in row.kinds for row in self.band) for m in members)


def removed_share(before: Array, after: Array, noise: Array) -> float:
    """Return the share of a squared error beyond noise, over all channels, that a smaller error removes. `before`, `after`, `noise`: shares
    of the deviation (channels,)."""
    excess = float(np.sum(np.maximum(before**2 - noise**2, 0.0)))
    return float(np.sum(before**2 - after**2)) / max(excess, 1e-12)


def beyond_noise(row: Row, noise: float) -> float:
    """Return the error of a set beyond noise, as a share of the deviation."""
    return float(max(row.error**2 - noise**2, 0.0) ** 0.5)


def excess(error: float, noise: float, c: Criteria) -> float:
    """Return a squared error beyond noise, at least that of the least width: less is no difference."""
    return max(error**2 - noise**2, c.least_width**2)


def share_left(row: Row, other: Row, noise: float, c: Criteria) -> float:
    """Return the squared error beyond noise that a set leaves, as a share of what another leaves: geometric mean over validation and
    training records."""
    held = excess(row.error, noise, c) / excess(other.error, noise, c)
    fitted = excess(row.training_error, noise, c) / excess(
        other.training_error, noise, c
    )
    return float((held * fitted) ** 0.5)


class Table:
    """Rows with the noise level of the best of them."""

    def __init__(
        self, rows: Sequence[Row], best: Row, least: Array, noise: Array, c: Criteria
    ):
        self.c = c
        #: RMS noise over channels as a share of the deviation
        self.noise = float(np.sqrt(np.mean(np.minimum(noise, best.validation) ** 2)))
        self.density = {id(row): row.log_density(best, least) for row in rows}

    def compare(self, row: Row, other: Row) -> Comparison:
        """Compare the log predictive density of a set with that of another."""
        return compare(self.density[id(row)], self.density[id(other)])

    def is_better(self, row: Row, other: Row) -> bool:
        """Return whether a set predicts better than another, beyond chance."""
        return self.compare(row, other).is_better(self.c)

    def competes(self, row: Row, simplest: Row) -> bool:
        """Return whether a set is as simple as the simplest one, or predicts better beyond chance."""
        return row.parameters <= simplest.parameters or self.is_better(row, simplest)

    def leaves(self, row: Row, other: Row) -> float:
        """Return the squared error beyond noise that a set leaves, as a share of what the other leaves."""
        return share_left(row, other, self.noise, self.c)

    def is_alike(self, row: Row, best: Row) -> bool:
        """Return whether chance makes the difference to the best set: the best set predicts no better, and leaves a similar error."""
        return (
            not self.is_better(best, row)
            and self.leaves(best, row) >= self.c.one_more_leaves
        )

    def width(self, best: Row) -> float:
        """Return the difference of errors that is no difference beside a set: it grows with what the set leaves."""
        grown = self.c.width_growth * excess(best.error, self.noise, self.c) ** 0.5
        return min(max(grown, self.c.least_width), self.c.material)


def answer_of(rows: Sequence[Row], least: Array, noise: Array, c: Criteria) -> Answer:
    """Return the answer from the rows of a search, of which the first is the refitted model.

    Args:
        rows: The refitted model and the sets.
        least: Smallest noise of weights (channels,).
        noise: Noise of the validation records as a share of the deviation (channels,).
        c: The limits.
    """
    refit = rows[0]
    singles = tuple(row for row in rows if len(row.members) == 1)
    sound = [row for row in rows[1:] if row.is_sound]
    if not sound:
        return Answer(refit, (), (), refit, c.least_width, singles)
    # faults of sensors and drives only where forces alone leave far more, or explain nothing
    best, table, chosen = _best_of(
        _forces_first(sound, noise, c), rows, least, noise, c
    )
    if not chosen.members:
        best, table, chosen = _best_of(sound, rows, least, noise, c)
    if not chosen.members:
        gain = table.compare(best, refit)
        return Answer(
            refit, (), (), best, table.width(best), singles, table.noise, gain
        )
    width = table.width(chosen)
    pool = [row for row in sound if row.blames <= chosen.blames]
    same = [row for row in pool if len(row.members) == len(chosen.members)]
    near = [
        row
        for row in same
        if row.error - chosen.error < width or table.is_alike(row, chosen)
    ]
    fewest = min(near, key=lambda row: (row.parameters, row.error))
    simplest = simplest_law(same, fewest, table.noise, c, c.one_more_leaves)
    others = [
        row
        for row in near
        if row.kinds != simplest.kinds and table.competes(row, simplest)
    ]
    band = (simplest, *sorted(others, key=lambda r: (r.parameters, r.error)))
    odds = np.exp([(chosen.error - row.error) / width for row in band])
    weights = tuple((odds / odds.sum()).tolist())
    gain = table.compare(simplest, refit)
    return Answer(refit, band, weights, best, width, singles, table.noise, gain)


def _best_of(
    pool: Sequence[Row], rows: Sequence[Row], least: Array, noise: Array, c: Criteria
) -> tuple[Row, Table, Row]:
    """Return the set of a pool with the smallest error, the table with its noise level, and the needed set."""
    best = min(pool, key=lambda row: row.error)
    table = Table(rows, best, least, noise, c)
    return best, table, _needed(pool, rows[0], table)


def _forces_first(rows: Sequence[Row], noise: Array, c: Criteria) -> list[Row]:
    """Return the sets of forces alone; all sets where faults of sensors and drives leave far less."""
    best = min(rows, key=lambda row: row.error)
    forces = [row for row in rows if not row.blames]
    if not best.blames or not forces:
        return forces or list(rows)
    level = float(np.sqrt(np.mean(np.minimum(noise, best.validation) ** 2)))
    rival = min(forces, key=lambda row: row.error)
    is_near = excess(rival.error, level, c) < c.forces_first * excess(
        best.error, level, c
    )
    return forces if is_near else list(rows)


def _needed(rows: Sequence[Row], refit: Row, table: Table) -> Row:
    """Return the best set with as few laws as are needed: more laws must lower the error beyond chance and by a material amount (in power),
    and each of them must remove a share of the rest."""
    c, chosen = table.c, refit
    for count in sorted({len(row.members) for row in rows}):
        best = min(
            (row for row in rows if len(row.members) == count),
            key=lambda row: row.error,
        )
        is_material = chosen.error**2 - best.error**2 > c.material**2
        allowed = c.one_more_leaves ** (count - len(chosen.members))
        if (
            is_material
            and table.leaves(best, chosen) < allowed
            and table.is_better(best, chosen)
        ):
            chosen = best
    return chosen


def simplest_law(
    rows: Sequence[Row], best: Row, noise: float, c: Criteria, leaves: float
) -> Row:
    """Return the set with fewest parameters among those of the same kinds, unless the best one leaves less than a share of what it
    leaves."""
    alike = [
        row
        for row in rows
        if row.kinds == best.kinds and share_left(best, row, noise, c) >= leaves
    ]
    return min([*alike, best], key=lambda row: (row.parameters, row.error))
