"""A unit for co-simulation beside records: how it is to be stepped, what it says, and its parameters refitted."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from .least_squares import bounded_step
from .noise import Whitener, finer, innovations, plain, trust, whitener
from .result import Quantity
from .structure import Free, Structure, base_structure

if TYPE_CHECKING:
    from ..cosimulation import Port, Unit, UnitModel
    from .problem import Array, Record

Say = Callable[[str], None]

AHEAD = (0.5, 0.0, 1.0)  # share of a step by which a unit's inputs may act late
COARSE = (
    0.02  # share of a deviation by which a unit stepped with the record may differ from one stepped finely
)
FINEST = 8  # communication steps a sample at most
RUN_IN = 0.02  # share of a deviation at which a unit has forgotten how it began


@dataclass(frozen=True)
class Stretch:
    """Samples first..stop-1 of a record, compared after the run-in; `held`: they take no part in fitting."""

    record: int
    first: int
    stop: int
    held: bool


class Comparison:
    """Records, the unit that is to say the same, and how it is stepped.

    records: with inputs and measured outputs in the unit's own units. outputs: the ports compared.
    """

    def __init__(
        self, unit: Unit, model: UnitModel, records: Sequence[Record], outputs: Sequence[Port]
    ) -> None:
        self.unit, self.model, self.records = unit, model, list(records)
        self.outputs = list(outputs)
        self.channels = [p.name for p in outputs]
        self.ahead = dict.fromkeys(
            self.records[0].inputs, 0.5
        )  # share of a step by which each input is set early
        self.every = 1  # steps of the unit a sample
        self._known: dict[tuple[int, tuple[float, ...]], Array] = {}

    @cached_property
    def time(self) -> float:
        return float(np.median([r.pace for r in self.records]))

    def run(
        self, model: UnitModel, index: int, *, first: int = 0, stop: int | None = None, every: int = 0
    ) -> Array:
        """Outputs (samples, channels) of the unit with the values of `model`, from rest at sample `first`."""
        record = self.records[index]
        every = every or self.every
        n = len(record) if stop is None else stop
        fine = np.minimum(np.arange((n - first - 1) * every + 1) / every + first, n - 1)
        inputs = {
            name: np.interp(
                np.minimum(fine + self.ahead[name] / every, n - 1), np.arange(len(values)), values
            )
            for name, values in record.inputs.items()
        }
        own = self.unit.model.parameters
        start = {k: v for k, v in model.parameters.items() if v != own[k]}
        out = self.unit.run(inputs, len(fine), record.step / every, self.channels, start)
        return out[::every]

    def simulate(self, model: UnitModel, index: int) -> Array:
        """The whole record; what was simulated before is remembered."""
        key = (index, tuple(model.parameters.values()))
        if key not in self._known:
            if len(self._known) > 256:
                self._known.clear()
            self._known[key] = self.run(model, index)
        return self._known[key]

    def settle(self, say: Say) -> list[str]:
        """How far ahead of a step its inputs are to be set, and how many steps a sample takes; what was found, in words.

        A unit knows an input only at the beginning of a step, and may hold it, or go there while the step lasts. Which of
        the ways it is, a run with short steps tells, in which none of them matters.
        """
        record = self.records[0]
        n = min(len(record), max(200, math.ceil(20 * self.time / record.step)))
        self.unit.forgets({k: v[:n] for k, v in record.inputs.items()}, n, record.step, self.channels, {})
        fine = self.run(self.model, 0, stop=n, every=2 * FINEST)
        spread = np.maximum(fine.std(axis=0), 0.1 * np.maximum(record.measured.std(axis=0), 1e-300))

        def error() -> float:
            return float(np.max((self.run(self.model, 0, stop=n) - fine).std(axis=0) / spread))

        while True:
            say(f"stepping the unit every {1e3 * record.step / self.every:.3g} ms")
            left = error()
            for name in record.inputs:
                tried = {self.ahead[name]: left}
                for self.ahead[name] in AHEAD:
                    if self.ahead[name] not in tried:
                        tried[self.ahead[name]] = error()
                self.ahead[name] = min(tried, key=lambda a: tried[a])
                left = tried[self.ahead[name]]
            if left < COARSE or self.every >= FINEST:
                break
            self.every *= 2
        when = {0.0: "at the beginning", 0.5: "in the middle", 1.0: "at the end"}
        how = ", ".join(f"{name} as it is {when[a]} of a step" for name, a in self.ahead.items())
        notes = [
            f"the unit is stepped every {1e3 * record.step / self.every:.3g} ms" + (f", {how}" if how else "")
        ]
        if left >= COARSE:
            notes.append(f"its outputs still depend on the step, by {left:.1%} of their deviation")
        return notes

    def run_in(self) -> tuple[float, bool]:
        """How long the unit remembers how it began [s], and whether that was seen: two runs that began apart, until they agree."""
        index = int(np.argmax([len(r) for r in self.records]))
        record = self.records[index]
        half = len(record) // 2
        late = len(record) // 4
        whole, after = (self.run(self.model, index, first=k, stop=late + half) for k in (0, late))
        apart = np.abs(whole[late:] - after) / np.maximum(record.measured.std(axis=0), 1e-300)
        over = np.flatnonzero(apart.max(axis=1) > RUN_IN)
        last = int(over[-1]) + 1 if len(over) else 0
        return last * record.step, last < 0.9 * half


@dataclass
class Fitted:
    """Parameters (transformed), what the unit says with them, and what the fit's own noise makes of it."""

    x: Array
    model: UnitModel
    cost: float
    hessian: Array
    likelihood: float = math.inf


