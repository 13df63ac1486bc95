"""Networks drawn at random: one to five masses, massless nodes, every element, plausible values, and inputs for them."""

import math

import numpy as np

from isd_gym import Network, simulate
from isd_gym.physics import elements as el
from isd_gym.physics.simulate import Plant

#: laws that store or dissipate what they are given and nothing else, at the values drawn here
PASSIVE = [
    "linear_stiffness", "linear_damping", "inertance", "coulomb_friction", "stribeck_friction", "quadratic_damping",
    "asymmetric_damping", "cubic_stiffness", "gas_spring", "bump_stop", "backlash", "hysteresis",
]  # fmt: skip
BETWEEN = [
    name
    for name, cls in el.TYPES.items()
    if cls.place == "between" and name != "motor" and not (cls.scheduled or cls.loaded)
]


def number(rng, f, passive):
    """A value of a parameter: uniform in the logarithm over its plausible range, at times negative where that is allowed."""
    low, high = f.metadata["range"]
    if not math.isfinite(low) or not math.isfinite(high):
        return float(rng.normal())
    if low <= 0.0:
        low = 0.0 if passive else low
        return float(rng.uniform(low, high))
    value = float(np.exp(rng.uniform(math.log(low), math.log(high))))
    if not passive and f.metadata["minimum"] < 0.0 and rng.random() < 0.1:
        value = -value
    return value


def element(rng, name, kind, pair, passive):
    cls = el.TYPES[kind]
    out = {"name": name, "type": kind, "between": list(pair)}
    for f in el.parameter_fields(cls):
        out[f.name] = number(rng, f, passive)
    for key, options in cls.choices.items():
        out[key] = str(rng.choice(options))
    if kind == "tabulated_force":
        knots = np.linspace(-0.3, 0.3, int(rng.integers(2, 6)))
        out |= {
            "rate": knots.tolist(),
            "force": (3e3 * knots + rng.normal(0.0, 200.0, len(knots))).tolist(),
            "scale": 1.0,
        }
    if kind == "stribeck_friction":
        out["static_level"] = out["level"] * float(rng.uniform(1.0, 2.0))
    return out


def draw(rng, *, passive=False, kinds=None):
    """A model (`isd-model/1`): a tree of masses and massless nodes on the ground and on a moved node, and laws anywhere."""
    masses = {
        f"m{i}": float(np.exp(rng.uniform(math.log(5.0), math.log(500.0))))
        for i in range(rng.integers(1, 6))
    }
    massless = [f"n{i}" for i in range(rng.integers(0, 3))]
    nodes = ["road", "ground", *masses]
    elements = []

    def add(kind, pair):
        elements.append(element(rng, f"e{len(elements)}", kind, pair, passive))

    for i, node in enumerate(masses):  # a chain that holds every mass
        other = nodes[int(rng.integers(0, 2 + i))]
        add("linear_stiffness", (node, other))
        if rng.random() < 0.8:
            add("linear_damping", (node, other))
    for node in (
        massless
    ):  # between a spring or damper on one side and something else on the other
        a, b = rng.choice(nodes, 2, replace=False)
        add(
            str(
                rng.choice(["linear_stiffness", "linear_damping", "series_compliance"])
            ),
            (node, str(a)),
        )
        add(str(rng.choice(["linear_stiffness", "linear_damping"])), (node, str(b)))
    everything = nodes + massless
    for kind in (
        kinds
        if kinds is not None
        else rng.choice(PASSIVE if passive else BETWEEN, rng.integers(1, 5))
    ):
        a, b = rng.choice(everything, 2, replace=False)
        if kind == "tyre_lift_off":
            b = "road"
        if a != b:
            add(str(kind), (str(a), str(b)))
    if rng.random() < 0.3 and not passive:
        a, b = rng.choice([n for n in everything if n != "road"], 2, replace=False)
        elements.append(
            {
                "name": "motor",
                "type": "motor",
                "between": [str(a), str(b)],
                "thrust_constant": 200.0,
            }
        )
    inputs = [{"name": "road", "quantity": "displacement", "at": "road", "unit": "m"}]
    if not any("road" in e["between"] for e in elements):
        add("linear_stiffness", ("m0", "road"))
    if elements[-1]["type"] == "motor" or any(e["type"] == "motor" for e in elements):
        inputs.append(
            {"name": "current", "quantity": "current", "element": "motor", "unit": "A"}
        )
    if not passive and rng.random() < 0.3:
        inputs.append({"name": "push", "quantity": "force", "at": "m0", "unit": "N"})
    outputs = [
        {"name": f"{n}_a", "quantity": "acceleration", "at": n, "unit": "m/s^2"}
        for n in masses
    ]
    outputs += [
        {"name": f"{n}_d", "quantity": "displacement", "at": n, "unit": "m"}
        for n in [*masses, *massless]
    ]
    return {
        "schema": "isd-model/1", "name": "random", "masses": masses, "elements": elements, "inputs": inputs, "outputs": outputs,
    }  # fmt: skip


