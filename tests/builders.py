"""Models, elements and channels of the tests as short calls, in place of spelled-out JSON."""

from typing import Any

import numpy as np

from isd_gym.physics.network import Network
from isd_gym.physics.simulate import simulate
from isd_gym.records.data import Table

#: unit of a channel unless another one is given
UNITS = {
    "displacement": "m", "velocity": "m/s", "acceleration": "m/s^2", "force": "N", "current": "A",
    "angle": "rad", "angular_velocity": "rad/s", "torque": "N m",
}  # fmt: skip


def element(name: str, kind: str, a: str, b: str, **values: Any) -> dict[str, Any]:
    """Return an element of a kind between two nodes."""
    return {"name": name, "type": kind, "between": [a, b], **values}


def spring(a: str, b: str, stiffness: Any, name: str = "spring") -> dict[str, Any]:
    """Return a linear spring [N/m] between two nodes."""
    return element(name, "linear_stiffness", a, b, stiffness=stiffness)


def damper(a: str, b: str, damping: Any, name: str = "damper") -> dict[str, Any]:
    """Return a linear damper [N s/m] between two nodes."""
    return element(name, "linear_damping", a, b, damping=damping)


def friction(a: str, b: str, level: Any, name: str = "rub") -> dict[str, Any]:
    """Return dry friction of a constant level [N] between two nodes."""
    return element(name, "coulomb_friction", a, b, level=level)


def channel(name: str, quantity: str, *nodes: str, **more: Any) -> dict[str, Any]:
    """Return an input or output at one node, between two nodes, or at `element`, in SI unless `unit` says otherwise."""
    place: dict[str, Any] = {0: {}, 1: {"at": nodes[0]} if nodes else {}, 2: {"between": [*nodes]}}[
        len(nodes)
    ]
    return {"name": name, "quantity": quantity, **place, "unit": UNITS.get(quantity), **more}


def model(name: str, elements: Any, inputs: Any = (), outputs: Any = (), **more: Any) -> dict[str, Any]:
    """Return the JSON of a model: `more` holds masses, inertias, bodies, levers and uncertainty."""
    named = {"name": name} if name else {}
    channels = {"inputs": [*inputs], "outputs": [*outputs]}
    return {"schema": "isd-model/1", **named, **more, "elements": [*elements], **channels}


def network(*given: Any, **more: Any) -> Network:
    """Return the network of a model; arguments as for `model`."""
    return Network.load(model(*given, **more))


def pushed_mass(name: str, outputs: list[dict[str, Any]], **more: Any) -> Network:
    """Return a mass of 5 kg on a spring of 2000 N/m and a damper of 30 N s/m, pushed by a force."""
    parts = [spring("mass", "ground", 2000.0), damper("mass", "ground", 30.0)]
    return network(name, parts, [channel("push", "force", "mass")], outputs, masses={"mass": 5.0}, **more)


def decoupled_half_car() -> Network:
    """Return the half car whose pitch inertia is m a b, so that the axles do not feel one another."""
    return Network.load("half-car-isd").with_parameters({"body.inertia.pitch": 690.0 * 1.35 * 1.35})


#: a passive quarter car with the sensors of a test drive
QUARTER_CAR = model(
    "quarter",
    [
        spring("body", "wheel", 22000.0),
        damper("body", "wheel", 1500.0),
        spring("wheel", "road", 192000.0, "tyre"),
    ],
    [channel("road", "displacement", "road")],
    [
        channel("body_acceleration", "acceleration", "body"),
        channel("wheel_acceleration", "acceleration", "wheel"),
        channel("travel", "displacement", "body", "wheel"),
    ],
    masses={"body": 345.0, "wheel": 45.0},
)


def drive_quarter_car(
    step: float = 2.5e-3, seconds: float = 12.0, seed: int = 0, car: Any = QUARTER_CAR
) -> tuple[Any, dict[str, Any]]:
    """Return time and columns of a drive of the quarter car on a road of sines, with 2 % noise."""
    rng = np.random.default_rng(seed)
    time = step * np.arange(round(seconds / step))
    f = np.geomspace(0.3, 15, 50)
    heights = sum(
        2e-3 / k * np.sin(2 * np.pi * k * time + p) for k, p in zip(f, rng.uniform(0, 6.3, 50), strict=True)
    )
    said = simulate(car, time, {"road": heights})
    return time, {"road": heights} | {
        k: y + 0.02 * y.std() * rng.standard_normal(len(y)) for k, y in said.items()
    }


def table(columns: Any, name: str) -> Table:
    """Return the columns of a generated rig, its time among them, as a table."""
    columns = dict(columns)
    return Table(columns.pop("time"), columns, name)


def named(d: Any) -> set[tuple[str, frozenset[str]]]:
    """Return the named effects of a diagnosis, with channel or terminals."""
    return {(e.effect, frozenset([e.channel] if e.channel else e.between or ())) for e in d.effects}
