"""Records for the diagnosis: read and checked, in SI; displacements differentiated; held out and cut into stretches."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from ..data import Table, check, read_table
from ..errors import InputError
from ..network import Channel, Network
from ..units import UNITS, convert
from .problem import Array, Record, low_pass

STRETCH = 5.0  # [s] held-out records are judged in stretches, each from an initial state of its own


def read(source: Table | str | Path, network: Network, notes: list[str]) -> Record:
    """A checked record, inputs in SI, outputs in the channels' units. Raises `InputError` where it cannot be used."""
    expected = {c.name: c.unit for c in (*network.inputs, *network.outputs)}
    table = source if isinstance(source, Table) else read_table(source, expected=expected)
    for name in expected:
        table[name]  # raises with the nearest name
    findings = check(
        table,
        inputs={c.name: c.quantity for c in network.inputs},
        outputs={c.name: c.quantity for c in network.outputs},
    )
    for f in findings:
        if f.level == "error":
            raise InputError(f"{table.source}: {f.channel + ': ' if f.channel else ''}{f.message}")
        notes.append(f"{Path(table.source).name}: {f}")
    table = table.uniform()

    def values(name: str, unit: str) -> Array:
        return convert(np.asarray(table[name]), table.units.get(name) or expected[name], unit)

    inputs = {c.name: values(c.name, UNITS[c.quantity]) for c in network.inputs}
    measured = np.stack([values(c.name, c.unit) for c in network.outputs], axis=1)
    name = Path(table.source).stem
    return Record(name, table.step, inputs, measured, {}, float(table.time[0]))


def derivatives(records: list[Record], network: Network) -> list[Record]:
    """Velocity and acceleration of moved nodes from noisy displacement, where forces need them.

    Model and data pass one and the same low-pass then, in all records, so that filtering does not bias.
    """
    order = max(
        (_derivative_needed(network, str(c.at)) for c in network.inputs if c.quantity == "displacement"),
        default=0,
    )
    if not order:
        return records
    needs = [c for c in network.inputs if c.quantity == "displacement"]
    step = records[0].step
    cutoff = min(_bandwidth(r, network, c, order) for r in records for c in needs)
    nyquist = 0.5 / step
    if cutoff > 0.7 * nyquist or any(abs(r.step - step) > 1e-3 * step for r in records):
        return records
    from scipy.signal import firwin

    # what is compared is sampled so that next to nothing but the pass band is left
    thin = math.ceil(nyquist / cutoff)
    cutoff = 0.85 * nyquist / thin
    size = min(2 * math.ceil(4.0 / (cutoff * step)) + 1, 2 * (min(r.samples for r in records) // 8) + 1)
    taps = firwin(size, cutoff, fs=1 / step, window=("kaiser", 6.0))
    # derivative and comparison each pass the filter, which has to guess what was before and after the record
    margin = min(math.ceil(len(taps) / thin), min(r.samples for r in records) // (8 * thin))
    out = []
    for r in records:
        inputs, slopes = dict(r.inputs), {}
        for c in needs:
            x = low_pass(r.inputs[c.name], taps)
            v = np.gradient(x, step, edge_order=2)
            inputs[c.name] = x
            slopes[c.name] = (v, np.gradient(v, step, edge_order=2))
        out.append(
            replace(
                r,
                inputs=inputs,
                slopes=slopes,
                measured=low_pass(r.measured, taps)[margin * thin : r.samples - margin * thin : thin],
                taps=taps,
                margin=margin,
                thin=thin,
            )
        )
    return out


def _derivative_needed(network: Network, node: str) -> int:
    """How often the displacement of a moved node has to be differentiated: 2 where inertia acts on it."""
    here = [e for e in network.elements if e.place == "between" and node in e.where]
    if any(e.linear()[2] for e in here):
        return 2
    reads = any(c.quantity == "force" and c.at == node for c in network.outputs)
    return 1 if reads or any(e.linear()[1] for e in here) else 0


def _bandwidth(record: Record, network: Network, channel: Channel, order: int) -> float:
    """Frequency [Hz] up to which a displacement's derivative of that order is signal, not noise.

    Where noise matters and a force is measured at the node, the band ends where the model makes, from there on up, half as
    much power again of the measured motion as the force has: that is noise. A missing effect does so in places only.
    Without a force to compare with the band ends in the valley between motion and noise.
    Infinite where noise is too little to matter.
    """
    from scipy.signal import welch

    x, step = record.inputs[channel.name], record.step
    a = np.diff(x, order)
    n = min(2048, len(a) // 4)
    f, s = welch(a, 1 / step, nperseg=n)
    width = max(3, len(f) // 64)

    def smooth(density: Array) -> Array:
        window = np.ones(width) / width
        return np.exp(np.convolve(np.log(np.maximum(density, 1e-300)), window, mode="same"))

    level = smooth(s)
    peak = int(np.argmax(level[: max(2, len(f) // 2)]))
    valley = peak + int(np.argmin(level[peak : len(f) - width]))
    if math.sqrt(s[valley:].sum() / max(s.sum(), 1e-300)) < 0.02:
        return math.inf
    end = float(f[valley])
    cell = next(
        (j for j, c in enumerate(network.outputs) if c.quantity == "force" and c.at == channel.at), None
    )
    if cell is not None:
        w = 2 * math.pi * f
        here = [e for e in network.elements if e.place == "between" and channel.at in e.where]
        k, c, b = (sum(e.linear()[q] for e in here) for q in range(3))
        made = s / np.maximum(2 * np.sin(0.5 * w * step), 1e-9) ** (2 * order)
        made = smooth(made * np.abs(k + 1j * w * c - w**2 * b) ** 2)
        force = record.measured[:, cell]
        _, s = welch(force - force.mean(), 1 / step, nperseg=n)
        seen = smooth(s)
        made = made * (seen[:valley].sum() / max(made[:valley].sum(), 1e-300))  # the parameters may be off
        signal = np.flatnonzero(made[: len(f) - width] < 1.5 * seen[: len(f) - width])
        end = float(f[signal[-1]])
    return max(end, float(20 * f[1]))


def split_records(
    estimation: list[Record], held: list[Record], notes: list[str]
) -> tuple[list[Record], list[Record]]:
    if held:
        return estimation, held
    if len(estimation) > 1:
        count = max(1, len(estimation) // 3)
        notes.append(f"held out: {', '.join(r.name for r in estimation[-count:])}")
        return estimation[:-count], estimation[-count:]
    record = estimation[0]
    at = (2 * len(record)) // 3
    notes.append("held out: the last third of the only record")
    return [record.part(0, at, record.name)], [record.part(at, len(record), f"{record.name} (last third)")]


def stretches(record: Record, seconds: float = STRETCH) -> list[Record]:
    count = max(1, int(len(record) * record.rate / seconds))
    count = min(count, max(1, len(record) // (400 if seconds == STRETCH else 200)))
    edges = np.linspace(0, len(record), count + 1).astype(int)
    return [record.part(a, b, record.name) for a, b in pairwise(edges)]
