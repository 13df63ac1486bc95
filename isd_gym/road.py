"""Roads: the paper's, ISO 8608 classes, bumps, potholes, sweeps and recorded profiles.

A road is rough ground plus a fixed profile, either of which may be absent. Rough ground is first-order filtered
white noise, drawn step by step inside the kernel (or ahead by `Road.heights`, the same numbers): its spectral
density over distance does not depend on the step, nor on the speed.

    one-sided PSD of height over spatial frequency n [cycle/m]:  G(n) = G(n0) n0^2 / (n^2 + n_c^2),  n0 = 0.1 cycle/m

which is ISO 8608 (waviness 2) above the cut-off n_c. The paper's road has n_c = 0: dz_r/dt is white with the two-sided
intensity (2 pi)^2 kappa u, and kappa = G(n0) n0^2 / 2.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .errors import InputError, shown
from .units import convert

if TYPE_CHECKING:
    from collections.abc import Callable

REFERENCE_FREQUENCY = 0.1  # n0 [cycle/m]
#: ISO 8608:2016 geometric means of G(n0) [m^3]
ISO_CLASSES = {letter: 16e-6 * 4.0**i for i, letter in enumerate("ABCDEFGH")}
PAPER_KAPPA = 5e-7  # m^3/cycle: Table 7's passive acceleration and tyre load within 1 %, travel 6 % less; Table 6 prints 5e-6
PRINTED_KAPPA = 5e-6
STEEPEST = 1.0  # median slope of a recorded profile [m/m]: no road is that steep, a forgotten unit is


@dataclass(frozen=True)
class Road:
    """A road.

    roughness: G(n0) [m^3], 0 for even ground. cutoff: n_c [cycle/m]. heights of a fixed profile [m] over `abscissa`,
    a distance [m] or, with `over_time`, a time [s]; `shift`: start at a random place of it.

    name: as reports call it.
    """

    name: str
    roughness: float = 0.0
    cutoff: float = 0.0
    abscissa: np.ndarray | None = None
    profile: np.ndarray | None = None
    over_time: bool = False
    shift: bool = False

    def noise(self, speed: float, step: float) -> tuple[float, float]:
        """(gain [m], pole [-]) of ``r_next = pole * r + gain * xi`` with unit-variance xi, exact at the samples.

        speed, step: [m/s], [s].
        """
        intensity = (2 * math.pi) ** 2 * 0.5 * self.roughness * REFERENCE_FREQUENCY**2 * speed  # two-sided
        rate = 2 * math.pi * self.cutoff * speed
        if rate == 0.0:
            return math.sqrt(intensity * step), 1.0
        return math.sqrt(intensity * -math.expm1(-2 * rate * step) / (2 * rate)), math.exp(-rate * step)

    def fixed(self, speed: float, step: float, count: int, rng: np.random.Generator) -> np.ndarray:
        """The fixed profile [m] at the ends of up to `count` steps, from 0 to where it stays; empty if there is none.

        speed, step: [m/s], [s]. rng: draws where it starts, with `shift`.
        """
        if self.abscissa is None or self.profile is None:
            return np.empty(0)
        x = np.arange(count + 1) * step * (1.0 if self.over_time else speed)
        span = self.abscissa[-1] - self.abscissa[0]
        start = rng.uniform(0.0, max(span - x[-1], 0.0)) if self.shift else 0.0
        z = np.interp(self.abscissa[0] + start + x, self.abscissa, self.profile)
        z = z[1:] - z[0]
        moving = np.flatnonzero(np.diff(z))  # the last height stays: no need to store it again and again
        return z[: moving[-1] + 2] if len(moving) else z[:1]

    def heights(
        self, duration: float, *, speed: float = 20.0, step: float = 1e-3, rng: np.random.Generator
    ) -> np.ndarray:
        """Heights [m] at 0, step, ..., duration; the road an environment with this generator would drive.

        duration, step: [s]. speed [m/s]. rng: what an environment would draw from.
        """
        from .kernel.cars import road_noise

        count = round(duration / step)
        gain, pole = self.noise(speed, step)
        counter = np.uint64(rng.integers(0, 2**64, dtype=np.uint64))
        rough = np.empty(count)
        road_noise(counter, gain, pole, 0.0, rough)
        fixed = self.fixed(speed, step, count, rng)
        if len(fixed):
            rough[: len(fixed)] += fixed
            rough[len(fixed) :] += fixed[-1]
        return np.concatenate([[0.0], rough])

    def psd(self, n: np.ndarray) -> np.ndarray:
        """One-sided PSD of the rough part [m^3] at spatial frequencies `n` [cycle/m]."""
        return self.roughness * REFERENCE_FREQUENCY**2 / (np.asarray(n, float) ** 2 + self.cutoff**2)


def paper_road(kappa: float = PAPER_KAPPA) -> Road:
    """The paper's road: white velocity of intensity (2 pi)^2 kappa u."""
    return Road("paper", roughness=2 * kappa / REFERENCE_FREQUENCY**2)


