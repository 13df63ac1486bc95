"""A rig on its bench: one simulation of it, its channels, and how near its model comes without what is hidden."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

from .effects import Change, Scale
from .plant import CREEP, Array, Element, Model, Run, Signal, integrate


@dataclass(frozen=True)
class Drive:
    """One record's inputs, and where the free nodes begin [m, m/s]."""

    inputs: dict[str, Signal]
    initial: dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Rig:
    """A rig without anything hidden, and one or two records' drives."""

    model: Model
    drives: tuple[Drive, ...]
    size: int
    interval: float
    time: float  # its time scale, a radian of its slowest or only oscillation [s]
    speed: float  # [m/s], a typical one
    known: tuple[str, ...] = ()  # parameters that the owner knows exactly
    pairs: tuple[tuple[str, str], ...] = ()  # where nuisances may sit
    snr_db: tuple[float, float] = (26.0, 60.0)
    input_db: float = 90.0  # how well displacements that go in are measured


# --------------------------------------------------------------------------------------------------- one simulation
def changed(model: Model, change: Change, label: str) -> Model:
    """`model` with a change in it."""
    out = copy.deepcopy(model)
    for i, e in enumerate(change.elements):
        out["elements"].append({"name": f"{label}_{i + 1}", **e})
    for spring, gap in change.play:
        e = next(e for e in out["elements"] if e["name"] == spring)
        e.update(type="x_spring_with_play", gap=gap)
    out["masses"].update(dict(change.masses))
    return out


def _drawn(current: Array, e: Element, interval: float) -> Array:
    """The current that a drive really delivers."""
    if e["type"] == "thrust_saturation":
        return np.asarray(e["current"] * np.tanh(current / e["current"]))
    if e["type"] == "actuator_lag":
        stay = np.exp(-interval / e["time_constant"])
        # the mean over each interval of a first-order lag, as the plant holds what it gets
        state = lfilter([0.0, 1.0 - stay], [1.0, -stay], current)
        blend = (1.0 - stay) * e["time_constant"] / interval
        return np.asarray(current + (state - current) * blend)
    raise ValueError(e["type"])


COARSE = 10.0 * CREEP
"""Creep of dry friction while sizes are sought."""


def run(
    rig: Rig,
    model: Model,
    drive: Drive,
    initial: dict[str, tuple[float, float]] | None = None,
    creep: float = CREEP,
) -> Run:
    """One simulation, its motor's drive included."""
    inputs = dict(drive.inputs)
    for e in model["elements"]:
        if "element" in e:
            name = next(i["name"] for i in model["inputs"] if i.get("element") == e["element"])
            s = inputs[name]
            inputs[name] = Signal(_drawn(s.value, e, rig.interval), s.rate, s.second, s.held)
    start = drive.initial if initial is None else initial
    return integrate(model, inputs, rig.size, rig.interval, speed=rig.speed, initial=start, creep=creep)


def outputs(rig: Rig, model: Model, ran: Run) -> dict[str, Array]:
    """The channels, with what their sensors do to them, without noise."""
    table = {}
    for o in model["outputs"]:
        if o["quantity"] == "force":
            if "at" in o:
                y = ran.load[o["at"]]
            else:  # a force cell reads all that acts between its element's terminals
                here = next(e["between"] for e in model["elements"] if e["name"] == o["element"])
                y = sum(ran.link[e["name"]] for e in model["elements"] if e.get("between") == here)
        else:
            signal = {
                "displacement": ran.position,
                "velocity": ran.velocity,
                "acceleration": ran.acceleration,
            }
            first, second = o.get("between") or (o["at"], "ground")
            y = signal[o["quantity"]][first] - signal[o["quantity"]][second]
        t = np.arange(rig.size) * rig.interval
        for e in model["elements"]:
            if e.get("channel") == o["name"]:
                y = y * e.get("gain", 1.0) + e.get("bias", 0.0)
                y = np.interp(t - e.get("delay", 0.0), t, y)
        table[o["name"]] = np.asarray(y, dtype=float)
    return table


