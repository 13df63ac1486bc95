"""A road that nobody measured, in the likelihood of a linear model: white in velocity, its level unknown.

Seen from the road's own frame the network is driven by a velocity (`isd_gym.network.assembly.frames`); with that white, and white noise at the
sensors, the outputs have a likelihood by the innovations of the stationary Kalman filter (Harvey, 1989, chapter 3; Ljung, System
Identification, section 4.3). The Fisher information says which parameters the records determine. Sensors of motion alone determine ratios
to mass; a known force, such as a motor's current, sets the scale.

Dry friction counts as a damper of unknown strength, other laws by their slope at rest. A law that is missing and not linear shows as
parameters that leave their plausible range, or as prediction errors that are not white: then there is no name. Such laws are for the
cut (`isd_gym.network.cut`).
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import elements as el
from ..data import Table
from ..errors import InputError, shown
from ..files import claim_folder, write_text
from ..loggers.recording import Recording
from ..network import Network
from ..network.cut import cut_nodes
from ..network.frames import order_told
from .criteria import CRITERIA, Gate
from .hypotheses import hypotheses
from .likelihood import IMPOSSIBLE, Likelihood, Number
from .noise import floors_of, lagged, predicted
from .problem import Array, Problem
from .records import read_record
from .result import Quantity, _plain
from .structure import REACH as FAR
from .structure import Hypothesis, Structure, add, base_structure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .criteria import Verdict
    from .likelihood import Prediction

SCHEMA = "isd-unmeasured/1"
#: kind, mark and parts of its folder
FOLDER = ("result without a road", "unmeasured.json", ("unmeasured.json", "model.json"))
#: effects that are linear, and may be told without the road
LINEAR = ("linear_stiffness", "linear_damping", "inertance")
#: Time limit of the search [s].
MAX_SECONDS = 120.0
WIDE = 3.0  # one sigma of the logarithm of what nothing is known of
DETERMINED = 0.5  # share of the stated uncertainty that is left of a determined parameter
SCALE = 0.1  # one sigma of the logarithm of the common scale of all masses and forces beyond which only ratios are told
STEP = 1e-4  # of a logarithm, in differences
REACH = 1.0  # of a logarithm, that one iteration may go
TURNS = 60  # iterations of a fit
SETTLED = 0.1  # 2 log L below which a fit has converged
LEAD = 6.0  # 2 log L by which an effect must lead the next
NOISE = 0.3  # share of an output's standard deviation that a fit may call noise
LAGS = 20  # samples of the past from which a prediction error is predicted
COLOURED = 0.1  # share of the power of a prediction error that its past may predict
TINY = 0.01  # share of the model's largest value in the same unit below which no effect is plausible

MASSIVE = ("kg", "N/m", "N s/m", "N/A", "N", "kg m^2", "N m/rad", "N m s/rad", "N m")


@dataclass(frozen=True)
class Unmeasured:
    """What records without a `road` determine, and the verdict on the model.

    A verdict `unknown_effect` is an abstention: no figure of the refitted model is to be relied on then.
    """

    road: str
    verdict: Verdict
    #: What had to hold for the verdict.
    gates: tuple[Gate, ...]
    #: Why there is no name, and what would help; empty where the verdict needs no such sentence.
    reason: str
    #: Two-sided intensity of the road's velocity [m^2/s] ([rad^2/s] where the road turns).
    level: Quantity
    #: Refitted parameters of the owner's model by path, with their 95 % intervals.
    parameters: dict[str, Quantity]
    #: Parameters whose stated uncertainty the records at least halve; none where the verdict is `unknown_effect`.
    determined: tuple[str, ...]
    #: One sigma of the logarithm of a factor common to all masses and forces.
    scale: float
    #: Whether only ratios to mass are determined.
    ratios_only: bool
    #: RMS noise of each output in SI.
    noise: dict[str, float]
    #: The owner's model with the refitted parameters and the named effect; unchanged where the verdict is no agreement and no name.
    model: Network
    #: Linear effects that were tried (effect, place, gain in 2 log L), the best first.
    effects: tuple[tuple[str, tuple[str, ...], float], ...] = ()
    #: The named effect, its place and its parameters.
    found: tuple[str, tuple[str, ...], dict[str, Quantity]] | None = None
    notes: tuple[str, ...] = ()
    #: Processor time of the search [s].
    seconds: float = 0.0

    @property
    def summary(self) -> str:
        """The result in a few sentences."""
        if self.verdict == "unknown_effect":
            return self.reason
        text = f"Determined without the road: {', '.join(self.determined) or 'none'}."
        if self.ratios_only:
            text += " Only ratios to mass: no known force acts, and all masses, springs and dampers could be larger by one factor."
        if self.found is not None:
            name, where, values = self.found
            size = ", ".join(f"{k} {q.value:.4g} {q.unit}" for k, q in values.items())
            text += f" The model lacks {name.replace('_', ' ')} between {' and '.join(where)} ({size})."
        elif self.reason:
            text += f" {self.reason}"
        elif not all(g.passed for g in self.gates if g.name == "complete"):
            text += f" None of the {len(self.effects)} linear effects that were tried is missing, as far as these records tell."
        elif self.effects:
            text += " No linear effect is missing that these records could tell."
        return text

    def lines(self) -> list[str]:
        """For the terminal: the summary, the gates that failed, the notes, and every number."""
        rows = [(f"level of {self.road} in velocity", self.level, True)]
        rows += [(path, q, path in self.determined) for path, q in self.parameters.items()]
        wide = max(len(name) for name, *_ in rows)
        out = [self.summary]
        if self.reason:
            out += [
                f"failed gate '{g.name}': {g.value:.3g}, limit {g.limit:.3g} ({g.text})"
                for g in self.gates
                if not g.passed and g.name != "significant"
            ]
        out += [f"note: {note}" for note in self.notes]
        for name, q, known in rows:
            prior = "" if q.prior is None else f", model {q.prior:.4g}"
            told = "" if known else "; not determined"
            out.append(f"{name:{wide}}  {q.value:.4g} ({q.low:.4g} to {q.high:.4g}) {q.unit}{prior}{told}")
        return out

    def to_dict(self) -> dict[str, Any]:
        """As JSON (`isd-unmeasured/1`); a number that is not finite becomes null."""
        return _plain(
            {
                "schema": SCHEMA,
                "verdict": self.verdict,
                "summary": self.summary,
                "gates": [
                    {"gate": g.name, "passed": g.passed, "value": g.value, "limit": g.limit, "text": g.text}
                    for g in self.gates
                ],
                "road": self.road,
                "level": self.level.to_dict(),
                "parameters": {k: q.to_dict() for k, q in self.parameters.items()},
                "determined": list(self.determined),
                "scale": self.scale,
                "ratios_only": self.ratios_only,
                "noise": self.noise,
                "effects": [{"effect": e, "between": list(w), "gain": g} for e, w, g in self.effects],
                "found": None
                if self.found is None
                else {
                    "effect": self.found[0],
                    "between": list(self.found[1]),
                    "parameters": {k: q.to_dict() for k, q in self.found[2].items()},
                },
                "seconds": self.seconds,
                "notes": list(self.notes),
            }
        )

    def save(self, folder: str | Path) -> None:
        """Write unmeasured.json and model.json into `folder`, new, empty or an earlier result; `InputError` for any other."""
        folder = claim_folder(folder, *FOLDER)
        write_text(folder / "unmeasured.json", json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n")
        self.model.save(folder / "model.json")


@dataclass(frozen=True)
class Clock:
    """A limit [s] of processor time, from `begun` on: a busy machine does not change the result."""

    limit: float
    begun: float

    @classmethod
    def start(cls, limit: float) -> Clock:
        return cls(limit, time.process_time())

    @property
    def seconds(self) -> float:
        return time.process_time() - self.begun

    @property
    def over(self) -> bool:
        return self.seconds > self.limit


@dataclass(frozen=True)
class Fitted:
    """A model that was fitted."""

    likelihood: Likelihood
    numbers: Array  # (n,)
    deviance: float  # -2 log L with the prior
    converged: bool = True  # False where the time limit ended the fit


@dataclass(frozen=True)
class Estimates:
    """The numbers of a fit with their uncertainty."""

    level: Quantity
    parameters: dict[str, Quantity]
    effect: dict[str, Quantity]  # parameters of the effect that was added
    #: Departure of each uncertain parameter from the owner's value, in standard deviations of the stated uncertainty.
    departures: dict[str, float]
    determined: tuple[str, ...]
    scale: float
    ratios_only: bool
    noise: dict[str, float]


def identify(
    data: Sequence[Table | Recording | str | Path],
    model: Network | str | Path | Mapping[str, Any],
    *,
    road: str | None = None,
    effects: bool = True,
    accept: Sequence[str] = (),
    max_seconds: float = MAX_SECONDS,
) -> Unmeasured:
    """Refit a model to records that lack its road, say what they determine, and name a linear effect that is missing.

    Args:
        data: Tables or files with the model's other inputs and its outputs.
        model: The owner's model.
        road: The input that was not measured; by default the input that the model marks so, or its only moved node.
        effects: Whether missing linear effects are looked for.
        accept: Checks of the data gate that only warn.
        max_seconds: Limit of processor time [s]. On reaching it the search stops, and a note says so.

    Raises:
        InputError: With one line, where the data or the model do not allow the search.
    """
    if not max_seconds > 0:
        raise InputError(f"the time limit must be > 0 s, not {max_seconds:g} s")
    owner = Network.load(model)
    network, name = _riding(owner, road)
    notes: list[str] = []
    tables = [data] if isinstance(data, Table | Recording | str | Path) else list(data)
    records = [read_record(t, _frameless(network, name), notes, accept) for t in tables]
    if not records:
        raise InputError("data: no records")
    for r in records:
        if r.reading is not None:
            raise InputError(
                f"{r.name}: its channels have rates or clocks of their own, and a road in the likelihood wants one raster; "
                "--cut takes them as they are"
            )
    step = records[0].step
    if any(abs(r.step - step) > 1e-3 * step for r in records):
        raise InputError("the records are sampled at different rates: resample them to one")
    problem = Problem(_frameless(network, name), records, ["fit"] * len(records))
    floors = np.array([f.deviation for f in floors_of(problem)]) / problem.factors
    spread = problem.measured().std(axis=0) / problem.factors
    others = [c.name for c in network.inputs if c.name != name]
    rows = []
    for r in records:
        u = np.stack([r.inputs[c] for c in others], axis=1) if others else np.zeros((len(r.measured), 0))
        y = (r.measured - r.measured.mean(axis=0)) / problem.factors
        # about its mean everything is as about rest: offsets of sensors, and what a mean current holds, are nobody's
        rows.append((np.ascontiguousarray(u - u.mean(axis=0)), np.ascontiguousarray(y)))
    clock = Clock.start(max_seconds)
    structure = base_structure(network)
    start = _start(network, structure, name, tuple(rows), step, np.clip(floors, 1e-4 * spread, 0.3 * spread))
    x = np.array([n.mean for n in start.numbers])
    owner_fit = _climb(start, x, clock, moves=np.arange(len(x)) >= len(structure.free))  # road and noise
    base = _climb(start, owner_fit.numbers, clock)
    # in the frame of the road nothing is tied to a ground whose distance nobody knows
    tied = [
        h
        for h in hypotheses(network)
        if h.effect in LINEAR and not order_told(network, (h.where[0], h.where[-1]))
    ]
    candidates = tied if effects else []
    tried, done = _search(base, candidates, clock)
    if clock.over:
        notes.append(
            f"the time limit of {max_seconds:g} s stopped the search: {done} of {len(candidates)} linear effects were tried"
            + ("" if base.converged else ", and the refit had not converged")
        )
    return _decided(owner, network, owner_fit, base, tried, (done, len(candidates)), clock, notes)


def _search(
    base: Fitted, candidates: Sequence[Hypothesis], clock: Clock
) -> tuple[list[tuple[Hypothesis, Fitted]], int]:
    """Fit the model with each of the candidates.

    Returns:
        The candidates that were fitted to the end, the best first, and how many candidates were tried.
    """
    fits, done = [], 0
    for h in candidates:
        found = None if clock.over else _with(base, h, clock)
        if clock.over:
            break
        done += 1
        if found is not None:
            fits.append((h, found))
    return sorted(fits, key=lambda t: t[1].deviance), done


def _riding(network: Network, road: str | None) -> tuple[Network, str]:
    """The network seen from the frame of its unmeasured road, and the road's name."""
    unmeasured = [c for c in network.moving if not c.measured]
    moving = [c for c in network.moving if c.name == road] if road else unmeasured or list(network.moving)
    if len(moving) != 1 or moving[0].quantity != "displacement":
        known = ", ".join(c.name for c in network.moving) or "none"
        raise InputError(
            f"the road that was not measured must be one moved node's displacement (there are: {known}), not {shown(road)}"
        )
    c = moving[0]
    speed = network.probe(c.name, "velocity", at=c.at)
    inputs = tuple(speed if o is c else o for o in network.inputs)
    cells = [o for o in network.outputs if o.quantity == "force" and o.at == c.at]
    if cells:
        raise InputError(f"output '{cells[0].name}' is measured at '{c.at}': who has that has the road")
    return replace(
        network, inputs=inputs, elements=tuple(e for e in network.elements if e.place == "between")
    ), c.name


