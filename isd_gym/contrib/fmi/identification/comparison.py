"""Simulation of a co-simulation FMU over measured records: communication step, input timing and run-in."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from isd_gym._common.arrays import Array
    from isd_gym.diagnosis._simulation.problem import Record

    from ..cosimulation import Port, Unit, UnitModel

Progress = Callable[[str], None]

#: input lead times to be tried, as shares of a communication step
LEADS = (0.5, 0.0, 1.0)
#: largest accepted difference between coarse and fine stepping, as a share of the output's deviation
STEP_TOLERANCE = 0.02
FINEST = 8  # communication steps per sample at most
#: difference of two runs, as a share of the deviation, below which the initial state is forgotten
RUN_IN_TOLERANCE = 0.02


@dataclass(frozen=True)
class Segment:
    """Samples `first` to `stop` - 1 of one record, after the run-in."""

    record: int  # index of the record
    first: int
    stop: int
    held_out: bool  # whether the segment takes no part in fitting


class FmuComparison:
    """Records and the FMU that simulates them.

    Args:
        fmu: The opened FMU.
        model: Parameters and ports of the FMU.
        records: Records with inputs and measured outputs in the FMU's units.
        outputs: Ports that are compared, in the order of the measured columns.
    """

    def __init__(
        self, fmu: Unit, model: UnitModel, records: Sequence[Record], outputs: Sequence[Port]
    ) -> None:
        self.fmu, self.model, self.records = fmu, model, list(records)
        self.outputs = list(outputs)
        self.channels = [p.name for p in outputs]
        #: share of a communication step by which each input is set early
        self.lead = dict.fromkeys(self.records[0].inputs, 0.5)
        self.steps_per_sample = 1
        self._cache: dict[tuple[int, tuple[float, ...]], Array] = {}

    @cached_property
    def time_scale(self) -> float:
        """Median time scale of the records' motion [s]."""
        return float(np.median([r.pace for r in self.records]))

    def run(
        self,
        model: UnitModel,
        index: int,
        *,
        first: int = 0,
        stop: int | None = None,
        steps_per_sample: int = 0,
    ) -> Array:
        """Simulate a part of a record from rest.

        Args:
            model: Parameter values.
            index: Index of the record.
            first: First sample.
            stop: Sample after the last one. Default: the end of the record.
            steps_per_sample: Communication steps per sample. Default: the value found by `settle`.

        Returns:
            Outputs (samples, channels) in the FMU's units.
        """
        record = self.records[index]
        every = steps_per_sample or self.steps_per_sample
        n = len(record) if stop is None else stop
        fine = np.minimum(np.arange((n - first - 1) * every + 1) / every + first, n - 1)
        inputs = {
            name: np.interp(np.minimum(fine + self.lead[name] / every, n - 1), np.arange(len(values)), values)
            for name, values in record.inputs.items()
        }
        own = self.fmu.model.parameters
        changed = {k: v for k, v in model.parameters.items() if v != own[k]}
        return self.fmu.run(inputs, len(fine), record.step / every, self.channels, changed)[::every]

    def simulate(self, model: UnitModel, index: int) -> Array:
        """Simulate a whole record, or return the stored result.

        Returns:
            Outputs (samples, channels) in the FMU's units.
        """
        key = (index, tuple(model.parameters.values()))
        if key not in self._cache:
            if len(self._cache) > 256:
                self._cache.clear()
            self._cache[key] = self.run(model, index)
        return self._cache[key]

    def settle(self, progress: Progress) -> list[str]:
        """Choose the lead of each input and the number of communication steps per sample.

        An FMU receives an input at the start of a communication step and may hold or extrapolate the input. The
        reference is a run with short steps, in which the difference vanishes.

        Returns:
            Notes for the user.
        """
        record = self.records[0]
        n = min(len(record), max(200, math.ceil(20 * self.time_scale / record.step)))
        self.fmu.forgets({k: v[:n] for k, v in record.inputs.items()}, n, record.step, self.channels, {})
        reference = self.run(self.model, 0, stop=n, steps_per_sample=2 * FINEST)
        deviation = np.maximum(reference.std(axis=0), 0.1 * np.maximum(record.measured.std(axis=0), 1e-300))

        def error() -> float:
            difference = self.run(self.model, 0, stop=n) - reference
            return float(np.max(difference.std(axis=0) / deviation))

        while True:
            progress(f"stepping the FMU every {1e3 * record.step / self.steps_per_sample:.3g} ms")
            least = error()
            for name in record.inputs:
                errors = {self.lead[name]: least}
                for self.lead[name] in LEADS:
                    if self.lead[name] not in errors:
                        errors[self.lead[name]] = error()
                self.lead[name] = min(errors, key=lambda lead: errors[lead])
                least = errors[self.lead[name]]
            if least < STEP_TOLERANCE or self.steps_per_sample >= FINEST:
                break
            self.steps_per_sample *= 2
        words = {0.0: "at the start", 0.5: "in the middle", 1.0: "at the end"}
        how = ", ".join(f"{name} {words[lead]} of a step" for name, lead in self.lead.items())
        step = 1e3 * record.step / self.steps_per_sample
        notes = [f"communication step of the FMU: {step:.3g} ms" + (f"; input values: {how}" if how else "")]
        if least >= STEP_TOLERANCE:
            notes.append(
                f"the FMU's outputs depend on the communication step, by {least:.1%} of their deviation"
            )
        return notes

    def run_in(self) -> tuple[float, bool]:
        """Measure the run-in: the time after which two runs with different initial states agree.

        Returns:
            The run-in [s], and whether the two runs agreed before the end.
        """
        index = int(np.argmax([len(r) for r in self.records]))
        record = self.records[index]
        half, late = len(record) // 2, len(record) // 4
        whole, part = (self.run(self.model, index, first=k, stop=late + half) for k in (0, late))
        difference = np.abs(whole[late:] - part) / np.maximum(record.measured.std(axis=0), 1e-300)
        over = np.flatnonzero(difference.max(axis=1) > RUN_IN_TOLERANCE)
        last = int(over[-1]) + 1 if len(over) else 0
        return last * record.step, last < 0.9 * half