def moves(rng, model, time):
    """Inputs of a model over `time`: a smooth road of some centimetres, a force, currents in steps."""
    size = 10.0 ** rng.uniform(-3.0, -1.3)
    out = {}
    for channel in model["inputs"]:
        phases, rates = (
            rng.uniform(0, 2 * math.pi, 4),
            2 * math.pi * rng.uniform(0.3, 8.0, 4),
        )
        wave = (
            sum(
                np.sin(w * time + p) - math.sin(p)
                for w, p in zip(rates, phases, strict=True)
            )
            / 4
        )
        if channel["quantity"] == "displacement":
            out[channel["name"]] = size * wave
        elif channel["quantity"] == "force":
            out[channel["name"]] = 1e3 * wave
        else:
            steps = rng.uniform(-5, 5, len(time) // 20 + 1)
            out[channel["name"]] = np.repeat(steps, 20)[: len(time)]
    return out


#: laws without kinks in the driven range
SMOOTH = ["cubic_stiffness", "quadratic_damping", "gas_spring"]
COARSE = 5e-4  # s, of a physics step


def converging(seed, rubs):
    """(order of convergence, whether a law's rate is only a difference) of a network with smooth laws, and friction if it `rubs`."""
    rng = np.random.default_rng([19 if rubs else 17, seed])
    kinds = [*rng.choice(SMOOTH, 1 if rubs else 2), *["coulomb_friction"] * rubs]
    model, time = draw(rng, passive=True, kinds=kinds), np.arange(301) * 1e-3
    starts = 0.5 - 0.5 * np.cos(
        np.pi * np.minimum(time / 0.1, 1.0)
    )  # from rest: a jump of velocity has no order
    inputs = {name: starts * values for name, values in moves(rng, model, time).items()}
    equations = Plant(Network.from_dict(model), COARSE).assemblies[0]
    found = order(model, inputs, time, COARSE)
    if found < 1.8 and not rubs:  # a massless node may be quicker than this step
        rates = np.linalg.eigvals(equations.rate[:, equations.columns("x")])
        found = order(model, inputs, time, min(COARSE, 1.0 / np.abs(rates).max()))
    return found, any(equations.by_difference)


def order(model, inputs, time, step):
    """Order of convergence at a halving of `step` [s]: by the RMS of all displacements, against an eighth of the halved one.

    Not a number where the error is next to that with which forces are solved for.
    """
    names = [c["name"] for c in model["outputs"] if c["quantity"] == "displacement"]

    def run(h):
        out = simulate(model, time, inputs, step=h)
        return np.stack([out[n] for n in names])

    fine = run(step / 16)
    errors = [np.sqrt(np.mean((run(h) - fine) ** 2)) for h in (step, step / 2)]
    if not errors[1] > 1e-8 * np.sqrt(np.mean(fine**2)):
        return math.nan
    return math.log2(errors[0] / errors[1])