def _frameless(network: Network, road: str) -> Network:
    """The same channels but for the road, which leaves its node in the air: to read records by, and for nothing else."""
    out = object.__new__(Network)
    out.__dict__.update({f.name: getattr(network, f.name) for f in fields(Network)})
    out.__dict__["inputs"] = tuple(c for c in network.inputs if c.name != road)
    return out


def _start(
    network: Network,
    base: Structure,
    road: str,
    rows: tuple[tuple[Array, Array], ...],
    step: float,
    noise: Array,
) -> Likelihood:
    rubs = tuple(e.name for e in network.elements for e in e.parts() if e.bound is not None)
    k = max((e.linear()[0] for e in network.elements), default=0.0)
    critical = 2.0 * math.sqrt(max(k, 1e-12) * max([*network.masses.values(), 1e-12]))
    own = [Number(f.path, f.mean, f.sigma) for f in base.free]
    own.append(Number(LEVEL, 0.0, 1e3))
    own += [Number(f"{name} as a damper", math.log(critical), WIDE) for name in rubs]
    own += [Number(c.name, math.log(s), WIDE) for c, s in zip(network.outputs, noise, strict=True)]
    others = tuple(c.name for c in network.inputs if c.name != road)
    L = Likelihood(base, road, rows, step, rubs, others, tuple(own))
    # the level that makes the outputs as large as they are, to begin with
    x = np.array([n.mean for n in own])
    at = len(base.free)
    levels = np.linspace(-30.0, 5.0, 36)
    costs = []
    for value in levels:
        x[at] = value
        costs.append(L(x))
    if min(costs) >= IMPOSSIBLE:
        raise InputError(
            "the model without its road has no stationary motion: what holds its masses, and damps them?"
        )
    own[at] = Number(LEVEL, float(levels[int(np.argmin(costs))]), 1e3)
    return replace(L, numbers=tuple(own))


