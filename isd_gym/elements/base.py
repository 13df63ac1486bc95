"""What an element is: its base class, its parameters, the registry, and what it knows of itself.

The force of an element is positive in tension: with the elongation d = x_first - x_second [m] and its rate
v [m/s] it pulls `first` by -F and `second` by +F.
"""

from __future__ import annotations

import functools
import math
import os
import re
import runpy
from dataclasses import MISSING, Field, dataclass, field, fields
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from .. import arrays
from ..arrays import Array as Array  # noqa: TC001  (re-exported)
from ..errors import InputError, plain, shown
from ..inputs import number

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from ..network import Network

GROUND = "ground"

#: Kinds of physical effect, as a diagnosis states them: the value of `Element.mechanism` is one of these.
MECHANISMS = (
    "dry_friction",
    "viscous",
    "elastic",
    "play",
    "inertial",
    "position_periodic",
    "series_compliance",
    "drive",
    "sensor",
    "constant",
    "other",
)


def parameter(
    unit: str,
    low: float,
    high: float,
    *,
    default: float | None = None,
    minimum: float = 0.0,
    open_end: bool = False,
    fixed: bool = False,
    spread: float | None = None,
    stride: float | None = None,
) -> Any:
    """A parameter [unit] with its plausible range (low, high) for a car corner, and the hard lower limit.

    The hard upper limit is a million times the plausible end, as often as the unit divides by a length: rigs that move by
    micrometres do so, too. It holds for the magnitude where there is no lower limit.

    `fixed` parameters give the law its shape and are not fitted unless asked for. `spread`: how far from its default
    a value is plausible at all (one sigma, where a car's range says nothing about other rigs). `stride`: how far a
    single step of a fit may go.

    unit: as in `units.TABLE`, or '-'. low, high: where a fit begins to look. default: in a model file that does not say.
    minimum: the hard lower limit, itself out of bounds with `open_end`.
    """
    lengths = re.search(r"/m(?:\^(\d))?$", unit)
    often = int(lengths[1] or 1) if lengths else 1
    meta = {
        "unit": unit,
        "range": (low, high),
        "minimum": minimum,
        "maximum": 1e6**often * max(abs(low), abs(high))
        if math.isfinite(low) and math.isfinite(high)
        else 1e12,
        "open": open_end,
        "fixed": fixed,
        "spread": spread,
        "stride": stride,
        "plausible": None,
        "reach": None,
    }
    return field(metadata=meta) if default is None else field(default=default, metadata=meta)


def plausible(of: Any, low: float = -math.inf, high: float = math.inf, *, reach: float | None = None) -> Any:
    """Return a parameter with the range that is plausible for a missing effect.

    The diagnosis looks for the value within this range. A model file may go beyond it.

    Args:
        of: The parameter, as `parameter` returns it.
        low: Least plausible value [unit of the parameter].
        high: Largest plausible value [unit of the parameter].
        reach: Largest factor by which a fit may leave the start value.
    """
    meta = {**of.metadata, "plausible": (low, high), "reach": reach}
    return field(metadata=meta) if of.default is MISSING else field(default=of.default, metadata=meta)


# --------------------------------------------------------------------------- what an element may look at


@dataclass(frozen=True)
class Motion:
    """What happens between a pair of nodes in the simulation at hand: elongation d [m], its rate v and acceleration a."""

    d: Array
    v: Array
    a: Array

    @property
    def reach(self) -> float:
        """Largest elongation [m]."""
        return max(float(np.abs(self.d).max()), 1e-12)


def rms(values: Array) -> float:
    """Root of the mean square of `values`, and no less than what may be divided by."""
    return max(arrays.rms(values), 1e-12)


#: share of the data's typical force that the start of a fit gives
PROBE = 0.05


@dataclass(frozen=True)
class Setting:
    """Where a hypothesis is to be tried: the place, what stands there, and how the data are sized.

    `motion` of the pair (None at a motor or a channel); `force` [N]: a typical one of the data; `signal`: deviation of
    the current [A] of the motor, or of the channel [its unit]; `time` [s]: in which the motion changes, one over its
    typical circular frequency; `options`: the choices that are not numbers; `samples` (n,): the measured channel, or the current
    that the motor is told to give, in the channel's unit or in A (None between two nodes); `pitches` [m]: periods that the spectrum of
    the missing force over travel shows, for a law that repeats over travel.

    network: the model; where: the place.
    """

    network: Network
    where: tuple[str, ...]
    motion: Motion | None
    force: float
    signal: float = 1.0
    time: float = 0.05
    options: Mapping[str, str] = field(default_factory=dict)
    samples: Array | None = None
    pitches: tuple[float, ...] = ()

    @property
    def beside(self) -> list[Element]:
        return beside(self.network, self.where)

    @property
    def moves(self) -> Motion:
        assert self.motion is not None
        return self.motion

    @property
    def small(self) -> float:
        """The force that a start gives [N]."""
        return PROBE * self.force


