"""Base class of elements, their parameters, and the registry.

The force of an element is positive in tension: with the elongation d = x_first - x_second [m] and the rate v
[m/s], the element pulls `first` by -F and `second` by +F.
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

from ..._common import arrays
from ..._common.errors import InputError, plain, shown
from ..._common.inputs import number

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from ..._common.arrays import Array
    from ..network import Network

GROUND = "ground"
#: words of element types that are names of persons
PERSONS = ("coulomb", "stribeck")

#: kinds of physical effect that a diagnosis states, the values of `Element.mechanism`
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
    """Define a parameter of an element with unit, plausible range and hard limits.

    The hard upper limit (of the magnitude, for a parameter without lower limit) is the plausible end times a
    million for each division by a length in the unit: rigs may move by micrometres.

    Args:
        unit: Name in `units.TABLE` or a product of such names, or '-'.
        low: Lower end of the plausible range for the corner of a car [unit].
        high: Upper end of the plausible range [unit].
        default: Value of a model file that omits the parameter; None for a required parameter.
        minimum: Hard lower limit [unit].
        open_end: Whether the hard lower limit itself is excluded.
        fixed: Whether the parameter only shapes the law and is not fitted by default.
        spread: Plausible standard deviation from the default [unit], for parameters whose range does not
            depend on a rig.
        stride: Largest change in a single step of a fit [unit].
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
    return (
        field(metadata=meta)
        if default is None
        else field(default=default, metadata=meta)
    )


def plausible(
    of: Any,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    reach: float | None = None,
) -> Any:
    """Return a parameter with the range that is plausible for a missing effect.

    The diagnosis searches for the value within this range. A model file may exceed the range.

    Args:
        of: The parameter, as `parameter` returns it.
        low: Smallest plausible value [unit of the parameter].
        high: Largest plausible value [unit of the parameter].
        reach: Largest factor by which a fit may leave the start value.
    """
    meta = {**of.metadata, "plausible": (low, high), "reach": reach}
    return (
        field(metadata=meta)
        if of.default is MISSING
        else field(default=of.default, metadata=meta)
    )


# --------------------------------------------------------------------------- what an element may look at


def spoken(effect: str) -> str:
    """Return the type of an element in words, such as ``Coulomb friction``.

    Args:
        effect: The type, such as ``coulomb_friction``.

    Returns:
        Words; only names of persons have a capital.
    """
    return " ".join(
        word.capitalize() if word in PERSONS else word for word in effect.split("_")
    )


@dataclass(frozen=True)
class Motion:
    """Simulated relative motion of a pair of nodes."""

    d: Array  # elongation (n,) [m]
    v: Array  # rate of elongation (n,) [m/s]
    a: Array  # second derivative of elongation (n,) [m/s^2]

    @property
    def reach(self) -> float:
        """Largest magnitude of the elongation [m]."""
        return max(float(np.abs(self.d).max()), 1e-12)


def rms(values: Array) -> float:
    """Return the root mean square of an array, bounded below for use as a divisor.

    Args:
        values: Array of any shape.

    Returns:
        Root mean square in the unit of `values`, at least 1e-12.
    """
    return max(arrays.rms(values), 1e-12)


#: force at the start of a fit, as a share of the typical force of the data
PROBE = 0.05


@dataclass(frozen=True)
class Setting:
    """Place of a hypothesis, with scales of the data at the place."""

    network: Network  # the model
    where: tuple[str, ...]  # the place: two nodes, a motor, or a channel
    motion: (
        Motion | None
    )  # relative motion of the two nodes; None at a motor or a channel
    force: float  # typical force of the data [N]
    #: standard deviation of the motor's current [A], or of the channel [unit of the channel]
    signal: float = 1.0
    time: float = 0.05  # reciprocal of the typical circular frequency of the motion [s]
    options: Mapping[str, str] = field(
        default_factory=dict
    )  # values of the choices that are not numbers
    #: measured channel [unit of the channel] or commanded current [A], (n,); None between two nodes
    samples: Array | None = None

    @property
    def beside(self) -> list[Element]:
        """Elements at the place."""
        return beside(self.network, self.where)

    @property
    def moves(self) -> Motion:
        """Relative motion of the two nodes."""
        assert self.motion is not None
        return self.motion

    @property
    def small(self) -> float:
        """Force at the start of a fit [N]."""
        return PROBE * self.force


