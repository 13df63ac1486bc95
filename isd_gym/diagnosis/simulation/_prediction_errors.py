"""Errors of a model on measured records: parameters stay, initial states and free offsets are fitted."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.arrays import channel_rms
from ..._common.errors import InputError
from ...physics.network import Network
from .._estimation.clock_lag import align_clocks
from .._estimation.gauss_newton import Fitter
from .._estimation.noise import floors_of, white_weights
from .._estimation.structure import base_structure
from .._records.filtering import differentiate_inputs
from .._records.reading import read_record
from .._simulation.problem import BROKEN, Problem, deviation_within
from ._initial_state_fit import ITERATIONS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from ...records.data import Table
    from ...records.loggers.recording import Recording

#: smallest noise that residuals are weighted with, as a share of the signal's deviation
LEAST_NOISE = 1e-3


@dataclass(frozen=True)
class PredictionError:
    """Error of a model in one channel of one record."""

    #: name of the record; 'all records' for the sum over several records
    record: str
    #: output of the model
    channel: str
    #: unit of the channel
    unit: str
    #: RMS of measured minus simulated signal [unit]
    rms: float
    #: `rms` over the standard deviation of the measured signal within its record
    nrmse: float
    #: RMS of the measurement noise over the same deviation, at most `nrmse`; None where the noise is not known
    noise: float | None


@dataclass(frozen=True)
class PredictionErrors:
    """Errors of a model on measured records."""

    #: name of the model
    model: str
    #: one entry per record and channel; with several records also one per channel over all records
    rows: tuple[PredictionError, ...]
    #: notes of the data checks, and lags between the clocks of loggers
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON: name of the model, errors and notes."""
        return {
            "model": self.model,
            "errors": [asdict(r) for r in self.rows],
            "notes": list(self.notes),
        }


def prediction_errors(
    data: Sequence[Table | Recording | str | Path],
    model: Network | str | Path | Mapping[str, Any],
) -> PredictionErrors:
    """Return the errors of a model on records, with the parameters of the model.

    As in a diagnosis, the initial state of each record, free offsets of sensors and lags between the clocks of loggers are fitted, and
    noisy inputs that are differentiated pass a low-pass together with the outputs. Data checks only give notes.

    Raises `InputError` if a record cannot be read, lacks a channel, or its simulation breaks down.
    """
    network = Network.load(model)
    if not network.outputs:
        raise InputError(f"model '{network.name}' has no outputs to compare with")
    if not data:
        raise InputError("data: no records")
    notes: list[str] = []
    records = [read_record(d, network, notes, ("all",)) for d in data]
    aligned, lags = align_clocks(records, network)
    filtered = differentiate_inputs(aligned, network)
    if any(r.filtered for r in filtered):
        notes.append(
            "measured and simulated outputs pass one low-pass, since a noisy input is differentiated"
        )
    problem = Problem(network, filtered)
    floors = floors_of(problem)
    noise = np.maximum([f.deviation for f in floors], LEAST_NOISE * problem.deviation())
    structure = base_structure(network)
    try:
        fit = Fitter(problem, white_weights(noise)).follow(
            structure, structure.start, problem.estimation, iterations=ITERATIONS
        )
    except BROKEN as error:
        raise InputError(
            f"model '{network.name}' does not simulate the records: {error}"
        ) from None
    left = [problem.records[i].measured - fit.outputs[i] for i in problem.estimation]
    for record, residual in zip(problem.records, left, strict=True):
        if not np.isfinite(residual).all():
            raise InputError(f"model '{network.name}' breaks down over {record.name}")
    groups = [
        (r.name, [r.measured], [e]) for r, e in zip(problem.records, left, strict=True)
    ]
    if len(groups) > 1:
        groups.append(("all records", [r.measured for r in problem.records], left))
    rows = []
    for name, measured, errors in groups:
        rms = channel_rms(errors)
        deviation = deviation_within(measured, range(len(measured)))
        for j, c in enumerate(network.outputs):
            noise_level = min(floors[j].deviation, rms[j])
            known = float(noise_level / deviation[j]) if floors[j].known else None
            rows.append(
                PredictionError(
                    name,
                    c.name,
                    c.unit,
                    float(rms[j]),
                    float(rms[j] / deviation[j]),
                    known,
                )
            )
    return PredictionErrors(network.name, tuple(rows), (*notes, *map(str, lags)))
