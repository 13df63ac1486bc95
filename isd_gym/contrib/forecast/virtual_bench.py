"""Simulated test bench: the nominal model, the sensors' noise, and records split as by a diagnosis.

Simulations are free of noise. White noise enters in expectation, so results are smooth in noise level and test length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from isd_gym._common.errors import InputError, shown
from isd_gym.diagnosis._estimation.gauss_newton import Fit, Fitter, residuals
from isd_gym.diagnosis._estimation.initial_states import states_along, transfer_states
from isd_gym.diagnosis._estimation.noise import deviance_of, floor_of, white_weights
from isd_gym.diagnosis._estimation.structure import Structure, base_structure
from isd_gym.diagnosis._hypotheses.forces import PlaceForces, place_forces
from isd_gym.diagnosis._hypotheses.law_matching import simulate_unmodelled_effects
from isd_gym.diagnosis._hypotheses.library import hypotheses
from isd_gym.diagnosis._hypotheses.motion import loads_of, motions, tell_gain
from isd_gym.diagnosis._records.filtering import differentiate_inputs
from isd_gym.diagnosis._records.splitting import split_records
from isd_gym.diagnosis._selection.candidate import Candidate
from isd_gym.diagnosis._selection.criteria import CRITERIA, LEAST_NOISE, Criteria
from isd_gym.diagnosis._selection.held_out import SMALL, HeldOutEvaluator
from isd_gym.diagnosis._simulation.problem import Problem, Record, bare
from isd_gym.physics.network import Network, assemble

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isd_gym._common.arrays import Array
    from isd_gym.diagnosis._estimation.structure import Hypothesis
    from isd_gym.physics.elements import Motion

REQUIRED_DEVIANCE = 50.0  # deviance by which a rival must be worse
MAX_SAMPLES = 16000  # simulated samples; a part of a longer test represents the whole test


@dataclass(frozen=True, eq=False)
class BenchFit:
    """A structure fitted to noise-free outputs."""

    fit: Fit
    training: list[Array]  # residuals (samples, channels) of the training records
    validation: list[Array]  # residuals (samples, channels) of the validation records


class VirtualBench:
    """A planned test with noise, on which effects are simulated and models are fitted.

    Args:
        network: The nominal model.
        records: Records with the inputs of the test.
        noise: RMS noise by output [unit of the output]. Default: as in the model, else 1 % of the deviation.
        criteria: Limits of the diagnosis.
        notes: List that receives a line per assumption.

    Raises:
        InputError: The model has no outputs, the noise is invalid, or the simulation fails.
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
        #: length of the whole test over the simulated length
        records, self.length_factor = _shorten(records, self.notes)
        records = [replace(r, name=f"test {k + 1}", start=0.0) for k, r in enumerate(records)]
        whole = Problem(network, records)
        clean = _simulate(whole, network)
        #: RMS noise (channels,) [unit of the channel]
        self.noise = self._stated_noise(network, np.concatenate(clean), noise or {})
        known = tuple(replace(c, noise=float(s)) for c, s in zip(network.outputs, self.noise, strict=True))
        self.network = replace(network, outputs=known)
        rng = np.random.default_rng(0)  # the split of the records depends on the signals
        noisy = [
            replace(r, measured=y + self.noise * rng.standard_normal(y.shape))
            for r, y in zip(records, clean, strict=True)
        ]
        noisy = differentiate_inputs(noisy, self.network)
        self._whole = Problem(self.network, noisy)
        pieces, roles = split_records(noisy, [], [], self._whole.time)
        index = {r.name: k for k, r in enumerate(noisy)}
        self._cuts = []  # record, first sample and end of each piece
        for p in pieces:
            k = index[p.name]
            first = round((p.start - noisy[k].start) / p.interval)
            self._cuts.append((k, first, first + len(p)))
        self.problem = Problem(self.network, self._cut(pieces, self.network), roles)
        self.structure = base_structure(self.network)
        #: noise that a diagnosis expects (channels,) [unit of the channel]
        self.floors = np.maximum(self.noise, LEAST_NOISE * self.problem.deviation())
        #: white noise of the residual weights (channels,) [unit of the channel]
        self.weighting_noise = np.hypot(self.noise, self.floors)
        self.nominal = self._fit_initial_states()

    def _stated_noise(self, network: Network, outputs: Array, given: Mapping[str, float]) -> Array:
        """Return the RMS noise (channels,): as given, as in the model, or a share of the outputs' deviation."""
        names = [c.name for c in network.outputs]
        for name, rms in given.items():
            if name not in names:
                raise InputError(
                    f"--noise: the model has no output {shown(name)} (it has: {', '.join(names)})"
                )
            if not (math.isfinite(rms) and rms > 0):
                raise InputError(f"--noise: {name} must be a number > 0, not {rms:g}")
        out = []
        for c, y in zip(network.outputs, outputs.T, strict=True):
            value: float | None = given.get(c.name, c.noise)
            if value is None:
                value = LEAST_NOISE * float(y.std())
                if not value > 0:
                    raise InputError(
                        f"output '{c.name}' does not change under this test: state its noise with --noise {c.name}=VALUE"
                    )
                self.notes.append(
                    f"noise of {c.name}: assumed 1 % of its deviation, {value:.3g} {c.unit} (change with --noise {c.name}=VALUE)"
                )
            out.append(value)
        return np.array(out)

    def _cut(self, pieces: Sequence[Record], network: Network) -> list[Record]:
        """Return the pieces with simulated outputs of `network`."""
        outputs = _simulate(self._whole, network)
        return [replace(p, measured=outputs[k][a:b]) for p, (k, a, b) in zip(pieces, self._cuts, strict=True)]

    def measure(self, truth: Network) -> Problem:
        """Return the problem with noise-free outputs of another network.

        Raises:
            InputError: The simulation of `truth` fails.
        """
        return self.problem.with_records(self._cut(self.problem.records, truth))

    def _fit_initial_states(self) -> Fit:
        """Fit the initial states of the nominal model, from the states of a simulation from rest."""
        s, x = self.structure, self.structure.start
        rest = np.zeros(assemble(bare(self.network)).size[0])
        initial = {}
        for i, (k, first, _) in enumerate(self._cuts):
            initial[i] = (
                states_along(self._whole, s, x, {k: rest}, [first])[k][0] if first and len(rest) else rest
            )
        fitter = Fitter(self.problem, white_weights(self.weighting_noise))
        return fitter.fit(s, x, initial, records=[*initial], frozen=True, iterations=3)

    # -- the nominal model on the training records ----------------------------------------------------------
    @cached_property
    def training_fit(self) -> Fit:
        """The nominal model on the training records."""
        f, own = self.nominal, self.problem.estimation
        return replace(f, outputs={i: f.outputs[i] for i in own}, initial={i: f.initial[i] for i in own})

    @cached_property
    def motion(self) -> dict[tuple[str, str], Motion]:
        """Motion by pair of nodes."""
        return motions(self.problem, self.training_fit)

    @cached_property
    def forces(self) -> PlaceForces:
        """Typical forces by place."""
        return place_forces(self.problem, self.training_fit)

    @cached_property
    def loads(self) -> dict[str, list[Array]]:
        """Load of each training record (samples,) [N] by element, for frictions under load."""
        return loads_of(self.problem, self.training_fit, list(hypotheses(self.network)))

    def load_of(self, h: Hypothesis) -> list[Array] | None:
        """Return the load of a friction in each training record; None where the loads do not tell level and gain apart.

        Args:
            h: A friction under load.
        """
        load = self.loads.get(dict(h.options)["load"])
        return load if load is not None and tell_gain(load) else None

    @cached_property
    def unmodelled_responses(self) -> dict[int, Array]:
        """Responses (samples, channels, laws) to small unmodelled effects by training record."""
        return simulate_unmodelled_effects(self.problem, self.training_fit, SMALL)

    @cached_property
    def unmodelled_envelope(self) -> Array:
        """Largest error (channels,) by small unmodelled effects, as a share of each channel's deviation."""
        base = Candidate(self.training_fit, 0.0)
        return HeldOutEvaluator(self.problem).unmodelled_envelope(
            base, self.criteria.small_effect, self.criteria.material
        )

    # -- fitting --------------------------------------------------------------------------------------------
    def deviance(self, residual: Sequence[Array]) -> float:
        """Return -2 log L of noise-free residuals [(samples, channels), ...] under white noise."""
        return deviance_of(residual, self.weighting_noise, np.ones(len(self.noise)))

    def fit(self, truth: Problem, structure: Structure, x: Array, *, iterations: int = 5) -> BenchFit:
        """Fit a structure to noise-free outputs.

        Args:
            truth: The problem with the outputs.
            structure: The structure.
            x: Start values of the structure's transformed parameters (parameters,).
            iterations: Iterations at most.

        Returns:
            The fit.

        Raises:
            InputError: The simulation fails at the start values.
        """
        known = transfer_states(truth, self.structure.network, self.nominal.initial, structure)
        weights = white_weights(self.weighting_noise)
        f = Fitter(truth, weights).fit(structure, x, known, iterations=iterations, tolerance=1e-3)
        left = residuals(truth, f)
        held = Fitter(truth, weights).follow(structure, f.x, truth.choosing, known, iterations=2)
        return BenchFit(f, left, residuals(truth, held))