def scale(rig: Rig, ran: Run, place: Any) -> Scale:
    """How far, fast and hard a place is worked without what is hidden."""
    elements = rig.model["elements"]
    if isinstance(place, str):  # a motor or a channel, or a spring
        e = next((e for e in elements if e["name"] == place), None)
        if e is None or e["type"] == "motor":
            current = next((i["name"] for i in rig.model["inputs"] if "element" in i), None)
            size = _rms(rig.drives[0].inputs[current].value) if current and e else 1.0
            return Scale(1.0, 1.0, size, rig.time)
        place = tuple(e["between"])
    d, v, a = (_rms(q[place[0]] - q[place[1]]) for q in (ran.position, ran.velocity, ran.acceleration))
    forces = [
        _rms(ran.link[e["name"]]) for e in elements if e.get("name") in ran.link and place[0] in e["between"]
    ]
    mass = rig.model["masses"].get(place[0], 0.0)
    return Scale(d, v, max([*forces, mass * a]), rig.time)


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


# --------------------------------------------------------------------------------- what the model without it can do
def _offsets(model: Model) -> set[str]:
    return {o["name"] for o in model["outputs"] if o.get("offset") == "free"}


def shares(model: Model, of: Mapping[str, Array], than: Mapping[str, Array]) -> dict[str, float]:
    """RMS of `of` - `than` over the deviation of `than`, channel by channel; a free offset is taken out."""
    free = _offsets(model)
    return {
        k: _rms(of[k] - than[k] - (np.mean(of[k] - than[k]) if k in free else 0.0))
        / max(float(np.std(than[k])), 1e-300)
        for k in than
    }


def refitted(
    rig: Rig, truth: Mapping[str, Array], spread: Mapping[str, float], rounds: int = 4
) -> dict[str, float]:
    """NRMSE per channel of the rig's model without what is hidden, fitted to the noiseless truth by Gauss and Newton.

    Parameters move as far as their stated spreads (three sigma at most), initial states freely where they are not at rest.
    """
    drive, free = rig.drives[0], _offsets(rig.model)
    deviation = {k: max(float(np.std(y)), 1e-300) for k, y in truth.items()}
    paths, start = list(spread), drive.initial
    sigma = np.array([*spread.values(), *[0.3] * (2 * len(start))])
    unit = [(_rms([x, v * rig.time]), 1.0 / rig.time) for x, v in start.values()]

    def residual(theta: Array) -> Array:
        model = copy.deepcopy(rig.model)
        for path, q in zip(paths, theta, strict=False):
            set_relative(model, path, q)
        initial = {}
        for i, (node, (x, v)) in enumerate(start.items()):
            dx, dv = theta[len(paths) + 2 * i : len(paths) + 2 * i + 2]
            initial[node] = (x + dx * unit[i][0], v + dv * unit[i][0] * unit[i][1])
        y = outputs(rig, model, run(rig, model, drive, initial))
        columns = [
            (y[k] - truth[k] - (np.mean(y[k] - truth[k]) if k in free else 0.0)) / deviation[k] for k in truth
        ]
        return np.concatenate(columns)

    theta, weight = np.zeros(len(sigma)), 0.05  # a prior as strong as a residual of 5 %
    r = residual(theta)

    def cost(r: Array, theta: Array) -> float:
        return (
            float(np.mean(r**2) + weight**2 * np.mean((theta / sigma) ** 2))
            if len(theta)
            else float(np.mean(r**2))
        )

    best, damp = cost(r, theta), 1e-3
    for _ in range(rounds if len(theta) else 0):
        J = np.stack([(residual(theta + 1e-4 * e) - r) / 1e-4 for e in np.eye(len(theta))], axis=1)
        H = J.T @ J / len(r) + np.diag(weight**2 / len(theta) / sigma**2)
        g = J.T @ r / len(r) + weight**2 / len(theta) * theta / sigma**2
        for _ in range(4):
            new = np.clip(theta - np.linalg.solve(H + damp * np.diag(np.diag(H)), g), -3 * sigma, 3 * sigma)
            try:
                rn = residual(new)
            except ArithmeticError:
                rn = np.full_like(r, np.inf)
            if cost(rn, new) < best:
                break
            damp *= 10.0
        else:
            break
        gain, theta, r, best, damp = best - cost(rn, new), new, rn, cost(rn, new), damp / 10.0
        if gain < 0.01 * best:
            break
    return dict(zip(truth, (_rms(c) for c in np.split(r, len(truth))), strict=True))


def set_relative(model: Model, path: str, relative: float) -> None:
    name, parameter = path.split(".")
    if parameter == "mass":
        model["masses"][name] *= 1.0 + relative
        return
    e = next(e for e in model["elements"] if e["name"] == name)
    e[parameter] *= 1.0 + relative
