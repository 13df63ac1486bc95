"""Evidence: the numbers from which `gates.decide` draws the verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


def as_numbers(values: Iterable[float]) -> tuple[float, ...]:
    """Return one plain number per channel."""
    return tuple(float(v) for v in values)


@dataclass(frozen=True)
class EffectEvidence:
    """Evidence for one effect of the foremost candidate."""

    #: effect and place in words
    label: str
    #: share of the force, current or signal at its place, or of the dissipated work where damping is slight
    share: float
    #: half of the widest 95 % interval of a value that is no shape, as the logarithm of a factor; infinite where the interval holds zero
    spread: float = 0.0
    #: how the values contradict the name; empty where they do not
    contradiction: str = ""
    #: whether the effect is a fault of a sensor
    sensor: bool = False
    #: size of that fault: of a gain, or of the time in which the motion changes
    fault: float = 0.0
    #: share of the excess error without the effect that the effect removes
    removed: float = 0.0
    #: excess error without the effect, mean over channels, as a share of the deviation
    width: float = 0.0
    #: whether that excess is larger in a channel than unmodelled effects make it
    beyond_small: bool = False
    #: share of the samples on the rarer side of the law's characteristic point; 1 where the law has none
    support: float = 1.0


@dataclass(frozen=True)
class Evidence:
    """Evidence for the foremost candidate against the refitted nominal model.

    Errors are RMS errors on the validation records as shares of the channel's deviation, one number per channel, unless stated
    otherwise. An excess error is the error beyond noise. An excess is a power where it is called an explained fraction.
    """

    channels: tuple[str, ...]
    #: error of the nominal model
    before: tuple[float, ...]
    #: error of the refitted nominal model
    refit: tuple[float, ...]
    #: error of the candidate
    after: tuple[float, ...]
    #: noise
    noise: tuple[float, ...]
    #: whether the owner or the signal tells the noise; otherwise the noise is only bounded
    noise_known: tuple[bool, ...]
    #: excess error of unmodelled effects beside the refitted model
    envelope: tuple[float, ...]
    effects: tuple[EffectEvidence, ...] = ()
    #: log predictive density minus that of the refitted model [nats]
    elpd_diff: float = 0.0
    #: standard error of that difference [nats]
    elpd_dse: float = math.inf
    #: share of the refitted model's excess error that the candidate removes
    explained: float = 0.0
    #: smallest excess loss of a rival of another kind, over the candidate's
    rival_loss: float = math.inf
    #: rivals of another kind that the candidate is not distinguished from
    indistinguishable: tuple[str, ...] = ()
    #: smallest excess loss of a rival that blames no sensor, over the candidate's
    force_loss: float = math.inf
    #: error of the refitted model on the training records
    training_refit: tuple[float, ...] = ()
    #: error of the candidate on the training records
    training_after: tuple[float, ...] = ()
    #: error of the candidate with most effects
    richest: tuple[float, ...] = ()
    #: largest share of an effect of that candidate
    richest_share: float = 1.0
    #: parameters of the nominal model at the limit of their stated uncertainty, in the candidate
    limits: tuple[str, ...] = ()
    #: the same in the refitted model
    refit_limits: tuple[str, ...] = ()
    #: excess error of unmodelled effects beside the candidate
    envelope_after: tuple[float, ...] = ()
    #: share of the excess error that the candidate removes on the training records
    training_explained: float = 0.0
    #: weight of the candidates that contain all effects of the candidate
    probability: float = 1.0
    #: share of the remaining excess error that a free curve in the effect's place removes
    lack_of_fit: float = 0.0
    #: share of the refitted model's excess error that the candidate removes on the test records
    test_explained: float = 1.0
    #: excess error on the test records over that of unmodelled effects, largest over channels, of the refitted model or of the candidate
    test_gap: float = math.inf
    #: share of the nominal model's squared error, over all channels, that the candidate removes: on validation or on test records, the larger
    nominal_removed: float = 1.0
    #: excess error of the candidate in the channel with the largest one, on validation or on test records, the larger
    largest_left: float = 0.0
    #: whether a special case of a law leaves no more than unmodelled effects, which may have made the difference
    imitated: bool = False

    def excess(self, errors: tuple[float, ...]) -> tuple[float, ...]:
        """Return errors beyond noise."""
        return tuple(math.sqrt(max(x**2 - f**2, 0.0)) for x, f in zip(errors, self.noise, strict=True))

    @property
    def width(self) -> float:
        """Excess error of the refitted model, mean over channels."""
        return sum(self.excess(self.refit)) / len(self.channels)

    @property
    def training_width(self) -> float:
        """Excess error of the refitted model on the training records, mean over channels."""
        return sum(self.excess(self.training_refit)) / len(self.channels) if self.training_refit else 0.0

    @property
    def width_after(self) -> float:
        """Excess error of the candidate, mean over channels."""
        return sum(self.excess(self.after)) / len(self.channels)

    @property
    def moved(self) -> float:
        """Largest share of a channel's deviation by which the error falls, on validation or training records."""
        pairs = [
            *zip(self.refit, self.after, strict=True),
            *zip(self.training_refit, self.training_after, strict=True),
        ]
        return max(math.sqrt(max(r**2 - a**2, 0.0)) for r, a in pairs)

    @property
    def agrees_before(self) -> bool:
        """Whether the nominal model errs by no more than unmodelled effects make."""
        return all(x < w for x, w in zip(self.excess(self.before), self.envelope, strict=True))

    @property
    def excess_ratio(self) -> float:
        """Power that the candidate leaves over the power of unmodelled effects, largest over channels."""
        pairs = zip(self.excess(self.after), self.envelope_after or self.envelope, strict=True)
        return max(x**2 / max(w**2, 1e-12) for x, w in pairs)

    @property
    def training_ratio(self) -> float:
        """Error of the candidate over that of the refitted model on the training records, as a geometric mean, which hides a channel that
        drifts."""
        pairs = list(zip(self.training_refit, self.training_after, strict=True))
        total = sum(math.log(max(after, 1e-12) / max(refit, 1e-12)) for refit, after in pairs)
        return math.exp(total / max(len(pairs), 1))

    @property
    def support(self) -> float:
        """Smallest support of the effects."""
        return min((e.support for e in self.effects), default=1.0)

    def closed_by_small(self, share: float) -> bool:
        """Return whether effects below a share of the force close the gap."""
        is_closed = all(x < w for x, w in zip(self.excess(self.richest), self.envelope, strict=True))
        return bool(self.richest) and is_closed and self.richest_share < share

    def has_credible_noise(self, misses: float) -> bool:
        """Return whether a noise that is only bounded covers a small error only."""
        return all(k or r < misses for k, r in zip(self.noise_known, self.refit, strict=True))