@dataclass(frozen=True)
class Start:
    """Values from which a fit begins. `ways`: value sets whose responses are projected together; `grows`: what scales
    with amplitude; `inverse`: the effect is one over the value; `signed`: it may act either way.

    values: by parameter.
    """

    values: dict[str, float]
    ways: tuple[dict[str, float], ...] = ()
    grows: tuple[str, ...] = ()
    inverse: bool = False
    signed: bool = False

    def __post_init__(self) -> None:
        if not self.ways:
            object.__setattr__(self, "ways", (self.values,))


# ------------------------------------------------------------------------------------------- the element


@dataclass(frozen=True)
class Element:
    """Anything that stands in a model's list of elements.

    `name` is unique in the model. `where` holds the terminals (two nodes), or the motor, or the channel.

    Two things are compiled into the kernel. ``law(p, d, v, d_last, z, h)`` gives (force [N], next z) of the parameters p,
    the elongation d [m], its rate v [m/s], d_last [m] at the step before, the law's state z and the step h [s];
    ``bound(p, d, v)`` gives the level [N] that a dry friction can hold.
    """

    name: str
    where: tuple[str, ...]

    type: ClassVar[str] = ""
    #: kind of physical effect, one of `MECHANISMS`
    mechanism: ClassVar[str] = "other"
    place: ClassVar[str] = "between"  # the key that says where: "between", "element" (a motor) or "channel"
    equation: ClassVar[str] = ""
    source: ClassVar[str] = ""
    signature: ClassVar[str] = ""  # what tells it from its neighbours
    test: ClassVar[str] = ""  # the measurement that would
    choices: ClassVar[dict[str, tuple[str, ...]]] = {}
    law: ClassVar[Callable[..., tuple[float, float]] | None] = None
    bound: ClassVar[Callable[..., float] | None] = None
    #: where its force shows when drawn: over "rate", over "elongation", or in "time" alone
    plane: ClassVar[str] = "elongation"
    #: put in series with what stands at its terminals, not beside it
    series: ClassVar[bool] = False
    #: types that it holds as a special case
    contains: ClassVar[tuple[str, ...]] = ()
    #: types that a candidate of this type replaces at the same place
    replaces: ClassVar[tuple[str, ...]] = ()
    #: the parameter that shapes it, for which fits may have several optima
    shaped_by: ClassVar[str | None] = None
    #: the law reads a logged channel (its field `channel`) in the place of the elongation
    scheduled: ClassVar[bool] = False
    #: (length of a period, phase) where it repeats over travel: fits have an optimum a period
    periodic: ClassVar[tuple[str, str] | None] = None

    def __post_init__(self) -> None:
        for f in parameter_fields(type(self)):
            value = getattr(self, f.name)
            value = number(value, f"element '{plain(self.name)}': {f.name}")
            low, high = f.metadata["minimum"], f.metadata["maximum"]
            if abs(value) > high:
                raise InputError(
                    f"element '{self.name}': {f.name} must be at most {high:g} {f.metadata['unit']}, not {value:g}"
                )
            if value < low or (f.metadata["open"] and value == low):
                rule = f"> {low:g}" if f.metadata["open"] else f">= {low:g}"
                raise InputError(
                    f"element '{self.name}': {f.name} must be {rule} {f.metadata['unit']}, not {value:g}"
                )
            object.__setattr__(self, f.name, value)
        for key, allowed in self.choices.items():
            if getattr(self, key) not in allowed:
                raise InputError(
                    f"element '{self.name}': {key} must be one of {', '.join(allowed)}, not {shown(getattr(self, key))}"
                )

    @property
    def between(self) -> tuple[str, str]:
        """The two terminals (first, second)."""
        return self.where[0], self.where[1]

    def linear(self) -> tuple[float, float, float]:
        """(stiffness [N/m], damping [N s/m], inertance [kg]) of the linear part."""
        return 0.0, 0.0, 0.0

    def parts(self) -> tuple[Element, ...]:
        """Elements that the kernel steps: the element where a law is defined, no element where the force is linear."""
        return (self,) if self.law is not None or self.bound is not None else ()

    def law_parameters(self) -> list[float]:
        """The numbers that `law` or `bound` reads, in the order it reads them."""
        return [getattr(self, f.name) for f in parameter_fields(type(self))]

    def quiet(self) -> float:
        """|d| [m] below which a smooth law is exactly zero and at rest; 0 where there is no such span."""
        return 0.0

    def contact(self) -> tuple[float, float, float, float] | None:
        """Of a law that is a stop: elongations [m] beyond which it pushes, its stiffness [N/m] and damping [N s/m]; else None.

        It pushes back with ``k (d - clearance) + c v``, or not at all where that would pull.
        """
        return None

    def apply(self, signal: Array, step: float) -> Array:
        """What an element at a motor or a channel makes of its signal (n, ...), sampled every `step` [s]."""
        raise NotImplementedError(f"{self.type} acts between two nodes, not on a signal")

    def curve(self, axis: Array) -> Array:
        """Its force [N] over `axis` (n,): the rate [m/s] or the elongation [m], as `plane` says."""
        p, rate = np.array(self.law_parameters()), self.plane == "rate"
        cls = type(self)
        if cls.bound is not None:
            return np.array([cls.bound(p, 0.0, v) * np.sign(v) for v in axis])
        if cls.law is not None:
            return np.array(
                [
                    cls.law(p, 0.0, x, 0.0, 0.0, 1e-3)[0] if rate else cls.law(p, x, 0.0, x, 0.0, 1e-3)[0]
                    for x in axis
                ]
            )
        return np.asarray(self.linear()[1 if rate else 0] * axis, dtype=np.float64)

    def to_dict(self) -> dict[str, Any]:
        """As the model file has it."""
        place: Any = list(self.where) if self.place == "between" else self.where[0]
        out: dict[str, Any] = {"name": self.name, "type": self.type, self.place: place}
        for f in fields(self):
            if f.name not in ("name", "where"):
                out[f.name] = getattr(self, f.name)
        return out

    # --------------------------------------------------- what it knows of itself as a hypothesis of the diagnosis

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        """Whether it makes sense as a missing effect at that place: by default where none of its type stands, or where a second one is
        more than another value of the first: it has a shape (`shaped_by`), and that of the first is known for sure.

        network: the model; where: the place.
        """
        alike = [e for e in beside(network, where) if e.type == cls.type]
        return all(cls.shaped_by and f"{e.name}.{cls.shaped_by}" not in network.uncertainty for e in alike)

    @classmethod
    def variants(cls, network: Network, where: tuple[str, ...]) -> list[dict[str, str]]:
        """The choices that are not numbers, each a hypothesis of its own.

        network: the model; where: the place.
        """
        return [{}]

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        """Where fits begin, sized by the motion and force of the data.

        By default: a parameter in m (m/s) is tried at shares of the elongation (rate), any other in the middle of its
        plausible range; those in which the force is linear are then scaled so that it is `PROBE` of the typical force.
        """
        from .starts import generic_starts

        return generic_starts(cls, at)

    @classmethod
    def sized(cls, start: Start, amplitude: Array) -> dict[str, float]:
        """The start's values when its responses (its `ways`) are to be multiplied by `amplitude`."""
        values = dict(start.values)
        factor = float(np.clip(amplitude[0], -50.0 if start.signed else 0.1, 50.0))
        for key in start.grows:
            values[key] = values[key] / factor if start.inverse else values[key] * factor
        return values

    @classmethod
    def grown(cls, start: Start, factor: float) -> dict[str, float]:
        """The values of an effect `factor` times as large as the start has it, its shape as it is.

        One whose size is no multiple of anything stays as it is.
        """
        values = dict(start.ways[0])
        for key in start.grows:
            values[key] = values[key] / factor if start.inverse else values[key] * factor
        return values

    @classmethod
    def special(cls, simple: str, values: Mapping[str, float], motion: Motion | None) -> dict[str, float]:
        """Start values of the special case `simple` (one of `contains`), from values of its own.

        motion: of the pair, where it is one.
        """
        names = {f.name for f in parameter_fields(TYPES[simple])}
        return {key: value for key, value in values.items() if key in names}

    @classmethod
    def tied(cls, network: Network, where: tuple[str, ...]) -> dict[str, str]:
        """Parameters that are not free but follow another: own name -> path in the network."""
        return {}

    @classmethod
    def held(cls, options: Mapping[str, str]) -> tuple[str, ...]:
        """Parameters that keep their start values in a fit, by the choices that are not numbers.

        options: the choices.
        """
        return ()

    def well_formed(self) -> bool:
        """Whether the values mean what the name says; a law that does not may be a step on the way, but is never named."""
        return True

    def support(self, motion: Motion) -> float:
        """Return the share of the samples on the rarer side of the law's characteristic point, such as a clearance or a slip.

        Args:
            motion: Motion of the terminals.

        Returns:
            Share from 0 to 1; 1 for a law without such a point.
        """
        return 1.0

    def differs_from_limit(self, motion: Motion) -> bool:
        """Return whether a motion distinguishes the law from a limit of the law that has another name.

        Args:
            motion: Motion of the terminals.
        """
        return True

    def fault(self, time: float) -> float:
        """How large a sensor's fault is: of a gain, or of the `time` [s] in which the motion changes; 0 for a force."""
        return 0.0

    def own_share(self, beside: Sequence[Element]) -> float:
        """Share of its force that is its own, and not what could be a parameter of what stands there.

        beside: the elements that stand there.
        """
        return 1.0

    def differing(self, beside: Sequence[Element]) -> tuple[str, str] | None:
        """Two parameters that are an effect by their difference alone: what they have in common could be a parameter of what stands there.

        beside: the elements that stand there.
        """
        return None


