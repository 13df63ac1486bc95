"""The verdict in a sentence that a person can repeat."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..elements import TYPES
from .candidate import Candidate
from .criteria import Criteria
from .evidence import Evidence
from .result import Effect, Place, Tabulated

#: where the records to report by err more with what was found
NOT_BORNE_OUT = " The records set aside to report by, which took no part in choosing, do not bear it out: they err more with it."


def plain_number(value: float) -> str:
    """Four significant digits, without an exponent where one can do without."""
    text = f"{value:.4g}"
    return np.format_float_positional(float(text), trim="-") if 1e4 <= abs(value) < 1e7 else text


def described(e: Effect) -> str:
    """An effect with its place and values."""
    spot = f"in channel {e.channel}" if e.channel else f"between {' and '.join(e.between or ())}"
    what = e.effect.replace("_", " ")
    if TYPES[e.effect].series:
        what, spot = f"{what},", f"in series with {e.behind or 'what stands'} {spot}"
    figures = ", ".join(
        f"{k.replace('_', ' ')} {plain_number(q.value)} {q.unit}" for k, q in e.parameters.items()
    )
    return f"{what} {spot} ({figures})"


def sentence(
    verdict: str,
    effects: Sequence[Effect],
    small: Sequence[Effect],
    contenders: Sequence[Candidate],
    where: Sequence[Place],
    gap: dict[str, dict[str, float]],
    evidence: Evidence,
    criteria: Criteria,
    remainder: str = "",
) -> str:
    """What was found, with the figures of the channel that tells most; `remainder`: what is left beside it."""
    # the channel that gains most, or, where nothing is named, the one that is off most
    worst = max(gap["refit"], key=lambda c: gap["refit"][c] ** 2 - (gap["after"][c] ** 2 if effects else 0.0))

    def percent(row: str) -> str:
        return f"{100 * gap[row][worst]:.1f} %"

    text = _core(verdict, effects, contenders, where, worst, percent, gap, criteria.material) + remainder
    if small:
        shares = " and ".join(f"{x.share:.1%} of the force" for x in evidence.effects)
        little = all(x.share < criteria.share for x in evidence.effects)
        why = "Too small to be named" if little else "Seen, and not borne out well enough to be named"
        text += f" {why}: {' and '.join(described(e) for e in small)}, {shares}."
    unknown = [c for c, k in zip(evidence.channels, evidence.floor_known, strict=True) if not k]
    if unknown and verdict in ("no_discrepancy", "parameters_only", "unknown_effect"):
        text += f" How much of {', '.join(unknown)} is noise cannot be told from these data."
    asked = evidence.limits if verdict == "missing_effect" else evidence.refit_limits
    if asked:
        text += f" The data ask for {', '.join(asked)} outside of what the model allows."
    return text


def remaining(place: Place, after: float, floor: float, further: str, then: float) -> str:
    """What is left beside what was named, with where it lives; `further`: what would explain most of it, and how far."""
    text = (
        f" It is not all: {after:.0%} of {place.channel} is left (noise {floor:.1%}), {place.when}; "
        "something else is missing beside it."
    )
    if further:
        text += f" Of what was tried, {further.replace('_', ' ')} comes closest ({then:.0%} left), and does not earn a name."
    return text


def _core(
    verdict: str,
    effects: Sequence[Effect],
    contenders: Sequence[Candidate],
    where: Sequence[Place],
    worst: str,
    percent: Callable[[str], str],
    gap: dict[str, dict[str, float]],
    material: float,
) -> str:
    wide = any(gap["refit"][c] ** 2 - gap["noise_floor"][c] ** 2 > material**2 for c in gap["refit"])
    if verdict in ("no_discrepancy", "parameters_only") and wide:
        return f"Nothing worth a name is missing: what is left in {worst} ({percent('before')} before, {percent('refit')} refitted, noise {percent('noise_floor')}) is what effects of a few per cent of the force make, as every rig has them."
    if verdict == "no_discrepancy":
        return "The model agrees with the measurement within noise; nothing is missing."
    if verdict == "parameters_only":
        return f"Parameters within their stated uncertainty explain the difference ({worst}: {percent('before')} before, {percent('refit')} refitted); nothing is missing."
    if verdict == "missing_effect":
        found = " and ".join(described(e) for e in effects)
        down = gap["after"][worst] <= gap["refit"][worst]
        text = f"The model lacks {found}; with it the error in {worst} on held-out data {'falls' if down else 'rises'} from {percent('refit')} to {percent('after')} (noise {percent('noise_floor')})."
        return text if down else text + NOT_BORNE_OUT
    if verdict == "ambiguous":
        names = " or ".join(r.label.replace("_", " ") for r in contenders)
        return f"Something is missing, and these data cannot tell which: {names}."
    spot = f"; it lives mostly in {where[0].channel}, {where[0].when}" if where else ""
    return f"Something is missing that no known effect explains{spot}."


def unnamed(t: Tabulated | None, closed: float | None = None) -> str:
    """What is said of a force without a name, or of there being none that can be followed.

    closed: the share of the gap that the table closes on the records to report by.
    """
    if t is None:
        return (
            " No force between two nodes that is a function of their rate, their distance or both explains half of it on held-out "
            "records: it depends on time, on its own past, or on something that was not measured."
        )
    over = {"rate": "their rate", "elongation": "their distance", "both": "their distance and rate"}[t.over]
    near = ", ".join(f"{name.replace('_', ' ')} {share:.0%}" for name, share in t.nearest)
    said = f" (nearest known laws, by the share of it that they give: {near})" if near else ""
    return (
        f" A force between {t.between[0]} and {t.between[1]} that depends on {over} removes {t.explained:.0%} of what is missing on "
        f"held-out records{said}; it stands in the model as '{t.element}'."
        + (NOT_BORNE_OUT if closed is not None and closed < 0 else "")
    )
