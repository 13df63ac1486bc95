"""Units of measurement that models and test benches use, with their SI equivalents."""

from __future__ import annotations

import math
import re
from typing import Any, TypeVar

from .errors import InputError, shown

#: SI unit of each translational quantity
UNITS = {
    "displacement": "m",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "force": "N",
    "current": "A",
}
#: quantity in a model file -> (quantity in the equations, SI unit)
QUANTITIES = {name: (name, unit) for name, unit in UNITS.items()} | {
    "angle": ("displacement", "rad"),
    "angular_velocity": ("velocity", "rad/s"),
    "angular_acceleration": ("acceleration", "rad/s^2"),
    "torque": ("force", "N m"),
    "voltage": ("current", "V"),  # commanded voltage of a drive
    # logged conditions that act on no node: the coefficients of laws may depend on them
    "temperature": ("condition", "degC"),
    "pressure": ("condition", "Pa"),
    "speed": ("condition", "m/s"),
}
#: input quantities of a model file that act on no node
CONDITIONS = tuple(
    name for name, (quantity, _) in QUANTITIES.items() if quantity == "condition"
)
#: input quantities of the equations that are held from one sample to the next
HELD = ("current", "condition")
#: SI units of rotational quantities
TURNING = ("rad", "rad/s", "rad/s^2", "N m")
Value = TypeVar("Value", float, Any)  # a number, or an array of numbers

#: factor of each unit on its SI unit
_FACTORS = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "in/s": 0.0254, "km/h": 1.0 / 3.6},
    "m/s^2": {"m/s^2": 1.0, "mm/s^2": 1e-3, "g": 9.80665},
    "N": {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605},
    "A": {"A": 1.0, "mA": 1e-3},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "rev": 2.0 * math.pi},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0},
    "rad/s^2": {"rad/s^2": 1.0, "deg/s^2": math.pi / 180.0},
    "N m": {"N m": 1.0, "mN m": 1e-3, "kN m": 1e3},
    "V": {"V": 1.0, "mV": 1e-3, "kV": 1e3},
    "degC": {"degC": 1.0},
    "Pa": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
}
#: unit -> (SI unit, factor)
TABLE = {
    unit: (si, factor)
    for si, factors in _FACTORS.items()
    for unit, factor in factors.items()
}
#: other spellings of units
_SPELLINGS = {
    spelling: unit
    for unit, spellings in {
        "m/s^2": ("m/s2", "m/s**2", "m/s²"),
        "mm/s^2": ("mm/s2", "mm/s²"),
        "deg": ("°", "degree", "degrees"),
        "degC": ("°C",),
        "rad": ("radian",),
        "deg/s": ("°/s",),
        "rpm": ("1/min", "U/min"),
        "rad/s^2": ("rad/s2", "rad/s²"),
        "deg/s^2": ("deg/s2", "deg/s²", "°/s²"),
        "N m": ("Nm", "N.m", "N*m", "N·m"),
        "mN m": ("mNm",),
        "kN m": ("kNm",),
        "V": ("volt",),
        "s": ("sec",),
        "um": ("µm",),
        "us": ("µs",),
        "km/h": ("kph",),
        "N": ("newton",),
        "g": ("G",),
    }.items()
    for spelling in spellings
}


def practical(value: float, unit: str) -> tuple[float, str]:
    """Return the scale and the unit in which engineers state a value, such as mm and kN/m.

    Only units that start with N, m (but not m/s^2) or s take a prefix.
    """
    size = abs(value)
    if not math.isfinite(size) or size == 0.0 or unit.startswith(("m/", "mm", "ms")):
        return 1.0, unit
    if unit[:1] == "N":
        large = ((1e6, 1e-6, "M"), (1e4, 1e-3, "k"))
        return next(
            ((f, prefix + unit) for least, f, prefix in large if size >= least),
            (1.0, unit),
        )
    if unit in ("m", "s"):
        steps = ((0.1, 1.0, ""), (1e-4, 1e3, "m"), (0.0, 1e6, "u"))
        return next((f, prefix + unit) for least, f, prefix in steps if size >= least)
    return 1.0, unit


def units_of(si: str) -> list[str]:
    """Return the units that convert to an SI unit."""
    return list(_FACTORS[si])


def si_of(unit: str) -> str:
    """Return the SI unit of the quantity that a unit measures."""
    return _entry(unit)[0]


def _entry(unit: Any) -> tuple[str, float]:
    key = _SPELLINGS.get(unit, unit) if isinstance(unit, str) else unit
    if not isinstance(key, str) or key not in TABLE:
        raise InputError(f"unknown unit {shown(unit)} (known: {', '.join(TABLE)})")
    return TABLE[key]


#: translational unit -> rotational unit of a parameter
_ABOUT = {"N": "N m", "m": "rad", "kg": "kg m^2"}


def about_axis(unit: str) -> str:
    """Return the unit of a parameter between two nodes that rotate."""
    return re.sub(r"\b(N|m|kg)\b", lambda part: _ABOUT[part[0]], unit)


def convert(value: Value, unit: str, target: str) -> Value:
    """Convert a value from one unit to another unit of the same quantity.

    Args:
        value: Number, or array of any shape, in `unit`.
        unit: Name of the present unit.
        target: Name of the wanted unit.

    Returns:
        Number or array of the same shape in `target`.

    Raises:
        InputError: A unit is unknown, or the two units measure different quantities.
    """
    (si, factor), (si_target, factor_target) = _entry(unit), _entry(target)
    if si != si_target:
        raise InputError(f"unit '{unit}' cannot be converted to '{target}'")
    return value * (factor / factor_target)
