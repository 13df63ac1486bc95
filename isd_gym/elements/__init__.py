"""The two-terminal elements a suspension is made of: equation, parameters, units, plausible ranges, source.

**Adding an element** is writing one class, here or in a file of yours, with `@register`. It says what it is in one of
four ways:

- linear: give `linear()`, its (stiffness, damping, inertance);
- a smooth law: give `law`, a numba-compilable function
  ``law(p, d, v, d_last, z, h) -> (force, z_next)`` of the parameters ``p``, the elongation and rate at the end of
  the step, the elongation at its beginning, one state ``z`` of the law's own and the step ``h``;
- a set-valued law (dry friction): give `bound`, ``bound(p, d, v) -> level``, the force it can hold or resist with;
- an effect at a motor (`place = "element"`) or at a measured channel (`place = "channel"`): give `apply`.

Nothing else changes, neither the kernel nor the file format nor the diagnosis, which tries it wherever it can stand. What
it may say of itself besides has defaults that serve a stranger's law: where it makes sense (`stands`), from which values
fits begin (`starts`), what it holds as special cases (`contains`, `special`), which parameter shapes it (`shaped_by`), where
its force shows (`plane`), when its values mean what its name says (`well_formed`), which test would tell it (`test`).
`mechanism` is the kind of effect that a diagnosis may state where the law stays open (`MECHANISMS`; by default 'other').

A package offers its elements through the entry point group ``isd_gym.elements`` (a module, or a function without
arguments, that registers them): then every command knows them.
"""

from __future__ import annotations

from .base import (
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
)
from .drives import (
    DRIVE_ORDER,
    ActuatorDelay,
    ActuatorLag,
    DriveDeadZone,
    QuadraticThrust,
    ThrustSaturation,
    delayed,
)
from .friction import AsymmetricFriction, CoulombFriction, StribeckFriction
from .laws import (
    PERIODS,
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
from .linear import Inertance, LinearDamping, LinearStiffness, Motor, SeriesCompliance, TerminalInertia
from .scheduled import ScheduledDamping, ScheduledFriction
from .sensors import SensorBias, SensorDeadZone, SensorDelay, SensorGain, SensorMagnitude
from .table import TabulatedForce

__all__ = [
    "DRIVE_ORDER",
    "GROUND",
    "MECHANISMS",
    "PERIODS",
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
]
