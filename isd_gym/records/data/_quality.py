"""The data gate: checks of a record's quality before a diagnosis."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import signal

from ..._common.errors import InputError, shown
from ..._common.units import CONDITIONS, convert
from ._columns import TIME
from ._signals import even_stamps, stamp_rounding

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from ._table import Table

    #: whether another channel moves from a first sample on for a number of samples
    Moving = Callable[[int, int], bool]

Level = Literal["error", "warning", "note"]
Span = tuple[float, float]


@dataclass(frozen=True)
class Finding:
    """A defect of a record, found by `check`."""

    #: 'error' (the record cannot be used as is), 'warning' (results from the record are doubtful) or 'note'
    level: Level
    channel: str  # channel; '' for the whole record
    message: str  # one line
    # spans of time [s] of the defect, at most 20; empty for the whole record
    where: tuple[Span, ...] = ()
    check: str = ""  # name of the check, of `CHECKS`

    def __str__(self) -> str:
        return (
            f"{self.level}: {self.channel + ': ' if self.channel else ''}{self.message}"
        )


#: quantity -> SI unit; spread above which a record is doubtful, and impossible, for a suspension or its rig;
#: smallest spread that a sensor could resolve. The spread is the largest distance of 99.5 % of the samples
#: from the median.
QUANTITIES: dict[str, tuple[str, float, float, float]] = {
    "displacement": ("m", 2.0, 5.0, 1e-6),
    "velocity": ("m/s", 10.0, 100.0, 1e-5),  # a vehicle coasts at 40
    "acceleration": ("m/s^2", 200.0, 2000.0, 1e-3),
    "force": ("N", 2e5, 1e6, 1e-2),
    "current": ("A", 200.0, 1000.0, 1e-4),
    "angle": ("rad", math.inf, math.inf, 1e-6),  # a rotation may be unlimited
    "angular_velocity": ("rad/s", 2e3, 2e4, 1e-5),
    "angular_acceleration": ("rad/s^2", 1e5, 1e7, 1e-3),
    "torque": ("N m", 1e5, 1e7, 1e-6),
    "voltage": ("V", 1e3, 1e5, 1e-5),
    "temperature": ("degC", 1e3, 1e4, 1e-3),
    "pressure": ("Pa", 1e9, 1e11, 1e-1),
    "speed": ("m/s", 1e3, 1e5, 1e-4),
}
MIN_SAMPLES = 200
#: samples that suffice for a record of as many periods of the rig
FEW_SAMPLES, PERIODS = 64, 10
#: time constant of `QUANTITIES` and of the limits below, if no model gives a rig's own [s]: body of a car on
#: its springs
CAR = 0.125
#: multiples of the rig's time constant: longest and shortest plausible step, longest step without doubt,
#: longest rest of a channel
LONGEST, SHORTEST, LONG, REST = 2.0, 8e-6, 0.4, 0.8
#: share of a channel's power (about its mean), held by clipped samples or missed by frozen samples, from
#: which a finding is an error. Frozen: 3 % of the deviation, the smallest disagreement that a diagnosis calls
#: an effect.
CLIPPED, MISSED = 0.1, 0.001
#: the same share at one end of a channel without noise, which may be simulated: friction holds an acceleration
RAILS = 0.25
#: equal samples at a level of a coarse encoder near a turn of the motion
STAIR = 5
STILL = 0.1  # share of a channel's usual power, in spans of equal length, below which the channel rests
GLITCHES = 3  # samples that may differ in a constant channel
ALIKE = 30.0  # factor between a channel and the model's output within which the scales agree
# factors between a channel and the model's output that a wrong unit causes
SLIP = (
    600.0,
    1600.0,
)
#: quantities of inputs that saturate and hold by design
COMMANDED = ("current", "force", *CONDITIONS)
#: names of the checks; an error may be accepted by the name of its check
CHECKS = (
    "time", "step", "length", "finite", "constant", "magnitude", "held", "jumps", "silent", "copies", "sign"
)  # fmt: skip
#: checks whose errors cannot be accepted: such a record cannot be compared
UNACCEPTABLE = ("time", "finite", "constant")
NOT_UNIFORM = "sampling is not uniform"
MAX_SPEED = 15.0  # largest plausible RMS speed of a displacement [m/s]; wheels and rods stay below 5


@dataclass(frozen=True)
class Scale:
    """Time constant and amplitudes of a rig, from its model."""

    # reciprocal of the circular frequency of the slowest oscillation [s]
    time: float = CAR
    #: time constant of the slowest oscillation or relaxation [s]; infinite if the rig only moves freely, NaN
    #: for that of the oscillation
    slowest: float = math.nan
    # period of the slowest oscillation [s]; infinite if unknown
    period: float = math.inf
    #: RMS about the mean of each output in a simulation of the record [SI]; empty if unknown
    spread: Mapping[str, float] = field(default_factory=dict)

    def factor(self, name: str, x: np.ndarray) -> float:
        """Return the ratio of a channel's measured amplitude (samples (n,) [SI]) to its simulated one; NaN if that is unknown."""
        said = self.spread.get(name, 0.0)
        return float(np.std(x)) / said if said > 0 else math.nan

    def explains(self, values: Mapping[str, np.ndarray]) -> bool:
        """Return whether all simulated outputs have the measured order of magnitude; the inputs are then plausible, too."""
        factors = [self.factor(n, values[n]) for n in self.spread if n in values]
        return bool(factors) and all(1 / ALIKE < f < ALIKE for f in factors)


