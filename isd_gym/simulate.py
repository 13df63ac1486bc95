"""Networks discretised for the kernel, and simulated over records.

`Plant` is a network (or several of the same structure, one a lane) at a step; `simulate` runs one over given inputs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

from . import elements as el
from .errors import InputError
from .network import Assembly, Channel, Network, assemble
from .units import convert

PHYSICS_STEP = 1e-3  # s
SI = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2", "force": "N", "current": "A"}


@dataclass(frozen=True)
class Discrete:
    """One network at one step: the matrices of the kernel (see `kernel.advance`), without a lane axis."""

    blocks: tuple[np.ndarray, ...]
    params: np.ndarray
    quiet: np.ndarray
    outputs: tuple[np.ndarray, ...]
    kinds: tuple[int, ...]
    differ: tuple[int, ...]
    fast: int


def _columns(asm: Assembly, keep: Sequence[int] | None) -> list[int]:
    """Columns of the base vector that enter linearly over the step: r, v, alpha, F where something uses them."""
    start, stop = asm.columns("r").start, asm.columns("F").stop
    if keep is not None:
        return list(keep)
    used = (
        np.any(asm.rate != 0, axis=0)
        | np.any(asm.outputs != 0, axis=0)
        | np.any(asm.elongation != 0, axis=0)
        | np.any(asm.elongation_rate != 0, axis=0)
    )
    return [j for j in range(start, stop) if used[j]]


def discretise(asm: Assembly, step: float, columns: Sequence[int]) -> Discrete:
    """Exact discretisation of the linear part: `columns` first-order hold, currents and friction zero-order hold."""
    from .kernel import LAW_PARAMETERS, law_code

    n, laws = asm.size[0], asm.laws
    x, u, c, f = asm.columns("x"), list(columns), asm.columns("I"), asm.columns("f")
    A = asm.rate[:, x]
    B = np.hstack([asm.rate[:, u], asm.rate[:, c], asm.rate[:, f]])
    k, m, nc = B.shape[1], len(u), c.stop - c.start
    if n:
        big = np.zeros((n + 2 * k, n + 2 * k))
        big[:n, :n], big[:n, n : n + k] = A * step, B * step
        big[n : n + k, n + k :] = np.eye(k)
        phi = expm(big)
        Ad, hold, late = phi[:n, :n], phi[:n, n : n + k], phi[:n, n + k :]
    else:
        Ad, hold, late = np.zeros((0, 0)), np.zeros((0, k)), np.zeros((0, k))
    early = hold - late
    kinds = tuple(law_code(type(e)) for e in laws)
    dry = np.array([code < 0 for code in kinds], bool)
    G0, G1 = early[:, m + nc :].copy(), late[:, m + nc :].copy()
    G1[:, dry] += G0[:, dry]
    G0[:, dry] = 0.0
    E, R = asm.elongation, asm.elongation_rate.copy()
    differ = np.array(asm.by_difference, bool)
    R[differ] = E[differ] / step
    D, DU, DC = E[:, x], E[:, u], E[:, c]
    S, SU, SC = R[:, x], R[:, u], R[:, c]
    GD, GS = D @ G1 + E[:, f], S @ G1 + R[:, f]
    params = np.zeros((len(laws), LAW_PARAMETERS))
    for j, e in enumerate(laws):
        numbers = e.law_parameters()
        params[j, : len(numbers)] = numbers
    quiet = np.array([[e.quiet()] for e in laws]).reshape(len(laws), 1)
    # the quiet way: at most one constant friction, and stops that nothing touches
    held = np.abs(GD[:, dry]) @ params[dry, :1] if len(laws) else quiet
    fast = (
        sum(dry) <= 1
        and not differ.any()
        and all(
            (type(e).bound is el.CoulombFriction.bound and GS[j, j] < 0)
            if dry[j]
            else quiet[j, 0] > held[j, 0]
            for j, e in enumerate(laws)
        )
    )
    O = asm.outputs
    return Discrete(
        blocks=(
            *(Ad, _pad(early[:, :m]), _pad(late[:, :m]), _pad(hold[:, m : m + nc]), G0, G1),
            *(D, _pad(DU), _pad(DC), S, _pad(SU), _pad(SC), GD, GS),
        ),
        params=params,
        quiet=np.maximum(quiet - held, 0.0),
        outputs=(O[:, x], _pad(O[:, u]), _pad(O[:, c]), O[:, f]),
        kinds=kinds,
        differ=tuple(int(d) for d in differ),
        fast=int(fast),
    )


def _pad(block: np.ndarray) -> np.ndarray:
    """At least one column: the kernel always reads the first input and the first current."""
    return block if block.shape[1] else np.zeros((len(block), 1))


class Plant:
    """Networks ready for the kernel: one shared by all `lanes`, or one a lane (all of the same structure).

    `step` [s]; `extra`: output channels after the network's own. `u_columns` says which of the base vector's inputs
    the kernel reads, in order; `labels` names them as (part, channel): part 'r', 'v', 'alpha' or 'F'.
    """

    def __init__(
        self,
        networks: Network | Sequence[Network],
        step: float = PHYSICS_STEP,
        *,
        lanes: int = 1,
        extra: Sequence[Channel] = (),
    ) -> None:
        from .kernel import kernel

        if not (isinstance(step, int | float) and math.isfinite(step) and step > 0):
            raise InputError(f"the step must be a positive number of seconds, not {step!r}")
        self.kernel = kernel()
        several = not isinstance(networks, Network)
        self.networks: list[Network] = list(networks) if several else [networks]  # type: ignore[list-item,arg-type]
        self.lanes = len(self.networks) if several else lanes
        self.step, self.extra = float(step), tuple(extra)
        once = {id(net): assemble(net, extra) for net in self.networks}  # many lanes may share a network
        self.assemblies = [once[id(net)] for net in self.networks]
        first = self.assemblies[0]
        used = sorted({c for asm in self.assemblies for c in _columns(asm, None)})
        self.u_columns = used
        self.channels = (*first.network.outputs, *extra)
        self._by_difference = first.outputs_by_difference
        parts = []
        displacement = [c for c in first.network.inputs if c.quantity == "displacement"]
        force = [c for c in first.network.inputs if c.quantity == "force"]
        for column in used:
            for part, channels in (
                ("r", displacement),
                ("v", displacement),
                ("alpha", displacement),
                ("F", force),
            ):
                span = first.columns(part)
                if span.start <= column < span.stop:
                    parts.append((part, channels[column - span.start].name))
        self.labels: tuple[tuple[str, str], ...] = tuple(parts)
        self.currents = [c for c in first.network.inputs if c.quantity == "current"]
        stepped = {id(asm): discretise(asm, self.step, used) for asm in once.values()}
        self.pack([stepped[id(asm)] for asm in self.assemblies], several)

    def pack(self, parts: Sequence[Discrete], several: bool) -> None:
        first = parts[0]
        for other in parts[1:]:
            if other.kinds != first.kinds or [b.shape for b in other.blocks] != [
                b.shape for b in first.blocks
            ]:
                raise InputError("the lanes' networks differ in structure, not only in parameters")
        n, m, nc = self.assemblies[0].size[0], max(len(self.u_columns), 1), max(len(self.currents), 1)
        nl, ny = len(first.kinds), len(self.channels)
        flat = [
            np.concatenate([b.ravel() for b in (*p.blocks, p.params, p.quiet, *p.outputs)]) for p in parts
        ]
        fast = min(p.fast for p in parts)
        rows = np.stack(flat, axis=1)
        self.mats = np.vstack([np.full((1, rows.shape[1]), self.step), rows])
        self.ints = np.array([m, nc, nl, fast, ny, *first.kinds, *first.differ], np.int64)
        self.size = np.zeros((0,) * n)
        self.tag = np.zeros((0,) * (2 if self.lanes == 1 else int(several)))
        self.n, self.n_laws, self.n_outputs = n, nl, ny

    def state(self, initial: np.ndarray | None = None) -> np.ndarray:
        """A fresh kernel state; `initial` (n,) or (n, lanes) in the coordinates of the assembly."""
        n, nl, lanes = self.n, self.n_laws, self.lanes
        state = np.zeros((2 * n + 7 * nl, lanes))
        if initial is not None and n:
            state[:n] = np.asarray(initial, float).reshape(n, -1)
            self._start_laws(state)
        return state

    def _start_laws(self, state: np.ndarray) -> None:
        """Elongations, rates and smooth forces that belong to the initial state, moved nodes at rest."""
        n, nl = self.n, self.n_laws
        x = state[:n]
        f, z, d, s = (state[n + i * nl : n + (i + 1) * nl] for i in range(4))
        for lane in range(self.lanes):
            asm = self.assemblies[lane if len(self.assemblies) > 1 else 0]
            cols = asm.columns("x")
            d[:, lane] = asm.elongation[:, cols] @ x[:, lane]
            s[:, lane] = asm.elongation_rate[:, cols] @ x[:, lane]
            for j, e in enumerate(asm.laws):
                if e.law is not None:
                    p = np.array(e.law_parameters())
                    f[j, lane], z[j, lane] = e.law(p, d[j, lane], s[j, lane], d[j, lane], 0.0, self.step)

    def run(
        self,
        inputs: Mapping[str, np.ndarray],
        *,
        every: int = 1,
        samples: int,
        initial: np.ndarray | None = None,
        derivatives: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    ) -> np.ndarray:
        """Outputs (samples, ny, lanes) at every `every`-th step, in SI units.

        `inputs`: SI values by channel at every physics step, shape (every*(samples-1)+1,) or with a lane axis;
        `derivatives`: (velocity, acceleration) of moved channels where needed and known, else differences.
        """
        total = every * (samples - 1) + 1
        shared = all(np.ndim(v) == 1 for v in inputs.values())
        width = 1 if shared else self.lanes

        def wide(values: np.ndarray) -> np.ndarray:
            values = np.asarray(values, float)
            return values[:, None] if values.ndim == 1 else values

        u = np.zeros((total, max(len(self.labels), 1), width))
        for j, (part, name) in enumerate(self.labels):
            if part in ("r", "F"):
                u[:, j] = wide(inputs[name])
            elif derivatives is not None and name in derivatives:
                u[:, j] = wide(derivatives[name][0 if part == "v" else 1])
            else:
                r = wide(inputs[name])
                v = np.gradient(r, self.step, axis=0)
                u[:, j] = v if part == "v" else np.gradient(v, self.step, axis=0)
        c = np.zeros((max(total - 1, 1), max(len(self.currents), 1), width))
        for j, channel in enumerate(self.currents):
            values = effective_current(
                self.networks[0], str(channel.element), wide(inputs[channel.name]), self.step
            )
            c[:, j] = values[: len(c)]
        out = np.empty((samples, self.n_outputs, self.lanes))
        state = self.state(initial)
        self.kernel.record(
            self.size, self.tag, self.mats, self.ints, state, u, c, self.lanes, every, int(shared), out
        )
        for j, difference in enumerate(self._by_difference):
            if difference:
                out[:, j] = np.gradient(out[:, j], self.step * every, axis=0)
        return out


def effective_current(network: Network, motor: str, command: np.ndarray, step: float) -> np.ndarray:
    """What the drive makes of a commanded current (n, lanes) held over each step: delay, lag, saturation.

    There was no current before the record.
    """
    from scipy.signal import lfilter

    out = np.asarray(command, float)
    for e in network.elements:
        if isinstance(e, el.ActuatorDelay) and e.where[0] == motor:
            out = delayed(out, e.delay / step, before=0.0)
    for e in network.elements:
        if isinstance(e, el.ActuatorLag) and e.where[0] == motor and e.time_constant > 0:
            pole = math.exp(-step / e.time_constant)
            share = (1.0 - pole) * e.time_constant / step  # mean of the decay over one step
            state, _ = lfilter([0.0, 1.0 - pole], [1.0, -pole], out, axis=0, zi=0.0 * out[:1])
            out = out + (state - out) * share
    for e in network.elements:
        if isinstance(e, el.ThrustSaturation) and e.where[0] == motor:
            out = e.current * np.tanh(out / e.current)
    return out


def delayed(values: np.ndarray, steps: float, before: float | None = None) -> np.ndarray:
    """`values` (n, ...) later by a number of samples, linear in between; `before` them, or the first one."""
    low = math.floor(steps)
    part = steps - low
    first = np.repeat(values[:1] if before is None else np.full_like(values[:1], before), low + 1, axis=0)
    longer = np.concatenate([first, values])[: len(values) + 1]
    return longer[1:] if part == 0.0 else (1.0 - part) * longer[1:] + part * longer[:-1]


def sense(network: Network, outputs: Mapping[str, np.ndarray], step: float) -> dict[str, np.ndarray]:
    """Outputs (n, ...) as the sensors of the network report them: delay, gain, bias (in the channel's unit)."""
    seen = dict(outputs)
    for e in network.elements:
        if e.place == "channel" and e.where[0] in seen:
            channel = e.where[0]
            if isinstance(e, el.SensorDelay):
                seen[channel] = delayed(seen[channel], e.delay / step)
            elif isinstance(e, el.SensorGain):
                seen[channel] = e.gain * seen[channel]
            elif isinstance(e, el.SensorBias):
                seen[channel] = seen[channel] + e.bias
    return seen


def upsample(values: np.ndarray, every: int, hold: bool = False) -> np.ndarray:
    """A record at `every` times its rate: held (currents) or linear in between."""
    if every == 1:
        return np.asarray(values, float)
    if hold:
        return np.repeat(values, every)[: every * (len(values) - 1) + 1]
    n = len(values)
    return np.interp(np.arange(every * (n - 1) + 1) / every, np.arange(n), values)


def simulate(
    model: Network | str | Path | Mapping[str, Any],
    time: np.ndarray,
    inputs: Mapping[str, np.ndarray],
    *,
    step: float = PHYSICS_STEP,
    initial: np.ndarray | None = None,
    extra: Sequence[Channel] = (),
) -> dict[str, np.ndarray]:
    """Outputs of a model for inputs sampled uniformly at `time` [s]; everything in the channels' own units.

    The physics runs at the largest whole fraction of the sampling step that is not above `step`. Displacements and
    forces are linear between samples, currents held. Where something acts through the velocity or acceleration of a
    moved node, these come from a cubic spline through its samples. `initial`: state in the assembly's coordinates.
    Raises `InputError` for a missing channel or a time that is not uniform.
    """
    network = Network.load(model)
    time = np.asarray(time, float)
    if time.ndim != 1 or len(time) < 2 or not np.all(np.isfinite(time)):
        raise InputError("time must be a row of at least two finite samples")
    dt = (time[-1] - time[0]) / (len(time) - 1)
    if dt <= 0 or np.abs(np.diff(time) - dt).max() > 0.01 * dt:
        raise InputError("time must be uniformly sampled and increasing")
    every = max(1, math.ceil(dt / step - 1e-9))
    plant = Plant(network, dt / every, extra=extra)
    needs = {name for part, name in plant.labels if part in ("v", "alpha")}
    fine, slopes = {}, {}
    for c in network.inputs:
        if c.name not in inputs:
            raise InputError(f"input '{c.name}' is missing")
        values = np.asarray(inputs[c.name], float)
        if values.shape != time.shape or not np.all(np.isfinite(values)):
            raise InputError(f"input '{c.name}' must hold {len(time)} finite samples")
        values = convert(values, c.unit, SI[c.quantity])
        fine[c.name] = upsample(values, every, hold=c.quantity == "current")
        if c.name in needs:
            spline = CubicSpline(np.arange(len(values)) * dt, values)
            at = np.arange(len(fine[c.name])) * (dt / every)
            fine[c.name] = spline(at)
            slopes[c.name] = (spline(at, 1), spline(at, 2))
    out = plant.run(fine, every=every, samples=len(time), initial=initial, derivatives=slopes)
    named = {c.name: convert(out[:, j, 0], SI[c.quantity], c.unit) for j, c in enumerate(plant.channels)}
    return sense(network, named, dt)
