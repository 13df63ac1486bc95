"""Plan of a test: predicted detectability of all effects, and gains by additional sensors."""

from __future__ import annotations

import time as clock
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym._common.units import convert
from isd_gym.diagnosis._selection.criteria import CRITERIA, Criteria
from isd_gym.diagnosis._simulation.problem import Record
from isd_gym.physics.elements import spoken
from isd_gym.physics.network import Network
from isd_gym.records.data import Table, read_table

from .effects import forecast_effects
from .planning._excitation import Excitation, Rig, infer_rig, make_excitation, make_record
from .result import Plan
from .sensitivity import Sensitivities, select_hypotheses
from .sensors import list_additional_sensors, rank_sensors
from .virtual_bench import VirtualBench, measured_noise

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isd_gym._common.arrays import Array
    from isd_gym.diagnosis._estimation.structure import Hypothesis

    from .planning._design import Progress

LEAST_SAMPLES = 400  # of a test


def plan(
    model: Network | str | Path | Mapping[str, Any],
    data: Sequence[Table | str | Path] = (),
    *,
    excitation: Excitation | str | None = None,
    rig: Rig | None = None,
    noise: Mapping[str, float] | None = None,
    only: Sequence[str] = (),
    add_sensors: bool = True,
    criteria: Criteria = CRITERIA,
    notes: Sequence[str] = (),
    progress: Progress | None = None,
) -> Plan:
    """Predict which effects `diagnose` could name after a test, and the smallest size of each.

    Each hypothesis is simulated, and the nominal model and the closest rivals are refitted. The criteria of the
    diagnosis decide on the residuals, with noise in expectation.

    Args:
        model: The nominal model.
        data: Records with the inputs of the test. Measured outputs give the noise.
        excitation: The test or its kind, if there are no records.
        rig: The rig for `excitation`. Default: `infer_rig`.
        noise: RMS noise by output [unit of the output]. Default: as in the model or in the records.
        only: Effects, nodes or channels that a hypothesis must contain. Rivals are not restricted.
        add_sensors: Whether to predict the gain by additional sensors.
        criteria: Limits of the diagnosis.
        notes: First notes of the plan.
        progress: Function that receives the stage and the finished share.

    Returns:
        The plan.

    Raises:
        InputError: The data, options and model do not fit together, or the simulation fails.
    """
    start = clock.perf_counter()
    progress = progress or (lambda name, share: None)
    network = Network.load(model)
    notes = list(notes)
    data = [data] if isinstance(data, Table | str | Path) else list(data)
    played = None
    if data:
        if excitation is not None:
            raise InputError("the test is either the inputs of DATA or --excitation, not both")
        records = [read_planned_record(d, network) for d in data]
        names = (Path(d.source if isinstance(d, Table) else d).name for d in data)
        text = f"the inputs of {', '.join(names)}"
    else:
        rig = rig or infer_rig(network, notes=notes)
        if not isinstance(excitation, Excitation):
            excitation = make_excitation(network, rig, excitation or "multisine")
        records = [make_record(network, rig, excitation)]
        text, played = excitation.describe(network, rig), excitation.to_dict()
    known = {**(measured_noise(records, network) if data else {}), **dict(noise or {})}
    bench = VirtualBench(network, records, noise=known, criteria=criteria, notes=notes)
    wanted = without_gain(bench, select_hypotheses(network, only), only, notes)
    more = list_additional_sensors(bench.network) if add_sensors else []
    progress("small effects", 0.0)
    sensitivities = Sensitivities(bench, more=more, progress=lambda share: progress("small effects", share))
    effects, matrix = forecast_effects(bench, sensitivities, wanted, progress)
    return Plan(
        network=bench.network,
        effects=tuple(effects),
        matrix=matrix,
        sensors=rank_sensors(sensitivities, progress) if more else (),
        test=text,
        excitation=played,
        records=tuple(records),
        noise={c.name: float(s) for c, s in zip(network.outputs, bench.noise, strict=True)},
        length=float(sum(r.samples * r.step for r in records)),
        notes=tuple(notes),
        seconds=clock.perf_counter() - start,
    )


def without_gain(
    bench: VirtualBench, wanted: Sequence[Hypothesis], only: Sequence[str], notes: list[str]
) -> list[Hypothesis]:
    """Return the hypotheses without frictions under load whose level and gain no test with these loads tells apart.

    Args:
        bench: The virtual bench.
        wanted: The hypotheses.
        only: Words that the user asked for. A friction that is asked for stays, with a note.
        notes: List that receives a line per place.
    """
    out = []
    for h in wanted:
        if h.kind.loaded and bench.load_of(h) is None:
            if h.effect not in only:
                continue
            load = dict(h.options)["load"]
            notes.append(
                f"{spoken(h.effect)} between {' and '.join(h.where)}: the mean load of {load} hardly differs between the training records, so that level "
                "and gain cannot be told apart; add a training record under a second load, such as another payload"
            )
        out.append(h)
    return out


def read_planned_record(source: Table | str | Path, network: Network) -> Record:
    """Read the inputs of a planned test, and the outputs if all outputs are present.

    Args:
        source: Table or file.
        network: The nominal model.

    Returns:
        The record. Displacements start at zero; missing outputs are zero.

    Raises:
        InputError: An input is missing or not finite, or the samples are too few or not evenly spaced.
    """
    if not network.inputs:
        raise InputError(f"model '{network.name}' has no inputs: a test is not possible")
    table = source if isinstance(source, Table) else _read_table(source, network)
    for c in network.inputs:
        table[c.name]  # raises an error for a missing column
    intervals = np.diff(table.time)
    if (
        len(table) < LEAST_SAMPLES
        or not np.isfinite(table.time).all()
        or intervals.min() < 0.5 * table.step
        or intervals.max() > 1.5 * table.step
    ):
        raise InputError(f"{table.source}: a test needs at least 400 evenly spaced samples")
    inputs = {}
    for c in network.inputs:
        x = convert(np.asarray(table[c.name]), table.units.get(c.name) or c.unit, c.si)
        if not np.isfinite(x).all():
            raise InputError(f"{table.source}: {c.name} has values that are not finite")
        inputs[c.name] = x - x[0] if c.quantity == "displacement" else x
    measured: Array = np.zeros((len(table), len(network.outputs)))
    if all(c.name in table.columns for c in network.outputs):
        columns = [
            convert(np.asarray(table[c.name]), table.units.get(c.name) or c.unit, c.unit)
            for c in network.outputs
        ]
        measured = np.stack(columns, axis=1)
    return Record(Path(table.source).stem, table.step, inputs, measured)


def _read_table(source: str | Path, network: Network) -> Table:
    """Read a file with inputs and outputs, or with inputs only."""
    inputs = {c.name: c.unit for c in network.inputs}
    try:
        return read_table(source, expected=inputs | {c.name: c.unit for c in network.outputs})
    except InputError:
        return read_table(source, expected=inputs)