LEVEL = "level"


def _scales(L: Likelihood) -> Array:
    """Return the unit of each number in steps: 1 of a logarithm, one standard deviation of any other."""
    own = [1.0 if f.log else f.sigma for f in L.structure.free]
    return np.array(own + [1.0] * (len(L.numbers) - len(own)))


def _information(L: Likelihood, x: Array, here: Prediction, pick: Sequence[int]) -> tuple[Array, Array]:
    """Compute the slope of -2 log L of the records, and the Fisher information.

    Args:
        L: The likelihood.
        x: Numbers (n,).
        here: Its prediction at `x`.
        pick: Indices (m,) of the numbers that may move.

    Returns:
        Slope (m,) of -2 log L and the Fisher information (m, m), both without the prior.

    References:
        Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, section 3.4.5.
    """
    W, scales = here.whitening, _scales(L)
    white = np.concatenate([e @ W.T for e in here.errors])
    moves, spreads = [], []
    for k in pick:
        for step in (STEP * scales[k], -STEP * scales[k]):
            there = L.predict(x + step * (np.arange(len(x)) == k))
            if there is not None:
                moves.append((np.concatenate([e @ W.T for e in there.errors]) - white).ravel() / step)
                spreads.append((W @ (there.covariance - here.covariance) @ W.T) / step)
                break
        else:
            moves.append(np.zeros(white.size))
            spreads.append(np.zeros_like(W))
    J, V = np.stack(moves), np.stack([s.ravel() for s in spreads])
    power = (white.T @ white).ravel()
    slope = 2.0 * J @ white.ravel() - V @ power + here.samples * V @ np.eye(len(W)).ravel()
    return slope, J @ J.T + 0.5 * here.samples * V @ V.T


