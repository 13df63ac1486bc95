"""From a kind and a seed to a case: the truth, its records, the model as its owner believes it."""

from __future__ import annotations

import copy
import zlib
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from ..reference import simulate
from .car import CAR, DAMPER, car_base, car_inputs, car_nuisances
from .others import (
    OTHER,
    RIG,
    SCALED,
    Scale,
    decay_base,
    drive_base,
    mass_base,
    no_inputs,
    push_inputs,
    rig_base,
    rig_inputs,
    rig_nuisances,
    scaled,
    stroke_inputs,
    two_base,
)
from .secret import FINE, MAIN, Array, Case, Element, Model, Secret

ALL_KINDS: list[str] = [*CAR, *RIG, *OTHER, *SCALED]
"""Every kind that `make_case` knows."""

Inputs = Callable[[Generator, Secret, int, bool], dict[str, Array]]
FAMILIES: dict[str, tuple[Callable[[Generator, Secret], Model], Inputs, float]] = {
    "car": (car_base, car_inputs, 20.0),
    "rig": (rig_base, rig_inputs, 35.0),
    "mass": (mass_base, push_inputs, 20.0),
    "decay": (decay_base, no_inputs, 8.0),
    "drive": (drive_base, stroke_inputs, 20.0),
    "two_mass": (two_base, push_inputs, 20.0),
}


def family(kind: str) -> str:
    """The network that a kind is about."""
    if kind in CAR:
        return "car"
    return next(name for name in ("rig", "mass", "decay", "drive", "two_mass") if kind.startswith(name + "_"))


def _plus(model: Model, extra: Iterable[Element], prefix: str) -> list[Element]:
    """Append elements to a model, with names; returns what was appended."""
    added = []
    for i, e in enumerate(extra):
        named = {"name": f"{prefix}_{i + 1}", **copy.deepcopy(e)}
        model["elements"].append(named)
        added.append(named)
    return added


def _into_series(model: Model, e: Element, node: str) -> Element:
    """Put an element between the elements named in `into` and the first terminal that they share."""
    parameters = {k: v for k, v in e.items() if k != "into"}
    targets = [t for t in model["elements"] if t.get("name") in e["into"]]
    first = targets[0]["between"][0]
    for t in targets:
        t["between"] = [node, t["between"][1]]
    return {**parameters, "between": [first, node]}


def _without_node(model: Model, spring: str) -> None:
    """Take a series spring away: its two terminals become one."""
    e = next(e for e in model["elements"] if e["name"] == spring)
    keep, gone = e["between"]
    model["elements"].remove(e)
    for other in [*model["elements"], *model["outputs"]]:
        if "between" in other:
            other["between"] = [keep if n == gone else n for n in other["between"]]


def _ar1(r: Generator, size: int, deviation: float, memory: float = 0.4) -> Array:
    white = r.standard_normal(size + 50) * deviation * np.sqrt(1 - memory**2)
    return np.asarray(lfilter([1.0], [1.0, -memory], white)[50:])


def _run(
    model: Model, inputs: Mapping[str, Array], size: int, initial: dict[str, tuple[float, float]], step: float
) -> dict[str, Array]:
    t = np.arange(size) * FINE
    derivatives = {}
    for i in model["inputs"]:
        if i["quantity"] == "displacement":
            spline = CubicSpline(t, inputs[i["name"]])
            derivatives[i["name"]] = (spline(t, 1), spline(t, 2))
    cells = copy.deepcopy(model)
    for output in cells["outputs"]:
        if "element" in output:  # a force cell reads all that acts between its terminals
            at = next(e["between"] for e in model["elements"] if e.get("name") == output["element"])
            output["element"] = [e["name"] for e in model["elements"] if e.get("between") == at]
    return simulate(cells, t, inputs, step=step, initial=initial, derivatives=derivatives)


