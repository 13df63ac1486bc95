"""Export of a network as a functional mock-up unit (FMI 2.0, co-simulation).

`export_fmu` writes the unit with PythonFMU. The unit holds the model and calls this package's kernel, so that
its results agree with `isd_gym.simulate`. It runs wherever Python finds isd_gym, on Linux and Windows,
x86-64.

A unit knows an input only at the beginning of a step. A displacement moves during a step from the value of
the preceding step to the present value: outputs at the end of step k belong to the inputs at its beginning,
one step late, as in any co-simulation without look-ahead.
"""

from __future__ import annotations

import hashlib
import json
import keyword
import math
import re
import sys
import tempfile
from collections import deque
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._common.errors import InputError, how_to_install
from .._common.files import check_file, whole, writing
from .._common.units import convert
from .elements import SensorDelay
from .network import Network
from .simulate import PHYSICS_STEP, Plant, effective_current, sense

if TYPE_CHECKING:
    from collections.abc import Mapping
    from xml.etree.ElementTree import Element

    Slave = Any
else:
    Slave = __import__("pythonfmu").Fmi2Slave if find_spec("pythonfmu") else object

__all__ = ["export_fmu"]

MEMORY = 2.0  # length of the stored commands and readings for drives and sensors with memory [s]


class Running:
    """A network that is stepped with inputs known at the beginning of each step; values are in the units of the channels.

    Args:
        network: The model.
        step: Largest physics step [s].

    Raises:
        InputError: The model has a sensor with a lead.
    """

    def __init__(self, network: Network, step: float = PHYSICS_STEP) -> None:
        self.network = network
        self.largest = float(step)
        self.plants: dict[float, Plant] = {}
        self.state: np.ndarray | None = None
        self.drives = any(e.place == "element" for e in network.elements)
        self.sensors = any(e.place == "channel" for e in network.elements)
        for e in network.elements:
            if isinstance(e, SensorDelay) and e.delay < 0:
                raise InputError(
                    f"element '{e.name}': no sensor of a running model can lead; delay must be >= 0 s"
                )
        self.moved = {c.name for c in network.moving}
        self.commands: dict[str, deque[float]] = {}
        self.readings: dict[str, deque[float]] = {}
        # last three values [SI] of each input, newest first
        self.last: dict[str, list[float]] = {}
        self.slope: dict[str, float] = {}
        self.outputs: dict[str, float] = {}
        self.raw: np.ndarray | None = None

    def start(self, inputs: Mapping[str, float]) -> dict[str, float]:
        """Start at rest.

        Args:
            inputs: Value by input.

        Returns:
            Value by output.

        Raises:
            InputError: An input is missing or not finite.
        """
        now = self._si(inputs)
        self.last = {name: [value] * 3 for name, value in now.items()}
        self.slope = dict.fromkeys(now, 0.0)
        self.state = self.raw = None
        self.commands.clear()
        self.readings.clear()
        self._go(
            self._plant(self.largest),
            {k: np.full(2, v) for k, v in now.items()},
            self.largest,
            still=True,
        )
        return dict(self.outputs)

    def advance(self, inputs: Mapping[str, float], seconds: float) -> dict[str, float]:
        """Simulate a period with the inputs that hold from now.

        Args:
            inputs: Value by input.
            seconds: Length of the period [s].

        Returns:
            Value by output at the end of the period.

        Raises:
            InputError: An input is missing or not finite, or the simulation diverges.
        """
        if not self.last:
            self.start(inputs)
        if not seconds > 0:
            return dict(self.outputs)
        now = self._si(inputs)
        every = max(1, math.ceil(seconds / self.largest - 1e-9))
        plant = self._plant(seconds / every)
        for name, value in now.items():
            self.last[name] = [value, *self.last[name][:2]]
        share = np.linspace(0.0, 1.0, every + 1)
        fine = {}
        for name, (end, begin, _) in self.last.items():
            fine[name] = (
                begin + (end - begin) * share
                if name in self.moved
                else np.full(every + 1, end)
            )
        self._go(plant, fine, seconds)
        return dict(self.outputs)

    def _si(self, inputs: Mapping[str, float]) -> dict[str, float]:
        out = {}
        for c in self.network.inputs:
            if c.name not in inputs:
                raise InputError(f"input '{c.name}' is missing")
            out[c.name] = float(convert(float(inputs[c.name]), c.unit, c.si))
            if not math.isfinite(out[c.name]):
                raise InputError(f"input '{c.name}' is not finite")
        return out

    def _plant(self, step: float) -> Plant:
        key = float(f"{step:.9e}")
        if key not in self.plants:
            if len(self.plants) > 8:  # the master uses a different step every time
                self.plants.clear()
            self.plants[key] = Plant(self.network, step)
        return self.plants[key]

    def _go(
        self,
        plant: Plant,
        fine: Mapping[str, np.ndarray],
        seconds: float,
        still: bool = False,
    ) -> None:
        rows = (
            len(next(iter(fine.values())))
            if fine
            else (1 + max(1, round(seconds / plant.step)))
        )
        u = np.zeros((rows, len(plant.labels), 1))
        curves = {
            name: self._curve(name, rows, seconds) for name in plant.differentiated
        }
        for j, (part, name) in enumerate(plant.labels):
            order = plant.order_of(part, name)
            u[:, j, 0] = curves[name][order] if name in curves else fine[name]
        for name in curves:
            self.slope[name] = float(curves[name][1][-1])
        c = np.zeros((rows - 1, len(plant.currents), 1))
        for j, channel in enumerate(plant.currents):
            c[:, j, 0] = self._current(
                str(channel.element), channel.name, fine[channel.name][1:], plant.step
            )
        if self.state is None:
            self.state = plant.grouped(plant.state(None, u[0], c[0])).reshape(-1)
        if still:
            u, c = u[:1], c[:1]
        out = np.empty((1 if still else 2, plant.n_outputs, 1))
        every = max(1, len(u) - 1)
        plant.kernel.record(
            plant.mats.ravel(),
            plant.ints,
            self.state,
            u.ravel(),
            c.ravel(),
            every,
            1,
            1,
            out,
        )
        values = out[-1, :, 0].copy()
        for j, difference in enumerate(plant._by_difference):
            if difference:
                now = values[j]
                values[j] = 0.0 if self.raw is None else (now - self.raw[j]) / seconds
                out[-1, j, 0] = now
        self.raw = out[-1, :, 0].copy()
        named = {
            ch.name: float(convert(float(v), ch.si, ch.unit))
            for ch, v in zip(plant.channels, values, strict=True)
        }
        if not all(map(math.isfinite, named.values())):
            raise InputError("the simulation broke down: an output is not finite")
        self.outputs = self._sensed(named, seconds)

    def _curve(
        self, name: str, rows: int, seconds: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a cubic from the last value to the present value, with continuous slope and the end slope of a parabola."""
        end, begin, before = self.last[name]
        s = np.linspace(0.0, 1.0, rows)
        m0 = self.slope[name] * seconds
        m1 = 1.5 * (end - begin) - 0.5 * (begin - before)
        a = 2 * begin - 2 * end + m0 + m1
        b = 3 * end - 3 * begin - 2 * m0 - m1
        r = begin + m0 * s + b * s**2 + a * s**3
        return (
            r,
            (m0 + 2 * b * s + 3 * a * s**2) / seconds,
            (2 * b + 6 * a * s) / seconds**2,
        )

    def _current(
        self, motor: str, name: str, command: np.ndarray, step: float
    ) -> np.ndarray:
        if not self.drives:
            return command
        held = self.commands.setdefault(name, deque(maxlen=math.ceil(MEMORY / step)))
        held.extend(command.tolist())
        return effective_current(self.network, motor, np.array(held)[:, None], step)[
            -len(command) :, 0
        ]

    def _sensed(self, named: dict[str, float], seconds: float) -> dict[str, float]:
        if not self.sensors:
            return named
        rows = {}
        for name, value in named.items():
            held = self.readings.setdefault(
                name, deque(maxlen=max(2, math.ceil(MEMORY / seconds)))
            )
            if not held:
                held.append(value)
            held.append(value)
            rows[name] = np.array(held)
        return {
            name: float(v[-1]) for name, v in sense(self.network, rows, seconds).items()
        }


#: namespaces of the scripts of all units that this process has loaded, see `NetworkSlave.__init_subclass__`
_NAMESPACES: list[dict[str, Any]] = []


class NetworkSlave(Slave):  # type: ignore[misc]
    """The class that PythonFMU runs: a `Running` network whose channels and parameters are variables of the unit.

    Args:
        options: Arguments of PythonFMU's `Fmi2Slave`.
    """

    MODEL = ""
    STEP = PHYSICS_STEP

    def __init_subclass__(cls, **options: Any) -> None:
        """Keep the namespace of the unit's script alive.

        PythonFMU releases it once per load without owning it, so that a second load in the same process would read freed
        memory. It runs the script at every load, and hence this method.

        Args:
            options: Arguments of the class.
        """
        super().__init_subclass__(**options)
        if cls.__module__ in sys.modules:
            _NAMESPACES.append(vars(sys.modules[cls.__module__]))

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Variability, Real

        self.network = Network.load(json.loads(self.MODEL))
        self.author = "isd_gym"
        self.description = self.network.description or self.network.name
        self.given = {c.name: 0.0 for c in self.network.inputs}
        self.found = {c.name: 0.0 for c in self.network.outputs}
        self.own = dict(self.network.parameters)
        self.units: dict[str, str] = {}
        self.running: Running | None = None

        def add(name: str, unit: str, values: dict[str, float], **how: Any) -> None:
            self.units[name] = unit
            self.register_variable(
                Real(
                    name,
                    getter=lambda: values[name],
                    setter=lambda value: values.__setitem__(name, float(value)),
                    **how,
                ),
                nested=False,
            )

        for c in self.network.inputs:
            about = f"{c.quantity} {_where(c)}"
            add(c.name, c.unit, self.given, causality=Fmi2Causality.input, variability=Fmi2Variability.continuous,
                description=about, start=0.0)  # fmt: skip
        for c in self.network.outputs:
            about = f"{c.quantity} {_where(c)}"
            add(c.name, c.unit, self.found, causality=Fmi2Causality.output, variability=Fmi2Variability.continuous,
                initial=Fmi2Initial.calculated, description=about)  # fmt: skip
        for path in self.own:
            add(path, self.network.unit_of(path), self.own, causality=Fmi2Causality.parameter,
                variability=Fmi2Variability.fixed, initial=Fmi2Initial.exact)  # fmt: skip

    def exit_initialization_mode(self) -> None:
        changed = {k: v for k, v in self.own.items() if v != self.network.parameters[k]}
        self.running = Running(self.network.with_parameters(changed), self.STEP)
        self.found.update(self.running.start(self.given))

    def do_step(self, current_time: float, step_size: float) -> bool:
        assert self.running is not None
        self.found.update(self.running.advance(self.given, step_size))
        return True

    def to_xml(self, model_options: dict[str, str] | None = None) -> Element:
        """Return the model description, with the units that PythonFMU omits.

        Args:
            model_options: Options of PythonFMU.

        Returns:
            Root of the XML document.
        """
        from xml.etree.ElementTree import Element, SubElement

        root = super().to_xml(model_options or {})
        units = Element("UnitDefinitions")
        for unit in sorted({u for u in self.units.values() if u and u != "-"}):
            SubElement(units, "Unit", name=unit)
        if len(units):
            at = [e.tag for e in root].index("CoSimulation") + 1
            root.insert(at, units)
        variables = root.find("ModelVariables")
        assert variables is not None
        for v in variables:
            unit = self.units[v.attrib["name"]]
            if unit and unit != "-":
                v[0].set("unit", unit)
        structure = root.find("ModelStructure")
        outputs = structure.find("Outputs") if structure is not None else None
        if structure is not None and outputs is not None:
            first = SubElement(structure, "InitialUnknowns")
            for unknown in outputs:
                SubElement(first, "Unknown", index=unknown.attrib["index"])
        return root


def _where(c: Any) -> str:
    if c.at:
        return f"at {c.at}"
    return (
        f"between {' and '.join(c.between)}"
        if c.between
        else f"of {', '.join(c.elements)}"
    )


def identifier(name: str) -> str:
    """Return a name that is valid in the files of a unit and in Python.

    Args:
        name: Any name.

    Returns:
        The identifier.
    """
    words = (
        "".join(w[:1].upper() + w[1:] for w in re.split(r"[^0-9a-zA-Z]+", name) if w)
        or "Model"
    )
    return (
        f"Model{words}" if not words[0].isalpha() or keyword.iskeyword(words) else words
    )


def export_fmu(
    model: Network | str | Path, path: str | Path, *, step: float = PHYSICS_STEP
) -> Path:
    """Write a model as a co-simulation unit (FMI 2.0).

    Inputs, outputs and parameters are variables with the model's names and units; parameters are set before
    the start.

    Args:
        model: The model, or the name of a built-in model, or a file.
        path: File to write (.fmu).
        step: Largest physics step [s].

    Returns:
        The path.

    Raises:
        InputError: PythonFMU is not installed, the suffix is not .fmu, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".fmu":
        raise InputError(f"cannot write a unit to '{path}': end the name in .fmu")
    check_file(path)
    if not find_spec("pythonfmu"):
        raise InputError(f"an FMU needs PythonFMU: {how_to_install('fmu')}")
    if not step > 0:
        raise InputError(f"the step must be positive, not {step}")
    from pythonfmu import FmuBuilder

    network = Network.load(model)
    name = identifier(network.name)
    Plant(network, step)  # raises an error for models that cannot be simulated
    text = (
        f"from isd_gym.physics import fmu\n\n\nclass {name}(fmu.NetworkSlave):\n"
        f"    MODEL = {json.dumps(network.to_dict())!r}\n    STEP = {float(step)!r}\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        # Python loads a module once per process: other content needs another name
        script = (
            Path(folder)
            / f"fmu_{name.lower()}_{hashlib.sha256(text.encode()).hexdigest()[:12]}.py"
        )
        paths = list(sys.path)
        try:
            # PythonFMU has a folder of its own there
            with writing(folder, tempfile.gettempdir()):
                script.write_text(text, encoding="utf-8")
                made = FmuBuilder.build_FMU(script, dest=folder)
        finally:
            sys.path[:] = paths
            sys.modules.pop(script.stem, None)
        with whole(path) as temporary:
            temporary.write_bytes(
                Path(made or Path(folder) / f"{name}.fmu").read_bytes()
            )
    return path