def _climb(L: Likelihood, x: Array, clock: Clock, moves: Any = None) -> Fitted:
    """Maximise the likelihood by Fisher scoring, damped after Levenberg and Marquardt.

    Args:
        L: The likelihood with its prior.
        x: Numbers to begin with (n,).
        clock: Ends the iterations when its time is up.
        moves: Which numbers may move (n,), bool; all by default.
    """
    pick: list[int] = np.flatnonzero(np.ones(len(x)) if moves is None else moves).tolist()
    known = np.array([n.sigma for n in L.numbers])[pick] ** -2.0
    centre = np.array([n.mean for n in L.numbers])[pick]
    reach, damping = REACH * _scales(L)[pick], 1e-3
    x, here = np.array(x, dtype=np.float64), L.predict(x)
    if here is None:
        return Fitted(L, x, IMPOSSIBLE, True)
    cost = L.prior(x) + here.deviance
    for _ in range(TURNS):
        if clock.over:
            return Fitted(L, x, cost, False)
        slope, information = _information(L, x, here, pick)
        slope = slope + 2.0 * known * (x[pick] - centre)
        bend = 2.0 * (information + np.diag(known))
        before = cost
        while damping < 1e9:
            step = -np.linalg.solve(bend + damping * np.diag(np.diag(bend)), slope)
            tried = x.copy()
            tried[pick] += np.clip(step, -reach, reach)
            there = L.predict(tried)
            if there is not None and L.prior(tried) + there.deviance < cost:
                x, here, cost = tried, there, L.prior(tried) + there.deviance
                damping = max(damping / 10.0, 1e-6)
                break
            damping *= 10.0
        if before - cost < SETTLED:
            break
    return Fitted(L, x, cost, True)