@dataclass(frozen=True)
class Start:
    """Start values of a fit."""

    values: dict[str, float]  # value by parameter
    #: value sets whose responses are projected together; the start values alone by default
    ways: tuple[dict[str, float], ...] = ()
    grows: tuple[
        str, ...
    ] = ()  # parameters that scale with the amplitude of the effect
    inverse: bool = (
        False  # whether the effect is proportional to the reciprocal of the parameters
    )
    signed: bool = False  # whether the effect may have either sign

    def __post_init__(self) -> None:
        if not self.ways:
            object.__setattr__(self, "ways", (self.values,))


def growing(**values: float) -> Start:
    """Return a start of parameters that all scale with the amplitude of the effect."""
    return Start(values, grows=tuple(values))


# ------------------------------------------------------------------------------------------- the element


@dataclass(frozen=True)
class Element:
    """An entry of a model's list of elements.

    Two functions are compiled into the kernel. ``law(p, d, v, d_last, z, h)`` returns (force [N], next z) for
    the parameters p, the elongation d [m], its rate v [m/s], the elongation d_last [m] at the step before,
    the law's state z and the step h [s]. ``bound(p, d, v)`` returns the level [N] that a dry friction can
    hold.
    """

    name: str  # name, unique in the model
    where: tuple[str, ...]  # two terminals (nodes), or a motor, or a channel

    type: ClassVar[str] = ""
    #: kind of physical effect, one of `MECHANISMS`
    mechanism: ClassVar[str] = "other"
    # key of the place in a model file: "between" (two nodes), "element" (a motor) or "channel"
    place: ClassVar[str] = "between"
    equation: ClassVar[str] = ""
    source: ClassVar[str] = ""
    signature: ClassVar[str] = (
        ""  # characteristic that distinguishes the element from similar ones
    )
    test: ClassVar[str] = ""  # measurement that would identify the element
    choices: ClassVar[dict[str, tuple[str, ...]]] = {}
    law: ClassVar[Callable[..., tuple[float, float]] | None] = None
    bound: ClassVar[Callable[..., float] | None] = None
    #: abscissa of a plot of the force: "rate", "elongation", or "time"
    plane: ClassVar[str] = "elongation"
    #: whether a missing element is in series with the elements at its terminals, instead of parallel
    series: ClassVar[bool] = False
    #: types that are special cases of this type
    contains: ClassVar[tuple[str, ...]] = ()
    #: types that a candidate of this type replaces at the same place
    replaces: ClassVar[tuple[str, ...]] = ()
    #: parameter that shapes the law; fits may have several optima in this parameter
    shaped_by: ClassVar[str | None] = None
    #: whether the law reads a logged channel (its field `channel`), or its current, instead of the elongation
    scheduled: ClassVar[bool] = False
    #: whether an input may command the current of the element
    driven: ClassVar[bool] = False
    #: whether the law reads the force of another element (its field `load`) instead of the elongation
    loaded: ClassVar[bool] = False
    #: (period, phase) parameters of a law that repeats over travel; fits have one optimum per period
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
        """Return stiffness [N/m], damping [N s/m] and inertance [kg] of the linear part of the element."""
        return 0.0, 0.0, 0.0

    def parts(self) -> tuple[Element, ...]:
        """Return the elements that the kernel steps: the element itself if it has a law or a bound; an empty
        tuple if the force is linear."""
        return (self,) if self.law is not None or self.bound is not None else ()

    def law_parameters(self) -> list[float]:
        """Return the numbers that `law` or `bound` reads, in order and in the units of the parameters."""
        return [getattr(self, f.name) for f in parameter_fields(type(self))]

    def quiet(self) -> float:
        """Return the magnitude of the elongation [m] below which a smooth law is exactly zero and at rest; 0
        without such a span."""
        return 0.0

    def period(self) -> float | None:
        """Return the travel [m] after which the force repeats, or [rad] where nodes turn; None for a law that
        does not repeat over travel."""
        return float(getattr(self, self.periodic[0])) if self.periodic else None

    def contact(self) -> tuple[float, float, float, float] | None:
        """Return upper and lower limit [m], stiffness [N/m] and damping [N s/m] of a stop; None for other laws.

        A stop pushes back with ``k (d - clearance) + c v`` beyond a limit, and never pulls.
        """
        return None

    def apply(self, signal: Array, step: float) -> Array:
        """Return the signal behind an element at a motor or a channel.

        Args:
            signal: Signal (n, ...) before the element.
            step: Sampling step [s].

        Returns:
            Signal (n, ...) after the element.

        Raises:
            NotImplementedError: The element is between two nodes.
        """
        raise NotImplementedError(
            f"{self.type} acts between two nodes, not on a signal"
        )

    def curve(self, axis: Array) -> Array:
        """Return the force of the element over rate or elongation, as `plane` states.

        Args:
            axis: Rates [m/s] or elongations [m], (n,).

        Returns:
            Force (n,) [N].

        Raises:
            NotImplementedError: The force depends on something else, too.
        """
        if self.plane == "time":
            raise NotImplementedError(f"{self.type} is no curve over rate or travel")
        p, rate = np.array(self.law_parameters()), self.plane == "rate"
        cls = type(self)
        if cls.bound is not None:
            return np.array([cls.bound(p, 0.0, v) * np.sign(v) for v in axis])
        if cls.law is not None:
            return np.array(
                [
                    cls.law(p, 0.0, x, 0.0, 0.0, 1e-3)[0]
                    if rate
                    else cls.law(p, x, 0.0, x, 0.0, 1e-3)[0]
                    for x in axis
                ]
            )
        return np.asarray(self.linear()[1 if rate else 0] * axis, dtype=np.float64)

    def to_dict(self) -> dict[str, Any]:
        """Return the element as an object of a model file: name, type, place and parameters."""
        place: Any = list(self.where) if self.place == "between" else self.where[0]
        out: dict[str, Any] = {"name": self.name, "type": self.type, self.place: place}
        for f in fields(self):
            if f.name not in ("name", "where"):
                out[f.name] = getattr(self, f.name)
        return out

    # --------------------------------------------------- the element as a hypothesis of the diagnosis

    @classmethod
    def stands(cls, network: Network, where: tuple[str, ...]) -> bool:
        """Return whether a missing effect of this type is sensible at a place.

        By default, a place may have no other element of this type, except if the shape (`shaped_by`) of each
        one is known for sure: a second element is then more than a change of the first.
        """
        alike = [e for e in beside(network, where) if e.type == cls.type]
        return all(
            cls.shaped_by and f"{e.name}.{cls.shaped_by}" not in network.uncertainty
            for e in alike
        )

    @classmethod
    def variants(cls, network: Network, where: tuple[str, ...]) -> list[dict[str, str]]:
        """Return the choices that are not numbers, value by choice; each set is a separate hypothesis."""
        return [{}]

    @classmethod
    def starts(cls, at: Setting) -> list[Start]:
        """Return start values of fits, best guesses first, scaled by the motion and force of the data.

        By default, a parameter in m (m/s) is tried at fractions of the elongation (rate), and any other
        parameter in the middle of its plausible range. Parameters in which the force is linear are then
        scaled so that the force is `PROBE` of the typical force.
        """
        from ._starts import generic_starts

        return generic_starts(cls, at)

    @classmethod
    def sized(cls, start: Start, amplitude: Array) -> dict[str, float]:
        """Return start values scaled to fitted amplitudes (ways,) [-] of the responses of `start.ways`."""
        values = dict(start.values)
        factor = float(np.clip(amplitude[0], -50.0 if start.signed else 0.1, 50.0))
        for key in start.grows:
            values[key] = (
                values[key] / factor if start.inverse else values[key] * factor
            )
        return values

    @classmethod
    def special(
        cls, simple: str, values: Mapping[str, float], motion: Motion | None
    ) -> dict[str, float]:
        """Return start values of the type `simple`, one of `contains`, from the values of this type."""
        names = {f.name for f in parameter_fields(TYPES[simple])}
        return {key: value for key, value in values.items() if key in names}

    @classmethod
    def tied(cls, network: Network, where: tuple[str, ...]) -> dict[str, str]:
        """Return the parameters that follow another parameter of the model: path in the network by parameter."""
        return {}

    @classmethod
    def held(cls, options: Mapping[str, str]) -> tuple[str, ...]:
        """Return the parameters that keep their start values in a fit, for the values of the choices."""
        return ()

    def well_formed(self) -> bool:
        """Return whether the values agree with the meaning of the type; others are never reported."""
        return True

    def support(self, motion: Motion) -> float:
        """Return the share of the samples on the rarer side of the law's characteristic point, such as a
        clearance or a slip; 1 for a law without such a point."""
        return 1.0

    def differs_from_limit(self, motion: Motion) -> bool:
        """Return whether a motion distinguishes the law from a limiting case with another name."""
        return True

    def differing(self, beside: Sequence[Element]) -> tuple[str, str] | None:
        """Return two parameters whose difference alone is the effect, since an element at the place could
        produce their common part; None if each parameter is an effect."""
        return None


