"""How a model stands and moves at the first sample, fitted to what was measured from there on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError
from ..._common.units import convert
from ...physics.network import Network, assemble
from ...records.data import Table
from .._estimation.clock_lag import Lag, align_clocks
from .._estimation.gauss_newton import Fitter
from .._estimation.noise import floors_of, white_weights
from .._estimation.structure import base_structure
from .._records.reading import read_record
from .._simulation.node_motion import transfer_matrix
from .._simulation.problem import Problem

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..._common.arrays import Array
    from ...records.loggers.recording import Recording

#: iterations of a fit to a whole record: the phase of a stiffening decay follows its amplitude over many periods
ITERATIONS = 12


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
    network = Network.load(model)
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
    structure = base_structure(network)
    noise = np.array([f.deviation for f in floors_of(problem)])
    fit = Fitter(problem, white_weights(noise)).follow(
        structure, structure.start, [0], iterations=ITERATIONS
    )
    if not np.isfinite(fit.outputs[0]).all():
        raise InputError(
            f"initial state: model '{network.name}' breaks down over {record.name}"
        )
    over = transfer_matrix(
        assemble(network.mechanical), assemble(Network.load(model)), problem.time
    )
    time = np.asarray(
        record.start + record.step * np.arange(record.samples), dtype=np.float64
    )
    inputs = {
        c.name: convert(record.inputs[c.name], c.si, c.unit) for c in network.inputs
    }
    return FittedInitialState(
        over @ fit.initial[0], time, inputs, tuple(lags), tuple(notes)
    )
