"""A test that has not been done: the network, its sensors and their noise, the records as a diagnosis would deal them.

Everything that noise does is reckoned with in expectation, never drawn: what is simulated is free of noise, and white noise
is added in thought. So sizes change smoothly with the noise and the length of the test.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError, shown
from ..network import Network, assemble
from .candidate import BROKEN
from .criteria import CRITERIA, Criteria
from .fit import Fit, Fitter, residuals
from .forces import PlaceForces, place_forces
from .initial import along, carried
from .judge import LEAST_NOISE, SMALL, Judge
from .motion import motions
from .noise import floor_of, innovations, plain, whitener
from .problem import Array, Problem, Record, bare
from .records import dealt, derivatives
from .structure import Structure, base_structure
from .unmodelled import unmodelled

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..elements import Motion

MOST = 16000  # compared samples that are simulated; of a longer test a part stands for the whole


@dataclass(frozen=True, eq=False)
class Refit:
    """A structure fitted to what an effect does: what it leaves (n, channels) of the pieces to fit and to choose by."""

    fit: Fit
    left: list[Array]
    held: list[Array]


class Stand:
    """The bench on which hypotheses are tried before the test.

    network: the owner's model. records: inputs of the test. noise: RMS of every output [its unit], from the model
    file where it is not given, else a hundredth of the output's own deviation. criteria: those of the diagnosis.
    """

    def __init__(
        self,
        network: Network,
        records: Sequence[Record],
        *,
        noise: Mapping[str, float] | None = None,
        criteria: Criteria = CRITERIA,
        notes: list[str] | None = None,
    ):
        self.criteria, self.notes = criteria, notes if notes is not None else []
        if not network.outputs:
            raise InputError(f"model '{network.name}' has no outputs: nothing is measured")
        records, self.repeat = _shortened(records, self.notes)
        records = [replace(r, name=f"test {k + 1}", start=0.0) for k, r in enumerate(records)]
        whole = Problem(network, records, ["fit"] * len(records))
        clean = [_finite(whole.simulate([network], i)[:, :, 0], network) for i in range(len(records))]
        self.noise = self._noise(network, np.concatenate(clean), noise or {})
        known = tuple(replace(c, noise=float(s)) for c, s in zip(network.outputs, self.noise, strict=True))
        self.network = replace(network, outputs=known)
        rng = np.random.default_rng(0)  # only for what decides by the looks of a record how it is dealt
        seen = [
            replace(r, measured=y + self.noise * rng.standard_normal(y.shape))
            for r, y in zip(records, clean, strict=True)
        ]
        seen = derivatives(seen, self.network)
        self.whole = Problem(self.network, seen, ["fit"] * len(seen))
        pieces, roles = dealt(seen, [], [], self.whole.time)
        by_name = {r.name: k for k, r in enumerate(seen)}
        self.cuts = []
        for p in pieces:
            k = by_name[p.name]
            first = round((p.start - seen[k].start) / p.rate)
            self.cuts.append((k, first, first + len(p)))
        shown_outputs = self.outputs(self.network)
        self.problem = Problem(self.network, self._dealt(pieces, shown_outputs), roles)
        self.structure = base_structure(self.network)
        deviation = self.problem.measured().std(axis=0)
        self.floors = np.maximum(self.noise, LEAST_NOISE * deviation)
        #: noise and what is reckoned with beside it: what a diagnosis whitens by
        self.level = np.hypot(self.noise, self.floors)
        self.base = self._rest()

    # -- laying out ---------------------------------------------------------------------------------------
    def _noise(self, network: Network, y: Array, given: Mapping[str, float]) -> Array:
        names = [c.name for c in network.outputs]
        for name, rms in given.items():
            if name not in names:
                raise InputError(
                    f"--noise: the model has no output {shown(name)} (it has: {', '.join(names)})"
                )
            if not (math.isfinite(rms) and rms > 0):
                raise InputError(f"--noise: {name} must be a number > 0, not {rms:g}")
        out = []
        for j, c in enumerate(network.outputs):
            value: float | None = given.get(c.name, c.noise)
            if value is None:
                value = LEAST_NOISE * float(y[:, j].std())
                if not value > 0:
                    raise InputError(
                        f"nothing shows in output '{c.name}' under this test: say its noise with --noise {c.name}=VALUE"
                    )
                self.notes.append(
                    f"noise of {c.name}: taken to be 1 % of its deviation, {value:.3g} {c.unit} (--noise {c.name}=VALUE says otherwise)"
                )
            out.append(value)
        return np.array(out)

    def _dealt(self, pieces: Sequence[Record], outputs: Sequence[Array]) -> list[Record]:
        return [replace(p, measured=outputs[k][a:b]) for p, (k, a, b) in zip(pieces, self.cuts, strict=True)]

    def outputs(self, network: Network) -> list[Array]:
        """Outputs (n, channels) of every record, whole, from rest. Raises `InputError` where they are not finite."""
        return [
            _finite(self.whole.simulate([network], i)[:, :, 0], network)
            for i in range(len(self.whole.records))
        ]

    def measuring(self, network: Network) -> Problem:
        """The pieces with the outputs of `network`, a truth, in the place of what is measured."""
        p = self.problem
        return Problem(p.network, self._dealt(p.records, self.outputs(network)), p.roles, p.step, p.time)

    def _rest(self) -> Fit:
        """The owner's model on the pieces, each from the state in which the simulation from rest enters it."""
        s, x = self.structure, self.structure.start
        rest = np.zeros(assemble(bare(self.network)).size[0])
        begin = {}
        for i, (k, first, _) in enumerate(self.cuts):
            begin[i] = along(self.whole, s, x, {k: rest}, [first])[k][0] if first and len(rest) else rest
        every = list(range(len(self.cuts)))
        return Fitter(self.problem, plain(self.level)).fit(
            s, x, begin, records=every, frozen=True, iterations=3
        )

    # -- what small effects make, once for all ----------------------------------------------------------------
    @cached_property
    def estimated(self) -> Fit:
        """The same on the pieces to fit by alone."""
        f, own = self.base, self.problem.estimation
        return replace(f, outputs={i: f.outputs[i] for i in own}, initial={i: f.initial[i] for i in own})

    @cached_property
    def motion(self) -> dict[tuple[str, str], Motion]:
        return motions(self.problem, self.estimated)

    @cached_property
    def forces(self) -> PlaceForces:
        return place_forces(self.problem, self.estimated)

    @cached_property
    def small(self) -> dict[int, Array]:
        return unmodelled(self.problem, self.estimated, SMALL)

    @cached_property
    def worth(self) -> Array:
        from .candidate import Candidate

        base = Candidate(self.estimated, 0.0)
        return Judge(self.problem).worth(base, self.criteria.small, self.criteria.material)

    # -- refitting ------------------------------------------------------------------------------------------
    def white(self, left: Sequence[Array]) -> Array:
        """White noise to reckon with (channels,) when weights are taken from what a fit leaves, noise allowed for."""
        square = np.mean(np.concatenate(left) ** 2, axis=0) + self.noise**2
        return np.asarray(np.sqrt(np.maximum(self.floors**2, 10.0 * (square - self.floors**2))))

    def likelihood(self, left: Sequence[Array]) -> float:
        """-2 log L that is expected of what a fit leaves, the noise added in thought."""
        return innovations(left, self.level)

    def refit(self, truth: Problem, structure: Structure, x: Array, *, iterations: int = 5) -> Refit:
        """A structure fitted to a truth as a diagnosis does it: with white weights, then with its own coloured ones."""
        known = carried(truth, self.structure.network, self.base.initial, structure)
        W = plain(self.level)
        f = Fitter(truth, W).fit(structure, x, known, iterations=iterations, tolerance=1e-3)
        left = residuals(truth, f)
        if np.any(
            np.mean(np.concatenate(left) ** 2, axis=0) > 0.3 * self.noise**2
        ):  # else the weights stay as they are
            coloured = whitener(left, np.hypot(self.white(left), self.noise))
            try:
                again = Fitter(truth, coloured).fit(
                    structure, f.x, f.initial, f.offset, iterations=3, tolerance=1e-3
                )
                other = residuals(truth, again)
                if self.likelihood(other) + again.prior < self.likelihood(left) + f.prior:
                    f, left = again, other
            except BROKEN:
                pass
        held = Fitter(truth, W).follow(structure, f.x, truth.choosing, known, iterations=2)
        return Refit(f, left, residuals(truth, held))


def _finite(y: Array, network: Network) -> Array:
    if not np.isfinite(y).all() or np.abs(y).max() > 1e12:
        raise InputError(f"model '{network.name}' breaks down under this test")
    return y


def _shortened(records: Sequence[Record], notes: list[str]) -> tuple[list[Record], float]:
    """The beginnings of records that are too long to be simulated over and over, and how much longer the whole is."""
    total = sum(r.samples for r in records)
    if total <= MOST:
        return list(records), 1.0
    share = MOST / total
    cut = [r.part(0, max(int(share * len(r)), 400), r.name) if len(r) > 400 else r for r in records]
    repeat = total / sum(r.samples for r in cut)
    notes.append(f"the first {1 / repeat:.0%} of each record was simulated, and stands for the rest")
    return cut, repeat


def measured_noise(records: Sequence[Record], network: Network) -> dict[str, float]:
    """Noise of the outputs that were measured along, where neither a model file tells it nor the signal hides it."""
    out = {}
    for j, c in enumerate(network.outputs):
        series = [r.measured[:, j] for r in records if np.ptp(r.measured[:, j]) > 0]
        if c.noise is None and series:
            found = floor_of(series, records[0].step)
            if found.known and found.deviation > 0:
                out[c.name] = found.deviation
    return out