def _simulate(problem: Problem, network: Network) -> list[Array]:
    """Simulate all records from rest; return outputs (samples, channels), or raise `InputError` if not finite."""
    out = []
    for i in range(len(problem.records)):
        y = problem.simulate([network], i)[:, :, 0]
        if not np.isfinite(y).all() or np.abs(y).max() > 1e12:
            raise InputError(f"model '{network.name}' cannot be simulated under this test")
        out.append(y)
    return out


def _shorten(records: Sequence[Record], notes: list[str]) -> tuple[list[Record], float]:
    """Return at most about `MAX_SAMPLES` samples of the records, and the ratio of whole to simulated length."""
    total = sum(r.samples for r in records)
    if total <= MAX_SAMPLES:
        return list(records), 1.0
    share = MAX_SAMPLES / total
    cut = [r.part(0, max(int(share * len(r)), 400), r.name) if len(r) > 400 else r for r in records]
    factor = total / sum(r.samples for r in cut)
    notes.append(f"the first {1 / factor:.0%} of each record was simulated and represents the whole record")
    return cut, factor


def measured_noise(records: Sequence[Record], network: Network) -> dict[str, float]:
    """Estimate the noise of measured outputs from the outputs' spectra.

    Args:
        records: Records; outputs may be zero.
        network: The nominal model.

    Returns:
        RMS noise [unit of the output] by output, for outputs without noise in the model and with a visible noise floor.
    """
    out = {}
    for j, c in enumerate(network.outputs):
        series = [r.measured[:, j] for r in records if np.ptp(r.measured[:, j]) > 0]
        if c.noise is None and series:
            found = floor_of(series, records[0].step)
            if found.known and found.deviation > 0:
                out[c.name] = found.deviation
    return out
