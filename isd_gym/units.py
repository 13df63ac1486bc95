"""Units a model or a test bench writes, and their SI values."""

from __future__ import annotations

import math
import re
from typing import Any, TypeVar

from .errors import InputError, shown

#: quantity of a channel along a line -> its SI unit
UNITS = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2", "force": "N", "current": "A"}
#: quantity as a model file has it -> (what it is to the equations, its SI unit)
QUANTITIES = {name: (name, unit) for name, unit in UNITS.items()} | {
    "angle": ("displacement", "rad"),
    "angular_velocity": ("velocity", "rad/s"),
    "angular_acceleration": ("acceleration", "rad/s^2"),
    "torque": ("force", "N m"),
    "voltage": ("current", "V"),  # that a drive is told to give
    # logged, and acting on no node: what the coefficients of laws may depend on
    "temperature": ("condition", "degC"),
    "pressure": ("condition", "Pa"),
    "speed": ("condition", "m/s"),
}
#: quantities, as a model file has them, of inputs that act on no node
CONDITIONS = tuple(name for name, (quantity, _) in QUANTITIES.items() if quantity == "condition")
#: quantities to the equations of inputs that are held from one sample to the next
HELD = ("current", "condition")
#: SI units of what turns
TURNING = ("rad", "rad/s", "rad/s^2", "N m")
Value = TypeVar("Value", float, Any)  # a number, or an array of them

#: unit -> (SI unit, factor)
TABLE: dict[str, tuple[str, float]] = {
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "in": ("m", 0.0254),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1e-3),
    "cm/s": ("m/s", 1e-2),
    "in/s": ("m/s", 0.0254),
    "km/h": ("m/s", 1.0 / 3.6),
    "m/s^2": ("m/s^2", 1.0),
    "mm/s^2": ("m/s^2", 1e-3),
    "g": ("m/s^2", 9.80665),
    "N": ("N", 1.0),
    "kN": ("N", 1e3),
    "lbf": ("N", 4.4482216152605),
    "A": ("A", 1.0),
    "mA": ("A", 1e-3),
    "rad": ("rad", 1.0),
    "mrad": ("rad", 1e-3),
    "deg": ("rad", math.pi / 180.0),
    "rev": ("rad", 2.0 * math.pi),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180.0),
    "rpm": ("rad/s", math.pi / 30.0),
    "rad/s^2": ("rad/s^2", 1.0),
    "deg/s^2": ("rad/s^2", math.pi / 180.0),
    "N m": ("N m", 1.0),
    "mN m": ("N m", 1e-3),
    "kN m": ("N m", 1e3),
    "V": ("V", 1.0),
    "mV": ("V", 1e-3),
    "kV": ("V", 1e3),
    "degC": ("degC", 1.0),
    "Pa": ("Pa", 1.0),
    "kPa": ("Pa", 1e3),
    "MPa": ("Pa", 1e6),
    "bar": ("Pa", 1e5),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
}
_SPELLINGS = {"m/s2": "m/s^2", "m/s**2": "m/s^2", "m/s²": "m/s^2", "mm/s2": "mm/s^2", "mm/s²": "mm/s^2"}
_SPELLINGS |= {
    "°": "deg",
    "°C": "degC",
    "degree": "deg",
    "degrees": "deg",
    "radian": "rad",
    "°/s": "deg/s",
    "1/min": "rpm",
    "U/min": "rpm",
}
_SPELLINGS |= {
    "rad/s2": "rad/s^2",
    "rad/s²": "rad/s^2",
    "deg/s2": "deg/s^2",
    "deg/s²": "deg/s^2",
    "°/s²": "deg/s^2",
}
_SPELLINGS |= {
    "Nm": "N m",
    "N.m": "N m",
    "N*m": "N m",
    "N·m": "N m",
    "mNm": "mN m",
    "kNm": "kN m",
    "volt": "V",
}
_SPELLINGS |= {"sec": "s", "µm": "um", "kph": "km/h", "newton": "N", "G": "g", "µs": "us"}


def si_of(unit: str) -> str:
    """The SI unit of what `unit` measures. Raises `InputError` for one that is not known."""
    key = _SPELLINGS.get(unit, unit) if isinstance(unit, str) else unit
    if not isinstance(key, str) or key not in TABLE:
        raise InputError(f"unknown unit {shown(unit)} (known: {', '.join(TABLE)})")
    return TABLE[key][0]


#: of a parameter: what turns instead of moving along a line
_ABOUT = {"N": "N m", "m": "rad", "kg": "kg m^2"}


def about_axis(unit: str) -> str:
    """The unit of a parameter between nodes that turn: 'N s/m' is 'N m s/rad' there."""
    return re.sub(r"\b(N|m|kg)\b", lambda part: _ABOUT[part[0]], unit)


def convert(value: Value, unit: str, target: str) -> Value:
    """`value` in `unit` as `target`; both must measure the same thing. Raises `InputError`."""
    pair = []
    for name in (unit, target):
        key = _SPELLINGS.get(name, name) if isinstance(name, str) else name
        if not isinstance(key, str) or key not in TABLE:
            raise InputError(f"unknown unit {shown(name)} (known: {', '.join(TABLE)})")
        pair.append(TABLE[key])
    (si, factor), (si_target, factor_target) = pair
    if si != si_target:
        raise InputError(f"unit '{unit}' cannot be turned into '{target}'")
    return value * (factor / factor_target)
