"""Two-terminal elements of a suspension: equation, parameters, units, plausible ranges, source.

**A new element** is one class with `@register`, in this package or in a user's file. The class defines the
element in one of four ways:

- linear: `linear()` returns (stiffness, damping, inertance);
- a smooth law: `law` is a numba-compilable function ``law(p, d, v, d_last, z, h) -> (force, z_next)`` of the
  parameters ``p``, the elongation ``d`` and rate ``v`` at the end of the step, the elongation ``d_last`` at
  the beginning, a state ``z`` and the step ``h``;
- a set-valued law (dry friction): ``bound(p, d, v) -> level`` is the largest force that the element can hold
  or resist with;
- an effect at a motor (`place = "element"`) or at a measured channel (`place = "channel"`): `apply`
  transforms the signal.

Nothing else changes: kernel, file format and diagnosis use the class, and the diagnosis tries the element at
every sensible place. Further attributes have defaults that suit an unknown law: sensible places (`stands`),
start values of fits (`starts`), special cases (`contains`, `special`), the shape parameter (`shaped_by`), the
plane of a plot (`plane`), validity of values (`well_formed`), and a decisive test (`test`). `mechanism` is
the kind of effect that a diagnosis states if the law stays open (`MECHANISMS`; 'other' by default).

A package offers elements through the entry point group ``isd_gym.elements`` (a module, or a function without
arguments, that registers the elements). All commands then know the elements.
"""

from __future__ import annotations

from ._base import (
    GROUND,
    MECHANISMS,
    PROBE,
    TYPES,
    Element,
    Motion,
    Setting,
    Start,
    beside,
    discover,
    parameter,
    parameter_fields,
    plausible,
    register,
    register_file,
    rms,
    spoken,
)
from ._drives import (
    DRIVE_ORDER,
    ActuatorDelay,
    ActuatorLag,
    DriveDeadZone,
    QuadraticThrust,
    ThrustSaturation,
    delayed,
)
from ._friction import AsymmetricFriction, CoulombFriction, StribeckFriction
from ._laws import (
    AsymmetricDamping,
    Backlash,
    BumpStop,
    CoggingForce,
    ConstantForce,
    CubicStiffness,
    DegressiveDamping,
    GasSpring,
    GravitySine,
    Hysteresis,
    QuadraticDamping,
    TyreLiftOff,
)
from ._linear import (
    Inertance,
    LinearDamping,
    LinearStiffness,
    Motor,
    SeriesCompliance,
    TerminalInertia,
)
from ._loaded import LoadDependentFriction, transmits
from ._scheduled import ControlledDamper, ScheduledDamping, ScheduledFriction
from ._sensors import (
    SensorBias,
    SensorDeadZone,
    SensorDelay,
    SensorGain,
    SensorMagnitude,
)
from ._table import TabulatedForce

__all__ = [
    "DRIVE_ORDER",
    "GROUND",
    "MECHANISMS",
    "PROBE",
    "TYPES",
    "ActuatorDelay",
    "ActuatorLag",
    "AsymmetricDamping",
    "AsymmetricFriction",
    "Backlash",
    "BumpStop",
    "CoggingForce",
    "ConstantForce",
    "ControlledDamper",
    "CoulombFriction",
    "CubicStiffness",
    "DegressiveDamping",
    "DriveDeadZone",
    "Element",
    "GasSpring",
    "GravitySine",
    "Hysteresis",
    "Inertance",
    "LinearDamping",
    "LinearStiffness",
    "LoadDependentFriction",
    "Motion",
    "Motor",
    "QuadraticDamping",
    "QuadraticThrust",
    "ScheduledDamping",
    "ScheduledFriction",
    "SensorBias",
    "SensorDeadZone",
    "SensorDelay",
    "SensorGain",
    "SensorMagnitude",
    "SeriesCompliance",
    "Setting",
    "Start",
    "StribeckFriction",
    "TabulatedForce",
    "TerminalInertia",
    "ThrustSaturation",
    "TyreLiftOff",
    "beside",
    "delayed",
    "discover",
    "parameter",
    "parameter_fields",
    "plausible",
    "register",
    "register_file",
    "rms",
    "spoken",
    "transmits",
]
