"""Excitations that a rig can play: their shapes within its limits, and the table that carries them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data import Table
from ..errors import InputError, shown
from ..network import Channel, Network, assemble
from ..units import convert
from .problem import Array, Record, bare

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

KINDS = ("multisine", "sweep", "steps", "triangle")
#: what a rig is taken to do at an input where neither data nor options say: reach [SI unit] and slope [SI unit/s]
REACH = {"m": 0.01, "m/s": 0.2, "m/s^2": 3.0, "rad": 0.2, "rad/s": 2.0, "rad/s^2": 30.0, "A": 5.0, "V": 6.0}
SLOPE = {"m": 0.5, "rad": 5.0}
WEIGHT = 0.1 * 9.81  # a force of a tenth of the masses' weight [m/s^2]
LENGTH = 20.0  # [s]
SAMPLES = 20.0  # per period of the band's upper end
RISE = 0.5  # [s] in which a test begins and ends, and no more than a tenth of it


@dataclass(frozen=True)
class Limits:
    """What the rig can do at one input: largest `reach` [SI unit] to either side and `slope` [SI unit/s]."""

    reach: float
    slope: float = math.inf

    def __post_init__(self) -> None:
        if not (0 < self.reach < math.inf and self.slope > 0):
            raise InputError(f"a limit of an input must be a number > 0, not {self.reach:g}")


@dataclass(frozen=True)
class Rig:
    """What can be played: `limits` of every input, the `band` (low, high) [Hz], `length` [s] and sampling `step` [s]."""

    limits: Mapping[str, Limits]
    band: tuple[float, float]
    length: float = LENGTH
    step: float = 2e-3

    def __post_init__(self) -> None:
        low, high = self.band
        if not 0 < low < high < math.inf:
            raise InputError(f"the band must go from a frequency > 0 to a higher one, not {low:g}:{high:g}")
        if not (self.length > 0 and math.isfinite(self.length)):
            raise InputError(f"the length of a test must be a number of seconds > 0, not {self.length:g}")
        if high * self.step > 0.25:
            raise InputError(
                f"a band up to {high:g} Hz wants a sampling rate of {4 * high:g} Hz or more, not {1 / self.step:g}"
            )
        if self.length * low < 1.0:
            raise InputError(
                f"in {self.length:g} s there is no period of {low:g} Hz: longer, or a higher band"
            )

    @property
    def time(self) -> Array:
        return np.asarray(self.step * np.arange(round(self.length / self.step) + 1), dtype=np.float64)


@dataclass(frozen=True)
class Excitation:
    """A test of one `kind`: at `level`, a share of each limit, between `low` and `high` [Hz], at the inputs `at`.

    seed: of the phases and the steps' heights. An input that is not in `at` stays at zero.
    """

    kind: str
    low: float
    high: float
    at: tuple[str, ...]
    level: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"no excitation {shown(self.kind)} (there are {', '.join(KINDS)})")

    def signals(self, network: Network, rig: Rig) -> dict[str, Array]:
        """Every input [SI unit] (samples,), within its limits, from zero to zero.

        network: the model whose inputs they are; rig: its limits, length and sampling step.
        """
        time = rig.time
        window = _window(time)
        out = {}
        for number, c in enumerate(network.inputs):
            if c.name not in self.at:
                out[c.name] = np.zeros(len(time))
                continue
            raw = _shape(self, c, time, np.random.default_rng([self.seed, number])) * window
            limits = rig.limits[c.name]
            raw *= self.level * limits.reach / max(float(np.abs(raw).max()), 1e-300)
            steep = float(np.abs(np.diff(raw)).max()) / rig.step
            if c.quantity != "current" and steep > limits.slope:
                raw *= limits.slope / steep
            out[c.name] = raw
        return out

    def describe(self, network: Network, rig: Rig) -> str:
        """In words, with the amplitudes: ``multisine, 0.5 to 15 Hz, 20 s: road to 8.2 mm``. Arguments: `network` and `rig`, as `signals` has them."""
        played = self.signals(network, rig)
        by_name = {c.name: c for c in network.inputs}
        parts = [f"{n} to {_amount(float(np.abs(played[n]).max()), by_name[n])}" for n in self.at]
        band = (
            f"at {self.low:.3g} Hz"
            if self.kind == "triangle"
            else f"up to {self.high:.3g} Hz"
            if self.kind == "steps"
            else f"{self.low:.3g} to {self.high:.3g} Hz"
        )
        return f"{self.kind}, {band}, {rig.length:g} s: {' and '.join(parts)}"

    def to_dict(self) -> dict[str, Any]:
        """JSON types."""
        return {
            "kind": self.kind,
            "band_hz": [self.low, self.high],
            "level": self.level,
            "at": list(self.at),
            "seed": self.seed,
        }


def _amount(value: float, c: Channel) -> str:
    if c.quantity == "displacement":
        return f"{1e3 * value:.3g} m{c.si}"
    return f"{value:.3g} {c.si}"


def _window(time: Array) -> Array:
    """From zero to one and back, smoothly, within `RISE`."""
    rise = min(RISE, 0.1 * float(time[-1]))
    ramp = np.clip(np.minimum(time, time[-1] - time) / rise, 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(math.pi * ramp), dtype=np.float64)


def _shape(e: Excitation, c: Channel, time: Array, rng: np.random.Generator) -> Array:
    """One input's signal before it is scaled. Displacements are played at about the same speed in all of the band."""
    moved = c.quantity == "displacement"
    if e.kind == "multisine":
        lines = np.arange(math.ceil(e.low * time[-1]), math.floor(e.high * time[-1]) + 1) / time[-1]
        if len(lines) > 200:  # as many a decade as below
            lines = np.unique(np.round(np.geomspace(lines[0], lines[-1], 200) * time[-1])) / time[-1]
        size = 1 / lines if moved else np.ones(len(lines))
        tries = [_sum(lines, size, rng.uniform(0, 2 * math.pi, len(lines)), time) for _ in range(6)]
        return min(tries, key=lambda y: float(np.abs(y).max() / max(y.std(), 1e-300)))
    if e.kind == "sweep":
        rate = math.log(e.high / e.low) / time[-1]
        phase = 2 * math.pi * e.low * np.expm1(rate * time) / rate
        middle = math.sqrt(e.low * e.high)
        size = np.minimum(1.0, middle / (e.low * np.exp(rate * time))) if moved else 1.0
        return np.asarray(size * np.sin(phase), dtype=np.float64)
    if e.kind == "triangle":
        return np.asarray(np.arcsin(np.sin(2 * math.pi * e.low * time)), dtype=np.float64)
    return _steps(e, c, time, rng)


