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

from ..case import Case
from ..reference import simulate
from .car import CAR, CAR_NUISANCES, DAMPER, car_base, car_inputs
from .others import (
    OTHER,
    RIG,
    RIG_NUISANCES,
    SCALED,
    Scale,
    decay_base,
    drive_base,
    mass_base,
    no_inputs,
    push_inputs,
    rig_base,
    rig_inputs,
    scaled,
    stroke_inputs,
    two_base,
)
from .secret import FINE, MAIN, Array, Element, Model, Secret

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
    return next(
        name
        for name in ("rig", "mass", "decay", "drive", "two_mass")
        if kind.startswith(name + "_")
    )


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
    model: Model,
    inputs: Mapping[str, Array],
    size: int,
    initial: dict[str, tuple[float, float]],
    step: float,
) -> dict[str, Array]:
    t = np.arange(size) * FINE
    derivatives = {}
    for i in model["inputs"]:
        if i["quantity"] == "displacement":
            spline = CubicSpline(t, inputs[i["name"]])
            derivatives[i["name"]] = (spline(t, 1), spline(t, 2))
    cells = copy.deepcopy(model)
    for output in cells["outputs"]:
        if (
            "element" in output
        ):  # a force cell reads the sum of the forces between its terminals
            at = next(
                e["between"]
                for e in model["elements"]
                if e.get("name") == output["element"]
            )
            output["element"] = [
                e["name"] for e in model["elements"] if e.get("between") == at
            ]
    return simulate(
        cells, t, inputs, step=step, initial=initial, derivatives=derivatives
    )


def _named(model: Model, name: str) -> Element:
    return next(e for e in model["elements"] if e.get("name") == name)


def _vary(model: Model, share: float, r: Generator, but: Iterable[str] = ()) -> None:
    """Scale the main parameters of a model's elements, but those named in `but`, by up to a share either way."""
    for e in model["elements"]:
        if e["type"] in MAIN and e["name"] not in but:
            e[MAIN[e["type"]]] *= 1 + share * r.uniform(-1, 1)


def _vary_masses(model: Model, share: float, r: Generator) -> None:
    for node in model["masses"]:
        model["masses"][node] *= 1 + share * r.uniform(-1, 1)


def _matched(secret: Secret, base_model: Model) -> Secret:
    """The secret with the effects that hang on an element of the base of its size."""
    for e in secret.add:
        if e["type"] == "tyre_lift_off":  # takes back what the linear tyre pulls
            e["stiffness"] = _named(base_model, "tyre")["stiffness"]
        if (
            e["type"] == "x_fading_damping"
        ):  # all of the damper, and when cold as strong
            e["damping"] = _named(base_model, *secret.replace)["damping"]
    return secret


def _hide(true: Model, secret: Secret) -> tuple[list[Element], list[list[Any]]]:
    """Put a secret into the true model; returns the hidden elements, and the effects with their places."""
    found: list[list[Any]] = []
    for name, other in secret.replace.items():
        e = _named(true, name)
        if not secret.unknown:
            found.append([other["type"], e["between"]])
        new = {"name": name, "between": e["between"], **other}
        e.clear()
        e.update(new)
    for name in secret.drop:
        e = _named(true, name)
        if name == "oil":
            found.append(["series_compliance", None])
        else:
            found.append([e["type"], None if len(secret.drop) > 1 else e["between"]])
    true["masses"].update(secret.masses)
    hidden = _plus(true, secret.add, "hidden")
    for e in hidden:
        place = e.get("between") or e.get("channel")
        if "element" in e:
            place = _named(true, e["element"])["between"]
        found.append([e["type"], place])
    for i, e in enumerate(secret.series):
        hidden += _plus(
            true, [_into_series(true, e, f"hidden_node_{i + 1}")], f"series_{i + 1}"
        )
        found.append([e["type"], None])
    return hidden, found


def _place(e: Element) -> tuple[str, str]:
    return e["type"], str(e.get("between") or e.get("element"))


def _add_nuisances(
    true: Model,
    group: str,
    secret: Secret,
    hidden: list[Element],
    count: int | None,
    r: Generator,
) -> list[Element]:
    """Add small effects that nobody knows at places without a hidden effect, and return these effects."""
    draws = {"car": CAR_NUISANCES, "rig": RIG_NUISANCES}.get(group, [])
    pool = [draw(r).add[0] for draw in draws]
    # a few per cent on a rough road as on a smooth one: motion goes with the root of its level
    for e in pool:
        power = {"cubic_stiffness": 1.0, "quadratic_damping": 0.5}.get(e["type"], 0.0)
        for key in {"stiffness", "damping"} & e.keys():
            e[key] /= secret.level**power
    taken = {_place(e) for e in hidden}
    pool = [e for e in pool if _place(e) not in taken]
    if count is None:
        count = 2 if group == "rig" else int(r.integers(2, 5))
    chosen = r.permutation(len(pool))[: min(count, len(pool))]
    return _plus(true, [pool[i] for i in sorted(chosen)], "nuisance")


def _move_damping(true: Model, nuisances: list[Element]) -> list[Element]:
    """Put nuisances at a car's damper where its damper is: on a massless node they would push for ever."""
    damper = next(
        (e["between"] for e in true["elements"] if e.get("name") == "damper"), DAMPER
    )
    moved = [e for e in nuisances if e.get("between") == list(DAMPER)]
    for e in moved:
        e["between"] = list(damper)
    return moved


