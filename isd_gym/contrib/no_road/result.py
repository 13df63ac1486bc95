"""Result of an identification without a measured road."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from isd_gym._common.files import claim_folder, write_text
from isd_gym.diagnosis.result import _plain

from .estimation import Estimates

if TYPE_CHECKING:
    from pathlib import Path

    from isd_gym.diagnosis._verdict.gates import Gate, Verdict
    from isd_gym.diagnosis.result import Quantity
    from isd_gym.physics.network import Network

SCHEMA = "isd-unmeasured/1"
#: Kind, mark and files of a result folder.
FOLDER = ("result without a road", "unmeasured.json", ("unmeasured.json", "model.json"))


@dataclass(frozen=True, kw_only=True)
class UnknownInputResult(Estimates):
    """Verdict on a model, and estimates from records without a road.

    With the verdict `unknown_effect` no parameter of the refitted model is reliable, and `determined` is empty.
    """

    road: str  # name of the unmeasured input
    verdict: Verdict
    gates: tuple[Gate, ...]  # conditions of the verdict
    reason: str  # reason for an abstention, and remedies; empty otherwise
    #: Model with refitted parameters and the named effect; the nominal model for `unknown_effect` and `ambiguous`.
    model: Network
    effects: tuple[
        tuple[str, tuple[str, ...], float], ...
    ]  # fitted effects (type, place, gain in 2 log L), best first
    found: tuple[str, tuple[str, ...], dict[str, Quantity]] | None  # named effect, place and parameters
    notes: tuple[str, ...]
    seconds: float  # processor time of the search [s]

    @property
    def summary(self) -> str:
        """The result in a few sentences."""
        if self.verdict == "unknown_effect":
            return self.reason
        text = f"Determined without the road: {', '.join(self.determined) or 'none'}."
        if self.ratios_only:
            text += " Only ratios to mass: no known force acts, and all masses, springs and dampers could be larger by one factor."
        if self.found is not None:
            name, where, values = self.found
            size = ", ".join(f"{k} {q.value:.4g} {q.unit}" for k, q in values.items())
            return f"{text} The model lacks {name.replace('_', ' ')} between {' and '.join(where)} ({size})."
        if self.reason:
            return f"{text} {self.reason}"
        if not all(g.passed for g in self.gates if g.name == "complete"):
            return f"{text} The records show none of the {len(self.effects)} linear effects that were tried."
        return f"{text} The records show no missing linear effect." if self.effects else text

    def lines(self) -> list[str]:
        """Return lines for the terminal: summary, notes, and fitted numbers."""
        out = [self.summary, *(f"note: {note}" for note in self.notes)]
        rows = {f"level of {self.road} in velocity": self.level} | self.parameters
        width = max(map(len, rows))
        for name, q in rows.items():
            prior = "" if q.prior is None else f", model {q.prior:.4g}"
            is_known = name not in self.parameters or name in self.determined
            end = "" if is_known else "; not determined"
            out.append(f"{name:{width}}  {q.value:.4g} ({q.low:.4g} to {q.high:.4g}) {q.unit}{prior}{end}")
        return out

    def to_dict(self) -> dict[str, Any]:
        """Return JSON data (`isd-unmeasured/1`); infinite numbers become null."""
        found = None
        if self.found is not None:
            effect, where, values = self.found
            found = {"effect": effect, "between": list(where), "parameters": _dicts(values)}
        return _plain(
            {
                "schema": SCHEMA,
                "verdict": self.verdict,
                "summary": self.summary,
                "gates": [
                    {"gate": g.name, "passed": g.passed, "value": g.value, "limit": g.limit, "text": g.text}
                    for g in self.gates
                ],
                "road": self.road,
                "level": self.level.to_dict(),
                "parameters": _dicts(self.parameters),
                "determined": self.determined,
                "scale": self.scale,
                "ratios_only": self.ratios_only,
                "noise": self.noise,
                "effects": [{"effect": e, "between": w, "gain": g} for e, w, g in self.effects],
                "found": found,
                "seconds": self.seconds,
                "notes": self.notes,
            }
        )

    def save(self, folder: str | Path) -> None:
        """Write unmeasured.json and model.json to a new or empty `folder`, or over an earlier result."""
        folder = claim_folder(folder, *FOLDER)
        write_text(folder / "unmeasured.json", json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n")
        self.model.save(folder / "model.json")


def _dicts(quantities: dict[str, Quantity]) -> dict[str, Any]:
    """Return quantities as JSON data."""
    return {name: q.to_dict() for name, q in quantities.items()}