def _sum(lines: Array, size: Array, phase: Array, time: Array) -> Array:
    out = np.zeros(len(time))
    for f, a, p in zip(lines, size, phase, strict=True):
        out += a * np.sin(2 * math.pi * f * time + p)
    return out


def _steps(e: Excitation, c: Channel, time: Array, rng: np.random.Generator) -> Array:
    """Levels held for a while, of any height; what cannot jump moves from one to the next within half a period of `high`."""
    out, at = np.zeros(len(time)), 0.0
    rise = 0.0 if c.quantity == "current" else 0.5 / e.high
    now = 0.0
    while at < time[-1]:
        hold = rise + rng.uniform(0.5 / e.high, max(0.5 / math.sqrt(e.low * e.high), 1.0 / e.high))
        to = rng.uniform(-1.0, 1.0)
        s = np.clip((time - at) / rise, 0.0, 1.0) if rise else (time >= at).astype(float)
        out += (to - now) * s**3 * (10 - 15 * s + 6 * s**2)  # least jerk
        now, at = to, at + hold
    return out


# ------------------------------------------------------------------------------------------------- the rig's limits


def rig_of(
    network: Network,
    records: Sequence[Record] = (),
    *,
    limits: Mapping[str, Limits] | None = None,
    band: tuple[float, float] | None = None,
    length: float | None = None,
    rate: float | None = None,
    notes: list[str] | None = None,
) -> Rig:
    """What the rig can play: as the options say, else the range of `records`, else what any rig of that kind can do.

    network: the model whose inputs are played. limits: by input. band: (low, high) [Hz]. length [s]. rate: sampling [Hz]. notes: gets a line for what nobody stated.
    """
    if not network.inputs:
        raise InputError(f"model '{network.name}' has no inputs: there is no test to play")
    said = notes if notes is not None else []
    given = dict(limits or {})
    for name in given:
        if name not in {c.name for c in network.inputs}:
            raise InputError(
                f"--limit: the model has no input {shown(name)} (it has: {', '.join(c.name for c in network.inputs)})"
            )
    for c in network.inputs:
        if c.name in given:
            continue
        if records:
            played = [np.asarray(r.inputs[c.name]) for r in records]
            reach = max(float(np.abs(x).max()) for x in played)
            steep = max(
                float(np.quantile(np.abs(np.diff(x)), 0.999)) / r.step
                for x, r in zip(played, records, strict=True)
            )
            if reach > 0:
                given[c.name] = Limits(reach, steep if c.quantity != "current" and steep > 0 else math.inf)
                continue
        weight = WEIGHT * sum(network.masses.values()) if c.si == "N" else 0.0
        reach = REACH.get(c.si) or weight
        if not reach:
            raise InputError(
                f"how far {c.name} may go is not known: say it with --limit {c.name}=VALUE [{c.unit}]"
            )
        given[c.name] = Limits(reach, SLOPE.get(c.si, math.inf))
        said.append(f"{c.name}: taken to reach {_amount(reach, c)} (--limit {c.name}=VALUE says otherwise)")
    own = band or (_band_of(records, network) if records else _natural_band(network))
    if band is None and not records:
        said.append(
            f"band: {own[0]:.3g} to {own[1]:.3g} Hz, about the model's own frequencies (--band says otherwise)"
        )
    step = 1 / rate if rate else records[0].step if records else 1.0 / (SAMPLES * own[1])
    if band is None:
        own = min(own[0], 0.1 / step), min(own[1], 0.25 / step)
    seconds = length or (max(r.samples * r.step for r in records) if records else max(LENGTH, 6.0 / own[0]))
    own = max(own[0], 1.0 / seconds) if band is None else own[0], own[1]
    return Rig(given, own, seconds, step)