def beside(network: Network, where: tuple[str, ...]) -> list[Element]:
    """Return the elements at a place: between the same two nodes, at the same motor, or on the same channel.

    Args:
        network: The model.
        where: The place.

    Returns:
        Elements in the order of the model.
    """
    kind = "between" if len(where) == 2 else None
    return [
        e
        for e in network.elements
        if (e.place == "between") == (kind == "between") and set(e.where) == set(where)
    ]


def held_by_parameter(network: Network, where: tuple[str, ...]) -> bool:
    """Return whether a place is between the ground and a mass of uncertain size."""
    node = next((n for n in where if n != GROUND), GROUND)
    return (
        GROUND in where
        and node in network.carried
        and network.uncertainty.get(network.mass_path(node), 0.0) > 0.0
    )


def held_still(network: Network, where: tuple[str, ...]) -> bool:
    """Return whether springs hold both terminals to the ground or to a moved node; a constant force then only
    shifts the rest position.
    """
    held = {GROUND, *network.moved_nodes}
    bodies = [
        (set(b.nodes), {p.name for p in b.points}, 1 + len(b.angles))
        for b in network.bodies
    ]
    springs = [
        set(e.where)
        for e in network.elements
        if e.place == "between" and e.linear()[0] > 0
    ]
    grown = True
    while grown:
        more = {n for s in springs if s & held for n in s} - held
        # a body rests where as many of its points are held as it has ways to move
        more |= {
            n
            for nodes, points, ways in bodies
            if len(points & held) >= ways
            for n in nodes
        } - held
        held |= more
        grown = bool(more)
    return set(where) <= held


