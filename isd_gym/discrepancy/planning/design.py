"""Design of tests: the excitation that best distinguishes rivals, or most hypotheses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...data import Table, write_table
from ...errors import InputError, shown
from ...errors import plain as one_line
from ...inputs import read_json
from ...network import assemble
from ..estimation.gauss_newton import Fitter, residuals
from ..estimation.noise import innovations, white_filters
from ..estimation.structure import Hypothesis, Structure, rebuilt
from ..hypotheses.library import hypotheses
from ..selection.criteria import CRITERIA
from ..simulation.problem import BROKEN, Array, Problem, Record, bare
from .excitation import Excitation, Rig, infer_rig, list_excitations, make_excitation, make_record, make_table
from .sensitivity import Sensitivities, choose_starts, select_hypotheses
from .virtual_bench import VirtualBench, measured_noise

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from ...network import Network
    from ..selection.candidate import Candidate
    from .plan_result import Progress

FINALISTS = 5  # tests for which rivals are refitted in full
MOST = 3  # rivals that are compared
SAMPLES = 12000  # of a test in the linearised comparison of rivals
FEW_SAMPLES = 6000  # of a test in the linearised comparison of all hypotheses


@dataclass(frozen=True, eq=False)
class Rival:
    """A set of effects with values."""

    label: str  # names of the effects
    structure: Structure  # the nominal model with the effects
    x: Array  # transformed free parameters (parameters,)


@dataclass(frozen=True, eq=False)
class Design:
    """A designed test."""

    excitation: Excitation  # the test signal
    rig: Rig  # the rig with the limits
    record: Record  # with the inputs of the test
    text: str  # description of the test
    #: distance of the two closest rivals after a refit [standard deviations of the noise, over the whole record]
    separation: float = 0.0
    closest: tuple[str, str] = ("", "")  # labels of these rivals; empty for a test without given rivals
    watch: str = ""  # channel with the largest difference
    usual: float = 0.0  # separation by a multisine over the whole band
    tried: int = 0  # number of compared tests
    #: hypotheses that the test distinguishes, that the multisine distinguishes, and number of hypotheses
    told: tuple[int, int, int] = (0, 0, 0)

    @property
    def sentence(self) -> str:
        """The choice and its reason."""
        usual = "a multisine over the whole band"
        if self.closest[0]:
            return (
                f"The best of {self.tried} tests to distinguish {' from '.join(self.closest)}: {self.text}. "
                f"Their distance is {self.separation:.3g} standard deviations of the noise ({self.usual:.3g} under {usual}). "
                f"Watch {self.watch}."
            )
        told, before, count = self.told
        return (
            f"The best of {self.tried} tests: {self.text}. At a twentieth of the force, {told} of {count} hypotheses are "
            f"distinguishable from all rivals ({before} under {usual})."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the test as `next_experiment` of a diagnosis."""
        return {
            "do": self.text,
            "watch": self.watch,
            "separates": list(self.closest),
            "separation_sigma": self.separation,
            "usual_sigma": self.usual,
            "tried": self.tried,
            "excitation": self.excitation.to_dict(),
        }

    def save(self, path: str | Path, network: Network) -> None:
        """Write the inputs as a table for a rig or for `simulate`.

        Args:
            path: Path of the table. Text files have a column ``name [unit]`` per input.
            network: The model with the inputs.
        """
        is_text = Path(path).suffix.lower() in (".csv", ".txt", ".tsv")
        write_table(path, (played if is_text else make_table)(network, self.record))


def played(network: Network, record: Record) -> Table:
    """Make the table of a record's inputs for a file format without units.

    Args:
        network: The model with the inputs.
        record: The record.

    Returns:
        The table with a column ``name [unit]`` per input, in the channels' units.
    """
    table = make_table(network, record)
    named = {f"{k} [{table.units[k]}]": v for k, v in table.columns.items()}
    return replace(table, columns=named, units={})


# ------------------------------------------------------------------------------------------------ given rivals