def _with(base: Fitted, h: Hypothesis, clock: Clock) -> Fitted | None:
    """Fit the model with one more effect, from a small and from a large start; None where the effect cannot stand there."""
    start, x = base.likelihood, base.numbers
    network = start.network(x)
    kinds = {"linear_stiffness": 0, "linear_damping": 1, "inertance": 2}
    size = max((e.linear()[kinds[h.effect]] for e in network.elements), default=0.0)
    size = size or (max(network.masses.values()) if h.effect == "inertance" else 0.0)
    if not size:
        return None
    (name,) = [f.name for f in el.parameter_fields(h.kind)]
    own, best = len(start.structure.free), None
    for share in (0.03, 0.3):
        try:
            built = add(start.structure, h, {name: share * size})
        except InputError:
            return None
        numbers = (
            *start.numbers[:own],
            Number(built.free[-1].path, math.log(share * size), WIDE),
            *start.numbers[own:],
        )
        L = replace(start, structure=built, numbers=numbers)
        fit = _climb(L, np.concatenate([x[:own], [math.log(share * size)], x[own:]]), clock)
        if fit.deviance < IMPOSSIBLE and (best is None or fit.deviance < best.deviance):
            best = fit
    return best


def _scale(L: Likelihood, x: Array, common: Array, data: Array) -> float:
    """One sigma, by the records alone, of the logarithm of a common factor, every other number free to follow."""
    prior = np.array([(c / q.sigma) ** 2 for c, q in zip(common, L.numbers, strict=True)]).sum()
    size = 0.02
    direct = (L(x + size * common) - 2 * L(x) + L(x - size * common)) / (2 * size**2) - prior
    still = common == 0
    profiled = float(common @ data @ common)
    if still.any():
        pull = data[still] @ common
        profiled -= float(pull @ np.linalg.pinv(data[np.ix_(still, still)], hermitian=True) @ pull)
    known = min(direct, profiled) if profiled > 0 else direct
    return 1.0 / math.sqrt(known) if known > 0 else math.inf


