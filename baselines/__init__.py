"""Baseline controllers: passive, skyhook, LQG, the paper's MPC, a friction-aware MPC.

``make("mpc")`` returns a controller whose model is the default car; `CONTROLLERS` lists all names. Every
controller sees only the observation of the environment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from isd_gym._common.errors import InputError
from isd_gym.benchmark.driving import Idle
from isd_gym.physics.cost import StageCost
from isd_gym.physics.network import Network
from isd_gym.physics.vehicle import require_quarter_car, vehicle

from ._semiactive import Clipped, controlled_damper
from .controller import BatchController

# a second copy, found in the source tree, would have classes of its own
if __name__ != "isd_gym.baselines":
    raise ImportError("the package is imported as isd_gym.baselines, not baselines")

_PREVIEW = 0.25  # default preview of the controllers with preview [s]


def noisy(share: float) -> Any:
    """Return the standard deviations that an estimator should assume for a share of the robust track's noise (`isd_gym.env._sensors.NOISE`)."""
    from isd_gym.env._sensors import NOISE
    from isd_gym.physics.prediction import Sensors

    clean = Sensors()
    return Sensors(
        **{
            k: (getattr(clean, k) ** 2 + (share * v) ** 2) ** 0.5
            for k, v in NOISE.items()
        }
    )


def _idle(name: str, model: Network, cost: StageCost, control_step: float) -> Idle:
    return Idle(name, model)


def _made(
    kind: str,
    preset: Callable[[Any, float, dict[str, Any]], Any] | None,
    name: str,
    model: Network,
    cost: StageCost,
    control_step: float,
    **options: Any,
) -> BatchController:
    """Return a controller of a class such as 'lqg.Lqg', whose module is imported on demand.

    `preset` returns the settings from the module, the control step and the options; options are fields of the settings.
    """
    module, _, cls = kind.partition(".")
    home = import_module(f".{module}", __package__)
    usual = (
        preset(home, control_step, options) if preset else getattr(home, cls).default
    )
    settings = options.pop("settings", None) or usual
    known = {f.name for f in fields(settings)}
    if unknown := [k for k in options if k not in known]:
        raise InputError(
            f"no option '{unknown[0]}': there are {', '.join(sorted(known))}"
        )
    return getattr(home, cls)(
        model, cost, control_step, replace(settings, **options), name
    )


def _previewing(home: Any, control_step: float, options: dict[str, Any]) -> Any:
    """Return the settings of the friction-aware MPC for the preview of the options."""
    preview = float(options.pop("preview", _PREVIEW))
    return home.with_preview(home.FrictionMpcSettings(), preview, control_step)


def _robust(home: Any, control_step: float, options: dict[str, Any]) -> Any:
    """Return the settings of the friction-aware MPC for noisy sensors."""
    # mean change of J against the same car without current, 96 cars of the robust track's ranges,
    # by the assumed noise of the sensors: 0 -22.29 %, 0.25 -23.61, 0.5 -23.76, 1
    # -23.70
    return home.FrictionMpcSettings(sensors=noisy(0.5))