def beside(network: Network, where: tuple[str, ...]) -> list[Element]:
    """The elements at a place: between the same two nodes, at the same motor, on the same channel.

    network: the model; where: the place.
    """
    kind = "between" if len(where) == 2 else None
    return [
        e
        for e in network.elements
        if (e.place == "between") == (kind == "between") and set(e.where) == set(where)
    ]


def held_by_parameter(network: Network, where: tuple[str, ...]) -> bool:
    """Whether one of the two is the ground and the other a mass that may move within its stated uncertainty."""
    node = next((n for n in where if n != GROUND), GROUND)
    return (
        GROUND in where
        and node in network.carried
        and network.uncertainty.get(network.mass_path(node), 0.0) > 0.0
    )


def held_still(network: Network, where: tuple[str, ...]) -> bool:
    """Whether springs hold both terminals to the ground or to a moved node: then a constant force only shifts the rest."""
    held = {GROUND, *network.moved_nodes}
    bodies = [(set(b.nodes), {p.name for p in b.points}, 1 + len(b.angles)) for b in network.bodies]
    springs = [set(e.where) for e in network.elements if e.place == "between" and e.linear()[0] > 0]
    grown = True
    while grown:
        more = {n for s in springs if s & held for n in s} - held
        # a body rests where as many of its points are held as it has ways to move
        more |= {n for nodes, points, ways in bodies if len(points & held) >= ways for n in nodes} - held
        held |= more
        grown = bool(more)
    return set(where) <= held