def _exp(x: float) -> float:
    """exp(x), and infinity where that is no floating-point number."""
    return math.exp(x) if x < 709.0 else math.inf


def _estimates(network: Network, fit: Fitted) -> Estimates:
    """Compute values, intervals and what is determined, from the Fisher information at the fit."""
    L, x = fit.likelihood, fit.numbers
    n, free = len(x), L.structure.free
    sigma = np.array([q.sigma for q in L.numbers])
    here = L.predict(x)
    assert here is not None
    _, data = _information(L, x, here, range(n))
    unit = 1.0 / np.sqrt(
        np.diag(data) + sigma**-2.0
    )  # so that the matrix to be inverted has a diagonal of ones
    covariance = np.linalg.pinv((data + np.diag(sigma**-2.0)) * np.outer(unit, unit), hermitian=True)
    deviation = unit * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    fitted = L.network(x)
    # a factor common to all masses and forces, every other number free to follow
    units = [network.unit_of(f.path) if f.owner < 0 else fitted.unit_of(f.path) for f in free]
    common = np.array(
        [1.0 if f.log and u in MASSIVE else 0.0 for f, u in zip(free, units, strict=True)]
        + [0.0] * (n - len(free))
    )
    common[len(free) + 1 : len(free) + 1 + len(L.rubs)] = 1.0
    scale = _scale(L, x, common, data)

    def quantity(v: float, s: float, unit: str, log: bool = True, prior: float | None = None) -> Quantity:
        back = _exp if log else float
        return Quantity(back(v), back(v - 1.96 * s), back(v + 1.96 * s), unit, prior)

    quantities = {
        f.path: quantity(v, s, u, f.log, network.parameters.get(f.path))
        for f, v, s, u in zip(free, x, deviation, units, strict=False)
    }
    at = len(free)
    return Estimates(
        level=quantity(x[at], deviation[at], "m^2/s"),
        parameters={k: q for k, q in quantities.items() if k in network.parameters},
        effect={k.rpartition(".")[2]: q for k, q in quantities.items() if k not in network.parameters},
        departures={
            f.path: float((v - f.mean) / f.sigma) for f, v in zip(free, x, strict=False) if f.owner < 0
        },
        determined=tuple(
            f.path for f, s in zip(free, deviation, strict=False) if f.owner < 0 and s < DETERMINED * f.sigma
        ),
        scale=scale,
        ratios_only=bool(common.any()) and scale > SCALE,
        noise={c.name: _exp(v) for c, v in zip(network.outputs, x[at + 1 + len(L.rubs) :], strict=True)},
    )


def coloured_share(errors: Sequence[Array], deviation: Array) -> Array:
    """Compute how much of each prediction error its own past predicts; nothing where the model holds.

    Args:
        errors: Prediction errors of each record, (samples, outputs).
        deviation: Standard deviation of each output (outputs,).

    Returns:
        Shares of the power (outputs,), beyond chance; 0 where the predictable part is below the material share of the output.
    """
    out = np.zeros(len(deviation))
    for j in range(len(deviation)):
        series = [np.ascontiguousarray(e[:, j]) for e in errors if len(e) > 2 * LAGS]
        count = sum(map(len, series))
        if not count:
            continue
        power = sum(float(e @ e) for e in series) / count
        _, left = predicted(*lagged(series, LAGS), 0.0)
        share = 1.0 - left**2 / max(power, 1e-300) - 2.0 * LAGS / count
        if share > 0 and math.sqrt(share * power) > CRITERIA.material * deviation[j]:
            out[j] = share
    return out


