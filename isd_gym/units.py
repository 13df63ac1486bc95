"""Units a model or a test bench writes, and their SI values."""

from __future__ import annotations

from typing import Any, TypeVar

from .errors import InputError, shown

#: quantity of a channel -> its SI unit
UNITS = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2", "force": "N", "current": "A"}
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
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
}
_SPELLINGS = {"m/s2": "m/s^2", "m/s**2": "m/s^2", "m/s²": "m/s^2", "mm/s2": "mm/s^2", "mm/s²": "mm/s^2"}
_SPELLINGS |= {"sec": "s", "µm": "um", "kph": "km/h", "newton": "N", "G": "g", "µs": "us"}


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
