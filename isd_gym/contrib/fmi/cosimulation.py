"""Functional mock-up units (FMU) of users as models: their description and their simulation.

An FMU is compiled code from its author. It is opened only if the user declares trust, and runs in a separate
process (`_host`, with FMPy), which isolates faults but not malicious code. Supported are FMI 2 and 3,
co-simulation and model exchange.
"""

from __future__ import annotations

import math
import tempfile
import zipfile
from contextlib import suppress
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError, hint, how_to_install, shown
from isd_gym._common.files import write_text
from isd_gym._common.guarded import Guarded
from isd_gym._common.inputs import memory_limit, plain_file, too_large
from isd_gym._common.units import QUANTITIES, convert

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType

    from isd_gym._common.arrays import Array

SECONDS = 600.0  # limit for one run or for loading [s]
NAMESPACE = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"

WHY_TRUST = "an FMU is compiled code of whoever made it and runs with your rights: it can read, change and send what you can"


@dataclass(frozen=True)
class Port:
    """A real variable of an FMU.

    Attributes:
        name: Name.
        unit: Unit in the notation of the FMU.
        causality: 'input', 'output' or 'local'.
    """

    name: str
    unit: str
    causality: str

    @property
    def quantity(self) -> str:
        """Key of `units.QUANTITIES`; '' for other units."""
        for quantity, (_, si) in QUANTITIES.items():
            with suppress(InputError):
                convert(1.0, self.unit, si)
                return quantity
        return ""


@dataclass(frozen=True)
class UnitModel:
    """Description of an FMU, with values of its parameters.

    Attributes:
        name: Name of the FMU.
        inputs: Real inputs.
        outputs: Real outputs, followed by local variables.
        parameters: Start value of each real parameter, in its unit.
        units: Unit by parameter.
        limits: Smallest and largest value by parameter; infinite if not stated.
        uncertainty: Relative standard deviation of the parameters to be refitted.
    """

    name: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    parameters: Mapping[str, float]
    units: Mapping[str, str] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    uncertainty: Mapping[str, float] = field(default_factory=dict)

    def unit_of(self, path: str) -> str:
        """Return the unit of a parameter.

        Args:
            path: Name of the parameter.

        Returns:
            Unit; '' without a unit.
        """
        return self.units.get(path, "")

    def with_parameters(self, values: Mapping[str, float]) -> UnitModel:
        """Return a copy with other values of some parameters.

        Args:
            values: Value by parameter.

        Returns:
            The changed description.

        Raises:
            InputError: No such parameter exists.
        """
        for name in values:
            if name not in self.parameters:
                raise InputError(
                    f"FMU {shown(self.name)} has no parameter {shown(name)}: {hint(name, self.parameters)}"
                )
        return replace(self, parameters={**self.parameters, **values})

    def save(self, path: str | Path) -> None:
        """Write the values of the parameters as a parameter set of the SSP standard (.ssv), which FMU simulators read.

        Args:
            path: File to write.

        Raises:
            InputError: The file cannot be written.
        """
        from xml.sax.saxutils import quoteattr

        rows = [
            f"    <ssv:Parameter name={quoteattr(k)}><ssv:Real value={quoteattr(repr(float(v)))}/></ssv:Parameter>"
            for k, v in self.parameters.items()
        ]
        head = f'<ssv:ParameterSet xmlns:ssv="{NAMESPACE}" version="1.0" name={quoteattr(self.name)}>'
        lines = ['<?xml version="1.0" encoding="UTF-8"?>', head, "  <ssv:Parameters>"]
        write_text(path, "\n".join([*lines, *rows, "  </ssv:Parameters>", "</ssv:ParameterSet>", ""]))


