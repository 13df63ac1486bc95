"""Policies by name: what the packages above this one offer for scoring, found by the entry points `isd_gym.policies`.

Each entry point is a function ``open(name, model, cost, control_step, options) -> Entry | None``; None means "not mine".
"""

from __future__ import annotations

import os
from difflib import get_close_matches
from typing import Any

from .cost import StageCost
from .driving import Entry, Idle
from .errors import InputError, shown
from .network import Network
from .plugins import POLICIES, plugins
from .vehicle import require_quarter_car

__all__ = ["Entry", "Idle", "conventional", "find", "passive"]


def conventional(network: Network) -> Network:
    """The conventional passive car (spring and damper in parallel) with the network's own masses and coefficients.

    The first two masses are body and wheel, whatever they are called. Raises `InputError` for a network that is no
    quarter car.
    """
    require_quarter_car(network, "the conventional passive car is that")
    car = Network.load("quarter-car-passive")
    own = network.parameters
    shared = {k: own[k] for k in car.parameters if k in own}
    masses = {f"{k}.mass": network.masses[o] for k, o in zip(car.masses, network.masses, strict=False)}
    return car.with_parameters(shared | masses)


def passive(network: Network) -> Entry:
    """What every policy is compared with.

    Of the car of `network`.
    """
    return Entry("passive", lambda: Idle("passive"), conventional(network))


def find(
    name: str,
    network: Network,
    *,
    model: Network | None = None,
    cost: StageCost | None = None,
    control_step: float = 5e-3,
    trust_zip: bool = False,
    **options: Any,
) -> Entry:
    """The policy of that name: passive, isd-passive, a baseline, or a trained policy's folder (or .zip).

    `model` is what a controller believes in, by default the plant `network`. A .zip holds pickles and is opened only with
    `trust_zip`. Raises `InputError` listing what there is.

    name: one that `available` lists, or a path. network: the plant that it will drive. cost: what it minimises. control_step [s].
    """
    if not trust_zip and name.lower().endswith(".zip") and os.path.isfile(name):
        raise InputError(
            f"{shown(name, 200)} is an archive with pickles in it: convert it once with `isd-gym convert`, "
            "or say --trust-zip if it is your own"
        )
    require_quarter_car(network, f"{shown(name, 200)} is a policy")
    if name == "passive":
        return passive(network)
    if name == "isd-passive":
        return Entry(name, lambda: Idle(name))
    known = ["passive", "isd-passive"]
    for point in plugins(POLICIES):
        opener = point.load()
        entry = opener(name, model or network, cost or StageCost(), control_step, options)
        if entry is not None:
            return entry
        known += getattr(opener, "names", list)()
    known = list(dict.fromkeys(known))
    near = get_close_matches(name[:80], known, 1)
    asked = f" (did you mean '{near[0]}'?)" if near else ""
    raise InputError(
        f"no policy {shown(name, 200)}{asked}: neither a policy folder nor one of {', '.join(known)}"
    )


def available() -> dict[str, str]:
    """What can be named without a path, and what it is in a line: the built-in, the baselines, the shipped, other packages'.

    An opener says its names by an attribute `about`, a function that gives {name: line}, or `names`, a function that lists them.
    """
    known = {
        "passive": "the conventional passive car: spring and damper in parallel; what all are compared with",
        "isd-passive": "the plant without current",
    }
    for point in plugins(POLICIES):
        opener = point.load()
        own = (
            opener.about()
            if hasattr(opener, "about")
            else dict.fromkeys(getattr(opener, "names", list)(), point.value)
        )
        known |= {name: text for name, text in own.items() if name not in known}
    return known