def driven_motor(network: Network, where: tuple[str, ...]) -> bool:
    return any(c.quantity == "current" and c.element == where[0] for c in network.inputs)


def parameter_fields(cls: type[Element]) -> tuple[Field[Any], ...]:
    """The numeric parameters of an element class, in order."""
    if cls not in _PARAMETERS:
        _PARAMETERS[cls] = tuple(f for f in fields(cls) if "unit" in f.metadata)
    return _PARAMETERS[cls]


_PARAMETERS: dict[type[Element], tuple[Field[Any], ...]] = {}


TYPES: dict[str, type[Element]] = {}
ENTRY_POINTS = "isd_gym.elements"


def register(cls: type[Element]) -> type[Element]:
    """Class decorator: make an element type known to models, the kernel and the diagnosis."""
    cls = dataclass(frozen=True)(cls)
    if not cls.type:
        raise InputError(f"{cls.__name__} has no type name")
    if cls.mechanism not in MECHANISMS:
        raise InputError(f"element type '{cls.type}': mechanism must be one of {', '.join(MECHANISMS)}")
    TYPES[cls.type] = cls
    return cls


@functools.cache
def discover() -> None:
    """Register what installed packages offer through the entry point group ``isd_gym.elements``.

    An entry is a module that registers its classes when imported, or a function without arguments that does.
    """
    for entry in entry_points(group=ENTRY_POINTS):
        found = entry.load()
        if callable(found) and not isinstance(found, type):
            found()


def register_file(path: str | Path) -> None:
    """Run a Python file of the user's own that registers elements. Raises `InputError` where it cannot be run.

    path: the file.
    """
    path = Path(path)
    if path.suffix != ".py" or not os.path.isfile(path):
        raise InputError(f"no Python file {shown(str(path))} with elements")
    before = dict(TYPES)
    try:
        runpy.run_path(str(path), run_name=path.stem)
    except Exception as error:
        raise InputError(f"{shown(str(path))} does not run: {type(error).__name__}: {error}") from None
    if before == TYPES:
        raise InputError(f"{shown(str(path))} registers no element (isd_gym.elements.register)")
