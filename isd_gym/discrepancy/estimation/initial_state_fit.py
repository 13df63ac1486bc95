"""How a model stands and moves at the first sample, fitted to what was measured from there on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...data import Table
from ...errors import InputError
from ...network import Network, assemble
from ...units import convert
from ..records import read_record
from ..simulation.node_motion import transfer_matrix
from ..simulation.problem import Array, Problem, bare
from .clock_lag import Lag, align_clocks
from .gauss_newton import Fitter
from .noise import floors_of, white_filters
from .structure import base_structure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ...loggers.recording import Recording


@dataclass(frozen=True)
class FittedInitialState:
    """A fitted initial state, and the simulation that it belongs to.

    state (states,): in the assembly's coordinates, as `isd_gym.simulate` takes it. time (n,) [s], inputs (n,) by channel in the
    channels' units: what to simulate over; of loggers with rates of their own, the grid on which they are compared.
    lags: of clocks that are late. notes: what the data gate found.
    """

    state: Array
    time: Array
    inputs: Mapping[str, Array]
    lags: tuple[Lag, ...] = ()
    notes: tuple[str, ...] = ()


def initial_state(
    data: Table | Recording | str | Path,
    model: Network | str | Path | Mapping[str, Any],
    *,
    outputs: Sequence[str] | None = None,
) -> FittedInitialState:
    """The state in which a model, its parameters as they are, comes closest to the outputs that were measured.

    data: a table or a file with the model's inputs and some of its outputs, or a recording. model: a network, a built-in one's name, a
    file or its content. outputs: those to fit by; by default all that `data` (a table or a recording) has. As in a diagnosis, free offsets
    and the lags of other loggers' clocks are fitted along, and the motion is known beforehand to about its own size.
    Raises `InputError` where nothing is measured, or where the model breaks down over the record.
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
    problem = Problem(network, [record], ["fit"])
    structure = base_structure(network)
    noise = np.array([f.deviation for f in floors_of(problem)])
    fit = Fitter(problem, white_filters(noise)).follow(structure, structure.start, [0], iterations=12)
    if not np.isfinite(fit.outputs[0]).all():
        raise InputError(f"initial state: model '{network.name}' breaks down over {record.name}")
    over = transfer_matrix(assemble(bare(network)), assemble(Network.load(model)), problem.time)
    time = np.asarray(record.start + record.step * np.arange(record.samples), dtype=np.float64)
    inputs = {c.name: convert(record.inputs[c.name], c.si, c.unit) for c in network.inputs}
    return FittedInitialState(over @ fit.initial[0], time, inputs, tuple(lags), tuple(notes))
