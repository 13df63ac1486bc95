"""The two-terminal elements a suspension is made of: equation, parameters, units, plausible ranges, source.

The force of an element is positive in tension: with the elongation d = x_first - x_second [m] and its rate
v [m/s] it pulls `first` by -F and `second` by +F.

**Adding an element** is adding one class here (or in a file of yours, with `@register`). It says what it is in
one of four ways, and nothing else changes, neither the kernel nor the file format nor the workflow:

- linear: give `linear()`, its (stiffness, damping, inertance);
- a smooth law: give `law`, a numba-compilable function
  ``law(p, d, v, d_last, z, h) -> (force, z_next)`` of the parameters ``p``, the elongation and rate at the end of
  the step, the elongation at its beginning, one state ``z`` of the law's own and the step ``h``;
- a set-valued law (dry friction): give `bound`, ``bound(p, d, v) -> level``, the force it can hold or resist with;
- an effect at a motor (`element=`) or at a measured channel (`channel=`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import Field, dataclass, field, fields
from typing import Any, ClassVar

from .errors import InputError


def parameter(
    unit: str,
    low: float,
    high: float,
    *,
    default: float | None = None,
    minimum: float = 0.0,
    open_end: bool = False,
    fixed: bool = False,
) -> Any:
    """A parameter [unit] with its plausible range (low, high) for a car corner, and the hard lower limit.

    `fixed` parameters give the law its shape and are not fitted unless asked for.
    """
    meta = {
        "unit": unit,
        "range": (low, high),
        "minimum": minimum,
        "open": open_end,
        "fixed": fixed,
    }
    return field(metadata=meta) if default is None else field(default=default, metadata=meta)


@dataclass(frozen=True)
class Element:
    """Anything that stands in a model's list of elements.

    `name` is unique in the model. `where` holds the terminals (two nodes), or the motor, or the channel.
    """

    name: str
    where: tuple[str, ...]

    type: ClassVar[str] = ""
    place: ClassVar[str] = "between"  # the key that says where: "between", "element" (a motor) or "channel"
    equation: ClassVar[str] = ""
    source: ClassVar[str] = ""
    signature: ClassVar[str] = ""  # what tells it from its neighbours
    choices: ClassVar[dict[str, tuple[str, ...]]] = {}
    law: ClassVar[Callable | None] = None
    bound: ClassVar[Callable | None] = None

    def __post_init__(self) -> None:
        for f in parameter_fields(type(self)):
            value = getattr(self, f.name)
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(f"element '{self.name}': {f.name} must be a number, not {value!r}")
            if not math.isfinite(value):
                raise InputError(f"element '{self.name}': {f.name} must be finite, not {value}")
            low = f.metadata["minimum"]
            if value < low or (f.metadata["open"] and value == low):
                rule = f"> {low:g}" if f.metadata["open"] else f">= {low:g}"
                raise InputError(
                    f"element '{self.name}': {f.name} must be {rule} {f.metadata['unit']}, not {value:g}"
                )
            object.__setattr__(self, f.name, float(value))
        for key, allowed in self.choices.items():
            if getattr(self, key) not in allowed:
                raise InputError(
                    f"element '{self.name}': {key} must be one of {', '.join(allowed)}, not {getattr(self, key)!r}"
                )

    @property
    def between(self) -> tuple[str, str]:
        """The two terminals (first, second)."""
        return self.where[0], self.where[1]

    def linear(self) -> tuple[float, float, float]:
        """(stiffness [N/m], damping [N s/m], inertance [kg]) of the linear part."""
        return 0.0, 0.0, 0.0

    def law_parameters(self) -> list[float]:
        """The numbers that `law` or `bound` reads, in the order it reads them."""
        return [getattr(self, f.name) for f in parameter_fields(type(self))]

    def quiet(self) -> float:
        """|d| [m] below which a smooth law is exactly zero and at rest; 0 where there is no such span."""
        return 0.0

    def to_dict(self) -> dict[str, Any]:
        place: Any = list(self.where) if self.place == "between" else self.where[0]
        out: dict[str, Any] = {"name": self.name, "type": self.type, self.place: place}
        for f in fields(self):
            if f.name not in ("name", "where"):
                out[f.name] = getattr(self, f.name)
        return out


def parameter_fields(cls: type[Element]) -> tuple[Field, ...]:
    """The numeric parameters of an element class, in order."""
    if cls not in _PARAMETERS:
        _PARAMETERS[cls] = tuple(f for f in fields(cls) if "unit" in f.metadata)
    return _PARAMETERS[cls]


_PARAMETERS: dict[type[Element], tuple[Field, ...]] = {}


TYPES: dict[str, type[Element]] = {}


def register(cls: type[Element]) -> type[Element]:
    """Class decorator: make an element type known to models, the kernel and the workflow."""
    cls = dataclass(frozen=True)(cls)
    if not cls.type:
        raise InputError(f"{cls.__name__} has no type name")
    TYPES[cls.type] = cls
    return cls


# ---------------------------------------------------------------------------------------------- linear


@register
class LinearStiffness(Element):
    type = "linear_stiffness"
    equation = "F = k d"
    source = "Table 6 (main spring, tyre), Table 4 (oil)"
    signature = "force in phase with travel, the same at every amplitude"
    stiffness: float = parameter("N/m", 1e2, 1e6)

    def linear(self) -> tuple[float, float, float]:
        return self.stiffness, 0.0, 0.0


@register
class SeriesCompliance(LinearStiffness):
    type = "series_compliance"
    equation = "F = k d, in series with what stands at the terminal"
    source = "oil elasticity of section 3, in series as the 0.1 Hz test demands"
    signature = "nothing at low frequency, growing with the force that passes through"
    stiffness: float = parameter("N/m", 1e4, 1e7, open_end=True)


@register
class LinearDamping(Element):
    type = "linear_damping"
    equation = "F = c v"
    source = "Table 6 (damper), Table 4 (leak)"
    signature = "force in phase with velocity, the same at every amplitude"
    damping: float = parameter("N s/m", 10.0, 1e4)

    def linear(self) -> tuple[float, float, float]:
        return 0.0, self.damping, 0.0


@register
class Inertance(Element):
    type = "inertance"
    equation = "F = b dv/dt"
    source = "equation (5), Table 6"
    signature = "force in phase with relative acceleration"
    inertance: float = parameter("kg", 1.0, 500.0)

    def linear(self) -> tuple[float, float, float]:
        return 0.0, 0.0, self.inertance


@register
class TerminalInertia(Element):
    type = "terminal_inertia"
    equation = "F = m a_terminal (absolute acceleration of one terminal)"
    source = "the m n dv1/dt term that equation (3) has and equation (4) drops"
    signature = "force in phase with absolute, not relative, acceleration"
    choices: ClassVar[dict[str, tuple[str, ...]]] = {"terminal": ("first", "second")}
    mass: float = parameter("kg", 0.5, 60.0)
    terminal: str = "second"


@register
class Motor(Element):
    type = "motor"
    equation = "F1 = K_f r I"
    source = "F1 of equations (6) and (8); area ratio S_R/S_r = 4.056 of Table 1"
    signature = "force in proportion to current"
    thrust_constant: float = parameter("N/A", 20.0, 200.0)
    ratio: float = parameter("-", 1.0, 10.0, default=1.0, open_end=True)


# -------------------------------------------------------------------------------------- dry friction
# A set-valued law holds with any force up to `bound` and slides against `bound`; the kernel projects.


def _constant(p, d, v):
    return p[0]


def _stribeck(p, d, v):
    return p[0] + (p[1] - p[0]) * math.exp(-((v / p[2]) ** 2))


@register
class CoulombFriction(Element):
    type = "coulomb_friction"
    equation = "F in f Sgn(v)"
    source = "f = 0.5 kN, section 3.2, Figure 6"
    signature = "a step in force where the velocity changes sign; sticking"
    bound = staticmethod(_constant)
    level: float = parameter("N", 5.0, 2000.0)


@register
class StribeckFriction(Element):
    type = "stribeck_friction"
    equation = "F in [f + (f_s - f) exp(-(v/v_s)^2)] Sgn(v)"
    source = "Stribeck; Armstrong-Helouvry et al., Automatica 30 (1994)"
    signature = "Coulomb friction with a higher level near zero velocity"
    bound = staticmethod(_stribeck)
    level: float = parameter("N", 5.0, 2000.0)
    static_level: float = parameter("N", 5.0, 4000.0)
    stribeck_velocity: float = parameter("m/s", 1e-3, 0.2, open_end=True)


# --------------------------------------------------------------------------------------- smooth laws


def _quadratic(p, d, v, d_last, z, h):
    return p[0] * v * abs(v), z


def _asymmetric(p, d, v, d_last, z, h):
    return (p[0] if v > 0.0 else p[1]) * v, z


def _cubic(p, d, v, d_last, z, h):
    return p[0] * d * d * d, z


def _gas(p, d, v, d_last, z, h):
    # the column never shrinks below 1 % of its length: past that the law has no meaning
    return p[0] * (1.0 - max(1.0 + d / p[1], 0.01) ** (-p[2])), z


def _stop(p, d, v, d_last, z, h):
    over = d - p[0] if d > 0.0 else d + p[0]
    touching = (d > p[0] and p[3] >= 0.0) or (d < -p[0] and p[3] <= 0.0)
    if not touching:
        return 0.0, z
    f = p[1] * over + p[2] * v
    return (max(f, 0.0) if d > 0.0 else min(f, 0.0)), z  # a stop pushes, it never holds back


def _backlash(p, d, v, d_last, z, h):
    half = 0.5 * p[0]
    return (p[1] * (d - half) if d > half else p[1] * (d + half) if d < -half else 0.0), z


def _bouc_wen(p, d, v, d_last, z, h):
    level, stiffness, exponent, shape = p[0], p[1], p[2], p[3]
    way = d - d_last
    if level <= 0.0 or way == 0.0:
        return z, z
    x = stiffness * abs(way) / level
    if exponent == 1.0:  # closed form: a line in the state on either side of zero
        u = z / level if way > 0.0 else -z / level
        if u < 0.0:
            a, u = 1.0 - 2.0 * shape, max(u, -1.0)  # du/dx = 1 + a u
            rest = max(1.0 + a * u, 1e-12)
            home = -u if abs(a) < 1e-9 else -math.log(rest) / a
            ahead = min(x, home)
            u = 0.0 if home <= x else u + (ahead if abs(a) < 1e-9 else rest * math.expm1(a * ahead) / a)
            x -= ahead
        if u >= 0.0:
            u = 1.0 - (1.0 - u) * math.exp(-x)
        z = level * u if way > 0.0 else -level * u
        return z, z
    steps = int(min(1.0 + 4.0 * x, 64.0))
    part = way / steps
    turn = shape if part > 0.0 else -shape
    for _ in range(steps):  # midpoint rule in travel: the law does not depend on the rate
        bend = (abs(z) / level) ** exponent * (math.copysign(turn, turn * z) + 1.0 - shape)
        m = z + 0.5 * part * stiffness * (1.0 - bend)
        bend = (abs(m) / level) ** exponent * (math.copysign(turn, turn * m) + 1.0 - shape)
        z = z + part * stiffness * (1.0 - bend)
    return z, z


def _cogging(p, d, v, d_last, z, h):
    return p[0] * math.sin(2.0 * math.pi * d / p[1] + p[2]), z


def _lift_off(p, d, v, d_last, z, h):
    return -max(p[0] * d - p[1], 0.0), z


@register
class QuadraticDamping(Element):
    type = "quadratic_damping"
    equation = "F = c2 v |v|"
    source = "orifice flow; Wang and Su, Vehicle System Dynamics 46 (2008), hydraulic inerters"
    signature = "damping that grows with amplitude"
    law = staticmethod(_quadratic)
    damping: float = parameter("N s^2/m^2", 10.0, 1e5)


@register
class AsymmetricDamping(Element):
    type = "asymmetric_damping"
    equation = "F = c_e v for v > 0 (extension), c_c v for v < 0 (compression), beside what stands there"
    source = "Dixon, The Shock Absorber Handbook: rebound and bump damping differ"
    signature = "an even part in the force-velocity plane; a mean offset under vibration"
    law = staticmethod(_asymmetric)
    extension: float = parameter("N s/m", -3000.0, 5000.0, minimum=-math.inf)
    compression: float = parameter("N s/m", -3000.0, 5000.0, minimum=-math.inf)


@register
class CubicStiffness(Element):
    type = "cubic_stiffness"
    equation = "F = k3 d^3"
    source = "Duffing; progressive springs"
    signature = "stiffness that grows with amplitude, smoothly and without dissipation"
    law = staticmethod(_cubic)
    stiffness: float = parameter("N/m^3", 1e4, 1e9, minimum=-math.inf)


@register
class GasSpring(Element):
    type = "gas_spring"
    equation = "F = F0 [1 - (1 + d/L)^(-n)]"
    source = "polytropic gas column about its static state"
    signature = "stiffer in compression than in extension, smoothly"
    law = staticmethod(_gas)
    force: float = parameter("N", 50.0, 2e4)
    length: float = parameter("m", 0.02, 1.0, open_end=True)
    exponent: float = parameter("-", 1.0, 1.67, default=1.3, fixed=True)


@register
class BumpStop(Element):
    type = "bump_stop"
    equation = "F = k (|d| - clearance) sgn d + c v in contact, never pulling; 0 else"
    source = "deputy cylinder stroke of Table 1: +-100 mm / 4.056 = +-24.65 mm at the device"
    signature = "nothing below a travel, a stiff spring beyond it"
    choices: ClassVar[dict[str, tuple[str, ...]]] = {"side": ("both", "extension", "compression")}
    law = staticmethod(_stop)
    clearance: float = parameter("m", 1e-3, 0.1)
    stiffness: float = parameter("N/m", 1e4, 5e6)
    damping: float = parameter("N s/m", 0.0, 1e4, default=0.0, fixed=True)
    side: str = "both"

    def law_parameters(self) -> list[float]:
        side = {"both": 0.0, "extension": 1.0, "compression": -1.0}[self.side]
        return [self.clearance, self.stiffness, self.damping, side]

    def quiet(self) -> float:
        return self.clearance


@register
class Backlash(Element):
    type = "backlash"
    equation = "F = k (|d| - gap/2) sgn d beyond half the gap, 0 within; in series with what stands there"
    source = "play in a joint"
    signature = "lost motion: the same at every amplitude, most visible at small ones"
    law = staticmethod(_backlash)
    gap: float = parameter("m", 1e-4, 0.02)
    stiffness: float = parameter("N/m", 1e5, 1e7, default=2e6, fixed=True)

    def quiet(self) -> float:
        return 0.5 * self.gap


@register
class Hysteresis(Element):
    type = "hysteresis"
    equation = "F = z, dz/dt = k [v - (s |v| z + (1-s) v |z|) |z|^(n-1) / F_y^n]"
    source = "Bouc (1967), Wen (1976), with beta = gamma (s = 1/2); s = 1, n = 1 is Dahl's law"
    signature = "loops in the force-travel plane whose corners are round, whatever the rate"
    law = staticmethod(_bouc_wen)
    level: float = parameter("N", 5.0, 5000.0)
    stiffness: float = parameter("N/m", 1e3, 1e7)
    exponent: float = parameter("-", 0.5, 4.0, default=1.0, open_end=True, fixed=True)
    shape: float = parameter("-", 0.0, 1.0, default=0.5, fixed=True)


@register
class CoggingForce(Element):
    type = "cogging_force"
    equation = "F = A sin(2 pi d / pitch + phase)"
    source = "detent force of a permanent-magnet linear motor"
    signature = "periodic in travel, whatever the time"
    law = staticmethod(_cogging)
    amplitude: float = parameter("N", 5.0, 1000.0)
    pitch: float = parameter("m", 1e-3, 0.05, open_end=True)
    phase: float = parameter("rad", -math.pi, math.pi, default=0.0, minimum=-math.inf)


@register
class TyreLiftOff(Element):
    type = "tyre_lift_off"
    equation = "F = -max(k d - W, 0): a tyre cannot pull on the road beyond its static load W"
    source = "unilateral contact of the tyre"
    signature = "dynamic tyre force cut off at the static load"
    law = staticmethod(_lift_off)
    stiffness: float = parameter("N/m", 5e4, 5e5)
    load: float = parameter("N", 500.0, 1e4)


# ---------------------------------------------------------------------- effects at a motor, a channel


@register
class ThrustSaturation(Element):
    type = "thrust_saturation"
    place = "element"
    equation = "I_eff = I_s tanh(I / I_s)"
    source = "iron saturation of a linear motor"
    signature = "thrust falls short at high current only"
    current: float = parameter("A", 1.0, 50.0, open_end=True)


@register
class ActuatorLag(Element):
    type = "actuator_lag"
    place = "element"
    equation = "tau dI/dt + I = I_command"
    source = "L/R of Table 1 (26 mH / 3.8 Ohm = 6.8 ms) or a drive's bandwidth"
    signature = "thrust late and rounded after a step in current"
    time_constant: float = parameter("s", 1e-3, 0.1)


@register
class ActuatorDelay(Element):
    type = "actuator_delay"
    place = "element"
    equation = "I(t) = I_command(t - T)"
    source = "bus and drive latency"
    signature = "thrust late but not rounded"
    delay: float = parameter("s", 1e-3, 0.1)


@register
class SensorGain(Element):
    type = "sensor_gain"
    place = "channel"
    equation = "y = g y_true"
    source = "calibration error"
    signature = "one channel off in proportion, all others right"
    gain: float = parameter("-", 0.3, 3.0, default=1.0, minimum=-math.inf)


@register
class SensorBias(Element):
    type = "sensor_bias"
    place = "channel"
    equation = "y = y_true + bias"
    source = "offset error"
    signature = "one channel off by a constant, all others right"
    bias: float = parameter("unit of the channel", -math.inf, math.inf, minimum=-math.inf)


@register
class SensorDelay(Element):
    type = "sensor_delay"
    place = "channel"
    equation = "y(t) = y_true(t - T)"
    source = "filter or bus latency"
    signature = "one channel late, all others right"
    delay: float = parameter("s", 1e-3, 0.1)
