"""A rig on its bench: one simulation, its channels, and the error of its model without the hidden effect."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.signal import lfilter

from .effects import Change, Scale
from .plant import CREEP, Array, Element, Model, Run, Signal, integrate

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .draw import Tempo


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


def rig_of(
    model: Model,
    drives: tuple[Drive, ...],
    tempo: Tempo,
    size: float,
    known: tuple[str, ...] = (),
    pairs: tuple[tuple[str, str], ...] = (),
    snr_db: tuple[float, float] = Rig.snr_db,
) -> Rig:
    """Return a rig that moves by `size` [m] at its tempo."""
    span, speed = 1 / tempo.omega, size * tempo.omega
    return Rig(
        model, drives, tempo.size, tempo.interval, span, speed, known, pairs, snr_db
    )


def at_rest(signals: list[Signal], name: str) -> tuple[Drive, ...]:
    return tuple(Drive({name: s}, {}) for s in signals)


# --------------------------------------------------------------------------------------------------- one simulation
def changed(model: Model, change: Change, label: str) -> Model:
    """`model` with a change in it."""
    out = copy.deepcopy(model)
    for i, e in enumerate(change.elements):
        out["elements"].append({"name": f"{label}_{i + 1}", **e})
    for spring, gap in change.play:
        e = next(e for e in out["elements"] if e["name"] == spring)
        e.update(type="x_spring_with_play", gap=gap)
    for damper, mount in change.bushings:
        e = next(e for e in out["elements"] if e["name"] == damper)
        e.update(
            type="x_damper_on_bushing",
            stiffness=mount["stiffness"],
            gap=mount.get("gap", 0.0),
        )
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
            name = next(
                i["name"] for i in model["inputs"] if i.get("element") == e["element"]
            )
            s = inputs[name]
            inputs[name] = Signal(
                _drawn(s.value, e, rig.interval), s.rate, s.second, s.held
            )
    start = drive.initial if initial is None else initial
    return integrate(
        model,
        inputs,
        rig.size,
        rig.interval,
        speed=rig.speed,
        initial=start,
        creep=creep,
    )


def outputs(rig: Rig, model: Model, ran: Run) -> dict[str, Array]:
    """The channels, with what their sensors do to them, without noise."""
    table = {}
    for o in model["outputs"]:
        if o["quantity"] == "force":
            if "at" in o:
                y = ran.load[o["at"]]
            else:  # a force cell reads the sum of the elements between its two nodes
                here = next(
                    e["between"] for e in model["elements"] if e["name"] == o["element"]
                )
                y = sum(
                    ran.link[e["name"]]
                    for e in model["elements"]
                    if e.get("between") == here
                )
        else:
            signal = {
                "displacement": ran.position,
                "velocity": ran.velocity,
                "acceleration": ran.acceleration,
                "angular_acceleration": ran.acceleration,
            }
            node = (
                o["at"]
                if "at" in o
                else f"{o['body']}.{o['axis']}"
                if "body" in o
                else None
            )
            first, second = o.get("between") or (node, "ground")
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
            current = next(
                (i["name"] for i in rig.model["inputs"] if "element" in i), None
            )
            size = _rms(rig.drives[0].inputs[current].value) if current and e else 1.0
            return Scale(1.0, 1.0, size, rig.time)
        place = tuple(e["between"])
    d, v, a = (
        _rms(q[place[0]] - q[place[1]])
        for q in (ran.position, ran.velocity, ran.acceleration)
    )
    forces = [
        _rms(ran.link[e["name"]])
        for e in elements
        if e.get("name") in ran.link and place[0] in e["between"]
    ]
    mass = rig.model["masses"].get(place[0], 0.0)
    return Scale(d, v, max([*forces, mass * a]), rig.time)


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


# --------------------------------------------------------------------------------- what the model without it can do
def _offsets(model: Model) -> set[str]:
    return {o["name"] for o in model["outputs"] if o.get("offset") == "free"}


def shares(
    model: Model, of: Mapping[str, Array], than: Mapping[str, Array]
) -> dict[str, float]:
    """RMS of `of` - `than` over the deviation of `than`, channel by channel; a free offset is taken out."""
    free = _offsets(model)
    return {
        k: _rms(of[k] - than[k] - (np.mean(of[k] - than[k]) if k in free else 0.0))
        / max(float(np.std(than[k])), 1e-300)
        for k in than
    }


@dataclass(frozen=True)
class Fit:
    """The rig's model without what is hidden against the noiseless truth: parameters, each by a factor `exp(theta)`.

    `spread` is how far they may move (relative, one sigma; three at most), against a prior worth a residual of `prior`.
    Where a record begins in motion, its initial states move as well.
    """

    rig: Rig
    truth: Mapping[str, Array]
    spread: Mapping[str, float]
    prior: float = 0.05

    @property
    def sigma(self) -> Array:
        return np.array(
            [*self.spread.values(), *[0.3] * (2 * len(self.rig.drives[0].initial))]
        )

    def residual(self, theta: Array) -> Array:
        """Simulated less true, all channels one after the other, as shares of their deviations; inf where it breaks down."""
        rig, model, free = (
            self.rig,
            copy.deepcopy(self.rig.model),
            _offsets(self.rig.model),
        )
        for path, q in zip(self.spread, theta, strict=False):
            set_relative(model, path, q)
        initial, moves = {}, iter(theta[len(self.spread) :])
        for node, (x, v) in rig.drives[0].initial.items():
            size = float(np.hypot(x, v * rig.time))
            initial[node] = (x + next(moves) * size, v + next(moves) * size / rig.time)
        try:
            y = outputs(rig, model, run(rig, model, rig.drives[0], initial, COARSE))
        except ArithmeticError:
            return np.full(len(self.truth) * rig.size, np.inf)
        errors = {k: y[k] - self.truth[k] for k in self.truth}
        shift = {k: float(np.mean(e)) if k in free else 0.0 for k, e in errors.items()}
        deviation = {k: max(float(np.std(q)), 1e-300) for k, q in self.truth.items()}
        return np.concatenate(
            [(e - shift[k]) / deviation[k] for k, e in errors.items()]
        )

    def cost(self, r: Array, theta: Array) -> float:
        return float(np.mean(r**2) + self.prior**2 * np.mean((theta / self.sigma) ** 2))

    def left(self, rounds: int = 5) -> dict[str, float]:
        """NRMSE per channel that is left, by Levenberg's steps."""
        _, r = self.fitted(rounds)
        return dict(
            zip(
                self.truth, (_rms(c) for c in np.split(r, len(self.truth))), strict=True
            )
        )

    def fitted(self, rounds: int = 5) -> tuple[Array, Array]:
        """Logarithms of the factors of the parameters after Levenberg's steps, and the residual there."""
        theta, damp = np.zeros(len(self.sigma)), 1e-3
        r = self.residual(theta)
        for _ in range(rounds if len(theta) else 0):
            new, rn, damp = self.step(r, theta, damp)
            gain = self.cost(r, theta) - self.cost(rn, new)
            if not gain > 0.0:
                break
            r, theta = rn, new
            if gain < 0.01 * self.cost(r, theta):
                break
        return theta, r

    def step(self, r: Array, theta: Array, damp: float) -> tuple[Array, Array, float]:
        """A step that does better, or the last that was tried."""
        J = np.stack(
            [(self.residual(theta + 1e-4 * e) - r) / 1e-4 for e in np.eye(len(theta))],
            axis=1,
        )
        pull = self.prior**2 / len(theta) / self.sigma**2
        H, g = J.T @ J / len(r) + np.diag(pull), J.T @ r / len(r) + pull * theta
        for _ in range(5):
            move = np.linalg.solve(H + damp * np.diag(np.diag(H)), g)
            new = np.clip(theta - move, -3 * self.sigma, 3 * self.sigma)
            rn = self.residual(new)
            if self.cost(rn, new) < self.cost(r, theta):
                return new, rn, damp / 10.0
            damp *= 10.0
        return new, rn, damp


def set_relative(model: Model, path: str, relative: float) -> None:
    """Multiply a parameter by the exponential of `relative`."""
    name, *where, parameter = path.split(".")
    owner: Any = model["masses"]
    if name in model.get("bodies", {}):
        owner = model["bodies"][name]
        for key in where:
            owner = owner[key]
    elif parameter == "mass":
        parameter = name
    else:
        owner = next(e for e in model["elements"] if e["name"] == name)
    owner[parameter] *= float(np.exp(relative))
