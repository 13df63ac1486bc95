"""Bodies and levers of networks drawn at random against Lagrange's multipliers, which eliminate nothing."""

import builders
import numpy as np
import pytest
from builders import channel

from isd_gym import Network
from isd_gym.physics.network import transfer

FREQUENCY = np.geomspace(0.2, 30.0, 12)
LINEAR = {
    "linear_stiffness": ("stiffness", 1e3, 1e5),
    "linear_damping": ("damping", 30.0, 3e3),
    "inertance": ("inertance", 1.0, 50.0),
}


def drawn(rng):
    """A full body, a pitching one, masses, massless nodes, a shaft, levers of every unit, two moved nodes."""

    def between(low, high):
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    def points(name, count, axes):
        return {
            f"{name}{i}": {axis: float(rng.normal()) for axis in axes}
            for i in range(count)
        }

    car = {
        "mass": between(10, 1000),
        "inertia": {"pitch": between(10, 1000), "roll": between(5, 500)},
    }
    seat = {
        "mass": between(5, 50),
        "inertia": {"pitch": between(1, 10)},
        "points": points("s", 2, "x"),
    }
    bodies = {"car": car | {"points": points("p", 4, "xy")}, "seat": seat}
    masses = {f"m{i}": between(5, 100) for i in range(2)}
    lines = [
        "car",
        "p0",
        "p1",
        "p2",
        "p3",
        "seat",
        "s0",
        "s1",
        *masses,
        "road",
        "base",
        "ground",
    ]
    elements = []

    def add(kind, a, b):
        key, low, high = LINEAR[kind]
        elements.append(
            builders.element(
                f"e{len(elements)}", kind, a, b, **{key: between(low, high)}
            )
        )

    for node in ("p0", "p1", "p2", "s0", "s1", *masses):  # something holds every motion
        add("linear_stiffness", node, str(rng.choice(["road", "base", "ground"])))
        add("linear_damping", node, str(rng.choice(["road", "base", "ground"])))
    for kind in rng.choice(list(LINEAR), 5):
        a, b = rng.choice(lines, 2, replace=False)
        if kind != "inertance" or not {a, b} <= {"road", "base", "ground"}:
            add(str(kind), str(a), str(b))
    add("linear_damping", "arm", "m0")  # a massless node behind a lever
    add("linear_stiffness", "fast", "ground")
    levers = [
        ("arm", str(rng.choice(["p3", "m1", "car", "road"])), "m/m"),
        ("shaft", str(rng.choice(["s1", "m0", "p2"])), "rad/m"),
        ("fast", "shaft", "rad/rad"),
    ]
    if rng.random() < 0.5:  # two nodes that are there already
        levers.append(("p1", str(rng.choice(["m1", "s0"])), "m/m"))
    listed = []
    for k, (first, second, unit) in enumerate(levers):
        ratio = float(rng.choice([-1, 1])) * between(0.2, 5.0)
        if rng.random() < 0.5:
            first, second, ratio = second, first, 1.0 / ratio
            unit = "/".join(unit.split("/")[::-1])
        listed.append(
            {"name": f"l{k}", "between": [first, second], "ratio": ratio, "unit": unit}
        )
    seen = [*lines[:-3], "arm"]
    roll, pushed = (
        {"body": "car", "axis": "roll"},
        rng.choice(["p1", "m0", "car", "arm"]),
    )
    moved = ["road displacement road", "base displacement base", f"push force {pushed}"]
    places = [f"{n}_place displacement {n}" for n in seen]
    outputs = [
        *places,
        channel("roll", "angle", **roll),
        "turn angle fast",
        "cell force road",
    ]
    parts = {
        "inertias": {"shaft": between(0.1, 5.0)},
        "bodies": bodies,
        "levers": listed,
    }
    return builders.model(
        "",
        elements,
        [*moved, channel("gust", "torque", **roll)],
        outputs,
        masses=masses,
        **parts,
    )


def with_multipliers(model, w):
    """Response at the circular frequency w: every node a coordinate, every tie an equation with a force of its own."""
    names = [*model["masses"], *model["inertias"], "road", "base"]
    inertia = dict(model["masses"] | model["inertias"])
    ties = []
    for name, body in model["bodies"].items():
        inertia |= {name: body["mass"]} | {
            f"{name}.{axis}": value for axis, value in body["inertia"].items()
        }
        for point, at in body["points"].items():
            arms = {f"{name}.pitch": at.get("x", 0.0)}
            if "roll" in body["inertia"]:
                arms[f"{name}.roll"] = -at.get("y", 0.0)
            ties.append({point: 1.0, name: -1.0} | arms)
    ties += [
        {v["between"][0]: 1.0, v["between"][1]: -v["ratio"]} for v in model["levers"]
    ]
    names += [n for n in inertia if n not in names]
    names += [n for tie in ties for n in tie if n not in names]
    index = {n: i for i, n in enumerate(dict.fromkeys(names))}
    size, s = len(index), 1j * w
    stiffness = np.zeros((size, size), complex)
    for node, value in inertia.items():
        stiffness[index[node], index[node]] += s * s * value
    for e in model["elements"]:
        row = np.zeros(size)
        for node, sign in zip(e["between"], (1.0, -1.0), strict=True):
            if node != "ground":
                row[index[node]] += sign
        key = LINEAR[e["type"]][0]
        power = {"stiffness": 1.0, "damping": s, "inertance": s * s}[key]
        stiffness += power * e[key] * np.outer(row, row)
    J = np.zeros((len(ties) + 2, size))
    for k, tie in enumerate(ties):
        for node, factor in tie.items():
            J[k, index[node]] = factor
    J[-2, index["road"]] = J[-1, index["base"]] = 1.0  # moved nodes follow their inputs
    whole = np.block([[stiffness, J.T], [J, np.zeros((len(J), len(J)))]])
    right = np.zeros((len(whole), 4), complex)
    right[len(whole) - 2, 0] = right[len(whole) - 1, 1] = 1.0
    right[index[model["inputs"][2]["at"]], 2] = 1.0
    right[index["car.roll"], 3] = 1.0
    solved = np.linalg.solve(whole, right)
    places = [c.get("at", "car.roll") for c in model["outputs"][:-1]]
    return np.vstack([solved[[index[n] for n in places]], -solved[len(whole) - 2]])


@pytest.mark.parametrize("seed", range(40))
def test_elimination_agrees_with_multipliers(seed):
    model = drawn(np.random.default_rng(seed))
    size = np.array([1.0, 1.0, 1e4, 1e4])  # inputs of like effect: 1 m, 10 kN, 10 kN m
    got = transfer(Network.from_dict(model), FREQUENCY) * size
    wanted = (
        np.array([with_multipliers(model, 2 * np.pi * f) for f in FREQUENCY]) * size
    )
    assert np.all(
        np.abs(got - wanted).max(axis=(0, 2)) < 1e-8 * np.abs(wanted).max(axis=(0, 2))
    )