def plausible_range(network: Network, effect: str, name: str) -> tuple[float, float]:
    """Return the range that a parameter of a new effect may have: of its class, wider where the model has other sizes."""
    meta = next(f.metadata for f in el.parameter_fields(el.TYPES[effect]) if f.name == name)
    low, high = meta["range"]
    own = [v for path, v in network.parameters.items() if network.unit_of(path) == meta["unit"] and v > 0]
    top = max(own, default=high)
    return min(low, TINY * top), max(high, top)


@dataclass(frozen=True)
class Check:
    """A gate, and how the summary says that it failed."""

    gate: Gate
    failure: str


def soundness(
    network: Network, estimates: Estimates, here: Prediction, deviation: Array, effect: str = ""
) -> list[Check]:
    """Return the gates that any result has to pass, be it a name or an agreement.

    Args:
        network: The owner's model.
        estimates: Of the fit.
        here: Prediction of the fit.
        deviation: Standard deviation of each output in SI (outputs,).
        effect: Type of the effect that was added, if any.
    """
    checks = []

    def check(name: str, passed: bool, value: float, limit: float, text: str, failure: str) -> None:
        checks.append(Check(Gate(name, bool(passed), float(value), limit, text), failure))

    finite = {"the road's level": estimates.level, **estimates.parameters, **estimates.effect}
    broken = [k for k, q in finite.items() if not all(map(math.isfinite, (q.value, q.low, q.high)))]
    check(
        "finite",
        not broken,
        len(broken),
        0,
        "numbers without a finite interval",
        f"the records do not determine {' and '.join(broken)} at all",
    )
    for path in sorted(estimates.departures, key=lambda k: -abs(estimates.departures[k]))[:1]:
        off, q = abs(estimates.departures[path]), estimates.parameters[path]
        check(
            "plausible",
            off <= FAR,
            off,
            FAR,
            f"standard deviations of its stated uncertainty by which {path} leaves the model's value, the most of all parameters",
            f"{path} would have to be {q.value:.4g} {q.unit}, {off:.1f} standard deviations from the model's {q.prior:.4g} {q.unit}",
        )
    for name, q in estimates.effect.items():
        low, high = plausible_range(network, effect, name)
        check(
            "range",
            low <= q.value <= high,
            q.value,
            low if q.value < low else high,
            f"{name} of the added {effect} in {q.unit}, plausible from {low:.3g} to {high:.3g}",
            f"the effect that fits best would have the {name} {q.value:.3g} {q.unit}, plausible are {low:.3g} to {high:.3g}",
        )
    outputs = [c.name for c in network.outputs]
    shares = np.array([estimates.noise[c] for c in outputs]) / deviation
    worst = int(np.argmax(shares))
    check(
        "noise",
        shares[worst] <= NOISE,
        shares[worst],
        NOISE,
        f"share of the standard deviation of {outputs[worst]} that the fit calls noise, the largest of all outputs",
        f"the fit calls {shares[worst]:.0%} of {outputs[worst]} noise",
    )
    shares = coloured_share(here.errors, deviation)
    worst = int(np.argmax(shares))
    check(
        "white",
        shares[worst] <= COLOURED,
        shares[worst],
        COLOURED,
        "share of the power of a prediction error that its past predicts, where the predictable part is at least "
        f"{CRITERIA.material:.0%} of the output" + (f": {outputs[worst]}" if shares[worst] > 0 else ""),
        f"the past predicts {shares[worst]:.0%} of the prediction error of {outputs[worst]}",
    )
    return checks


def _reason(owner: Network, failed: Mapping[str, str]) -> str:
    """Say why there is no verdict on the model and what would help, from the gates that failed and their sentences."""
    late = [failed[k] for k in ("converged", "complete") if k in failed]
    wrong = [text for k, text in failed.items() if k not in ("converged", "complete")]
    text = ""
    if wrong:
        text += f"No linear model explains the records: {'; '.join(wrong)}. "
        text += "A force that is not linear, such as dry friction or an end stop, acts like this. "
        node = next(iter(cut_nodes(owner)), None)
        text += (
            f"isd-gym diagnose --cut {node} finds such forces without the road."
            if node
            else "With an accelerometer at the wheel, isd-gym diagnose --cut finds such forces without the road."
        )
        if "plausible" in failed:
            text += " If the parameter may be that far off, state a larger uncertainty (--uncertain)."
    if late:
        text = f"{text} Too little time: {'; '.join(late)}. A longer --max-seconds or shorter records help.".strip()
    return text


