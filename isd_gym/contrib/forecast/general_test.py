"""A test that distinguishes all hypotheses, the rivals of an earlier diagnosis, and the noise of a test."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError, shown
from isd_gym._common.errors import plain as one_line
from isd_gym._common.inputs import read_json
from isd_gym.diagnosis._estimation.structure import Hypothesis, rebuilt
from isd_gym.diagnosis._hypotheses.library import hypotheses
from isd_gym.diagnosis._selection.criteria import LEAST_NOISE
from isd_gym.diagnosis._simulation.problem import BROKEN, Problem, Record

from .planning._design import MAX_RIVALS, Design, Rival
from .planning._excitation import (
    Excitation,
    Rig,
    list_excitations,
    make_excitation,
    make_record,
)
from .sensitivity import Sensitivities, choose_starts, select_hypotheses
from .virtual_bench import VirtualBench, measured_noise

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from isd_gym._common.arrays import Array
    from isd_gym.physics.network import Network

    from .planning._design import Progress

FEW_SAMPLES = 6000  # of a test in the linearised comparison of all hypotheses


def read_rivals(network: Network, result: str | Path | Mapping[str, Any]) -> list[Rival]:
    """Read the rivals of an undecided diagnosis.

    Args:
        network: The diagnosed model.
        result: Path of the diagnosis.json, or the content of the file.

    Returns:
        At least two rivals, best first.

    Raises:
        InputError: The file is no diagnosis of the model, or contains fewer than two rivals.
    """
    data = result if isinstance(result, Mapping) else read_json(result)
    name = "the diagnosis" if isinstance(result, Mapping) else str(result)
    if not isinstance(data, Mapping) or not str(data.get("schema", "")).startswith("isd-diagnosis/"):
        raise InputError(f"{name}: is no result of a diagnosis (isd-diagnosis/1)")
    rows = data.get("alternatives") or []
    try:
        if any(not row.get("values") for row in rows[:MAX_RIVALS]):
            raise InputError(f"{name}: its alternatives have no values; run the diagnosis again")
        stated = {path: float(q["value"]) for path, q in (data.get("parameters") or {}).items()}
        fitted = {path: value for path, value in stated.items() if math.isfinite(value)}
        out = [_read_rival(network, row, fitted) for row in rows[:MAX_RIVALS]]
    except InputError:
        raise
    except (AttributeError, KeyError, StopIteration, TypeError, ValueError) as error:
        raise InputError(
            f"{name}: its alternatives do not fit the model '{network.name}' ({one_line(str(error))})"
        ) from None
    if len(out) < 2:
        raise InputError(
            f"{name}: its verdict is {shown(str(data.get('verdict')))}, there are no rivals to distinguish"
        )
    return out


def _read_rival(network: Network, row: Mapping[str, Any], fitted: Mapping[str, float]) -> Rival:
    """Return the rival of one entry of `alternatives`, with the fitted parameters of the nominal model."""
    values = row["values"]
    effects = []
    for effect, where, value, options in zip(
        row["effects"], row["where"], values, row.get("options") or [{}] * len(values), strict=True
    ):
        choices = dict(options)
        behind = choices.pop("behind", "")
        if behind and behind not in {e.name for e in network.elements}:
            raise KeyError(behind)
        effects.append((Hypothesis(effect, tuple(where), tuple(choices.items()), behind), dict(value)))
    structure = rebuilt(network, effects)
    x = structure.start
    for k, f in enumerate(structure.free):
        if f.owner < 0 and f.path in fitted:
            x[k] = min(max(f.forward(fitted[f.path]), f.low), f.high)
    return Rival(" and ".join(h.label for h, _ in effects), structure, x)


def design_general_test(
    network: Network, rig: Rig, noise: Array, *, only: Sequence[str] = (), progress: Progress | None = None
) -> Design | None:
    """Choose the test that distinguishes most hypotheses, each at a twentieth of the force under a multisine.

    Args:
        network: The nominal model.
        rig: The rig.
        noise: RMS noise (channels,) [unit of the channel].
        only: Effects, nodes or channels that a hypothesis must contain.
        progress: Function that receives the stage and the finished share.

    Returns:
        The test, or None if no test can be simulated.
    """
    progress = progress or (lambda name, share: None)
    known = {c.name: float(s) for c, s in zip(network.outputs, noise, strict=True)}

    def bench_of(e: Excitation) -> VirtualBench:
        return VirtualBench(network, [make_record(network, rig, e, samples=FEW_SAMPLES)], noise=known)

    usual = make_excitation(network, rig)
    every = [usual, *(e for e in list_excitations(network, rig) if e.level == 1.0)]
    first = bench_of(usual)
    starts = choose_starts(first, list(hypotheses(first.network)), 1)
    wanted = set(select_hypotheses(network, only))
    rated = []
    for k, e in enumerate(every):
        progress("tests", k / len(every))
        try:
            sizes = Sensitivities(bench_of(e), starts).smallest_sizes(wanted=wanted)
        except BROKEN:
            continue
        score = float(np.mean(-np.log(np.clip(sizes, 0.05, 20.0)))) if len(sizes) else -9.0
        rated.append((score, e, int(np.sum(sizes <= 1.0)), len(sizes)))
    progress("tests", 1.0)
    if not rated:
        return None
    _, e, told, of = max(rated, key=lambda r: r[0])
    before = rated[0][2] if rated[0][1] is usual else 0
    record = make_record(network, rig, e, "designed")
    text = e.describe(network, rig)
    return Design(e, rig, record, text, tried=len(every) - 1, told=(told, before, of))


def estimate_output_noise(
    network: Network, rig: Rig, given: Mapping[str, float], records: Sequence[Record] = ()
) -> Array:
    """Estimate the RMS noise of each output.

    Args:
        network: The nominal model.
        rig: The rig.
        given: Stated RMS noise by output [unit of the output].
        records: Measured records.

    Returns:
        RMS noise (channels,) [unit of the output]: as given, else as in the model, else as in the records, else 1 % of
        the deviation under a multisine.
    """
    known = {**measured_noise(records, network), **given}
    record = make_record(network, rig, make_excitation(network, rig))
    y = Problem(network, [record]).simulate([network], 0)[:, :, 0]
    values = []
    for c, signal in zip(network.outputs, y.T, strict=True):
        values.append(known.get(c.name, c.noise) or LEAST_NOISE * float(signal.std()) or 1.0)
    return np.array(values)
