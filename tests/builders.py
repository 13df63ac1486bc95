"""Models, elements and channels of the tests as short calls, in place of spelled-out JSON."""

from dataclasses import replace
from typing import Any

import numpy as np

from isd_gym import Network, Table, simulate
from isd_gym._common.arrays import rms as rms

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
    place: dict[str, Any] = {
        0: {},
        1: {"at": nodes[0]} if nodes else {},
        2: {"between": [*nodes]},
    }[len(nodes)]
    return {
        "name": name,
        "quantity": quantity,
        **place,
        "unit": UNITS.get(quantity),
        **more,
    }


def model(
    name: str, elements: Any, inputs: Any = (), outputs: Any = (), **more: Any
) -> dict[str, Any]:
    """Return the JSON of a model: `more` holds masses, inertias, bodies, levers and uncertainty.

    A channel may be a text of its name, quantity and nodes ("travel displacement body wheel").
    """
    named = {"name": name} if name else {}
    sides = {"inputs": inputs, "outputs": outputs}
    channels = {
        k: [channel(*c.split()) if isinstance(c, str) else c for c in v]
        for k, v in sides.items()
    }
    return {
        "schema": "isd-model/1",
        **named,
        **more,
        "elements": [*elements],
        **channels,
    }


def network(*given: Any, **more: Any) -> Network:
    """Return the network of a model; arguments as for `model`."""
    return Network.load(model(*given, **more))


def cart(
    *elements: Any,
    inputs: Any = ("push force cart",),
    outputs: Any = ("speed velocity cart",),
    mass: float = 2.0,
    **more: Any,
) -> Any:
    """Return the JSON of a mass [kg] with these elements that a force pushes and whose speed is seen."""
    return model("cart", elements, inputs, outputs, masses={"cart": mass}, **more)


def oscillator(
    *outputs: Any, mass: float = 5.0, stiffness: float = 2000.0, damping: float = 30.0, base: str = "",
    beside: Any = (), name: str = "oscillator", **more: Any,
) -> Network:  # fmt: skip
    """Return a mass [kg] on a spring [N/m] and a damper [N s/m], shaken at a base of this name or pushed by a force."""
    foot, moved = (
        (base, f"{base} displacement {base}") if base else ("ground", "push force mass")
    )
    parts = [spring("mass", foot, stiffness), damper("mass", foot, damping), *beside]
    return network(name, parts, [moved], outputs, masses={"mass": mass}, **more)


def sines(time: Any, frequencies: Any, phases: Any, sizes: Any = 1.0) -> Any:
    """Return the sum of sines of these frequencies [Hz], phases [rad] and sizes."""
    f, p, a = np.broadcast_arrays(frequencies, phases, sizes)
    return np.sin(2 * np.pi * np.outer(time, f) + p) @ a


def recorded(
    model: Network, step: float, inputs: Any, samples: int = 0, initial: Any = None
) -> Any:
    """Return the record of a diagnosis that a network itself makes, from rest or from a state."""
    from isd_gym.diagnosis._simulation.problem import Problem, Record

    samples = samples or len(next(iter(inputs.values())))
    blank = Record("run", step, inputs, np.zeros((samples, len(model.outputs))))
    state = None if initial is None else np.array(initial)[:, None]
    seen = Problem(model, [blank]).simulate([model], 0, state, like=model)
    return replace(blank, measured=seen[:, :, 0])


def fitter_of(problem: Any, *noise: float) -> tuple[Any, Any]:
    """Return the fitter of records whose outputs have white noise of these deviations, and the structure of the nominal model."""
    from isd_gym.diagnosis._estimation.gauss_newton import Fitter
    from isd_gym.diagnosis._estimation.noise import white_weights
    from isd_gym.diagnosis._estimation.structure import base_structure

    fitter = Fitter(problem, white_weights(np.array(noise)))
    return fitter, base_structure(problem.network)


def fitted(problem: Any, *noise: float, **options: Any) -> Any:
    """Return the fit of a nominal model to records whose outputs have white noise of these deviations."""
    fitter, structure = fitter_of(problem, *noise)
    return fitter.fit(structure, **options)


def followed(problem: Any, *noise: float, **options: Any) -> Any:
    """Return a nominal model with fitted initial states alone, likewise."""
    fitter, structure = fitter_of(problem, *noise)
    return fitter.follow(structure, structure.start, problem.estimation, **options)


def decoupled_half_car() -> Network:
    """Return the half car whose pitch inertia is m a b, so that the axles do not feel one another."""
    return Network.load("half-car-isd").with_parameters(
        {"body.inertia.pitch": 690.0 * 1.35 * 1.35}
    )


#: a passive quarter car with the sensors of a test drive
STRUT = [spring("body", "wheel", 22000.0), damper("body", "wheel", 1500.0)]
SENSORS = [f"{n}_acceleration acceleration {n}" for n in ("body", "wheel")]
QUARTER_CAR = model(
    "quarter",
    [*STRUT, spring("wheel", "road", 192000.0, "tyre")],
    ["road displacement road"],
    [*SENSORS, "travel displacement body wheel"],
    masses={"body": 345.0, "wheel": 45.0},
)


def drive_quarter_car(
    step: float = 2.5e-3, seconds: float = 12.0, seed: int = 0, car: Any = QUARTER_CAR
) -> tuple[Any, dict[str, Any]]:
    """Return time and columns of a drive of the quarter car on a road of sines, with 2 % noise."""
    rng = np.random.default_rng(seed)
    time = step * np.arange(round(seconds / step))
    f = np.geomspace(0.3, 15, 50)
    heights = sines(time, f, rng.uniform(0, 6.3, 50), 2e-3 / f)
    said = simulate(car, time, {"road": heights})
    noisy = {
        k: y + 0.02 * y.std() * rng.standard_normal(len(y)) for k, y in said.items()
    }
    return time, {"road": heights} | noisy


def table(columns: Any, name: str) -> Table:
    """Return the columns of a generated rig, its time among them, as a table."""
    columns = dict(columns)
    return Table(columns.pop("time"), columns, name)


def named(d: Any) -> set[tuple[str, frozenset[str]]]:
    """Return the named effects of a diagnosis, with channel or terminals."""
    return {
        (e.effect, frozenset([e.channel] if e.channel else e.between or ()))
        for e in d.effects
    }