def driven_motor(network: Network, where: tuple[str, ...]) -> bool:
    """Return whether an input commands the current of a motor."""
    return any(
        c.quantity == "current" and c.element == where[0] for c in network.inputs
    )


def parameter_fields(cls: type[Element]) -> tuple[Field[Any], ...]:
    """Return the numeric parameters of an element type, in order.

    Args:
        cls: Class of the element.

    Returns:
        Dataclass fields with unit, range and limits in their metadata.
    """
    if cls not in _PARAMETERS:
        _PARAMETERS[cls] = tuple(f for f in fields(cls) if "unit" in f.metadata)
    return _PARAMETERS[cls]


_PARAMETERS: dict[type[Element], tuple[Field[Any], ...]] = {}


TYPES: dict[str, type[Element]] = {}
ENTRY_POINTS = "isd_gym.elements"


def register(cls: type[Element]) -> type[Element]:
    """Register an element type for models, the kernel and the diagnosis; a class decorator.

    Args:
        cls: Class of the element; becomes a frozen dataclass.

    Raises:
        InputError: The class has no type name, or an unknown mechanism.
    """
    cls = dataclass(frozen=True)(cls)
    if not cls.type:
        raise InputError(f"{cls.__name__} has no type name")
    if cls.mechanism not in MECHANISMS:
        raise InputError(
            f"element type '{cls.type}': mechanism must be one of {', '.join(MECHANISMS)}"
        )
    TYPES[cls.type] = cls
    return cls


@functools.cache
def discover() -> None:
    """Register the elements that installed packages offer through the entry point group ``isd_gym.elements``.

    An entry point is a module that registers classes on import, or a function without arguments.
    """
    for entry in entry_points(group=ENTRY_POINTS):
        found = entry.load()
        if callable(found) and not isinstance(found, type):
            found()


def register_file(path: str | Path) -> None:
    """Run a Python file of a user that registers elements.

    Args:
        path: The file.

    Raises:
        InputError: The file does not exist, fails, or registers no element.
    """
    path = Path(path)
    if path.suffix != ".py" or not os.path.isfile(path):
        raise InputError(f"no Python file {shown(str(path))} with elements")
    before = dict(TYPES)
    try:
        runpy.run_path(str(path), run_name=path.stem)
    except Exception as error:
        raise InputError(
            f"{shown(str(path))} does not run: {type(error).__name__}: {error}"
        ) from None
    if before == TYPES:
        raise InputError(
            f"{shown(str(path))} registers no element (isd_gym.physics.elements.register)"
        )