def make_case(
    kind: str,
    seed: int,
    *,
    duration: float | None = None,
    snr_db: float | None = None,
    spread: float | None = None,
    nuisances: int | None = None,
    moving: bool | None = None,
    step: float = 2e-5,
) -> Case:
    """One hidden-effect case; every choice that is not given is drawn from `seed`.

    kind: one of `ALL_KINDS`. duration: of each record [s]. snr_db: of each channel of the estimation record
    (validation has the same noise in absolute terms). spread: relative one-sided error of the owner's base
    parameters. nuisances: how many small effects the truth has besides. moving: whether records begin in
    mid-motion instead of at rest. step: of the reference simulator [s].
    """
    r = np.random.default_rng([zlib.crc32(kind.encode()), seed])
    group = family(kind)
    base, make_inputs, usual = FAMILIES[group]
    duration = usual if duration is None else duration
    snr_db = float(r.choice([26.0, 32.0, 40.0])) if snr_db is None else snr_db
    spread = float(r.choice([0.02, 0.05])) if spread is None else spread
    moving = bool(r.random() < 0.5) and group == "car" if moving is None else moving
    size = 2 * round(duration / FINE / 2) + 1
    lead = round(3.0 / FINE) if moving else 0
    plain = Secret()

    def initial(record: int) -> dict[str, tuple[float, float]]:
        return {"mass": ((0.03, 0.0), (-0.02, 0.15))[record]} if group == "decay" else {}

    base_model = base(r, plain)
    for e in base_model["elements"]:  # the rig at hand is not the textbook's
        if e["type"] in MAIN:
            e[MAIN[e["type"]]] *= 1 + 0.1 * r.uniform(-1, 1)
    for node in base_model["masses"]:
        base_model["masses"][node] *= 1 + 0.1 * r.uniform(-1, 1)
    streams = [r.spawn(1)[0] for _ in range(2)]
    draws = [copy.deepcopy(s.bit_generator.state) for s in streams]

    def inputs(secret: Secret) -> list[dict[str, Array]]:
        for s, state in zip(streams, draws, strict=True):
            s.bit_generator.state = copy.deepcopy(state)
        return [make_inputs(s, secret, size + lead, bool(i)) for i, s in enumerate(streams)]

    def base_element(name: str) -> Element:
        return next(e for e in base_model["elements"] if e["name"] == name)

    if kind in SCALED:
        effect, where = SCALED[kind]
        secret = scaled(effect, where, r, scale(base_model, where, inputs(plain)[0], size, initial(0)))
    else:
        secret = {**CAR, **RIG, **OTHER}[kind](r)
    for e in secret.add:
        if e["type"] == "tyre_lift_off":  # takes back what the linear tyre pulls
            e["stiffness"] = base_element("tyre")["stiffness"]
        if e["type"] == "x_fading_damping":  # all of the damper, and when cold as strong
            e["damping"] = base_element(*secret.replace)["damping"]
    driven = inputs(secret)

    # the truth
    true = copy.deepcopy(base_model)
    found: list[list[Any]] = []
    for name, other in secret.replace.items():
        e = next(e for e in true["elements"] if e["name"] == name)
        if not secret.unknown:
            found.append([other["type"], e["between"]])
        new = {"name": name, "between": e["between"], **other}
        e.clear()
        e.update(new)
    for name in secret.drop:
        e = next(e for e in true["elements"] if e["name"] == name)
        split = len(secret.drop) > 1 or name == "oil"
        found.append(["series_compliance" if name == "oil" else e["type"], None if split else e["between"]])
    true["masses"].update(secret.masses)
    hidden = _plus(true, secret.add, "hidden")
    for e in hidden:
        place = e.get("between") or e.get("channel")
        if "element" in e:
            place = next(m["between"] for m in true["elements"] if m["name"] == e["element"])
        found.append([e["type"], place])
    for i, e in enumerate(secret.series):
        hidden += _plus(true, [_into_series(true, e, f"hidden_node_{i + 1}")], f"series_{i + 1}")
        found.append([e["type"], None])
    answer: list[list[Any]] | str = "unknown" if secret.unknown else found
    pool = {"car": car_nuisances, "rig": rig_nuisances}.get(group, lambda r: [])(r)
    # a few per cent on a rough road as on a smooth one: motion goes with the root of its level
    for e in pool:
        power = {"cubic_stiffness": 1.0, "quadratic_damping": 0.5}.get(e["type"], 0.0)
        for key in ("stiffness", "damping"):
            if key in e:
                e[key] /= secret.level**power
    taken = {(e["type"], str(e.get("between") or e.get("element"))) for e in hidden}
    pool = [n for n in pool if (n["type"], str(n.get("between") or n.get("element"))) not in taken]
    count = (2 if group == "rig" else int(r.integers(2, 5))) if nuisances is None else nuisances
    chosen = r.permutation(len(pool))[: min(count, len(pool))]
    small = _plus(true, [pool[i] for i in sorted(chosen)], "nuisance")
    damper = next((e["between"] for e in true["elements"] if e.get("name") == "damper"), None)
    behind = [e for e in small if e.get("between") == list(DAMPER) and group == "car"]
    for e in behind:  # less damping is the damper's: on a massless node of its own it would push for ever
        e["between"] = list(damper or DAMPER)

    # the owner's model
    owner = copy.deepcopy(base_model)
    owner["uncertainty"] = {}
    for node in owner["masses"]:
        owner["masses"][node] *= 1 + spread * r.uniform(-1, 1)
        owner["uncertainty"][f"{node}.mass"] = spread
    for e in owner["elements"]:
        if e["type"] in MAIN and e["name"] not in secret.drop:
            e[MAIN[e["type"]]] *= 1 + spread * r.uniform(-1, 1)
            owner["uncertainty"][f"{e['name']}.{MAIN[e['type']]}"] = spread
    without = copy.deepcopy(true)  # the truth but for what is hidden
    without["elements"] = [
        e for e in without["elements"] if not str(e.get("name")).startswith(("hidden", "series"))
    ]
    for e in without["elements"]:
        if e.get("name") in {b["name"] for b in behind}:
            e["between"] = list(DAMPER)
    without["masses"] = {n: m for n, m in without["masses"].items() if n not in secret.masses}
    for e in without["elements"]:
        original = next((b for b in base_model["elements"] if b["name"] == e.get("name")), None)
        if original is not None:
            e.clear()
            e.update(copy.deepcopy(original))
    for m in (owner, without):
        for name in secret.drop:
            if name == "oil":
                _without_node(m, name)
            else:
                m["elements"] = [e for e in m["elements"] if e.get("name") != name]

    # the records
    outputs = [o["name"] for o in base_model["outputs"]]
    records: list[dict[str, Array]] = []
    noise: dict[str, float] = {}
    visibility: dict[str, float] = {}
    for i, u in enumerate(driven):
        y = {k: v[lead::2] for k, v in _run(true, u, size + lead, initial(i), step).items()}
        if i == 0:
            noise = {k: 10 ** (-snr_db / 20) * float(np.std(y[k])) for k in outputs}
            plainly = _run(without, u, size + lead, initial(i), step) if answer else None
            for k in outputs:
                change = (
                    0.0 if plainly is None else float(np.sqrt(np.mean((y[k] - plainly[k][lead::2]) ** 2)))
                )
                visibility[k] = change / noise[k]
        table = {"time": np.arange(len(y[outputs[0]])) * 2 * FINE}
        for item in base_model["inputs"]:
            column = u[item["name"]][lead::2]
            if item["quantity"] != "current":
                # what moves a machine is measured better than what moves a car
                imperfect = 1e-5 if group in ("rig", "drive") else 2e-3
                column = column + imperfect * np.std(column) * r.standard_normal(len(column))
            table[item["name"]] = column
        for k in outputs:
            table[k] = y[k] + _ar1(r, len(y[k]), noise[k])
        records.append(table)
    return Case(
        kind,
        seed,
        owner,
        records[0],
        records[1],
        answer,
        {"model": true, "hidden": hidden, "nuisances": small},
        snr_db,
        spread,
        visibility,
    )


def scale(
    model: Model,
    where: tuple[str, str],
    inputs: dict[str, Array],
    size: int,
    initial: dict[str, tuple[float, float]],
) -> Scale:
    """How far and fast two terminals move without the hidden effect, and the force between them."""
    probe = copy.deepcopy(model)
    probe["outputs"] = [
        {"name": q, "quantity": q, "between": list(where)} for q in ("displacement", "velocity")
    ] + [
        {"name": e["name"], "quantity": "force", "element": e["name"]}
        for e in model["elements"]
        if e["between"] == list(where)
    ]
    y = _run(probe, inputs, size, initial, 1e-4)
    rms = {k: float(np.sqrt(np.mean(v**2))) for k, v in y.items()}
    d, v = rms.pop("displacement"), rms.pop("velocity")
    return Scale(d, v, max(rms.values()))
