"""Policies by name: the built-in policies and those of other packages, found by the entry points `isd_gym.policies`.

Each entry point is a function ``open(name, model, cost, control_step, options) -> Entry | None``; None means
an unknown name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from difflib import get_close_matches
from typing import Any

from .._common.errors import InputError, shown
from .._common.plugins import POLICIES, plugins
from ..physics.cost import StageCost
from ..physics.network import Network
from ..physics.network._bodies import Point
from ..physics.vehicle import kind, vehicle
from ._own_controllers import entry_of_file
from .driving import Entry, Idle

__all__ = ["Entry", "Idle", "available", "conventional", "find", "find_all", "passive"]

#: name of the reference of every score
_REFERENCE = "passive"
#: built-in conventional passive cars by number of corners
_CONVENTIONAL = {1: "quarter-car-passive", 2: "half-car-passive", 4: "full-car-passive"}


def conventional(network: Network) -> Network:
    """Return the conventional passive car of a network: spring and damper in parallel at each corner.

    The car keeps masses, inertias and points of the network, and coefficients of the same names. Body and
    wheel of a quarter car are its first two masses; those of other cars are the body and the wheel of each
    corner.

    Args:
        network: Network of a car.

    Raises:
        InputError: The network is no car, or has another number of corners than 1, 2 or 4.
    """
    own = vehicle(network)
    count = len(vehicle(network).corners)
    if count not in _CONVENTIONAL:
        raise InputError(
            f"network '{network.name}' has {count} corners: conventional passive cars have 1, 2 or 4 of them"
        )
    car = Network.load(_CONVENTIONAL[count])
    parameters = network.parameters
    shared = {k: parameters[k] for k in car.parameters if k in parameters}
    if count == 1:
        masses = {
            f"{k}.mass": network.masses[o]
            for k, o in zip(car.masses, network.masses, strict=False)
        }
        return car.with_parameters(shared | masses)
    corners = list(zip(vehicle(car).corners, own.corners, strict=True))
    masses = {
        f"{one.wheel}.mass": network.masses[other.wheel] for one, other in corners
    }
    given = network.bodies[0]
    held = {one.body: Point(one.body, other.x, other.y) for one, other in corners}
    free = [
        p
        for p in given.points
        if p.name not in held and p.name not in {c.body for c in own.corners}
    ]
    body = replace(given, name=car.bodies[0].name, points=(*held.values(), *free))
    known = set(car.parameters)
    return replace(
        car.with_parameters({k: v for k, v in (shared | masses).items() if k in known}),
        bodies=(body,),
        outputs=(),
        uncertainty={},
    )


def passive(network: Network) -> Entry:
    """Return the reference of every score: the conventional passive car.

    Args:
        network: Network of a car.

    Raises:
        InputError: The network is no car, or has another number of corners than 1, 2 or 4.
    """
    car = conventional(network)
    return Entry(_REFERENCE, lambda: Idle(_REFERENCE, car), car)


def find(
    name: str,
    network: Network,
    *,
    model: Network | None = None,
    cost: StageCost | None = None,
    control_step: float = 5e-3,
    speed: float | None = None,
    trained: str | None = None,
    **options: Any,
) -> Entry:
    """Return a policy by its name: passive, isd-passive, a baseline, a trained policy, or an own controller.

    Of a .zip file only the weights are read; nothing of the file is executed. The Python file of an own controller
    is executed.

    Args:
        name: A name in `available`, the path of a policy folder or .zip file, or ``file.py:Class`` or
            ``file.py:function``.
        network: The plant.
        model: Model of a controller; None for the plant.
        cost: Stage cost that a controller minimises; None for the usual one.
        control_step: Control step [s].
        speed: Speed of the car [m/s], the option `speed` of controllers of a car with two axles; None if
            unknown.
        trained: Options of the training of a .zip file, such as "observation=history"; None to find them.
        options: Settings of a controller.

    Raises:
        InputError: The name is unknown, or the policy does not fit the plant.
    """
    if (entry := entry_of_file(name)) is not None:
        return entry
    if trained is not None and name.lower().endswith(".zip"):
        options["trained"] = trained
    car = vehicle(network)
    if name == _REFERENCE:
        return passive(network)
    if name == "isd-passive":
        return Entry(name, lambda: Idle(name, network))
    cost = StageCost.of(cost, car.axes, len(car.corners))
    belief = model or network
    if kind(belief) != kind(network):
        raise InputError(
            f"the controllers' model '{belief.name}' is a {kind(belief)}, but the plant '{network.name}' is a {kind(network)}"
        )
    if speed is not None and len(car.corners) > 1:
        options["speed"] = speed
    for point in plugins(POLICIES):
        if (
            entry := point.load()(name, belief, cost, control_step, options)
        ) is not None:
            return entry
    known = list(available())
    near = get_close_matches(name[:80], known, 1)
    asked = f" (did you mean '{near[0]}'?)" if near else ""
    raise InputError(
        f"no policy {shown(name, 200)}{asked}: neither a policy folder, a file.py:Class, nor one of {', '.join(known)}"
    )


def find_all(
    policies: Sequence[str | Entry], network: Network, **how: Any
) -> list[Entry]:
    """Return policies by name, under distinct names where possible.

    A trained policy brings its name along. Where two policies have the same name, or a trained policy has the
    name of the reference ("passive"), the path is the name of the trained policy.

    Args:
        policies: Names as in `find`, or entries, which keep their names.
        network: The plant.
        how: Further arguments of `find`.

    Returns:
        The policies, in the given order.

    Raises:
        InputError: A name is unknown, or a policy does not fit the plant.
    """
    asked = [p if isinstance(p, str) else p.name for p in policies]
    entries = [find(p, network, **how) if isinstance(p, str) else p for p in policies]
    count = Counter([_REFERENCE, *(e.name for e in entries)])
    return [
        entry
        if count[entry.name] == 1 or entry.name == name
        else replace(entry, name=name)
        for name, entry in zip(asked, entries, strict=True)
    ]


def available() -> dict[str, str]:
    """Return the names that need no path: built-in policies, baselines, shipped policies and those of other packages.

    The function of an entry point may have an attribute `about`, a function that returns {name: description},
    or `names`, a function that returns names.

    Returns:
        One-line description by name.
    """
    known = {
        _REFERENCE: "the conventional passive car: spring and damper in parallel; what all are compared with",
        "isd-passive": "the plant without current",
    }
    for point in plugins(POLICIES):
        opener = point.load()
        own = opener.about() if hasattr(opener, "about") else {}
        own = own or dict.fromkeys(getattr(opener, "names", list)(), point.value)
        known |= {name: text for name, text in own.items() if name not in known}
    return known