def iso_road(letter: str, *, cutoff: float = 0.002) -> Road:
    """ISO 8608 class A-H (geometric mean), flat below `cutoff` [cycle/m].

    letter: of the class.
    """
    if letter.upper() not in ISO_CLASSES:
        raise InputError(f"no ISO 8608 class '{letter}': A to H")
    return Road(letter.upper(), roughness=ISO_CLASSES[letter.upper()], cutoff=cutoff)


def _over_distance(name: str, shape: Callable[[np.ndarray], np.ndarray], end: float) -> Road:
    x = np.arange(0.0, end, 0.005)
    return Road(name, abscissa=x, profile=shape(x))


def bump(height: float = 0.05, length: float = 2.0, at: float = 20.0) -> Road:
    """A raised-cosine bump [m] of `length` [m], starting `at` [m].

    height [m].
    """

    def shape(x: np.ndarray) -> np.ndarray:
        inside = (x >= at) & (x <= at + length)
        return np.where(inside, height * 0.5 * (1 - np.cos(2 * math.pi * (x - at) / length)), 0.0)

    return _over_distance("bump", shape, at + length + 1.0)


def pothole(depth: float = 0.05, length: float = 1.0, at: float = 20.0, edge: float = 0.1) -> Road:
    """A hole of `depth` [m] and `length` [m] with edges sloped over `edge` [m], starting `at` [m]."""
    x = np.array([0.0, at, at + edge, at + length - edge, at + length, at + length + 1.0])
    return Road("pothole", abscissa=x, profile=np.array([0.0, 0.0, -depth, -depth, 0.0, 0.0]))


def sweep(amplitude: float = 0.005, start: float = 0.5, stop: float = 20.0, duration: float = 20.0) -> Road:
    """A sine of `amplitude` [m] whose frequency rises linearly from `start` to `stop` [Hz] in `duration` [s]."""
    t = np.arange(0.0, duration, 2.5e-4)
    phase = 2 * math.pi * (start * t + 0.5 * (stop - start) / duration * t**2)
    return Road("sweep", abscissa=t, profile=amplitude * np.sin(phase), over_time=True)


def recorded(path: str | Path) -> Road:
    """A measured profile: a table (any that `data.read_table` reads) with `distance` or `time`, and `height` or `road`.

    path: of the table. Units are those of the file, metres and seconds where it tells none. Raises `InputError`.
    """
    from .data.table import read_columns

    path = Path(path)
    roles: dict[str, str] = {}

    def choose(names: list[str]) -> list[str]:
        lower = {name.lower(): name for name in reversed(names)}
        for role, known in (("along", ("distance", "time")), ("height", ("height", "road"))):
            found = next((k for k in known if k in lower), None)
            if found is None:
                raise InputError(f"road '{path}' needs a header with 'distance' or 'time', and 'height'")
            roles[role] = lower[found]
        return list(roles.values())

    table = read_columns(path, choose, resample=True)
    over_time = roles["along"].lower() == "time"
    columns = []
    for role, unit in (("along", "s" if over_time else "m"), ("height", "m")):
        name = roles[role]
        values = np.asarray(table.values[name])
        if values.dtype.kind not in "fiub" or values.ndim != 1:
            raise InputError(f"road '{path}': column {shown(name)} does not hold plain numbers")
        try:
            columns.append(convert(values.astype(float), table.units.get(name) or unit, unit))
        except InputError as error:
            raise InputError(f"road '{path}': column {shown(name)}: {error}") from None
    return profiled(str(path), *columns, over_time=over_time, axis=roles["along"], line=table.line)