def _natural_band(network: Network) -> tuple[float, float]:
    """From a quarter of the lowest to half as much again of the highest frequency [Hz] at which the model swings."""
    asm = assemble(bare(network))
    found = np.linalg.eigvals(asm.rate[:, asm.columns("x")]) if asm.size[0] else np.zeros(0)
    swings = np.abs(found[(np.abs(found.imag) > 0.05 * np.abs(found))]) / (2 * math.pi)
    swings = swings[np.isfinite(swings) & (swings > 1e-3)]
    if not len(swings):
        return 0.25, 15.0
    low, high = 0.25 * float(swings.min()), 1.5 * float(swings.max())
    return max(low, high / 200.0), high


def _band_of(records: Sequence[Record], network: Network) -> tuple[float, float]:
    """Frequencies [Hz] between which nearly all of the inputs' power lies, of displacements that of their speed."""
    from scipy.signal import welch

    low, high = math.inf, 0.0
    for r in records:
        for c in network.inputs:
            x = np.asarray(r.inputs[c.name])
            if not np.ptp(x) > 0:
                continue
            x = np.gradient(x, r.step) if c.quantity == "displacement" else x - x.mean()
            f, s = welch(x, 1 / r.step, nperseg=min(len(x), 8192))
            total = np.cumsum(s)
            low = min(low, float(f[np.searchsorted(total, 0.02 * total[-1])]))
            high = max(high, float(f[np.searchsorted(total, 0.95 * total[-1])]))
            low = max(low, float(f[1]))
    return (low, high) if 0 < low < high else (0.25, 15.0)


# ----------------------------------------------------------------------------------------------------- choosing


def candidates(network: Network, rig: Rig, seed: int = 0) -> Iterator[Excitation]:
    """Tests among which a design chooses: every kind, all of the band and either half of it, strong and weak, at all
    inputs and at each alone.

    network: the model whose inputs they are; rig: its band and length; seed: as every `Excitation` has it.
    """
    low, high = rig.band
    middle = math.sqrt(low * high)
    names = tuple(c.name for c in network.inputs)
    places = [names, *((n,) for n in names)] if len(names) > 1 else [names]
    for at in places:
        for kind in KINDS:
            bands = (
                [(low, high), (low, middle), (middle, high)]
                if kind in ("multisine", "sweep")
                else [(low, high)]
            )
            bands += [(middle, high)] if kind in ("steps", "triangle") else []
            for a, b in bands:
                if rig.length * a < 1.0:
                    continue
                for level in (1.0, 0.4):
                    yield Excitation(kind, a, b, at, level, seed)


def default(network: Network, rig: Rig, kind: str = "multisine", seed: int = 0) -> Excitation:
    """One test of that kind with all of the band at all inputs.

    network: the model whose inputs they are; rig: its band; kind: one of `KINDS`; seed: as `Excitation` has it.
    """
    return Excitation(kind, *rig.band, tuple(c.name for c in network.inputs), 1.0, seed)


def record_of(network: Network, rig: Rig, e: Excitation, name: str = "planned") -> Record:
    """A record of the test as it will be: inputs, and outputs that nobody measured yet (zeros).

    network: the model whose inputs it plays; rig: what plays it; e: the test; name: the record's.
    """
    inputs = e.signals(network, rig)
    return Record(name, rig.step, inputs, np.zeros((len(rig.time), len(network.outputs))))


def table_of(network: Network, record: Record, source: str = "planned test") -> Table:
    """The inputs of a record as a rig plays them: time [s] and a column for each in the channel's own unit.

    network: the model whose inputs they are; record: holds them [SI unit]; source: what the table calls its origin.
    """
    columns, units = {}, {}
    for c in network.inputs:
        columns[c.name] = convert(np.asarray(record.inputs[c.name]), c.si, c.unit)
        units[c.name] = c.unit
    return Table(record.step * np.arange(record.samples), columns, source, units)
