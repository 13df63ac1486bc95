"""Properties of a logged column: rate, range, bandwidth and oddities."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import welch

from ..._common.errors import InputError
from ..._common.units import TABLE, UNITS, convert, si_of
from ..data._columns import unit_known
from ..data._quality import (
    MAX_SPEED,
    QUANTITIES,
    held_samples,
    spread_and_speed,
)
from ..data._signals import even_stamps, stamp_rounding
from ..loggers.recording import GAP, Raster, even, rounded

if TYPE_CHECKING:
    from collections.abc import Mapping

FEW = 5.0  # samples per period below which the motion is poorly resolved


@dataclass(frozen=True)
class Oddity:
    """A remark on a column or on the time stamps, for the user.

    Attributes:
        where: File.
        column: Column; '' for the time stamps.
        text: The observation.
        advice: Remedy; '' if there is none.
    """

    where: str
    column: str
    text: str
    advice: str = ""

    def __str__(self) -> str:
        name = f"{self.column}: " if self.column else ""
        return f"{name}{self.text}{'; ' + self.advice if self.advice else ''}"


@dataclass(frozen=True)
class Facts:
    """Properties of a column.

    Attributes:
        file: Index of the file.
        raster: Index of the raster in the file.
        name: Name of the column.
        unit: Unit; '' if unknown.
        rate: Sampling rate [Hz].
        samples: Number of samples.
        missing: Number of samples that are not finite.
        least: Smallest value [unit].
        largest: Largest value [unit].
        mean: Mean [unit].
        deviation: RMS about the mean [unit].
        band: Frequency [Hz] below which half of the power lies.
    """

    file: int
    raster: int
    name: str
    unit: str
    rate: float
    samples: int
    missing: int
    least: float
    largest: float
    mean: float
    deviation: float
    band: float

    @property
    def constant(self) -> bool:
        """Whether the column never changes."""
        return not self.deviation > 1e-12 * max(
            abs(self.largest), abs(self.least), 1e-300
        )


def facts_of(
    raster: Raster, file: int, number: int, units: Mapping[str, str]
) -> list[Facts]:
    """Return the properties of every column of a raster.

    Args:
        raster: The raster.
        file: Index of the file.
        number: Index of the raster in the file.
        units: Unit by column, with priority over the units in the file.

    Returns:
        One entry per column.
    """
    out = []
    for name, x in raster.columns.items():
        good = x[np.isfinite(x)]
        lo, hi, mean, sd = (
            (
                float(good.min()),
                float(good.max()),
                float(good.mean()),
                float(good.std()),
            )
            if len(good)
            else (math.nan, math.nan, math.nan, 0.0)
        )
        rate = 1.0 / raster.step if raster.step > 0 else math.nan
        band = (
            _band(good, rate)
            if len(good) > 63 and sd > 0 and math.isfinite(rate)
            else math.nan
        )
        missing = len(x) - len(good)
        unit = units.get(name) or raster.units.get(name, "")
        out.append(
            Facts(
                file, number, name, unit, rate, len(x), missing, lo, hi, mean, sd, band
            )
        )
    return out


def _band(x: np.ndarray, rate: float) -> float:
    f, s = welch(x - x.mean(), rate, nperseg=min(len(x), 4096))
    total = np.cumsum(s)
    return float(np.interp(0.5 * total[-1], total, f)) if total[-1] > 0 else math.nan


# ------------------------------------------------------------------------------------------------- oddities


def odd_stamps(raster: Raster) -> list[Oddity]:
    """Return remarks on the time stamps: gaps, repeats, reversals, jitter and an impossible unit of time.

    Args:
        raster: The raster.

    Returns:
        Remarks, possibly none.
    """
    out: list[Oddity] = []
    t = raster.time[np.isfinite(raster.time)]

    def say(text: str, advice: str = "") -> None:
        out.append(Oddity(raster.name, "", text, advice))

    if len(t) < len(raster):
        say(f"{len(raster) - len(t)} samples have no stamp")
    if len(t) < 3:
        say(f"{len(t)} samples only")
        return out
    if rounding := stamp_rounding(t):
        say(rounded(rounding, raster.step))
        t = even_stamps(t)
    d = np.diff(t)
    begin = t[0]
    if (back := d < 0).any():
        k = int(np.argmax(back))
        say(
            f"stamps run backwards {back.sum()} times, first {t[k] - begin:.6g} s after the begin",
            "cut the file there",
        )
    if (again := d == 0).any():
        say(
            f"{again.sum()} stamps occur twice, first {t[int(np.argmax(again))] - begin:.6g} s after the begin"
        )
    step = raster.step
    gaps = np.flatnonzero(d > GAP * step)
    if 0 < len(gaps) <= 0.2 * len(d):
        told = ", ".join(f"{d[g]:.3g} s at {t[g] - begin:.6g} s" for g in gaps[:3])
        say(
            f"{f'{len(gaps)} gaps' if len(gaps) > 1 else 'a gap'}: {told}{' ...' if len(gaps) > 3 else ''}",
            "the record is split there",
        )
    elif not back.any() and not again.any() and not even(t):
        say(
            f"uneven stamps: steps from {d.min():.3g} to {d.max():.3g} s",
            "each sample is compared at its own instant",
        )
    if not 1e-6 <= step <= 0.25 and raster.stamp:
        # for stamps that only look like seconds
        likely = [
            unit
            for unit in ("ms", "us", "ns")
            if 1e-4 <= convert(step, unit, "s") <= 0.25
        ]
        say(
            f"a step of {step:.4g} s: is {raster.stamp} in another unit?",
            f"--unit {raster.stamp}={likely[0]}" if likely else "",
        )
    return out


def si_unit(unit: str) -> str:
    """Return the SI unit of the quantity that a unit measures.

    Args:
        unit: Name of a unit.

    Returns:
        SI unit; '' for an unknown unit.
    """
    try:
        return si_of(unit)
    except InputError:
        return ""


def quantity_of(unit: str) -> str | None:
    """Return the translational quantity that a unit measures.

    Args:
        unit: Name of a unit.

    Returns:
        Quantity such as 'force'; None for other units.
    """
    si = si_unit(unit)
    return next((q for q, u in UNITS.items() if u == si), None)


def odd_values(raster: Raster, facts: Facts) -> list[Oddity]:
    """Return remarks on a column: dead, frozen or stepped values, a factor of 1000, or a rate too low for its motion.

    Args:
        raster: The raster.
        facts: Properties of the column.

    Returns:
        Remarks, possibly none.
    """
    x = raster.columns[facts.name]
    out: list[Oddity] = []

    def say(text: str, advice: str = "") -> None:
        out.append(Oddity(raster.name, facts.name, text, advice))

    if facts.name in raster.texts:
        say(raster.texts[facts.name], "correct the file")
    elif facts.missing:
        say(
            f"{facts.missing} samples are missing or not finite",
            "" if facts.missing == facts.samples else "the record is split there",
        )
    if facts.constant:
        say(
            f"is constant ({facts.mean:.6g})"
            if facts.missing < facts.samples
            else "holds no number"
        )
        return out
    good = np.isfinite(x)
    quantity = quantity_of(facts.unit)
    # a commanded current is held by design
    if (
        quantity != "current"
        and good.all()
        and len(x) >= 64
        and not (np.diff(raster.time) <= 0).any()
    ):
        for f in held_samples(facts.name, x, raster.time):
            say(f.message)
    if quantity is not None:
        out += odd_scale(raster, facts, quantity)
    if facts.band > facts.rate / FEW and _smooth(x[good]):
        say(
            f"{facts.rate / facts.band:.1f} samples a period: too slow for the motion, which half of lies above {facts.band:.3g} Hz",
            "log it faster",
        )
    return out


def _smooth(x: np.ndarray) -> bool:
    """Return whether a column is a motion and not white noise: neighbouring samples are correlated."""
    x = x - x.mean()
    return bool(abs(np.dot(x[1:], x[:-1])) > 0.2 * np.dot(x, x))


def unit_in_name(name: str) -> str:
    """Return the unit at the end of a column's name, such as rad/s for ``speed_rad_s``.

    Args:
        name: Name of a column.

    Returns:
        Unit; '' for a name without a unit.
    """
    words = re.split(r"[_\s]+", name)
    for first in range(1, len(words)):
        unit = "/".join(words[first:])
        if unit_known(unit):
            return unit
    return ""


def odd_scale(raster: Raster, facts: Facts, quantity: str) -> list[Oddity]:
    """Return a remark on a column whose size or speed is implausible for its quantity.

    Args:
        raster: The raster.
        facts: Properties of the column, with its unit.
        quantity: Quantity, of `QUANTITIES`.

    Returns:
        A remark, or an empty list.
    """
    x = raster.columns[facts.name]
    x = x[np.isfinite(x)]
    si, doubtful, impossible, least = QUANTITIES[quantity]
    factor = convert(1.0, facts.unit, si)
    # invalid stamps have no step
    step = raster.step if raster.step > 0 else math.inf
    spread, speed = (factor * v for v in spread_and_speed(x, step, quantity))
    big = spread > doubtful or speed > MAX_SPEED
    small = spread < 2 * least
    if not big and not small:
        return []
    wanted = [
        unit
        for unit, (s, k) in TABLE.items()
        if s == si
        and any(
            abs(k / factor / r - 1) < 0.2
            for r in ((1e-3, 1e-6, 1 / 9.81) if big else (1e3, 1e6, 9.81))
        )
        and 2 * least < spread * k / factor < doubtful
        and speed * k / factor < MAX_SPEED
    ]
    text = f"reaches {spread:.4g} {si}{f' at {speed:.3g} m/s' if speed > MAX_SPEED else ''} as {facts.unit}"
    advice = (
        f"in {' or '.join(wanted)} it would be plausible: --unit {facts.name}={wanted[0]}"
        if wanted
        else "which is implausible"
    )
    return [Oddity(raster.name, facts.name, text, advice)]