def profiled(
    source: str,
    along: np.ndarray,
    height: np.ndarray,
    *,
    over_time: bool,
    axis: str = "time",
    line: Callable[[int], str] = "sample {}".format,
) -> Road:
    """A measured profile: `height` (n,) [m] over distance [m] or time [s], `along` (n,). Raises `InputError`.

    source, axis, line: for messages, the file, the name of its column and its line of a sample. over_time: whether it is time.
    """
    x, z = along, height
    if len(x) != len(z):
        raise InputError(f"road '{source}': {shown(axis)} has {len(x)} samples, the height has {len(z)}")
    bad = np.flatnonzero(~np.isfinite(x) | ~np.isfinite(z) | (np.abs(x) > 1e9) | (np.abs(z) > 1e5))
    if len(bad):
        raise InputError(f"road '{source}', {line(bad[0])}: not finite, or no road any more")
    if len(x) < 2:
        raise InputError(f"road '{source}' has fewer than two points")
    steps = np.diff(x)
    if steps.min() <= 0:
        where = line(int(np.argmax(steps <= 0)) + 1)
        raise InputError(f"road '{source}', {where}: {shown(axis)} does not increase")
    if steps.max() > 10 * np.median(steps):
        where = line(int(np.argmax(steps)) + 1)
        raise InputError(f"road '{source}', {where}: gap of {steps.max():g} in {shown(axis)}")
    slope = float(np.median(np.abs(np.diff(z)) / steps))
    if slope > (STEEPEST * 20.0 if over_time else STEEPEST):
        raise InputError(
            f"road '{source}' climbs {slope:.3g} m in every {'second' if over_time else 'metre'}: is the height in mm? "
            "Name the unit in the header, as in 'height [mm]'"
        )
    return Road(Path(source).stem, abscissa=x, profile=z, over_time=over_time, shift=True)


NAMES = "paper, paper-printed, flat, A ... H, bump, pothole, sweep, a file, or a sum such as C+bump"


def road(source: str | Path | Road) -> Road:
    """A road from its name: paper, paper-printed (kappa as in Table 6), flat, A-H, bump, pothole, sweep, a CSV file.

    A class and a profile add up: 'C+bump'.

    source: the name, or a road as it is.
    """
    if isinstance(source, Road):
        return source
    text = str(source)
    named: dict[str, Callable[[], Road]] = {
        "paper": paper_road,
        "paper-printed": lambda: replace(paper_road(PRINTED_KAPPA), name="paper-printed"),
        "flat": lambda: Road("flat"),
        "bump": bump,
        "pothole": pothole,
        "sweep": sweep,
    }
    if text in named:
        return named[text]()
    if text.upper().removeprefix("ISO-") in ISO_CLASSES:
        return iso_road(text.upper().removeprefix("ISO-"))
    if os.path.exists(text) and not os.path.isdir(text):  # a pipe is refused where it is read
        return recorded(text)
    if len(text) > 4096:
        raise InputError(f"no road {shown(text)}: {NAMES}")
    if "+" in text:
        parts = [road(part) for part in text.split("+")]
        rough = [p for p in parts if p.roughness > 0]
        shaped = [p for p in parts if p.profile is not None]
        if len(rough) <= 1 and len(shaped) <= 1:
            base = rough[0] if rough else Road("flat")
            if shaped:
                s = shaped[0]
                base = replace(
                    base, abscissa=s.abscissa, profile=s.profile, over_time=s.over_time, shift=s.shift
                )
            return replace(base, name=text)
        raise InputError(f"road {shown(text)}: one rough road and one profile can be added")
    raise InputError(f"no road {shown(text)}: {NAMES}")