def _believed(base_model: Model, secret: Secret, spread: float, r: Generator) -> Model:
    """The model as its owner believes it, with the uncertainty of its parameters."""
    owner = copy.deepcopy(base_model)
    _vary_masses(owner, spread, r)
    _vary(owner, spread, r, secret.drop)
    owner["uncertainty"] = {f"{node}.mass": spread for node in owner["masses"]}
    for e in owner["elements"]:
        if e["type"] in MAIN and e["name"] not in secret.drop:
            owner["uncertainty"][f"{e['name']}.{MAIN[e['type']]}"] = spread
    _drop(owner, secret.drop)
    return owner


def _without_hidden(
    true: Model, base_model: Model, secret: Secret, moved: list[Element]
) -> Model:
    """The truth but for the hidden effect; `moved`: nuisances that return to the damper's place."""
    without = copy.deepcopy(true)
    originals = {e["name"]: e for e in base_model["elements"]}
    at_damper = {e["name"] for e in moved}
    kept = []
    for e in without["elements"]:
        name = e.get("name")
        if str(name).startswith(("hidden", "series")):
            continue
        if name in at_damper:
            e["between"] = list(DAMPER)
        kept.append(copy.deepcopy(originals[name]) if name in originals else e)
    without["elements"] = kept
    without["masses"] = {
        n: m for n, m in without["masses"].items() if n not in secret.masses
    }
    _drop(without, secret.drop)
    return without


def _drop(model: Model, names: Iterable[str]) -> None:
    for name in names:
        if name == "oil":
            _without_node(model, name)
        else:
            model["elements"].remove(_named(model, name))


def _measured(
    model: Model, inputs: dict[str, Array], imperfect: float, r: Generator
) -> dict[str, Array]:
    """The inputs as sensors see them: all but currents with a share of noise."""
    table = {}
    for channel in model["inputs"]:
        column = inputs[channel["name"]]
        if channel["quantity"] != "current":
            column = column + imperfect * np.std(column) * r.standard_normal(
                len(column)
            )
        table[channel["name"]] = column
    return table


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
    starts = ((0.03, 0.0), (-0.02, 0.15)) if group == "decay" else ()
    initial = [{"mass": state} for state in starts] or [{}, {}]

    base_model = base(r, Secret())
    _vary(base_model, 0.1, r)  # the rig at hand is not the textbook's
    _vary_masses(base_model, 0.1, r)
    streams = [r.spawn(1)[0] for _ in range(2)]

    def inputs(secret: Secret, record: int) -> dict[str, Array]:
        return make_inputs(
            copy.deepcopy(streams[record]), secret, size + lead, bool(record)
        )

    if kind in SCALED:
        effect, where = SCALED[kind]
        size_of = scale(base_model, where, inputs(Secret(), 0), size, initial[0])
        secret = scaled(effect, where, r, size_of)
    else:
        secret = {**CAR, **RIG, **OTHER}[kind](r)
    secret = _matched(secret, base_model)

    true = copy.deepcopy(base_model)
    hidden, found = _hide(true, secret)
    small = _add_nuisances(true, group, secret, hidden, nuisances, r)
    moved = _move_damping(true, small) if group == "car" else []
    owner = _believed(base_model, secret, spread, r)
    without = _without_hidden(true, base_model, secret, moved)
    answer: list[list[Any]] | str = "unknown" if secret.unknown else found

    def run(model: Model, record: int, driven: dict[str, Array]) -> dict[str, Array]:
        y = _run(model, driven, size + lead, initial[record], step)
        return {name: values[lead::2] for name, values in y.items()}

    records: list[dict[str, Array]] = []
    noise: dict[str, float] = {}
    visibility: dict[str, float] = {}
    # what moves a machine is measured better than what moves a car
    imperfect = 1e-5 if group in ("rig", "drive") else 2e-3
    for i in range(2):
        driven = inputs(secret, i)
        y = run(true, i, driven)
        if i == 0:
            noise = {k: 10 ** (-snr_db / 20) * float(np.std(y[k])) for k in y}
            plain = run(without, i, driven) if answer else y
            visibility = {
                k: float(np.sqrt(np.mean((y[k] - plain[k]) ** 2))) / noise[k] for k in y
            }
        seen = {name: column[lead::2] for name, column in driven.items()}
        table = {"time": np.arange(size // 2 + 1) * 2 * FINE} | _measured(
            base_model, seen, imperfect, r
        )
        records.append(table | {k: y[k] + _ar1(r, len(y[k]), noise[k]) for k in y})
    return Case(
        kind=kind,
        seed=seed,
        model=owner,
        estimation=records[0],
        validation=records[1],
        answer=answer,
        truth={"model": true, "hidden": hidden, "nuisances": small},
        snr_db=snr_db,
        spread=spread,
        visibility=visibility,
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
        {"name": q, "quantity": q, "between": list(where)}
        for q in ("displacement", "velocity")
    ] + [
        {"name": e["name"], "quantity": "force", "element": e["name"]}
        for e in model["elements"]
        if e["between"] == list(where)
    ]
    y = _run(probe, inputs, size, initial, 1e-4)
    rms = {k: float(np.sqrt(np.mean(v**2))) for k, v in y.items()}
    d, v = rms.pop("displacement"), rms.pop("velocity")
    return Scale(d, v, max(rms.values()))