class Refit:
    """Gauss-Newton over whole runs of the unit, with the stated uncertainty as prior; derivatives by differences."""

    def __init__(self, comparison: Comparison, stretches: Sequence[Stretch]) -> None:
        self.c, self.stretches = comparison, list(stretches)
        self.structure: Structure = base_structure(comparison.model)  # type: ignore[arg-type]  # parameters alone are asked for
        self.free = tuple(_within(f, comparison.model) for f in self.structure.free)
        self.mean = np.array([f.mean for f in self.free])
        self.sigma = np.array([f.sigma for f in self.free])
        self.low, self.high = (np.array([getattr(f, k) for f in self.free]) for k in ("low", "high"))

    def at(self, x: Array) -> UnitModel:
        return self.c.model.with_parameters(
            {f.path: f.back(float(v)) for f, v in zip(self.free, x, strict=True)}
        )

    def residuals(self, model: UnitModel, held: bool) -> list[Array]:
        out = []
        for s in self.stretches:
            if s.held == held:
                y = self.c.simulate(model, s.record)
                out.append((self.c.records[s.record].measured - y)[s.first : s.stop])
        return out

    def _tried(self, x: Array, W: Whitener) -> float:
        try:
            left = self.residuals(self.at(x), held=False)
        except InputError:
            return math.inf
        return sum(float(np.sum(W(r) ** 2)) for r in left) + float(
            np.sum(((x - self.mean) / self.sigma) ** 2)
        )

    def linearised(self, x: Array, W: Whitener) -> tuple[Array, Array]:
        """Hessian and slope of half the cost, without the prior."""
        p = len(x)
        here = self.residuals(self.at(x), held=False)
        columns = []
        for k, f in enumerate(self.free):
            h = 2e-3 if f.log else 1e-3 * max(abs(x[k]), 0.03 * f.sigma)
            h = -h if x[k] + h > f.high else h
            moved = x.copy()
            moved[k] += h
            columns.append(
                [(b - a) / h for a, b in zip(here, self.residuals(self.at(moved), held=False), strict=True)]
            )
        H, g = np.zeros((p, p)), np.zeros(p)
        for i, r in enumerate(here):
            stack = np.stack([r, *(-c[i] for c in columns)], axis=2)
            G = W(stack).reshape(-1, p + 1)
            G = G.T @ G
            H += G[1:, 1:]
            g += G[1:, 0]
        return H, g

    def fit(self, floors: Array, say: Say, rounds: int = 3, iterations: int = 6) -> Fitted:
        """Rounds of a fit and of weights from what it left, until the likelihood under own coloured noise stops falling."""
        x, W, best = self.mean.copy(), plain(floors), None
        least: Array | None = None
        for number in range(rounds):
            say(
                f"refitting {len(x)} parameters (round {number + 1}, {self.c.unit.runs} runs of the unit so far)"
            )
            x, H = self._descended(x, W, iterations)
            left = self.residuals(self.at(x), held=False)
            least = trust(left, floors) if least is None else least
            prior = float(np.sum(((x - self.mean) / self.sigma) ** 2))
            value = innovations(left, finer(least, floors)) + prior
            enough = best is not None and value > best.likelihood - 2.0
            if best is None or value < best.likelihood:
                best = Fitted(x, self.at(x), self._tried(x, W), H, value)
            if enough or not len(x):
                break
            W = whitener(left, least)
        assert best is not None
        return best

    def _descended(self, x: Array, W: Whitener, iterations: int) -> tuple[Array, Array]:
        damping, cost = 1e-4, self._tried(x, W)
        if not math.isfinite(cost):
            raise InputError(f"{self.c.unit.path}: the simulation breaks down at the start values")
        H = np.zeros((len(x), len(x)))
        for _ in range(iterations if len(x) else 0):
            H, g = self.linearised(x, W)
            slope = g + (self.mean - x) / self.sigma**2
            full = H + np.diag(1 / self.sigma**2)
            for _ in range(5):
                new = x + bounded_step(full, slope, x, self.low, self.high, 2 * self.sigma, damping)
                value = self._tried(new, W)
                if value < cost:
                    break
                damping = max(10 * damping, 1e-3)
            else:
                break
            gain, x, cost, damping = (cost - value) / cost, new, value, max(0.2 * damping, 1e-6)
            if gain < 1e-4:
                break
        return x, H

    def intervals(self, found: Fitted, floors: Array) -> dict[str, Quantity]:
        """Every parameter with its 95 % interval, under the coloured noise that is left."""
        left = self.residuals(found.model, held=False)
        H, _ = self.linearised(found.x, whitener(left, trust(left, floors)))
        variance = np.diag(np.linalg.inv(H + np.diag(1 / self.sigma**2))) if len(found.x) else np.zeros(0)
        out = {}
        for f, x, v in zip(self.free, found.x, np.minimum(variance, self.sigma**2), strict=True):
            s, prior = 1.96 * math.sqrt(v), self.c.model.parameters[f.path]
            low, high = sorted((f.back(x - s), f.back(x + s)))
            out[f.path] = Quantity(f.back(float(x)), low, high, self.c.model.unit_of(f.path), prior)
        return out


def _within(f: Free, model: UnitModel) -> Free:
    """No further than the unit's own limits."""
    low, high = model.limits.get(f.path, (-math.inf, math.inf))
    own = [f.forward(v) if math.isfinite(v) and (v > 0 or not f.log) else v for v in (low, high)]
    return replace(
        f, low=max(f.low, own[0] if not (f.log and low <= 0) else -math.inf), high=min(f.high, own[1])
    )