@dataclass(frozen=True)
class _Channel:
    """A channel of a record, with its grain and its runs of equal samples."""

    name: str  # name
    quantity: str  # key of `QUANTITIES`
    is_input: bool  # whether the model is driven by the channel
    x: np.ndarray  # samples (n,) [SI]
    time: np.ndarray  # time stamps (n,) [s]

    @functools.cached_property
    def starts(self) -> np.ndarray:
        """First sample of each run of equal samples."""
        return np.r_[0, np.flatnonzero(np.diff(self.x)) + 1]

    @functools.cached_property
    def lengths(self) -> np.ndarray:
        """Number of samples of each run."""
        return np.diff(np.r_[self.starts, len(self.x)])

    @functools.cached_property
    def levels(self) -> np.ndarray:
        """Value of each run."""
        return self.x[self.starts]

    @functools.cached_property
    def resolution(self) -> float:
        """Smallest usual step between values."""
        gaps = np.diff(np.unique(self.x))
        return float(np.quantile(gaps[gaps > 1e-9 * np.ptp(self.x)], 0.1))

    @functools.cached_property
    def noise(self) -> float:
        """Standard deviation of the noise; 0 if 70 dB below the signal.

        The noise follows from eighth differences, which suppress signals below a tenth of the sampling rate, in
        windows of 50 samples outside of rest. Low quantiles over the windows exclude friction and impacts, which
        are intermittent.
        """
        moves = np.repeat(self.lengths < 5, self.lengths)
        jagged = np.abs(np.diff(self.x, 8))[sliding_window_view(moves, 9).all(axis=1)]
        if len(jagged) < 50:
            return 0.0
        windows = jagged[: len(jagged) // 50 * 50].reshape(-1, 50)
        quiet = float(np.quantile(np.median(windows, axis=1), 0.05))
        noise = quiet / (0.55 * math.sqrt(math.comb(16, 8)))
        return noise if noise > 3e-4 * np.std(self.x) else 0.0

    @property
    def ends(self) -> tuple[tuple[float, str], tuple[float, str]]:
        """Largest and smallest value, without negative zeros, and their names."""
        largest = float(self.x.max())
        smallest = float(self.x.min())
        return (largest + 0.0, "largest"), (smallest + 0.0, "smallest")

    def finding(self, level: Level, text: str, flags: np.ndarray) -> Finding:
        """Return a finding on the flagged samples (n,)."""
        return Finding(level, self.name, text, _spans(flags, self.time))


def check(
    table: Table,
    *,
    inputs: Mapping[str, str],
    outputs: Mapping[str, str],
    scale: Scale | None = None,
) -> list[Finding]:
    """Judge whether a record can be trusted: the data gate of the diagnosis.

    Every test compares a channel with itself, with the other channels, or with physical limits. Errors that
    only a model reveals (swapped channels of one kind, shifted time, sign) are not judged.

    A constant output is an error. Clipped and frozen samples are warnings unless enough of the signal is
    affected:

    - Clipped samples are an error if they hold `CLIPPED` of the channel's power about its mean, `RAILS` in a
      channel without noise. Samples at
      zero are rest, not clipping (a range ends elsewhere), and so are samples during which no other channel
      moves.
    - Frozen samples are an error if they miss `MISSED` of the channel's power. The missed power of a stretch
      is the mean square error of linear interpolation over stretches of the same length elsewhere in the
      channel, plus a third of the squared jump at the end of the stretch. Stretches during which no other
      channel moves do not count, nor stretches before and after which the channel stays within its
      resolution.

    Args:
        table: The record.
        inputs: Quantity (a key of `QUANTITIES`) by input channel.
        outputs: Quantity by output channel.
        scale: Scale of the rig, from its model; None for the scale of a car.

    Returns:
        Findings, errors first. A list without errors and warnings means that the record can be trusted.

    Raises:
        InputError: The table lacks a channel, or a quantity is unknown.
    """
    values = {
        name: _in_si(table, name, quantity)
        for name, quantity in {**inputs, **outputs}.items()
    }
    scale = scale or Scale()
    found = _named("time", _check_time(table.time))
    if not found or found[-1].level != "error":
        found += _named("length", _check_length(table.time, scale))
    if any(f.level == "error" for f in found):
        return found  # the other checks need a time base
    found += _named("step", _check_step(table.time, scale))
    time = table.uniform().time
    found += _check_content(values, inputs, outputs, time)
    dead = {f.channel for f in found if f.check in ("finite", "constant")}
    alive = [
        _Channel(name, quantity, name in inputs, values[name], time)
        for name, quantity in {**inputs, **outputs}.items()
        if name not in dead
    ]
    are_explained = scale.explains(values)
    for channel in alive:
        if channel.name in outputs:
            of_model = scale.factor(channel.name, channel.x)
        else:
            of_model = 1.0 if are_explained else math.nan
        magnitude = _check_magnitude(channel, table.step, of_model)
        found += _named("magnitude", magnitude)
        if channel.name not in outputs and channel.quantity in COMMANDED:
            continue
        others = [c for c in alive if c is not channel]
        held = _check_held(channel, REST * scale.time, others)
        found += _named("held", held)
        # a jump may be the end of a frozen stretch
        if all(f.level == "note" for f in held):
            found += _named("jumps", _check_spikes(channel))
    drives = [values[n] for n in inputs]
    moving = {c.name: _moves(c.x, drives) for c in alive if c.name in outputs}
    found += _named("silent", _check_silent(moving))
    found += _named("copies", _check_same_columns(values))
    found += _named("copies", _check_repeats(alive, time))
    return sorted(found, key=lambda f: ("error", "warning", "note").index(f.level))


def _in_si(table: Table, name: str, quantity: str) -> np.ndarray:
    """Return a channel (n,) in the SI unit of its quantity."""
    if quantity not in QUANTITIES:
        raise InputError(
            f"'{name}': unknown quantity '{quantity}' (known: {', '.join(QUANTITIES)})"
        )
    unit = QUANTITIES[quantity][0]
    return convert(table[name], table.units.get(name) or unit, unit)


def _check_silent(moving: Mapping[str, bool]) -> list[Finding]:
    """Return findings on outputs that hold nothing but noise: errors where no output moves."""
    level: Level = "warning" if any(moving.values()) else "error"
    text = "holds nothing but noise: no excitation, or not connected?"
    return [Finding(level, name, text) for name, moves in moving.items() if not moves]


def rises_unevenly(time: np.ndarray) -> bool:
    """Return whether stamps (n,) [s] rise without gaps, but not at uniform steps."""
    return any(f.message.startswith(NOT_UNIFORM) for f in _check_time(time))


def known_check(name: str) -> None:
    """Check that the errors of a check can be accepted."""
    if name not in (*CHECKS, "all") or name in UNACCEPTABLE:
        known = ", ".join(c for c in CHECKS if c not in UNACCEPTABLE)
        raise InputError(
            f"no check {shown(name)} that can be accepted (there are {known}, all)"
        )


def admit(
    table: Table, findings: Sequence[Finding], notes: list[str], accept: Sequence[str]
) -> None:
    """Append the findings of the data gate to the notes, and stop at an error that the user has not accepted."""
    for f in findings:
        message = f"{table.source}: {f.channel + ': ' if f.channel else ''}{f.message}"
        if f.level == "error" and f.check in UNACCEPTABLE:
            raise InputError(message)
        if f.level == "error" and not {f.check, "all"} & set(accept):
            helps = (
                f"--unit {f.channel}=UNIT says another; "
                if f.check == "magnitude"
                else ""
            )
            raise InputError(f"{message} ({helps}--accept {f.check} goes on)")
        notes.append(f"{Path(table.source).name}: {f}")


def _named(check: str, findings: Iterable[Finding]) -> list[Finding]:
    return [replace(f, check=check) for f in findings]


def _spans(flags: np.ndarray, time: np.ndarray) -> tuple[Span, ...]:
    edges = np.flatnonzero(np.diff(np.r_[False, flags, False])).reshape(-1, 2)
    return tuple((float(time[a]), float(time[b - 1])) for a, b in edges[:20])


def _check_length(time: np.ndarray, scale: Scale) -> list[Finding]:
    """Return an error on a record of few samples, and a warning where few samples are few periods of the rig, too."""
    count = len(time)
    periods = float(np.ptp(time)) / scale.period
    if count < FEW_SAMPLES:
        return [
            Finding(
                "error", "", f"too short: {count} samples of at least {FEW_SAMPLES}"
            )
        ]
    if count >= MIN_SAMPLES or periods >= PERIODS:
        return []
    text = f"short: {count} samples of {MIN_SAMPLES} (or {FEW_SAMPLES} for {PERIODS} periods of the rig)"
    return [Finding("warning", "", text)]


def _check_step(time: np.ndarray, scale: Scale) -> list[Finding]:
    """Return a finding on a step that suggests another unit than seconds.

    The slowest motion of the rig tells which steps are plausible. A relaxation beyond the record tells no more than the record's
    length, and a rig that only moves freely tells nothing: a step that is too long for a car is a warning then.
    """
    duration = float(np.ptp(time))
    step = duration / (len(time) - 1)
    slowest = (
        scale.time if math.isnan(scale.slowest) else max(scale.time, scale.slowest)
    )
    # a slow step on a fast rig is no wrong unit yet
    slow = max(min(slowest, duration), CAR)
    shortest = SHORTEST * min(scale.time, CAR)
    text = f"a step of {step:.4g} s is implausible: is time in another unit than s?"
    if not shortest <= step <= LONGEST * slow:
        return [Finding("error", TIME, text)]
    if step > LONG * slow or (math.isinf(slowest) and step > LONGEST * CAR):
        return [Finding("warning", TIME, text)]
    return []


def _check_time(time: np.ndarray) -> list[Finding]:
    if not np.all(np.isfinite(time)):
        return [
            Finding(
                "error",
                TIME,
                f"{np.sum(~np.isfinite(time))} time stamps are missing or not finite",
            )
        ]
    if len(time) < 3:
        return []
    found: list[Finding] = []
    if rounding := stamp_rounding(time):
        time = even_stamps(time)
        text = f"time stamps are rounded to {rounding:.2g} s; the step is {time[1] - time[0]:.6g} s"
        found.append(Finding("note", TIME, text))
    d = np.diff(time)
    for bad, what in ((d < 0, "runs backwards"), (d == 0, "repeats")):
        if bad.any():
            text = f"time {what} after t = {time[np.argmax(bad)]:.6g} s ({bad.sum()} times)"
            return [Finding("error", TIME, text, _spans(np.r_[bad, False], time))]
    step = float(np.median(d))
    gaps = d > 1.5 * step
    if (
        gaps.any()
        and np.mean(gaps) < 0.2
        and np.max(np.abs(d[~gaps] - step)) < 0.2 * step
    ):
        first = int(np.argmax(gaps))
        text = f"{gaps.sum()} gaps in time, the first of {d[first]:.4g} s after t = {time[first]:.6g} s"
        where = tuple(
            (float(time[i]), float(time[i + 1])) for i in np.flatnonzero(gaps)[:20]
        )
        return [
            Finding("error", TIME, f"{text}, where the step is {step:.4g} s", where)
        ]
    step = float(time[-1] - time[0]) / (len(time) - 1)
    # deviation from the best uniform grid
    stray = float(np.ptp(time - step * np.arange(len(time)))) / 2
    # stamps with few digits deviate by half the last digit; the ends, and so the step, deviate as much
    digit = next(
        (
            10.0**-k
            for k in range(9)
            if np.max(np.abs(time - np.round(time, k))) < 1e-3 * step
        ),
        0.0,
    )
    if stray > max(0.1 * step, min(0.76 * digit, step)):
        worst = time[int(np.argmax(np.abs(d - step)))]
        text = f"{NOT_UNIFORM}: steps from {d.min():.4g} to {d.max():.4g} s, worst at t = {worst:.6g} s"
        return [Finding("error", TIME, text)]
    if stray > 0.01 * step:
        text = f"time stamps stray by {stray:.2g} s from a step of {step:.6g} s; taken as uniform"
        found.append(Finding("note", TIME, text))
    return found


def spread_and_speed(x: np.ndarray, step: float, quantity: str) -> tuple[float, float]:
    """Return the spread of a channel (n,) (see `QUANTITIES`), and the RMS speed of a displacement [1/s]; 0 for other quantities."""
    spread = float(np.quantile(np.abs(x - np.median(x)), 0.995))
    if quantity != "displacement":
        return spread, 0.0
    lag = min(max(1, round(0.02 / step)), len(x) - 1)
    return spread, float(np.std(x[lag:] - x[:-lag])) / (lag * step)


def _check_magnitude(channel: _Channel, step: float, of_model: float) -> list[Finding]:
    """Return findings on impossible amplitudes; `of_model` is the ratio to the model's amplitude and has
    priority (NaN: unknown)."""
    x, quantity = channel.x, channel.quantity
    unit, doubtful, impossible, least = QUANTITIES[quantity]
    spread, speed = spread_and_speed(x, step, quantity)
    if 1 / ALIKE < of_model < ALIKE:
        doubtful = math.inf
        impossible = math.inf
        least = 0.0
        speed = 0.0
    level: Level = "warning"
    text = f"{quantity} reaches {spread:.4g} {unit}"
    if spread > impossible or speed > MAX_SPEED:
        level = "error"
        text += f" at {speed:.3g} m/s" if speed > MAX_SPEED else ""
        text += ", which cannot be: a wrong unit, or columns swapped?"
    elif SLIP[0] < max(of_model, 1 / of_model) < SLIP[1]:
        times = "a thousand times" if of_model > 1 else "a thousandth of"
        text += f", {times} what the model says for these inputs: a wrong unit?"
    elif spread > doubtful:
        text += ": a wrong unit, or columns swapped?"
    elif np.ptp(x) < 2 * least:
        text = f"{quantity} stays within {np.ptp(x):.2g} {unit}: a wrong unit?"
    elif quantity == "acceleration" and abs(abs(np.mean(x)) - 9.81) < 0.3:
        text = f"has a mean of {np.mean(x):.3g} m/s^2: gravity is still in it"
    else:
        return []
    return [Finding(level, channel.name, text)]


def _check_content(
    values: Mapping[str, np.ndarray],
    inputs: Mapping[str, str],
    outputs: Mapping[str, str],
    time: np.ndarray,
) -> list[Finding]:
    """Return findings on samples that are not finite, and on constant channels."""
    found, idle = [], []
    for name, x in values.items():
        bad = ~np.isfinite(x)
        if bad.any():
            where = _spans(bad, time)
            text = f"{bad.sum()} samples are not finite, first at t = {where[0][0]:.6g} s: split the record there"
            found.append(Finding("error", name, text, where, "finite"))
            continue
        value = _constant(x, 0 if name in inputs else GLITCHES)
        if value is None:
            continue
        level: Level = "error"
        text = f"is constant ({value:.6g}): a dead sensor, or an empty column? Take it out of the model's outputs"
        if name in inputs:
            level = "note"
            text = f"is constant ({value:.6g})"
            idle.append(name)
        found.append(Finding(level, name, text, check="constant"))
    if idle and outputs and len(idle) == len(inputs):
        text = f"no input changes ({', '.join(idle)}): the outputs are compared with free motion"
        found.append(Finding("warning", "", text, check="constant"))
    return found


def _constant(x: np.ndarray, glitches: int = GLITCHES) -> float | None:
    """Return the only value of a channel x (n,) apart from some `glitches` [samples]; None for a channel that varies."""
    value = float(np.median(x)) + 0.0  # no negative zero
    off = np.abs(x - value) > 1e-12 * np.max(np.abs(x))
    return value if off.sum() <= glitches else None


def _moves(x: np.ndarray, drives: list[np.ndarray]) -> bool:
    """Return whether a channel holds more than noise: slow, or with a spectrum that is not flat, or coherent with an input."""
    # white noise has sqrt(2), AR(1) noise of 0.6 still 0.89
    if np.std(np.diff(x)) < 0.9 * np.std(x):
        return True
    # a train of impacts is white but not Gaussian
    if np.mean((x - x.mean()) ** 4) > 4.5 * np.var(x) ** 2:
        return True
    options: dict[str, Any] = {"nperseg": min(128, len(x) // 8), "detrend": "linear"}
    power = signal.welch(x, **options)[1][1:-1]
    # white 1, AR(1) noise of 0.6 0.64
    if np.exp(np.mean(np.log(power + 1e-300))) < 0.6 * np.mean(power):
        return True
    least = 0.05 + 3 * options["nperseg"] / len(x)
    drives = [u for u in drives if np.all(np.isfinite(u)) and np.ptp(u) > 0]
    return any(
        np.mean(signal.coherence(u, x, **options)[1][2:-1]) > least for u in drives
    )


def held_samples(name: str, x: np.ndarray, time: np.ndarray) -> list[Finding]:
    """Return findings on clipping, frozen stretches and slow sampling of a column (n,) of unknown quantity; none for a constant column."""
    if _constant(x) is not None:
        return []
    return _check_held(_Channel(name, "force", False, x, time), REST * CAR, [])


def _sticks(channel: _Channel, least: int) -> bool:
    """Return whether a channel rests at many levels, possibly its extremes, and leaves each level continuously.

    After a dropout the channel returns at another level.
    """
    x = channel.x
    after = channel.starts + channel.lengths
    rests = np.flatnonzero((channel.lengths >= least) & (after < len(x)))
    levels = channel.levels[rests]
    if len(np.unique(levels)) < 5:
        return False
    away = np.abs(x[after[rests]] - levels)
    steps = np.abs(np.diff(x))
    return bool(np.median(away) < 2.0 * np.median(steps[steps > 0]))


def _turns_on_stairs(channel: _Channel, value: float) -> bool:
    """Return whether a channel rests at a value once, and at levels just before and just after it, as a coarse encoder does where the motion
    turns; a clipped channel enters and leaves the value in motion."""
    starts, lengths = channel.starts, channel.lengths
    is_long = lengths >= STAIR
    is_value = channel.levels == value
    at = np.flatnonzero(is_value & is_long)
    if len(at) != 1:
        return False
    first = int(starts[at[0]])
    length = int(lengths[at[0]])
    near = is_long & ~is_value
    before = near & (starts < first) & (starts + lengths >= first - length)
    after = near & (starts > first) & (starts <= first + 2 * length)
    return bool(before.any() and after.any())


def _moving_during(others: Sequence[_Channel]) -> Moving:
    """Return a function that tells whether one of the `others` moves from a first sample for a number of samples; always without others.

    A channel moves if its power, without that of its noise, is at least `STILL` of its usual power in
    stretches of equal length.
    """

    @functools.cache
    def usual(k: int, length: int) -> float:
        x = others[k].x
        stretches = x[: len(x) // length * length].reshape(-1, length)
        return float(stretches.var(axis=1).mean()) - others[k].noise ** 2

    def moving(first: int, length: int) -> bool:
        length = max(length, 2)
        for k, other in enumerate(others):
            here = min(first, len(other.x) - length)
            power = float(other.x[here : here + length].var()) - other.noise**2
            if usual(k, length) > 0 and power > STILL * usual(k, length):
                return True
        return not others

    return moving


def _missed_power(channel: _Channel, held: np.ndarray) -> float:
    """Return the share of a channel's power that frozen runs miss (see `check`)."""
    x = channel.x
    starts = channel.starts
    lengths = channel.lengths
    frozen = np.repeat(held, lengths)
    sound = np.cumsum(np.r_[0, frozen])

    @functools.cache
    def by_interpolation(length: int) -> float:
        at = np.arange(0, len(x) - length, max(1, length // 4))
        at = at[sound[at + length + 1] == sound[at]]
        at = at[:: max(1, len(at) // 100)]
        if len(at) < 3:
            return float(np.var(x[~frozen])) if not frozen.all() else math.inf
        windows = x[at[:, None] + np.arange(length + 1)]
        ramps = windows[:, :1] + (windows[:, -1:] - windows[:, :1]) * np.linspace(
            0, 1, length + 1
        )
        return float(np.mean((windows - ramps) ** 2))

    missed = 0.0
    for first, length in zip(
        starts[held].tolist(), lengths[held].tolist(), strict=True
    ):
        back = float(x[first + length] - x[first]) if first + length < len(x) else 0.0
        missed += length * (by_interpolation(length) + back**2 / 3)
    return missed / (len(x) * float(np.var(x)))


def _at_end(
    channel: _Channel,
    moving: Moving,
    is_alone: bool,
    end: tuple[float, str],
    text: str,
    level: Level,
) -> list[Finding]:
    """Return findings on samples at the largest or the smallest value, an `end` of the channel."""
    x, (value, what) = channel.x, end
    longest = int(np.argmax(np.where(channel.levels == value, channel.lengths, 0)))
    if not moving(int(channel.starts[longest]), int(channel.lengths[longest])):
        return []
    flags = x == value
    share = flags.sum() * (value - x.mean()) ** 2 / (len(x) * np.var(x))
    if abs(value) >= 0.5 * channel.resolution:
        is_severe = share > (RAILS if level == "note" else CLIPPED)
        return [channel.finding("error" if is_severe else level, text, flags)]
    # at rest, or a sensor of one direction
    if is_alone or share <= CLIPPED:
        return []
    text = f"{flags.sum()} samples are exactly 0, its {what} value, while other channels move: is one direction alone measured?"
    return [channel.finding(level, text, flags)]


def _check_held(
    channel: _Channel, rest: float, others: Sequence[_Channel]
) -> list[Finding]:
    """Return findings on clipping, frozen sensors, dropouts and slow sampling.

    All are runs of exactly equal samples, longer than `rest` [s] or frequent. In a channel with noise, many
    equal samples have no innocent cause except a resolution coarser than the momentary noise. A channel
    without noise (an encoder, a command, a simulation) may rest: only a dead stop in mid-motion is reported.
    The affected share of the signal separates warnings from errors (see `check`).
    """
    if slow := _sampled_slowly(channel):
        return slow
    moving = _moving_during(others)
    is_alone = not others
    if channel.noise > channel.resolution:
        found, held, level, worst = _stops_in_noise(channel, moving, is_alone)
    else:
        found, held, level, worst = _dead_stops(channel, moving, is_alone, rest)
    stretches = zip(channel.starts[held], channel.lengths[held], strict=True)
    held[held] = [moving(int(first), int(length)) for first, length in stretches]
    if held.any():
        flags = np.repeat(held, channel.lengths)
        begin = channel.time[np.argmax(flags)]
        text = f"does not change for {flags.sum()} samples, first at t = {begin:.6g} s: frozen, dropped out?"
        if worst != level and _missed_power(channel, held) > MISSED:
            level = worst
        found.append(channel.finding(level, text, flags))
    return found


def _sampled_slowly(channel: _Channel) -> list[Finding]:
    """Return a finding on a channel that holds each value for several samples.

    An encoder at constant speed also gives stairs, of one resolution each.
    """
    usual = int(np.bincount(channel.lengths).argmax())
    is_held = usual > 1 and np.mean(channel.lengths == usual) > 0.6
    if not is_held or len(np.unique(channel.x)) <= 20:
        return []
    if np.median(np.abs(np.diff(channel.levels))) <= 1.5 * channel.resolution:
        return []
    text = f"holds each value for {usual} samples: sampled more slowly than the table"
    return [Finding("warning", channel.name, text)]


def _stops_in_noise(
    channel: _Channel, moving: Moving, is_alone: bool
) -> tuple[list[Finding], np.ndarray, Level, Level]:
    """Return findings on clipping of a noisy channel, which runs are frozen, and the usual and the worst level of a finding on these."""
    x = channel.x
    lengths = channel.lengths
    levels = channel.levels
    n = len(x)
    per_noise = channel.resolution / channel.noise
    # probability that two samples are equal
    equal = max(np.sum(lengths[lengths < 5] - 1) / n, min(0.9, per_noise / 2.5), 1 / n)
    # n equal^(least - 1) < 1e-4
    least = max(5, 1 + math.ceil(math.log(1e-4 / n) / math.log(equal)))
    sticks = _sticks(channel, least)
    found: list[Finding] = []
    settled: list[float] = []  # values at which the channel is clipped or rests
    for value, what in channel.ends:
        if sticks or _turns_on_stairs(channel, value):
            continue
        count = np.sum(x == value)
        # at neighbouring values
        beside = (np.sum(np.abs(x - value) < channel.noise) - count) * per_noise
        if count >= max(least, 5 + 10 * beside):
            settled.append(value)
            text = f"is clipped: {count} samples sit exactly at the {what} value, {value:.6g}"
            end = value, what
            found += _at_end(channel, moving, is_alone, end, text, "warning")
    held = (lengths >= least) & ~np.isin(levels, settled)
    held[held] = ~_calm(channel, held)
    # simulated stick and slip
    rests = np.sum(held) > 10 and len(np.unique(levels[held])) == 1
    return found, held, "warning", "warning" if rests or sticks else "error"


def _dead_stops(
    channel: _Channel, moving: Moving, is_alone: bool, rest: float
) -> tuple[list[Finding], np.ndarray, Level, Level]:
    """Return findings on dead stops at the ends of a channel without noise, which runs are frozen, and the usual and the worst level of a
    finding on these."""
    x = channel.x
    starts = channel.starts
    lengths = channel.lengths
    # last step, compared with the curvature just before
    into = np.abs(np.diff(x, prepend=x[0]))[starts]
    second = np.abs(np.diff(x, 2, prepend=[x[0], x[0]]))
    curved = np.array(
        [np.median(second[max(s - 6, 0) : s]) if s else np.inf for s in starts]
    )
    held = (lengths >= 5) & (into > 4 * (curved + channel.resolution))
    is_position = channel.quantity in ("displacement", "angle") and not channel.is_input
    level: Level = "warning" if is_position else "note"  # no mass stops dead
    found: list[Finding] = []
    settled: list[float] = []
    for value, what in channel.ends:
        if np.sum(held & (channel.levels == value)) > 1:
            settled.append(value)
            text = (
                f"stops dead at its {what} value, {value:.6g}, time and again: clipped?"
            )
            end = value, what
            found += _at_end(channel, moving, is_alone, end, text, level)
    step = channel.time[1] - channel.time[0]
    held &= (lengths * step > rest) & ~np.isin(channel.levels, settled)
    if is_alone or channel.is_input or _sticks(channel, 5):
        return found, held, level, level
    return found, held, level, "error" if is_position else "warning"


def _calm(channel: _Channel, held: np.ndarray) -> np.ndarray:
    """Return True for each held run before and after which the channel changes by at most its grain per sample.

    Such a channel came to rest; a frozen sensor stops in mid-motion.
    """
    step = min(channel.noise, 2 * channel.resolution)
    steps, around = np.abs(np.diff(channel.x)), 10

    def quiet(first: int, stop: int) -> bool:
        part = steps[max(first, 0) : stop]
        return not len(part) or float(np.median(part)) <= step

    return np.array(
        [
            quiet(a - around, a) and quiet(a + k - 1, a + k - 1 + around)
            for a, k in zip(channel.starts[held], channel.lengths[held], strict=True)
        ],
        dtype=bool,
    )


def _check_spikes(channel: _Channel) -> list[Finding]:
    """Return findings on one to three samples far from their neighbours on both sides, and on jumps of a displacement.

    "Far" means four times any step within ten samples on either side, twelve times the noise, and four times
    the 97 % quantile of all steps. (Friction makes an acceleration jump to and fro, but by no more than its
    other jumps.)
    """
    x = channel.x
    quantity = channel.quantity
    time = channel.time
    noise = channel.noise
    resolution = channel.resolution
    grain = max(3 * noise, resolution)
    is_command = channel.is_input and noise <= resolution
    n, around = len(x), 10
    d = np.abs(np.diff(x))
    # [i]: largest of d[i] ... d[i + 9]
    largest = sliding_window_view(d, around).max(axis=1)
    usual = float(np.quantile(d, 0.97))
    flags = np.zeros(n, bool)
    # short pulses are plausible in a command, and in a force or an acceleration: an impact
    is_sudden = is_command or quantity in ("force", "acceleration")
    for width in (1,) if is_sudden else (1, 2, 3):
        s = np.arange(around + 1, n - width - around)
        local = np.maximum(largest[s - 1 - around], largest[s + width])
        before = x[s - 1]
        change = x[s + width] - x[s - 1]
        inside = np.arange(width)[:, None]
        off = x[s + inside] - before - change * (inside + 1) / (width + 1)
        is_one_side = np.abs(np.sign(off).sum(axis=0)) == width
        least = np.where(is_one_side, np.abs(off).min(axis=0), 0.0)
        is_back = np.abs(change) <= (width + 1) * local
        far = 4 * np.maximum(np.maximum(local, grain), usual)
        flags[s[is_back & (least > far)] + inside] = True
    found = []
    if flags.any():
        text = f"{flags.sum()} samples are spikes or dropouts, first at t = {time[np.argmax(flags)]:.6g} s"
        many = flags.mean() > 0.005 and quantity in ("displacement", "velocity")
        level: Level = "error" if many else "warning"
        found.append(channel.finding(level, text, flags))
    if quantity == "displacement":
        s = np.arange(around, n - 1 - around)
        local = np.maximum(largest[s - around], largest[s + 1])
        # a commanded step has rest on both sides
        at = s[(d[s] > 5 * np.maximum(local, grain)) & (local > 0)]
        if len(at):
            text = f"jumps by {d[at[0]]:.3g} m in one sample after t = {time[at[0]]:.6g} s: samples lost?"
            where = tuple((float(time[i]), float(time[i + 1])) for i in at[:20])
            found.append(Finding("error", channel.name, text, where))
    return found


def _check_same_columns(values: Mapping[str, np.ndarray]) -> list[Finding]:
    """Return findings on columns that are equal to an earlier column."""
    found = []
    names = [n for n, x in values.items() if np.all(np.isfinite(x)) and np.ptp(x) > 0]
    for first, second in itertools.combinations(names, 2):
        if np.array_equal(values[first], values[second]):
            text = f"is the same column as '{first}'"
            found.append(Finding("error", second, text))
    return found


def _check_repeats(channels: Sequence[_Channel], time: np.ndarray) -> list[Finding]:
    """Return a finding on samples that all noisy channels repeat, later by a common time."""
    noisy = [c for c in channels if c.noise > c.resolution]
    if len(noisy) < 2:
        return []
    rows = np.column_stack([c.x for c in noisy])
    order = np.lexsort(rows.T)
    same = np.all(rows[order[1:]] == rows[order[:-1]], axis=1)
    shift, count = np.unique(np.abs(order[1:] - order[:-1])[same], return_counts=True)
    if not len(shift):
        return []
    by = int(shift[count.argmax()])
    flags = np.zeros(len(rows), bool)
    flags[by:] = np.all(rows[by:] == rows[:-by], axis=1)
    # a periodic simulation without noise repeats throughout
    twice = np.sum(np.all(rows[2 * by :] == rows[: -2 * by], axis=1))
    # probability that two samples are equal at rest
    chance = math.prod(c.resolution / (2.5 * c.noise) for c in noisy)
    if flags.sum() < max(5, 3 * twice, 10 * len(rows) * chance):
        return []
    where = _spans(flags, time)
    earlier = f"{by * (time[1] - time[0]):.4g} s earlier"
    text = f"{flags.sum()} samples, first at t = {where[0][0]:.6g} s, repeat those {earlier}"
    return [Finding("error" if flags.sum() >= 20 else "warning", "", text, where)]