#: class and preset of each controller
_CLASSES: dict[str, tuple[str, Callable[[Any, float, dict[str, Any]], Any] | None]] = {
    "skyhook": ("_simple.Skyhook", None),
    "add": ("_simple.AccelerationDriven", None),
    "lqg": ("lqg.Lqg", None),
    "lqg-preview": ("lqg.Lqg", lambda home, *_: home.LqgSettings(preview=_PREVIEW)),
    "lqr-full": ("lqg.FullStateLqr", None),
    "mpc-paper": ("mpc.Mpc", lambda home, *_: home.PAPER),
    "mpc": ("mpc.Mpc", None),
    "mpc-friction": ("friction.FrictionMpc", None),
    "mpc-friction-preview": ("friction.FrictionMpc", _previewing),
    "mpc-robust": ("friction.FrictionMpc", _robust),
    "lqg-wheelbase": ("_wheelbase.WheelbaseLqg", None),
    "mpc-wheelbase": ("_wheelbase.WheelbaseMpc", None),
}
#: no current
_IDLE = ("passive", "isd-passive")  # "passive" on another plant: the conventional car
#: name -> factory(model, cost, control_step, **options)
CONTROLLERS: dict[str, Callable[..., BatchController | Idle]] = {
    **{name: partial(_idle, name) for name in _IDLE},
    **{
        name: partial(_made, kind, preset, name)
        for name, (kind, preset) in _CLASSES.items()
    },
}
#: one-line descriptions
ABOUT = {
    "passive": "the conventional passive car",
    "isd-passive": "the plant without current",
    "skyhook": "a damper to the sky, by the motor",
    "add": "acceleration-driven damping",
    "lqg": "linear-quadratic optimum on the measured signals, with a Kalman filter",
    "lqg-preview": "the LQG with the road ahead in sight",
    "lqr-full": "linear-quadratic optimum that sees the whole state, which no car measures",
    "mpc-paper": "the paper's predictive controller with the settings a toolbox would take",
    "mpc": "the paper's predictive controller, tuned",
    "mpc-friction": "predictive control that knows of the seal's friction (differential dynamic programming)",
    "mpc-friction-preview": "the same with the road ahead in sight",
    "mpc-robust": "mpc-friction for the robust track: its estimate reckons with noisy sensors",
    "lqg-wheelbase": "the LQG of a half or full car that knows the rear road from the front, without a sensor for it",
    "mpc-wheelbase": "mpc-friction at each corner of a half or full car, the rear road known from the front",
}
#: plants of controllers with a plant of their own
PLANTS = {"passive": "quarter-car-passive"}
#: controllers of a quarter car that drive a car with several corners as one at each corner
_AT_EACH_CORNER = (
    "skyhook",
    "add",
    "lqg",
    "mpc-paper",
    "mpc",
    "mpc-friction",
    "mpc-robust",
)

#: controllers with preview of a quarter car that drive a car with several corners, each with the road ahead of its wheel
_WITH_PREVIEW = ("lqg-preview", "mpc-friction-preview")
#: controllers of a car with a front and a rear axle
WHOLE_CAR = ("lqg-wheelbase", "mpc-wheelbase")


def make(
    name: str,
    model: Network | str | Path | Mapping[str, Any] | None = None,
    cost: StageCost | None = None,
    control_step: float = 5e-3,
    **options: Any,
) -> BatchController | Idle:
    """Return a controller.

    In a car with several corners, a controller of a quarter car drives each corner separately
    (`Decentralised`).

    Args:
        name: A key of `CONTROLLERS`.
        model: Model of the controller: a network, a built-in name, a file or its content; None for the
            default car.
        cost: Minimised stage cost; None for the environment's.
        control_step: Control step [s].
        options: Fields of the controller's settings, such as ``make("mpc", horizon=30)``.

    Raises:
        InputError: The name or an option is unknown, or the model is another kind of car.
    """
    if name not in CONTROLLERS:
        raise InputError(f"no controller '{name}': there are {', '.join(CONTROLLERS)}")
    factory = CONTROLLERS[name]
    usual = PLANTS.get(name, "half-car-isd" if name in WHOLE_CAR else "quarter-car-isd")
    network = Network.load(usual if model is None else model)
    car = vehicle(network)
    cost = StageCost.of(cost, car.axes, len(car.corners))
    if len(car.corners) > 1 and name in (*_AT_EACH_CORNER, *_WITH_PREVIEW):
        from ._decentralised import Decentralised, Previewing, at_each_corner

        speed = float(options.pop("speed", 20.0))
        corners = at_each_corner(
            network,
            cost,
            lambda one, own: factory(  # type: ignore[arg-type, return-value]
                one, own, control_step, **options
            ),
        )
        if name in _WITH_PREVIEW:
            return Previewing(name, network, corners, speed, control_step)
        return Decentralised(name, network, corners)
    if name not in (*_IDLE, *_AT_EACH_CORNER, *WHOLE_CAR):
        require_quarter_car(network, f"'{name}' is a controller")
    if name not in _IDLE and controlled_damper(network) is not None:
        return Clipped(
            network,
            lambda active: factory(  # type: ignore[arg-type, return-value]
                active, cost, control_step, **options
            ),
            control_step,
        )
    return factory(network, cost, control_step, **options)


__all__ = ["CONTROLLERS", "PLANTS", "BatchController", "make"]
