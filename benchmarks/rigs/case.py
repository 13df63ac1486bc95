"""A case: what the owner of a rig has, and what is hidden in the rig."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

Model = dict[str, Any]
Records = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Case:
    """Model and records of the owner, and the hidden effects."""

    kind: str
    seed: int
    #: `isd-model/1`, as its owner believes it
    model: Model
    estimation: Records
    #: None: there is one record only
    validation: Records | None
    #: pairs of an effect's name and its terminals, or channel, or None where several places are the same; "unknown"; or empty where
    #: nothing is hidden
    answer: list[list[Any]] | str
    #: `model`: the true network; `hidden`, `nuisances`: what of it the owner does not know
    truth: dict[str, Any]
    snr_db: float
    #: relative standard deviation of the owner's parameters
    spread: float
    #: RMS change of each channel by the hidden effect: over its deviation, or over the noise in `hidden`
    visibility: dict[str, float]
    #: the same after the best fit of the model without the effect, as far as its owner allows
    irreducible: dict[str, float] = field(default_factory=dict)
