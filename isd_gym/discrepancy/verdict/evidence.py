"""Everything that is measured of one candidate, once: the numbers that `criteria.decide` reads."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


def row(values: Iterable[float]) -> tuple[float, ...]:
    """One number a channel, as plain ones."""
    return tuple(float(v) for v in values)


@dataclass(frozen=True)
class EffectEvidence:
    """One effect of a candidate.

    share: of the force, current or signal at its place. spread: half of its widest 95 % interval over the value.
    complaint: why its values cannot be what its name says, empty where they can. sensor: whether it is a sensor's fault,
    and `fault` how large a one (of a gain, or of the time in which the motion changes).
    """

    label: str
    share: float
    spread: float = 0.0
    complaint: str = ""
    sensor: bool = False
    fault: float = 0.0
    #: share of the excess error without the effect that the effect removes
    removed: float = 0.0
    #: excess error without the effect, mean over channels, as a share of the deviation
    width: float = 0.0
    #: whether that excess is larger in a channel than unmodelled effects make it
    beyond_small: bool = False


@dataclass(frozen=True)
class Evidence:
    """A candidate against the owner's model refitted. Per channel, as shares of its deviation on the records to choose by:

    before, refit, after: errors of the owner's model, of it refitted, and of the candidate. floor: noise; floor_known:
    whether the signal or the owner tells it, or it is only bounded. worth: excess that small effects make of the model
    refitted; worth_after: of the candidate, which may have many rests. Of the candidate: its `effects`; explained: share of the refitted model's excess; lead: excess of the nearest rival of another kind over its own, and those that are abreast;
    force_lead: the same of the best rival that blames no sensor; sure: how often it is chosen when held-out blocks are drawn anew;
    shapeless: share of what it leaves that a free curve in its effect's place removes.
    fitted_refit, fitted_after, fitted_explained: errors, and the share that is explained, on the records that were fitted to.
    closest: errors of the richest candidate, and `closest_share` the largest share of its effects. limits, refit_limits: what the candidate, and
    the model refitted, ask for beyond what the owner allows; beside: parameters of the owner's laws over the same plane at an effect's
    place, which may make one law of another.
    """

    channels: tuple[str, ...]
    before: tuple[float, ...]
    refit: tuple[float, ...]
    after: tuple[float, ...]
    floor: tuple[float, ...]
    floor_known: tuple[bool, ...]
    worth: tuple[float, ...]
    effects: tuple[EffectEvidence, ...] = ()
    #: log predictive density minus that of the refitted model [nats], and its standard error
    elpd_diff: float = 0.0
    elpd_dse: float = math.inf
    explained: float = 0.0
    lead: float = math.inf
    abreast: tuple[str, ...] = ()
    force_lead: float = math.inf
    fitted_refit: tuple[float, ...] = ()
    fitted_after: tuple[float, ...] = ()
    closest: tuple[float, ...] = ()
    closest_share: float = 1.0
    limits: tuple[str, ...] = ()
    refit_limits: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    worth_after: tuple[float, ...] = ()
    fitted_explained: float = 0.0
    sure: float = 1.0
    shapeless: float = 0.0
    #: share of the refitted model's excess error that the candidate removes on the test records
    confirmed: float = 1.0
    #: power left on the test records over the power of unmodelled effects, largest over channels
    test_rest: float = 0.0

    def _excess(self, row: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(math.sqrt(max(x**2 - f**2, 0.0)) for x, f in zip(row, self.floor, strict=True))

    @property
    def excess_before(self) -> tuple[float, ...]:
        return self._excess(self.before)

    @property
    def excess_refit(self) -> tuple[float, ...]:
        return self._excess(self.refit)

    @property
    def excess_after(self) -> tuple[float, ...]:
        return self._excess(self.after)

    @property
    def width(self) -> float:
        """How wide the gap is beyond the noise, in the mean over channels."""
        return sum(self.excess_refit) / len(self.channels)

    @property
    def moved(self) -> float:
        """Largest share of a channel's deviation that the candidate moves towards the records, held out or fitted to."""
        pairs = [
            *zip(self.refit, self.after, strict=True),
            *zip(self.fitted_refit, self.fitted_after, strict=True),
        ]
        return max(math.sqrt(max(r**2 - a**2, 0.0)) for r, a in pairs)

    @property
    def agrees_before(self) -> bool:
        return all(x < w for x, w in zip(self.excess_before, self.worth, strict=True))

    @property
    def driven_out(self) -> tuple[str, ...]:
        """Parameters over the candidate's plane at its place that stand at the limit of what the owner allows, and did not without it.

        What is really missing brings them back; another law needs them for the rest of its curve.
        """
        return tuple(x for x in self.limits if x in self.beside and x not in self.refit_limits)

    @property
    def rest(self) -> float:
        """Power that the candidate leaves over the power that small effects leave, in the channel where that is largest."""
        pairs = zip(self.excess_after, self.worth_after or self.worth, strict=True)
        return max(x**2 / max(w**2, 1e-12) for x, w in pairs)

    @property
    def width_after(self) -> float:
        """How wide a gap the candidate leaves beyond the noise, in the mean over channels."""
        return sum(self.excess_after) / len(self.channels)

    @property
    def fitted_ratio(self) -> float:
        """Error of the candidate over that of the refitted model on the fitted records, geometric mean over channels.

        A ratio just below 1 is no merit: a refitted model makes up for a good part of what it lacks there; and where dry friction lets
        one channel drift, that channel says nothing.
        """
        pairs = list(zip(self.fitted_refit, self.fitted_after, strict=True))
        total = sum(math.log(max(after, 1e-12) / max(refit, 1e-12)) for refit, after in pairs)
        return math.exp(total / max(len(pairs), 1))

    def closed_by_small(self, share: float) -> bool:
        """Whether effects too small to be named would close the gap."""
        rest = all(x < w for x, w in zip(self._excess(self.closest), self.worth, strict=True))
        return bool(self.closest) and rest and self.closest_share < share

    def believed(self, misses: float) -> bool:
        """Whether a noise that is only bounded covers no more than a small error."""
        return all(k or r < misses for k, r in zip(self.floor_known, self.refit, strict=True))
