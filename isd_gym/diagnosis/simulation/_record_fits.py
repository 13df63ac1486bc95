"""Simulations of measured records at fixed parameters: initial states, free offsets and lags of clocks are fitted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.arrays import channel_rms
from ..._common.errors import InputError
from ..._common.units import convert
from ...physics.network import Network, assemble
from ...records.data import Table
from .._estimation.clock_lag import Lag, align_clocks
from .._estimation.gauss_newton import Fit, Fitter
from .._estimation.noise import floors_of, white_weights
from .._estimation.structure import base_structure
from .._records.filtering import differentiate_inputs
from .._records.reading import read_record
from .._simulation.node_motion import transfer_matrix
from .._simulation.problem import BROKEN, Problem, deviation_within

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..._common.arrays import Array
    from ...records.loggers.recording import Recording

#: iterations of a fit to a whole record: the phase of a stiffening decay follows its amplitude over many periods
ITERATIONS = 12
#: smallest noise that residuals are weighted with, as a share of the signal's deviation
LEAST_NOISE = 1e-3


@dataclass(frozen=True)
class FittedInitialState:
    """A fitted initial state with the inputs of its simulation."""

    #: state in the coordinates of the assembly (states,), for `isd_gym.simulate`
    state: Array
    #: time [s] (n,); the common grid for loggers with different rates
    time: Array
    #: inputs by channel (n,), in the units of the channels
    inputs: Mapping[str, Array]
    #: lags of loggers' clocks
    lags: tuple[Lag, ...] = ()
    #: notes of the data checks
    notes: tuple[str, ...] = ()


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
    errors: tuple[PredictionError, ...]
    #: notes of the data checks, and lags between the clocks of loggers
    notes: tuple[str, ...] = ()


def initial_state(
    data: Table | Recording | str | Path,
    model: Network | str | Path | Mapping[str, Any],
    *,
    outputs: Sequence[str] | None = None,
) -> FittedInitialState:
    """Return the initial state with the smallest error of the measured outputs, at fixed parameters of the model.

    As in a diagnosis, free offsets and lags of loggers' clocks are fitted too, and the size of the motion is the prior of the state.

    Args:
        data: Table or file with the inputs and some outputs of the model, or a recording.
        model: Network, name of a built-in network, model file or its content.
        outputs: Outputs of the fit; by default all outputs in `data`.

    Returns:
        The initial state, with time and inputs of the record.

    Raises:
        InputError: No output is measured, or the simulation of the record diverges.
    """
    whole = network = Network.load(model)
    if outputs is None and not isinstance(data, str | Path):
        there = data.columns if isinstance(data, Table) else data.signals
        outputs = [c.name for c in network.outputs if c.name in there]
    if outputs is not None:
        network = network.with_outputs(outputs)
    if not network.outputs:
        raise InputError(
            "initial state: none of the model's outputs is measured, so that there is nothing to fit it to"
        )
    notes: list[str] = []
    record = read_record(data, network, notes, ("all",))
    (record,), lags = align_clocks([record], network)
    problem = Problem(network, [record])
    states = transfer_matrix(
        assemble(network.mechanical), assemble(whole), problem.time
    )
    state = states @ _follow(problem).initial[0]
    time = record.start + record.step * np.arange(record.samples, dtype=np.float64)
    inputs = {
        c.name: convert(record.inputs[c.name], c.si, c.unit) for c in network.inputs
    }
    return FittedInitialState(state, time, inputs, tuple(lags), tuple(notes))


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
    records, lags = align_clocks(records, network)
    records = differentiate_inputs(records, network)
    if any(r.slopes for r in records):
        notes.append(
            "measured and simulated outputs pass one low-pass, since a noisy input is differentiated"
        )
    problem = Problem(network, records)
    fit = _follow(problem)
    groups = [(r.name, [i]) for i, r in enumerate(records)]
    if len(records) > 1:
        groups.append(("all records", problem.estimation))
    floors, errors = floors_of(problem), []
    for name, members in groups:
        measured = [records[i].measured for i in members]
        rms = channel_rms([records[i].measured - fit.outputs[i] for i in members])
        deviation = deviation_within(measured, members)
        for j, c in enumerate(network.outputs):
            noise = min(floors[j].deviation, rms[j]) / deviation[j]
            row = PredictionError(
                record=name,
                channel=c.name,
                unit=c.unit,
                rms=float(rms[j]),
                nrmse=float(rms[j] / deviation[j]),
                noise=float(noise) if floors[j].known else None,
            )
            errors.append(row)
    return PredictionErrors(network.name, tuple(errors), (*notes, *map(str, lags)))


def _follow(problem: Problem) -> Fit:
    """Return the simulation of records at the parameters of the model, with fitted initial states and offsets.

    Raises:
        InputError: The simulation of a record breaks down.
    """
    network, structure = problem.network, base_structure(problem.network)
    noise = [f.deviation for f in floors_of(problem)]
    weights = white_weights(np.maximum(noise, LEAST_NOISE * problem.deviation()))
    try:
        fit = Fitter(problem, weights).follow(
            structure, structure.start, problem.estimation, iterations=ITERATIONS
        )
    except BROKEN as error:
        raise InputError(
            f"model '{network.name}' does not simulate the records: {error}"
        ) from None
    for i, record in enumerate(problem.records):
        if not np.isfinite(fit.outputs[i]).all():
            raise InputError(f"model '{network.name}' breaks down over {record.name}")
    return fit
