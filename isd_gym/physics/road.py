"""Roads: the paper's, ISO 8608 classes, bumps, potholes, sweeps and recorded profiles.

A road is rough ground plus a fixed profile, either of which may be absent. Rough ground is first-order filtered
white noise, drawn step by step inside the kernel (or ahead by `Road.heights`, the same numbers): its spectral
density over distance does not depend on the step, nor on the speed.

    one-sided PSD of height over spatial frequency n [cycle/m]:  G(n) = G(n0) n0^2 / (n^2 + n_c^2),  n0 = 0.1 cycle/m

which is ISO 8608 (waviness 2) above the cut-off n_c. The paper's road has n_c = 0: dz_r/dt is white with the two-sided
intensity (2 pi)^2 kappa u, and kappa = G(n0) n0^2 / 2.

A car has one track (quarter and half car) or a left and a right track (full car). Both tracks have this density, and the
coherence of an isotropic surface (`tracks`). A profile is the same on both sides (a bump that an axle meets) or differs.
All wheels of a side pass the same track, each after its distance behind the foremost wheel over the speed.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .._common.errors import InputError, shown
from .._common.units import convert
from .tracks import (
    DIFFERENCE_STATES,
    ONE_WHEEL,
    SUM_STATES,
    WheelPositions,
    delayed,
    track_filters,
)

__all__ = [
    "NAMES",
    "Road",
    "bump",
    "iso_road",
    "on_side",
    "paper_road",
    "pothole",
    "profiled",
    "recorded",
    "road",
    "sweep",
]


REFERENCE_FREQUENCY = 0.1  # n0 [cycle/m]
#: ISO 8608:2016 geometric means of G(n0) [m^3]
ISO_CLASSES = {letter: 16e-6 * 4.0**i for i, letter in enumerate("ABCDEFGH")}
PAPER_KAPPA = 5e-7  # m^3/cycle: Table 7's passive acceleration and tyre load within 1 %, travel 6 % less; Table 6 prints 5e-6
PRINTED_KAPPA = 5e-6
ROUGHEST, LARGEST_CUTOFF, HIGHEST = (
    1e3,
    1e3,
    1e5,
)  # limits of G(n0) [m^3], of n_c [cycle/m] and of heights [m]
STEEPEST = 1.0  # median slope of a recorded profile [m/m]: no road is that steep, a forgotten unit is


@dataclass(frozen=True)
class Road:
    """A road: rough ground, a fixed profile, or both."""

    # name in reports
    name: str
    # G(n0) [m^3]; 0 for even ground
    roughness: float = 0.0
    # n_c [cycle/m]
    cutoff: float = 0.0
    # places (n,) of the fixed profile: distance [m], or time [s] with `over_time`
    abscissa: np.ndarray | None = None
    # heights of the fixed profile [m]: (n,) for all tracks, or (2, n) for the left and the right track
    profile: np.ndarray | None = None
    # whether `abscissa` is a time
    over_time: bool = False
    # whether a drive starts at a random place of the profile
    shift: bool = False

    def __post_init__(self) -> None:
        """Check the numbers, and the shape of the profile."""
        for name, value, most in (
            ("roughness", self.roughness, ROUGHEST),
            ("cutoff", self.cutoff, LARGEST_CUTOFF),
        ):
            if (
                isinstance(value, bool)
                or not isinstance(value, int | float | np.number)
                or not 0 <= value <= most
            ):
                raise InputError(
                    f"road {shown(self.name)}: {name} must be a number from 0 to {most:g}, not {shown(value)}"
                )
        for name in ("abscissa", "profile"):
            if (given := getattr(self, name)) is not None:
                object.__setattr__(
                    self, name, _numbers(given, f"road {shown(self.name)}: {name}")
                )
        if (self.abscissa is None) != (self.profile is None):
            raise InputError(
                f"road {shown(self.name)}: give both abscissa and profile, or neither"
            )
        if self.abscissa is None or self.profile is None:
            return
        count = len(self.abscissa)
        shape = self.profile.shape
        if shape not in ((count,), (2, count)):
            raise InputError(
                f"road {shown(self.name)}: a profile over {count} places has the shape ({count},) or "
                f"(2, {count}) for left and right, not {shape}"
            )
        if not (np.diff(self.abscissa) >= 0).all():
            raise InputError(
                f"road {shown(self.name)}: the places of a profile must not go back"
            )
        if np.abs(self.profile).max() > HIGHEST:
            raise InputError(
                f"road {shown(self.name)}: a height of {np.abs(self.profile).max():g} m is no road"
            )

    @property
    def has_two_tracks(self) -> bool:
        """Whether the profile differs between left and right: only cars with two tracks can drive on it."""
        return self.profile is not None and self.profile.ndim == 2

    def noise(self, speed: float, step: float) -> tuple[float, float]:
        """Return the discrete filter of the rough road under one track, exact at the samples.

        The height follows ``r_next = pole * r + gain * xi`` with white noise xi of unit variance.

        Args:
            speed: Speed [m/s].
            step: Step [s].

        Returns:
            Gain [m] and pole [-].
        """
        # two-sided
        intensity = (
            (2 * math.pi) ** 2 * 0.5 * self.roughness * REFERENCE_FREQUENCY**2 * speed
        )
        rate = 2 * math.pi * self.cutoff * speed
        if rate == 0.0:
            return math.sqrt(intensity * step), 1.0
        return math.sqrt(
            intensity * -math.expm1(-2 * rate * step) / (2 * rate)
        ), math.exp(-rate * step)

    def track_filters(
        self, width: float, speed: float, step: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the first-order sections of the rough left and right track, exact at the samples.

        Args:
            width: Track width [m].
            speed: Speed [m/s].
            step: Step [s].

        Returns:
            Poles (9,) and gains [m] (9,), read-only, as `tracks.track_filters` defines them.

        Raises:
            InputError: The track width is implausible.
        """
        return track_filters(
            self.roughness * REFERENCE_FREQUENCY**2, self.cutoff, width, speed * step
        )

    def fixed_tracks(
        self,
        tracks: int,
        speed: float,
        step: float,
        count: int,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Return the fixed profile at the ends of the steps, from 0 up to the place where all tracks stay.

        Args:
            tracks: Number of tracks of the car, 1 or 2.
            speed: Speed [m/s].
            step: Step [s].
            count: Number of steps.
            rng: Draws the start, with `shift`; one draw for both tracks.

        Returns:
            Heights [m] (tracks, m), m <= count, left track first; (tracks, 0) without a profile.

        Raises:
            InputError: The profile differs between left and right, and the car has one track.
        """
        if self.has_two_tracks and tracks == 1:
            raise InputError(
                f"road {shown(self.name)} has a left and a right track, the car has one: "
                "choose a road without sides, or a full car"
            )
        if self.abscissa is None or self.profile is None:
            return np.empty((tracks, 0))
        x = np.arange(count + 1) * step * (1.0 if self.over_time else speed)
        span = self.abscissa[-1] - self.abscissa[0]
        start = rng.uniform(0.0, max(span - x[-1], 0.0)) if self.shift else 0.0
        x = self.abscissa[0] + start + x
        z = np.array(
            [np.interp(x, self.abscissa, side) for side in np.atleast_2d(self.profile)]
        )
        z = z[:, 1:] - z[:, :1]
        # the last height stays, and is stored once
        moving = np.flatnonzero(np.diff(z).any(axis=0))
        z = z[:, : moving[-1] + 2] if len(moving) else z[:, :1]
        return z if len(z) == tracks else np.repeat(z, tracks, axis=0)

    def heights(
        self,
        duration: float,
        *,
        speed: float = 20.0,
        step: float = 1e-3,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Return the heights under one wheel: the road that an environment with this generator drives.

        Args:
            duration: Length of the drive [s].
            speed: Speed [m/s].
            step: Step [s].
            rng: Generator that an environment would draw from.

        Returns:
            Heights [m] (n,) at 0, step, ..., duration.

        Raises:
            InputError: The profile differs between left and right.
        """
        return self.wheel_heights(ONE_WHEEL, duration, speed=speed, step=step, rng=rng)[
            0
        ]

    def wheel_heights(
        self,
        wheels: WheelPositions,
        duration: float,
        *,
        speed: float = 20.0,
        step: float = 1e-3,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Return the heights under several wheels: the road that an environment with this generator drives.

        The road is even where the foremost wheel starts and behind: a wheel at the distance x behind the foremost wheel
        stays at 0 until x / speed, then passes over the same heights (`tracks.delayed`). A car with one track draws
        the random numbers of `heights`; a car with two tracks draws one more seed, of the difference of the tracks.

        Args:
            wheels: Positions of the wheels.
            duration: Length of the drive [s].
            speed: Speed [m/s].
            step: Step [s].
            rng: Generator that an environment would draw from: seeds of the rough tracks, then start of the profile.

        Returns:
            Heights [m] (wheels, n) at 0, step, ..., duration, in the order of `wheels`.

        Raises:
            InputError: The profile differs between left and right, and the car has one track.
        """
        count = round(duration / step)
        rough = np.empty((wheels.tracks, count))
        if wheels.tracks == 1:
            from ._kernel.cars import road_noise

            road_noise(_seed(rng), *self.noise(speed, step), 0.0, rough[0])
        else:
            from ._kernel.tracks import track_noise

            states = np.zeros(SUM_STATES + DIFFERENCE_STATES)
            filters = self.track_filters(wheels.width, speed, step)
            track_noise(_seed(rng), _seed(rng), *filters, SUM_STATES, states, rough)
        fixed = self.fixed_tracks(wheels.tracks, speed, step, count, rng)
        length = fixed.shape[1]
        if length:
            rough[:, :length] += fixed
            rough[:, length:] += fixed[:, -1:]
        tracks = np.concatenate([np.zeros((wheels.tracks, 1)), rough], axis=1)
        delays = wheels.delays(speed, step)
        return np.array(
            [delayed(tracks[k], d) for k, d in zip(wheels.track, delays, strict=True)]
        )

    def psd(self, n: np.ndarray) -> np.ndarray:
        """Return the one-sided power spectral density of the rough part.

        Args:
            n: Spatial frequencies [cycle/m], any shape.

        Returns:
            Density [m^3] in the shape of `n`.
        """
        return (
            self.roughness
            * REFERENCE_FREQUENCY**2
            / (np.asarray(n, float) ** 2 + self.cutoff**2)
        )


def _numbers(given: object, name: str) -> np.ndarray:
    """Return finite numbers as an array of at least one element."""
    try:
        found = np.asarray(given)
        if found.dtype.kind not in "fiu":
            raise ValueError
        found = found.astype(float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} must be an array of numbers") from None
    if found.ndim == 0 or not found.size or not np.isfinite(found).all():
        raise InputError(f"{name} must be finite numbers, at least one")
    return found


def _seed(rng: np.random.Generator) -> np.uint64:
    return np.uint64(rng.integers(0, 2**64, dtype=np.uint64))


def paper_road(kappa: float = PAPER_KAPPA) -> Road:
    """Return the paper's road: the vertical velocity is white with the intensity (2 pi)^2 kappa u.

    Args:
        kappa: Road level [m^3/cycle].

    References:
        Liu, Zhao, Yang, Chen, Shen, Shock and Vibration, 2019, Table 6. The default reproduces Table 7's
            passive row.
    """
    return Road("paper", roughness=2 * kappa / REFERENCE_FREQUENCY**2)


def iso_road(letter: str) -> Road:
    """Return a road of an ISO 8608 class (geometric mean), flat below a cut-off of 0.002 cycle/m.

    Args:
        letter: Class, A to H.

    Raises:
        InputError: No such class exists.

    References:
        ISO 8608:2016, Mechanical vibration, Road surface profiles, Reporting of measured data.
    """
    if letter.upper() not in ISO_CLASSES:
        raise InputError(f"no ISO 8608 class '{letter}': A to H")
    return Road(letter.upper(), roughness=ISO_CLASSES[letter.upper()], cutoff=0.002)


def bump(height: float = 0.05, length: float = 2.0, at: float = 20.0) -> Road:
    """Return a raised-cosine bump.

    Args:
        height: Height [m].
        length: Length [m].
        at: Distance of its beginning from the start [m].
    """
    x = np.arange(0.0, at + length + 1.0, 0.005)
    inside = (x >= at) & (x <= at + length)
    shape = np.where(
        inside, height * 0.5 * (1 - np.cos(2 * math.pi * (x - at) / length)), 0.0
    )
    return Road("bump", abscissa=x, profile=shape)


def pothole(
    depth: float = 0.05, length: float = 1.0, at: float = 20.0, edge: float = 0.1
) -> Road:
    """Return a hole with sloped edges.

    Args:
        depth: Depth [m].
        length: Length [m].
        at: Distance of its beginning from the start [m].
        edge: Length of each edge [m].
    """
    x = np.array(
        [0.0, at, at + edge, at + length - edge, at + length, at + length + 1.0]
    )
    return Road(
        "pothole", abscissa=x, profile=np.array([0.0, 0.0, -depth, -depth, 0.0, 0.0])
    )


def sweep(
    amplitude: float = 0.005,
    start: float = 0.5,
    stop: float = 20.0,
    duration: float = 20.0,
) -> Road:
    """Return a sine over time whose frequency rises linearly.

    Args:
        amplitude: Amplitude [m].
        start: First frequency [Hz].
        stop: Last frequency [Hz].
        duration: Duration [s].
    """
    t = np.arange(0.0, duration, 2.5e-4)
    phase = 2 * math.pi * (start * t + 0.5 * (stop - start) / duration * t**2)
    return Road("sweep", abscissa=t, profile=amplitude * np.sin(phase), over_time=True)


def on_side(ground: Road, side: str) -> Road:
    """Return a road with a profile under the wheels of one side; the other track stays at 0.

    Args:
        ground: Road with a profile that is equal on both sides.
        side: 'left' or 'right'.

    Returns:
        The road with a profile of two tracks, with the side in its name, as in 'bump-left'.

    Raises:
        InputError: The side is unknown, or the road has no profile that is equal on both sides.
    """
    if side not in _SIDES:
        raise InputError(f"no side {shown(side)}: {' or '.join(_SIDES)}")
    if ground.profile is None or ground.has_two_tracks:
        raise InputError(
            f"road {shown(ground.name)} has no profile that a side could have alone"
        )
    tracks = np.zeros((2, len(ground.profile)))
    tracks[_SIDES.index(side)] = ground.profile
    return replace(ground, name=f"{ground.name}-{side}", profile=tracks)


def recorded(path: str | Path) -> Road:
    """Read a measured profile of one track or of a left and a right track.

    The table has a column `distance` or `time`, and one column `height` (or `road`), or two columns:
    `height_left` and `height_right`, or `height_1` (left) and `height_2` (right). All formats of
    `data.read_table` are read.

    Args:
        path: File of the table, in the units of its header, or in metres and seconds.

    Returns:
        The road; a drive starts at a random place.

    Raises:
        InputError: The file cannot be read, lacks a column, has three tracks, or holds no plausible road.
    """
    from ..records.data._table import read_columns

    path = Path(path)
    names: list[str] = []

    def choose(found: list[str]) -> list[str]:
        lower = {name.lower(): name for name in reversed(found)}
        along = next((k for k in ("distance", "time") if k in lower), None)
        heights = _height_columns(path, list(lower))
        if along is None or not heights:
            raise InputError(
                f"road '{path}' needs a header with 'distance' or 'time', and 'height'"
            )
        names[:] = [lower[name] for name in (along, *heights)]
        return names

    table = read_columns(path, choose)
    over_time = names[0].lower() == "time"
    columns = []
    for name, unit in zip(names, ("s" if over_time else "m", "m", "m"), strict=False):
        values = np.asarray(table.values[name])
        if values.dtype.kind not in "fiub" or values.ndim != 1:
            raise InputError(
                f"road '{path}': column {shown(name)} does not hold plain numbers"
            )
        try:
            columns.append(
                convert(values.astype(float), table.units.get(name) or unit, unit)
            )
        except InputError as error:
            raise InputError(f"road '{path}': column {shown(name)}: {error}") from None
    along, *heights = columns
    if len({len(side) for side in heights}) > 1:
        raise InputError(
            f"road '{path}': {shown(names[1])} and {shown(names[2])} differ in length"
        )
    height = heights[0] if len(heights) == 1 else np.array(heights)
    return profiled(
        str(path), along, height, over_time=over_time, axis=names[0], line=table.line
    )


#: heights of one side: 'height_left', 'left height', 'height_r', 'height_2'
_SIDE_COLUMN = re.compile(
    r"(?:height|road)[ _.-]?(?:(l(?:eft)?)|(r(?:ight)?)|(\d+))|(left)[ _.-]?(?:height|road)|(right)[ _.-]?(?:height|road)"
)


def _height_columns(path: Path, names: list[str]) -> list[str]:
    """Return the height columns among lower-case names: none, one, or left and right; raise `InputError` for others."""
    found: list[tuple[str, int, str]] = []
    plain = next((name for name in ("height", "road") if name in names), None)
    if plain is not None:
        found.append(("number", -1, plain))
    for name in names:
        if match := _SIDE_COLUMN.fullmatch(name):
            left = match[1] or match[4]
            right = match[2] or match[5]
            number = match[3]
            side = "left" if left else "right" if right else "number"
            found.append((side, int(number or 0), name))
    found.sort()
    sides = [side for side, _, _ in found]
    if len(found) > 2 or (
        found and sides not in (["number"], ["number", "number"], ["left", "right"])
    ):
        listed = ", ".join(shown(name) for _, _, name in found)
        count = "three tracks" if len(found) == 3 else f"{len(found)} tracks"
        problem = (
            f"has {count} ({listed})"
            if len(found) > 2
            else f"has no left and right in {listed}"
        )
        raise InputError(
            f"road '{path}' {problem}: keep one column 'height', or 'height_left' and 'height_right'"
        )
    return [name for _, _, name in found]


def profiled(
    source: str,
    along: np.ndarray,
    height: np.ndarray,
    *,
    over_time: bool,
    axis: str = "time",
    line: Callable[[int], str] = "sample {}".format,
) -> Road:
    """Return a road from a measured profile of one track or of a left and a right track.

    Args:
        source: File, for messages and the name of the road.
        along: Places (n,): distance [m] or time [s].
        height: Heights [m] (n,), or (2, n) for the left and the right track.
        over_time: Whether `along` is a time.
        axis: Name of the column of `along`, for messages.
        line: Line of a sample in the file, for messages.

    Returns:
        The road; a drive starts at a random place.

    Raises:
        InputError: Lengths differ, a value is not finite, `along` does not increase, or the road is too steep.
    """
    x, z = along, height
    if len(x) != z.shape[-1]:
        raise InputError(
            f"road '{source}': {shown(axis)} has {len(x)} samples, the height has {z.shape[-1]}"
        )
    sides = np.atleast_2d(z)
    wrong = (~np.isfinite(sides) | (np.abs(sides) > 1e5)).any(axis=0)
    bad = np.flatnonzero(~np.isfinite(x) | (np.abs(x) > 1e9) | wrong)
    if len(bad):
        raise InputError(
            f"road '{source}', {line(bad[0])}: not finite, or too large for a road"
        )
    if len(x) < 2:
        raise InputError(f"road '{source}' has fewer than two points")
    steps = np.diff(x)
    if steps.min() <= 0:
        where = line(int(np.argmax(steps <= 0)) + 1)
        raise InputError(f"road '{source}', {where}: {shown(axis)} does not increase")
    if steps.max() > 10 * np.median(steps):
        where = line(int(np.argmax(steps)) + 1)
        raise InputError(
            f"road '{source}', {where}: gap of {steps.max():g} in {shown(axis)}"
        )
    slope = float(np.median(np.abs(np.diff(sides)) / steps, axis=1).max())
    if slope > (STEEPEST * 20.0 if over_time else STEEPEST):
        raise InputError(
            f"road '{source}' climbs {slope:.3g} m in every {'second' if over_time else 'metre'}: is the height in mm? "
            "Name the unit in the header, as in 'height [mm]'"
        )
    return Road(
        Path(source).stem, abscissa=x, profile=z, over_time=over_time, shift=True
    )


_SIDES = ("left", "right")
NAMES = (
    "paper, paper-printed, flat, A ... H, bump, pothole, sweep, a file, or a sum such as C+bump; "
    "of one side: bump-left, pothole-right"
)


def road(source: str | Path | Road) -> Road:
    """Return a road from its name.

    Names are paper, paper-printed (kappa as in Table 6), flat, A to H, bump, pothole, sweep and files. A
    class and a profile add up: 'C+bump'. Both wheels of an axle meet 'bump' and 'pothole'; a single wheel
    meets 'bump-left' or 'pothole-right'.

    Args:
        source: Name, file, or a road, which is returned unchanged.

    Raises:
        InputError: The name is unknown, or the file holds no road.
    """
    if isinstance(source, Road):
        return source
    text = str(source)
    named: dict[str, Callable[[], Road]] = {
        "paper": paper_road,
        "paper-printed": lambda: replace(
            paper_road(PRINTED_KAPPA), name="paper-printed"
        ),
        "flat": lambda: Road("flat"),
        "bump": bump,
        "pothole": pothole,
        "sweep": sweep,
    }
    if text in named:
        return named[text]()
    shape, _, side = text.rpartition("-")
    if shape in ("bump", "pothole") and side in _SIDES:
        return on_side(named[shape](), side)
    if text.upper().removeprefix("ISO-") in ISO_CLASSES:
        return iso_road(text.upper().removeprefix("ISO-"))
    if os.path.exists(text) and not os.path.isdir(text):  # reading refuses a pipe
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
                    base,
                    abscissa=s.abscissa,
                    profile=s.profile,
                    over_time=s.over_time,
                    shift=s.shift,
                )
            return replace(base, name=text)
        raise InputError(
            f"road {shown(text)}: one rough road and one profile can be added"
        )
    raise InputError(f"no road {shown(text)}: {NAMES}")