def _decided(
    owner: Network,
    network: Network,
    owner_fit: Fitted,
    base: Fitted,
    tried: list[tuple[Hypothesis, Fitted]],
    progress: tuple[int, int],
    clock: Clock,
    notes: Sequence[str],
) -> Unmeasured:
    """Weigh the fits against the gates, and say what the records determine.

    Args:
        owner: The owner's model.
        network: The same seen from the road.
        owner_fit: Of the owner's model, with the road's level and the noise alone free.
        base: Of the owner's model.
        tried: Effects that were fitted, the best first.
        progress: How many effects were tried, and how many there are.
        clock: Of the search.
        notes: What was noted so far.
    """
    significant = CRITERIA.significant
    gains = [base.deviance - fit.deviance for _, fit in tried]
    h, fit = tried[0] if tried and gains[0] > significant else (None, base)
    estimates = _estimates(network, fit)
    L = fit.likelihood
    here = L.predict(fit.numbers)
    assert here is not None
    deviation = np.concatenate([y for _, y in L.records]).std(axis=0)
    done, every = progress
    checks = [
        Check(
            Gate(
                "converged",
                base.converged,
                float(base.converged),
                1,
                "1 where the refit ended within the time limit",
            ),
            "the refit did not converge",
        ),
        *soundness(network, estimates, here, deviation, h.effect if h else ""),
    ]
    must = {c.gate.name for c in checks}
    complete = Gate(
        "complete", done == every, done, every, "linear effects that were tried within the time limit"
    )
    checks.append(
        Check(
            complete,
            f"{done} of {every} linear effects were tried, and the best of these may not be the best of all",
        )
    )
    if h is not None:
        must.add("complete")
    gates = [c.gate for c in checks]
    if tried:
        text = "twice the log likelihood that the best effect gains"
        gates.append(Gate("significant", h is not None, gains[0], significant, text))
    if h is not None:
        lead = gains[0] - gains[1] if len(gains) > 1 else math.inf
        text = "twice the log likelihood by which the best effect leads the next, at most 1000"
        gates.append(Gate("ahead", lead > LEAD, min(lead, 1e3), LEAD, text))
    failed = {g.name for g in gates if not g.passed}
    gain = owner_fit.deviance - base.deviance
    verdict: Verdict
    reason = ""
    if failed & must:
        verdict = "unknown_effect"
        reason = _reason(owner, {c.gate.name: c.failure for c in checks if c.gate.name in failed & must})
    elif h is None:
        verdict = "no_discrepancy" if gain <= significant else "parameters_only"
    elif "ahead" in failed:
        verdict = "ambiguous"
        reason = (
            "A linear effect is missing, and two explain the records as well: "
            + " or ".join(
                f"{o.effect.replace('_', ' ')} between {' and '.join(o.where)}" for o, _ in tried[:2]
            )
            + "."
        )
    else:
        verdict = "missing_effect"
    model = owner
    if verdict not in ("unknown_effect", "ambiguous"):
        fitted = L.network(fit.numbers)
        kept = tuple(e for e in owner.elements if e.place != "between")
        model = replace(owner, masses=fitted.masses, elements=(*fitted.elements, *kept))
    else:
        notes = [*notes, "model.json is the model as it was given"]
    return Unmeasured(
        road=L.road,
        verdict=verdict,
        gates=tuple(gates),
        reason=reason,
        level=estimates.level,
        parameters=estimates.parameters,
        determined=() if verdict == "unknown_effect" else estimates.determined,
        scale=estimates.scale,
        ratios_only=estimates.ratios_only,
        noise=estimates.noise,
        model=model,
        effects=tuple((o.effect, o.where, g) for (o, _), g in zip(tried, gains, strict=True)),
        found=(h.effect, h.where, estimates.effect) if h and verdict == "missing_effect" else None,
        notes=tuple(notes),
        seconds=clock.seconds,
    )