class Unit:
    """A running FMU; `model` is its description. A context manager: process and unpacked files end with the block.

    Args:
        path: The .fmu file.
        trust: Whether the code of the FMU may run here; without trust, nothing is unpacked.

    Raises:
        InputError: Trust is missing, or the file is no FMU that can run here.
    """

    def __init__(self, path: str | Path, *, trust: bool = False) -> None:
        self.path = Path(path)
        plain_file(self.path)
        if not trust:
            raise InputError(f"{path}: {WHY_TRUST}; --trust-fmu opens it (trust=True in Python)")
        self._folder = tempfile.TemporaryDirectory(prefix="isd-gym-fmu-")
        self._process: Guarded | None = None
        self._afresh = False  # a new process for every run: the FMU keeps state between runs
        self.runs = 0
        try:
            self._unpack()
            about, _ = self._ask({"do": "describe"})
            self.model = _model(about)
        except BaseException:
            self.close()
            raise
        self.about = {"FMI": about["fmi"], "kind": about["kind"]}

    def __enter__(self) -> Unit:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the process and remove the unpacked files."""
        self._stop()
        self._folder.cleanup()

    def _unpack(self) -> None:
        limit = memory_limit()
        try:
            with zipfile.ZipFile(self.path) as archive:
                members = archive.infolist()
                size = sum(m.file_size for m in members)
                if size > limit:
                    raise too_large(str(self.path), size, limit)
                if "modelDescription.xml" not in archive.namelist():
                    raise InputError(f"{self.path}: is no FMU (there is no modelDescription.xml in it)")
                archive.extractall(self._folder.name)  # extraction stays within the folder
        except (
            zipfile.BadZipFile,
            NotImplementedError,
            RuntimeError,
            EOFError,
            OSError,
            ValueError,
        ) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{self.path}: is no FMU, or a broken one ({error})") from None

    def run(
        self,
        inputs: Mapping[str, Array],
        rows: int,
        step: float,
        outputs: list[str],
        start: Mapping[str, float],
    ) -> Array:
        """Return outputs of a simulation from rest; each input is set at the beginning of a step.

        All values are in the units of the FMU.

        Args:
            inputs: Values (rows,) by input.
            rows: Number of samples.
            step: Sampling step [s].
            outputs: Names of the outputs.
            start: Values of parameters that differ from the start values.

        Returns:
            Outputs (rows, outputs).

        Raises:
            InputError: The simulation fails, or an output is not finite.
        """
        names = list(inputs)
        values = np.stack([inputs[n] for n in names], axis=1) if names else np.zeros((rows, 1))
        request = {"do": "run", "step": step, "start": dict(start), "inputs": names, "outputs": outputs}
        if self._afresh:
            self._stop()
        self.runs += 1
        _, found = self._ask(request, values)
        assert found is not None
        if not np.isfinite(found).all():
            raise InputError(f"{self.path}: the simulation broke down: an output is not finite")
        return found

    def forgets(self, *arguments: Any) -> None:
        """Run twice; if the results differ, use a new process for every further run.

        Args:
            arguments: Arguments of `run`.
        """
        first, second = self.run(*arguments), self.run(*arguments)
        scale = np.maximum(np.abs(first).max(axis=0), 1e-300)
        if np.any(np.abs(first - second).max(axis=0) > 1e-9 * scale):
            self._afresh = True

    # -- the process --------------------------------------------------------------------------------------
    def _ask(
        self, request: dict[str, Any], array: Array | None = None
    ) -> tuple[dict[str, Any], Array | None]:
        shape = None if array is None else list(array.shape)
        request = request | {"folder": self._folder.name, "shape": shape}
        if self._process is None:
            program = (resources.files("isd_gym.contrib.fmi") / "_host.py").read_text(encoding="utf-8")
            self._process = Guarded(program, folder=self._folder.name)
        found = self._process.ask(request, _counts, SECONDS, array)
        if found is None:
            self._stop()
            raise InputError(f"{self.path}: its code broke down, or took more than {SECONDS:.0f} s")
        head, arrays = found
        if "lacks" in head:
            raise InputError(f"{self.path}: running it needs FMPy: {how_to_install('fmu')}")
        if "refused" in head:
            raise InputError(f"{self.path}: {head['refused']}")
        return head, arrays[0].reshape(head["shape"]) if arrays else None

    def _stop(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.close()


def _counts(head: dict[str, Any]) -> list[int]:
    return [math.prod(head["shape"])] if head.get("shape") else []


def _model(about: Mapping[str, Any]) -> UnitModel:
    ports: dict[str, list[Port]] = {"input": [], "output": [], "local": []}
    parameters: dict[str, float] = {}
    units: dict[str, str] = {}
    limits: dict[str, tuple[float, float]] = {}
    for name, causality, variability, unit, start, low, high, _ in about["variables"]:
        if causality in ports and variability != "constant":
            ports[causality].append(Port(name, unit, causality))
        elif causality == "parameter" and variability in ("fixed", "tunable") and start is not None:
            parameters[name], units[name] = start, unit
            limits[name] = (-np.inf if low is None else low, np.inf if high is None else high)
    name = str(about["name"] or "FMU")
    return UnitModel(
        name, tuple(ports["input"]), (*ports["output"], *ports["local"]), parameters, units, limits
    )