class RivalComparison:
    """Comparison of rivals under one test: each rival in turn is the truth, and the others are refitted.

    Args:
        network: The nominal model.
        record: The record of the test.
        rivals: The rivals.
        noise: RMS noise (channels,) [unit of the channel].

    Raises:
        InputError: The simulation of a rival fails.
    """

    def __init__(self, network: Network, record: Record, rivals: Sequence[Rival], noise: Array):
        self.rivals = rivals
        blank = Problem(network, [record])
        self.outputs = [blank.simulate([r.structure.at(r.x)], 0)[:, :, 0] for r in rivals]
        if not all(np.isfinite(y).all() and np.abs(y).max() <= 1e12 for y in self.outputs):
            raise InputError("the simulation of a rival fails")
        self.problem = Problem(network, [replace(record, measured=self.outputs[0])])
        level = np.maximum(
            noise, CRITERIA.least_noise * np.max([y.std(axis=0) for y in self.outputs], axis=0)
        )
        self.noise = np.where(level > 0, level, 1.0)

    def linear_distance(self) -> float:
        """Return the smallest linearised distance of two rivals [standard deviations of the noise]."""
        least, fitter = math.inf, Fitter(self.problem, white_filters(self.noise))
        for b, r in enumerate(self.rivals):
            fit = fitter.fit(r.structure, r.x, {0: _rest_state(r.structure)}, iterations=0)
            others = [y for k, y in enumerate(self.outputs) if k != b]
            _, left = fitter.refit(fit, {0: np.stack([y - fit.outputs[0] for y in others], axis=2)})
            least = min(least, float(np.sqrt(np.sum(left[0] ** 2, axis=(0, 1)).min())))
        return least

    def distance(self) -> tuple[float, tuple[str, str], int]:
        """Compute the smallest distance of two rivals after a full refit.

        Returns:
            The distance [standard deviations of the noise], the labels of the two rivals, and the index of the channel
            with the largest difference.
        """
        best: tuple[float, tuple[str, str], int] = (math.inf, ("", ""), 0)
        level = math.sqrt(2.0) * self.noise
        for a, truth in enumerate(self.rivals):
            record = replace(self.problem.records[0], measured=self.outputs[a])
            p = Problem(self.problem.network, [record], time=self.problem.time)
            fitter = Fitter(p, white_filters(self.noise))
            for b, r in enumerate(self.rivals):
                if a == b:
                    continue
                start = {0: _rest_state(r.structure)}
                (left,) = residuals(p, fitter.fit(r.structure, r.x, start, iterations=6, tolerance=1e-3))
                deviance = innovations([left], level) - innovations([0.0 * left], level)
                distance = math.sqrt(max(deviance, 0.0))
                if distance < best[0]:
                    power = np.sum((left / self.noise) ** 2, axis=0)
                    best = distance, (truth.label, r.label), int(np.argmax(power))
        return best


def _rest_state(structure: Structure) -> Array:
    """Return the initial state at rest (states,)."""
    return np.zeros(assemble(bare(structure.network)).size[0])


def design_test(
    network: Network,
    rivals: Sequence[Rival],
    rig: Rig,
    noise: Array,
    *,
    tests: Iterable[Excitation] | None = None,
    progress: Progress | None = None,
) -> Design | None:
    """Choose the test that maximises the distance of the two closest rivals.

    Args:
        network: The nominal model.
        rivals: The rivals, most important first.
        rig: The rig.
        noise: RMS noise (channels,) [unit of the channel].
        tests: Tests to be compared. Default: `list_excitations`.
        progress: Function that receives the stage and the finished share.

    Returns:
        The test, or None for fewer than two rivals or if no test can be simulated.
    """
    progress = progress or (lambda name, share: None)
    rivals = list(rivals)[:MOST]
    if len(rivals) < 2:
        return None
    every = list(list_excitations(network, rig) if tests is None else tests)
    ranked = []
    for k, e in enumerate(every):
        progress("tests", k / len(every))
        try:
            record = make_record(network, rig, e, samples=SAMPLES)
            ranked.append((RivalComparison(network, record, rivals, noise).linear_distance(), k))
        except BROKEN:
            continue
    finalists = [k for _, k in sorted(ranked, key=lambda p: -p[0])[:FINALISTS]]
    # the first test is the reference
    reference = [0] if any(k == 0 for _, k in ranked) else []
    best: Design | None = None
    usual = 0.0
    for n, k in enumerate(dict.fromkeys([*finalists, *reference])):
        progress("refits", n / (FINALISTS + 1))
        e = every[k]
        record = make_record(network, rig, e, "next experiment")
        try:
            distance, pair, channel = RivalComparison(network, record, rivals, noise).distance()
        except BROKEN:
            continue
        usual = distance if k == 0 else usual
        if best is None or distance > best.separation:
            watch = network.outputs[channel].name
            best = Design(e, rig, record, e.describe(network, rig), distance, pair, watch, tried=len(every))
    progress("tests", 1.0)
    progress("refits", 1.0)
    return None if best is None else replace(best, usual=usual)


def next_experiment(problem: Problem, contenders: Sequence[Candidate], floor: Array) -> Design | None:
    """Design the test that distinguishes the contenders of a diagnosis, within the range of the records.

    Args:
        problem: Model and records of the diagnosis.
        contenders: Fitted candidates, best first.
        floor: RMS noise (channels,) [unit of the channel].

    Returns:
        The test, or None if the model has no inputs or no test can be designed.
    """
    if not problem.network.inputs:
        return None
    rivals = [Rival(c.label, c.fit.structure, c.fit.x) for c in contenders]
    try:
        rig = infer_rig(problem.network, [problem.records[i] for i in problem.estimation])
    except InputError:
        return None
    return design_test(problem.network, rivals, rig, np.asarray(floor, dtype=np.float64))


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
        if any(not row.get("values") for row in rows[:MOST]):
            raise InputError(f"{name}: its alternatives have no values; run the diagnosis again")
        stated = {path: float(q["value"]) for path, q in (data.get("parameters") or {}).items()}
        fitted = {path: value for path, value in stated.items() if math.isfinite(value)}
        out = [_read_rival(network, row, fitted) for row in rows[:MOST]]
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


# ---------------------------------------------------------------------------------------------- all hypotheses


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
        values.append(known.get(c.name, c.noise) or CRITERIA.least_noise * float(signal.std()) or 1.0)
    return np.array(values)
