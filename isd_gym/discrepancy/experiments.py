"""The test that would tell two rivals apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import InputError
from ..network import Network
from .candidate import Candidate
from .problem import Array, Problem, Record


def experiments(network: Network, record: Record) -> list[tuple[str, dict[str, Array], float]]:
    """Candidate tests: (description, inputs, step): sines, a slow triangle, a bump and current steps."""
    step = 2e-3
    t = np.arange(0.0, 10.0, step)
    moved = [c for c in network.inputs if c.quantity == "displacement"]
    current = [c for c in network.inputs if c.quantity == "current"]
    forces = [c for c in network.inputs if c.quantity == "force"]
    silent = {c.name: np.zeros(len(t)) for c in network.inputs}
    out: list[tuple[str, dict[str, Array], float]] = []
    window = np.minimum(1.0, np.minimum(t, t[-1] - t) / 0.5)
    for c in moved:
        x = record.inputs[c.name]
        reach = float(np.ptp(x)) / 2 or 0.01
        for scale in (0.5, 1.5):
            a = scale * reach
            for f in (0.5, 1.5, 4.0, 10.0):
                amplitude = min(a, 0.6 / (2 * math.pi * f))
                out.append(
                    (
                        f"sine of {1e3 * amplitude:.3g} mm at {f:g} Hz at {c.name}",
                        silent | {c.name: amplitude * window * np.sin(2 * math.pi * f * t)},
                        step,
                    )
                )
            out.append(
                (
                    f"triangle of {1e3 * a:.3g} mm at 0.1 Hz at {c.name}",
                    silent | {c.name: a * (2 / math.pi) * np.arcsin(np.sin(2 * math.pi * 0.1 * t))},
                    step,
                )
            )
        bump = np.where((t > 1) & (t < 1.2), 0.5 * (1 - np.cos(2 * math.pi * (t - 1) / 0.2)), 0.0)
        out.append(
            (
                f"bump of {2e3 * reach:.3g} mm, 0.2 s long, at {c.name}",
                silent | {c.name: 2 * reach * bump},
                step,
            )
        )
    for c in current:
        top = float(np.abs(record.inputs[c.name]).max()) or 1.0
        out.append(
            (
                f"steps of {top:.3g} A in {c.name}",
                silent | {c.name: top * np.sign(np.sin(2 * math.pi * 0.7 * t))},
                step,
            )
        )
        out.append(
            (
                f"sine of {top:.3g} A at 1.5 Hz in {c.name}",
                silent | {c.name: top * np.sin(2 * math.pi * 1.5 * t)},
                step,
            )
        )
    for c in forces:
        top = float(np.abs(record.inputs[c.name]).max()) or 1.0
        for f in (0.3, 1.5, 5.0):
            out.append(
                (
                    f"sine of {top:.3g} N at {f:g} Hz at {c.name}",
                    silent | {c.name: top * np.sin(2 * math.pi * f * t)},
                    step,
                )
            )
    return out


def next_experiment(problem: Problem, rivals: Sequence[Candidate], floor: Array) -> dict[str, Any] | None:
    """The candidate test whose outcome the two foremost rivals predict most differently, in noise standard deviations."""
    if len(rivals) < 2:
        return None
    first = problem.records[problem.estimation[0]]
    best: tuple[float, str, str] = (0.0, "", "")
    for text, inputs, step in experiments(problem.network, first):
        n = len(next(iter(inputs.values())))
        blank = Record("experiment", step, inputs, np.zeros((n, len(problem.channels))))
        trial = Problem(problem.network, [blank], ["fit"], problem.step, problem.time)
        try:
            a, b = (trial.simulate([r.fit.network], 0)[:, :, 0] for r in rivals[:2])
        except (InputError, np.linalg.LinAlgError):
            continue
        if not (np.isfinite(a).all() and np.isfinite(b).all()):
            continue
        separation = np.sqrt(np.mean((a - b) ** 2, axis=0)) / np.maximum(floor, 1e-300)
        j = int(np.argmax(separation))
        if separation[j] > best[0]:
            best = float(separation[j]), text, problem.channels[j]
    if not best[1]:
        return None
    names = [r.label for r in rivals[:2]]
    return {"do": best[1], "watch": best[2], "separates": names, "separation_sigma": best[0]}
