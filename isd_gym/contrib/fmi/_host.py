"""Runner of a functional mock-up unit (FMU) in a separate process, where a fault of the FMU is only an error.

`isd_gym.contrib.fmi.cosimulation` starts this text with ``python -c``; the text imports nothing from the package. A
request is a line of JSON on standard input, followed by its arrays as float64; the answer is a line of JSON
on standard output, followed by arrays. FMPy loads the FMU: compiled code from its author, which runs with
the rights of this process.
"""

from __future__ import annotations

import json
import os
import sys
from collections import deque

import numpy as np

REAL = ("Real", "Float64", "Float32")


class Refused(Exception):
    """Error with one line for the user."""


class Fmu:
    """An unpacked FMU with its description, which is loaded for its first run."""

    def __init__(self, folder):
        import fmpy

        self.fmpy, self.folder, self.instance = fmpy, folder, None
        self.said: deque[str] = deque(maxlen=3)  # last messages of the FMU, for the error message
        self.described = fmpy.read_model_description(folder, validate=False)
        kinds = [self.described.coSimulation, self.described.modelExchange]
        self.kind = next(
            (n for n, k in zip(("CoSimulation", "ModelExchange"), kinds, strict=True) if k), None
        )
        if self.kind is None:
            raise Refused("it can neither be stepped nor integrated (no co-simulation, no model exchange)")
        if not fmpy.supported_platforms(folder) or fmpy.platform not in fmpy.supported_platforms(folder):
            has = ", ".join(fmpy.supported_platforms(folder)) or "no platform"
            raise Refused(f"it has no code for {fmpy.platform} (it has some for {has})")

    def describe(self):
        rows = []
        for v in self.described.modelVariables:
            if v.type not in REAL or v.dimensions:
                continue
            unit = v.unit or (v.declaredType.unit if v.declaredType is not None else None) or ""
            low, high = (_number(getattr(v, k)) for k in ("min", "max"))
            row = [v.name, v.causality or "local", v.variability or "", unit, _number(v.start), low, high]
            rows.append([*row, v.description or ""])
        step = self.described.defaultExperiment.stepSize if self.described.defaultExperiment else None
        about = {"name": self.described.modelName, "fmi": self.described.fmiVersion, "kind": self.kind}
        return about | {"variables": rows, "step": _number(step)}

    def run(self, step, start, inputs, outputs, values):
        fmpy = self.fmpy
        if self.instance is None:
            logger = self.log if self.described.fmiVersion == "2.0" else None
            self.instance = fmpy.instantiate_fmu(self.folder, self.described, self.kind, logger=logger)
        rows = len(values)
        time = step * np.arange(rows)
        table = None
        if inputs:
            table = np.zeros(rows, [("time", float), *((name, float) for name in inputs)])
            table["time"] = time
            for j, name in enumerate(inputs):
                table[name] = values[:, j]
        try:
            found = fmpy.simulate_fmu(
                self.folder, model_description=self.described, fmu_instance=self.instance, fmi_type=self.kind,
                start_time=0.0, stop_time=float(time[-1]), output_interval=step, step_size=step,
                input=table, start_values=start, output=outputs, validate=False, set_stop_time=False,
            )  # fmt: skip
            self.instance.reset()
        except Exception:
            self.instance = None  # a failed instance is not used again
            raise
        if len(found) < rows:
            raise Refused(f"it stopped at t = {float(found['time'][-1]):.6g} s of {float(time[-1]):.6g}")
        return np.stack([np.asarray(found[name][:rows], float) for name in outputs], axis=1)

    def log(self, environment, instance, status, category, message):
        self.said.append(message.decode("utf-8", "replace") if isinstance(message, bytes) else str(message))


def _number(value):
    try:
        return float(value)
    except (TypeError, ValueError):
        return None


def answer(told, head, array=None):
    told.write(json.dumps(head | {"shape": None if array is None else list(array.shape)}).encode() + b"\n")
    if array is not None:
        told.write(np.ascontiguousarray(array, float).tobytes())
    told.flush()


def main():
    asked = os.fdopen(os.dup(0), "rb")
    told = os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDWR)
    for standard in (0, 1, 2):  # output of an FMU is no answer
        os.dup2(nothing, standard)
    fmu = None
    for line in iter(asked.readline, b""):
        request = json.loads(line)
        shape = request.get("shape")
        array = np.frombuffer(asked.read(8 * shape[0] * shape[1])).reshape(shape) if shape else None
        try:
            if fmu is None:
                fmu = Fmu(request["folder"])
            if request["do"] == "describe":
                answer(told, fmu.describe())
            else:
                how = {k: request[k] for k in ("step", "start", "inputs", "outputs")}
                answer(told, {}, fmu.run(values=array, **how))
        except ImportError as error:
            answer(told, {"lacks": error.name or "fmpy"})
        except Refused as error:
            answer(told, {"refused": str(error)})
        except Exception as error:
            said = [*(fmu.said if fmu else ()), f"{type(error).__name__}: {error}"]
            answer(told, {"refused": "; ".join(" ".join(x.split()) for x in said)[-400:]})
            if fmu is not None:
                fmu.said.clear()
    os._exit(0)  # some FMUs crash when their libraries are unloaded


if __name__ == "__main__":
    sys.exit(main())
