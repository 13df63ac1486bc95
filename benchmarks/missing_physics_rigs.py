"""Rigs of MissingPhysBench, drawn by the generator of the hidden suite (benchmarks/rigs/families).

The generator draws rigs, effects, their size, nuisances, sensors and the errors of the nominal model. This module chooses among
its rigs and kinds, sets the noise level, adds a record for the test, and closes a loop.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from rigs.families import case as cases
from rigs.families import effects as fx
from rigs.families import rigs as drawn
from rigs.families.bench import Drive, Fit, Rig, outputs, run, set_relative
from rigs.families.draw import Tempo, log, rough
from rigs.families.effects import NOTHING, at, unknown
from rigs.families.plant import Run, Signal

if TYPE_CHECKING:
    from collections.abc import Callable

SOIL, BASE, UPPER = drawn.SOIL, drawn.BASE, drawn.UPPER
#: stiffness of the position controller over that of the spring, and its damping ratio
LOOP = (2.0, 0.5)

Columns = dict[str, np.ndarray]


def _with_outputs(rig: Rig, *channels: tuple[str, str, list[str] | None]) -> Rig:
    """Return the rig with other channels: name, quantity and the two terminals, or None for the mass."""
    unit = {"displacement": "m", "acceleration": "m/s^2"}
    model = copy.deepcopy(rig.model)
    model["outputs"] = [
        {
            "name": n,
            "quantity": q,
            "unit": unit[q],
            **({"between": w} if w else {"at": "mass"}),
        }
        for n, q, w in channels
    ]
    return replace(rig, model=model)


def _shaken(r: np.random.Generator) -> Rig:
    travel = ("travel", "displacement", ["mass", "base"])
    return _with_outputs(
        drawn.shaken(r, "both"), travel, ("acceleration", "acceleration", None)
    )


def _pushed(r: np.random.Generator) -> Rig:
    return _with_outputs(drawn.pushed(r), ("position", "displacement", None))


def _two_masses(r: np.random.Generator) -> Rig:
    lower = ("lower_travel", "displacement", ["lower", "base"])
    return _with_outputs(
        drawn.shaken2(r), lower, ("upper_travel", "displacement", ["upper", "lower"])
    )


def _loop(r: np.random.Generator) -> Rig:
    """A pushed mass under a position controller: a spring and a damper to the node of the reference."""
    rig = _pushed(r)
    model = copy.deepcopy(rig.model)
    mass = model["masses"]["mass"]
    stiffness = (
        next(e["stiffness"] for e in model["elements"] if e["name"] == "spring")
        * LOOP[0]
    )
    damping = 2.0 * LOOP[1] * np.sqrt(stiffness * mass)
    here = {"between": ["mass", "reference"]}
    model["elements"] += [
        {
            "name": "loop_stiffness",
            "type": "linear_stiffness",
            **here,
            "stiffness": stiffness,
        },
        {"name": "loop_damping", "type": "linear_damping", **here, "damping": damping},
    ]
    name = model["inputs"][0]["name"]
    model["inputs"] = [
        {"name": name, "quantity": "displacement", "at": "reference", "unit": "m"}
    ]
    drives = tuple(
        Drive({name: _divided(d.inputs[name], stiffness)}, {}) for d in rig.drives
    )
    known = (*rig.known, "loop_stiffness.stiffness", "loop_damping.damping")
    return replace(rig, model=model, drives=drives, known=known)


def _divided(signal: Signal, by: float) -> Signal:
    return Signal(signal.value / by, signal.rate / by, signal.second / by)


RIGS: dict[str, Callable[[np.random.Generator], Rig]] = {
    "shaken": _shaken,
    "pushed": _pushed,
    "two_masses": _two_masses,
    "loop": _loop,
}
KINDS = {
    "none": NOTHING,
    "friction_ground": at("coulomb_friction", fx.coulomb, SOIL),
    "asymmetric": at("asymmetric_damping", fx.asymmetric, BASE),
    "cubic_upper": at("cubic_stiffness", fx.hardening, UPPER),
    "quadratic": at("quadratic_damping", fx.quadratic, SOIL),
    "friction": at("coulomb_friction", fx.coulomb, SOIL),
    "cubic": at("cubic_stiffness", fx.hardening, SOIL),
    "friction_ground_and_cubic": at("coulomb_friction", fx.coulomb, SOIL)
    & at("cubic_stiffness", fx.hardening, BASE),
    "friction_and_cubic": at("coulomb_friction", fx.coulomb, SOIL)
    & at("cubic_stiffness", fx.hardening, SOIL),
    "tanh": unknown(fx.tanh_spring, BASE),
    "switched": unknown(fx.switched_spring, SOIL),
    "gain": at("sensor_gain", fx.sensor_gain, "upper_travel"),
    "delay": at("sensor_delay", fx.sensor_delay, fx.FIRST),
}


def make_case(
    kind: str, seed: int, noise_db: int, samples: tuple[int, int]
) -> tuple[dict[str, Any], Columns, dict[str, Any]]:
    """Draw one case.

    Args:
        kind: "rig.what" of `RIGS` and `KINDS`.
        seed: Seed.
        noise_db: Signal-to-noise ratio of every channel [dB].
        samples: Smallest and largest number of samples of a record.

    Returns:
        The files of the case (model, train, validation, test_input), the noise-free test outputs, and the truth.
    """
    which, what = kind.split(".")
    last: list[Rig] = []

    def draw(r: np.random.Generator) -> Rig:
        rig = RIGS[which](r)
        while not samples[0] <= rig.size <= samples[1]:
            rig = RIGS[which](r)
        rig = replace(
            rig, drives=(*rig.drives, _test_drive(r, rig)), snr_db=(noise_db, noise_db)
        )
        last[:] = [rig]
        return rig

    case = cases.make_case(cases.Family(draw, {what: KINDS[what]}), kind, seed)
    rig, true = last[0], case.truth["model"]
    ran = [run(rig, true, drive) for drive in rig.drives]
    seen = [outputs(rig, true, r) for r in ran]
    owner = case.model
    assert case.validation is not None
    records = [case.estimation, case.validation]
    name = owner["inputs"][0]["name"]
    if which == "loop":
        owner, driven = (
            _opened(owner, rig),
            [_push(true, rig, r, d) for r, d in zip(ran, rig.drives, strict=True)],
        )
        records = [
            {**t, name: d.value} for t, d in zip(records, driven[:2], strict=True)
        ]
        drives = tuple(Drive({name: d}, {}) for d in driven)
        rig = replace(rig, model=_opened(rig.model, rig), drives=drives)
    time = np.arange(rig.size) * rig.interval
    files: dict[str, Any] = {
        "model": owner,
        "train": records[0],
        "validation": records[1],
        "test_input": {"time": time, name: rig.drives[2].inputs[name].value},
    }
    test = {"time": time, **seen[2]}
    truth = {
        "effects": [{"law": law, "place": place} for law, place in case.answer]
        if case.answer != "unknown"
        else [],
        "places": [p for p in map(_place, case.truth["hidden"]) if p],
        "hidden": case.truth["hidden"],
        "nuisances": [
            {**e, "law": e["type"], "place": e["between"]}
            for e in case.truth["nuisances"]
        ],
        "parameters": _true_values(owner, true),
        "nominal_error": _nominal_error(rig, seen, owner["uncertainty"]),
    }
    return files, test, truth


def _test_drive(r: np.random.Generator, rig: Rig) -> Drive:
    """A rough signal of about the strength of the training record."""
    name, signal = next(iter(rig.drives[0].inputs.items()))
    frequency = 1.0 / (2.0 * np.pi * rig.time)
    tempo = Tempo(frequency, rig.interval, rig.size)
    size = float(np.std(signal.value)) * log(r, 0.7, 1.3)
    return Drive(
        {name: rough(r, tempo, 0.25 * frequency, 3.0 * frequency, 0.5, size)}, {}
    )


def _place(e: dict[str, Any]) -> Any:
    return e.get("between") or e.get("channel")


def _opened(model: dict[str, Any], rig: Rig) -> dict[str, Any]:
    """The model without the controller: the force of the controller is the input."""
    out = copy.deepcopy(model)
    out["elements"] = [e for e in out["elements"] if not e["name"].startswith("loop_")]
    name = out["inputs"][0]["name"]
    out["inputs"] = [{"name": name, "quantity": "force", "at": "mass", "unit": "N"}]
    return out


def _push(true: dict[str, Any], rig: Rig, ran: Run, drive: Drive) -> Signal:
    """The force of the controller on the mass."""
    gains = {e["name"]: e for e in true["elements"]}
    stiffness, damping = (
        gains["loop_stiffness"]["stiffness"],
        gains["loop_damping"]["damping"],
    )
    (target,) = drive.inputs.values()
    force = stiffness * (target.value - ran.position["mass"]) + damping * (
        target.rate - ran.velocity["mass"]
    )
    rate = stiffness * (target.rate - ran.velocity["mass"]) + damping * (
        target.second - ran.acceleration["mass"]
    )
    return Signal(force, rate, np.gradient(rate, rig.interval))


def _true_values(owner: dict[str, Any], true: dict[str, Any]) -> dict[str, float]:
    """The true values of the uncertain parameters."""
    elements = {e["name"]: e for e in true["elements"]}
    out = {}
    for path in owner["uncertainty"]:
        name, key = path.split(".")
        out[path] = float(
            true["masses"][name] if key == "mass" else elements[name][key]
        )
    return out


def _nominal_error(rig: Rig, seen: list[Columns], stated: dict[str, float]) -> float:
    """Error in the test of the nominal structure with the best parameters for the noise-free training record."""
    fit = Fit(rig, seen[0], stated)
    theta, _ = fit.fitted()
    model = copy.deepcopy(rig.model)
    for path, q in zip(stated, theta, strict=False):
        set_relative(model, path, float(q))
    y = outputs(rig, model, run(rig, model, rig.drives[2]))
    return float(
        np.sqrt(
            np.mean(
                [
                    np.mean((y[k] - seen[2][k]) ** 2) / np.var(seen[2][k])
                    for k in seen[2]
                ]
            )
        )
    )
