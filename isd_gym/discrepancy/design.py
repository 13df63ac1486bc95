"""The test that tells rivals apart: chosen among parametrised excitations within what the rig can do."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data import Table, write_table
from ..errors import InputError, shown
from ..errors import plain as one_line
from ..inputs import read_json
from .candidate import BROKEN, Candidate
from .excitation import Excitation, Rig, candidates, default, record_of, rig_of, table_of
from .fit import Fitter, residuals
from .judge import LEAST_NOISE
from .noise import innovations, plain
from .problem import Array, Problem, Record
from .structure import Hypothesis, Structure, rebuilt

if TYPE_CHECKING:
    from ..network import Network

FINALS = 5  # tests for which rivals are refitted in full
MOST = 3  # rivals that are held against one another
SAMPLES = 12000  # of a test that are simulated while tests are compared


@dataclass(frozen=True, eq=False)
class Rival:
    """A set of effects at its values: `structure` and `x`, its free numbers (transformed). label: what it is called."""

    label: str
    structure: Structure
    x: Array


@dataclass(frozen=True, eq=False)
class Design:
    """A test that was designed, in words (`text`), as numbers (`excitation`, played within `rig`) and as the `record` that plays it.

    separation: distance [standard deviations of the noise, over the whole record] of the two
    rivals that stay closest, the one refitted to the other; `closest` names them, `watch` the channel that shows most of it.
    usual: the same for a multisine over all of the band. tried: how many tests there were to choose among. told: of a
    test that is for no rivals in particular: hypotheses that it tells, that the usual one tells, and how many there are.
    """

    excitation: Excitation
    rig: Rig
    record: Record
    text: str
    separation: float = 0.0
    closest: tuple[str, str] = ("", "")
    watch: str = ""
    usual: float = 0.0
    tried: int = 0
    told: tuple[int, int, int] = (0, 0, 0)

    @property
    def sentence(self) -> str:
        """What was chosen and why."""
        head = f"Of {self.tried} tests the one that tells"
        usual = "a multisine over all of the band"
        if self.closest[0]:
            a, b = self.closest
            return (
                f"{head} {a} from {b} best: {self.text}. They stay {self.separation:.3g} standard deviations of the noise apart "
                f"({self.usual:.3g} by {usual}); watch {self.watch}."
            )
        told, before, of = self.told
        return (
            f"{head} most: {self.text}. At a twentieth of the force it tells {told} of {of} hypotheses from all others, "
            f"{usual} {before}."
        )

    def to_dict(self) -> dict[str, Any]:
        """As a diagnosis has it in `next_experiment`."""
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
        """Write the inputs as a table that a rig can play, and that `simulate` reads.

        path: of the table, its suffix tells the format; network: the model whose inputs they are.
        """
        write_test(path, network, self.record)


def played(network: Network, record: Record) -> Table:
    """The inputs of a record as a table for a file without units of its own: a column ``name [unit]`` for each.

    network: the model whose inputs they are, in its channels' units; record: holds them in SI units.
    """
    table = table_of(network, record)
    named = {f"{k} [{table.units[k]}]": v for k, v in table.columns.items()}
    return replace(table, columns=named, units={})


def write_test(path: str | Path, network: Network, record: Record) -> None:
    """The inputs of a record as a table: time [s] and, in text files, a column ``name [unit]`` for each.

    path: of the table, its suffix tells the format; network: the model whose inputs they are; record: holds them [SI unit].
    """
    text = Path(path).suffix.lower() in (".csv", ".txt", ".tsv")
    write_table(path, played(network, record) if text else table_of(network, record))


class Bout:
    """Rivals under one test: each in turn is the truth, and the others are refitted to it."""

    def __init__(self, network: Network, record: Record, rivals: Sequence[Rival], noise: Array):
        self.rivals = rivals
        blank = Problem(network, [record], ["fit"])
        outputs = []
        for r in rivals:
            y = blank.simulate([r.structure.at(r.x)], 0)[:, :, 0]
            if not np.isfinite(y).all() or np.abs(y).max() > 1e12:
                raise InputError("breaks down")
            outputs.append(y)
        self.outputs = outputs
        self.problem = Problem(network, [replace(record, measured=outputs[0])], ["fit"])
        level = np.maximum(noise, LEAST_NOISE * np.max([y.std(axis=0) for y in outputs], axis=0))
        self.noise = np.where(level > 0, level, 1.0)

    def linear(self) -> float:
        """The least distance of two, to first order of what refitting does."""
        least = math.inf
        for b, r in enumerate(self.rivals):
            f = Fitter(self.problem, plain(self.noise))
            n0 = len(_rest(self.problem, r.structure))
            fit = f.fit(r.structure, r.x, {0: np.zeros(n0)}, iterations=0)
            others = [y for k, y in enumerate(self.outputs) if k != b]
            change = np.stack([y - fit.outputs[0] for y in others], axis=2)
            _, left = f.refit(fit, {0: change})
            least = min(least, float(np.sqrt(np.sum(left[0] ** 2, axis=(0, 1)).min())))
        return least

    def full(self) -> tuple[float, tuple[str, str], int]:
        """(least distance, who it is between, the channel that shows most of it), after refitting in full."""
        best: tuple[float, tuple[str, str], int] = (math.inf, ("", ""), 0)
        for a, truth in enumerate(self.rivals):
            record = replace(self.problem.records[0], measured=self.outputs[a])
            p = Problem(self.problem.network, [record], ["fit"], time=self.problem.time)
            for b, r in enumerate(self.rivals):
                if a == b:
                    continue
                n0 = len(_rest(p, r.structure))
                f = Fitter(p, plain(self.noise)).fit(
                    r.structure, r.x, {0: np.zeros(n0)}, iterations=6, tolerance=1e-3
                )
                (left,) = residuals(p, f)
                level = math.sqrt(2.0) * self.noise
                whole = innovations([left], level) - innovations([0.0 * left], level)
                power = np.sum((left / self.noise) ** 2, axis=0)
                distance = math.sqrt(max(whole, 0.0))
                if distance < best[0]:
                    best = distance, (truth.label, r.label), int(np.argmax(power))
        return best


def _rest(problem: Problem, structure: Structure) -> Array:
    from ..network import assemble
    from .problem import bare

    return np.zeros(assemble(bare(structure.network)).size[0])


def design(
    network: Network,
    rivals: Sequence[Rival],
    rig: Rig,
    noise: Array,
    *,
    tests: Iterable[Excitation] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Design | None:
    """The test within `rig` under which the two of `rivals` that stay closest are furthest apart.

    network: the owner's model. noise (channels,): RMS of the outputs [their units]. tests: to choose among, else
    `candidates`. progress: called with a stage and its share. Returns None where fewer than two rivals are left, or none
    of the tests can be simulated.
    """
    say = progress or (lambda name, share: None)
    rivals = list(rivals)[:MOST]
    if len(rivals) < 2:
        return None
    every = list(candidates(network, rig) if tests is None else tests)
    ranked = []
    for k, e in enumerate(every):
        say("tests", k / len(every))
        try:
            ranked.append((Bout(network, _short(network, rig, e), rivals, noise).linear(), k))
        except BROKEN:
            continue
    ranked.sort(key=lambda p: -p[0])
    best: Design | None = None
    usual = 0.0
    finalists = [k for _, k in ranked[:FINALS]]
    for n, k in enumerate(dict.fromkeys([*finalists, *([0] if any(q == 0 for _, q in ranked) else [])])):
        say("refits", n / (FINALS + 1))
        e = every[k]
        record = record_of(network, rig, e, "next experiment")
        try:
            distance, pair, channel = Bout(network, record, rivals, noise).full()
        except BROKEN:
            continue
        usual = distance if k == 0 else usual
        if best is None or distance > best.separation:
            watch = network.outputs[channel].name
            best = Design(e, rig, record, e.describe(network, rig), distance, pair, watch, tried=len(every))
    say("tests", 1.0)
    say("refits", 1.0)
    return None if best is None else replace(best, usual=usual)


def _short(network: Network, rig: Rig, e: Excitation) -> Record:
    record = record_of(network, rig, e)
    return record if len(record) <= SAMPLES else record.part(0, SAMPLES, record.name)


def noise_of(network: Network, rig: Rig, given: Mapping[str, float], records: Sequence[Record] = ()) -> Array:
    """RMS noise of every output [its unit] (channels,): as given, of the model file, as records of it tell, else 1 % of its
    deviation under a multisine over all of the band.

    network: the owner's model; rig: what can play that multisine. given: by the output's name; records: what was measured, where it was.
    """
    from .stand import measured_noise

    known = measured_noise(records, network)
    record = record_of(network, rig, default(network, rig))
    y = Problem(network, [record], ["fit"]).simulate([network], 0)[:, :, 0]
    out = []
    for j, c in enumerate(network.outputs):
        value = given.get(c.name, c.noise) or known.get(c.name)
        out.append(value or LEAST_NOISE * float(y[:, j].std()) or 1.0)
    return np.array(out)


# ------------------------------------------------------------------------------------------------ whose rivals


def next_experiment(problem: Problem, contenders: Sequence[Candidate], floor: Array) -> Design | None:
    """The test that would decide between what a diagnosis could not tell apart, within the range of its own records.

    problem: the diagnosis', whose records to fit by tell what the rig can do. contenders: as fitted, the foremost first.
    floor (channels,): RMS of the noise [the channels' units]. None where the model has no inputs, its records tell of no rig, or `design` finds none.
    """
    if not problem.network.inputs:
        return None
    rivals = [Rival(c.label, c.fit.structure, c.fit.x) for c in contenders]
    try:
        records = [r for i, r in enumerate(problem.records) if problem.roles[i] == "fit"]
        rig = rig_of(problem.network, records)
    except InputError:
        return None
    return design(problem.network, rivals, rig, np.asarray(floor, dtype=np.float64))


def rivals_of(network: Network, result: str | Path | Mapping[str, Any]) -> list[Rival]:
    """The rivals that a diagnosis was left with, from its JSON. Raises `InputError` where there are none to tell apart.

    network: the owner's model that was diagnosed; result: the path of its diagnosis.json, or what stands in it.
    """
    data = result if isinstance(result, Mapping) else read_json(result)
    name = "the diagnosis" if isinstance(result, Mapping) else str(result)
    if not isinstance(data, Mapping) or not str(data.get("schema", "")).startswith("isd-diagnosis/"):
        raise InputError(f"{name}: is no result of a diagnosis (isd-diagnosis/1)")
    rows = data.get("alternatives") or []
    try:
        if any(not row.get("values") for row in rows[:MOST]):
            raise InputError(f"{name}: its alternatives have no values; run the diagnosis again")
        told = {path: float(q["value"]) for path, q in (data.get("parameters") or {}).items()}
        fitted = {path: value for path, value in told.items() if math.isfinite(value)}
        out = [_rival(network, row, fitted) for row in rows[:MOST]]
    except InputError:
        raise
    except (AttributeError, KeyError, StopIteration, TypeError, ValueError) as error:
        raise InputError(
            f"{name}: its alternatives do not fit the model '{network.name}' ({one_line(str(error))})"
        ) from None
    if len(out) < 2:
        raise InputError(
            f"{name}: its verdict is {shown(str(data.get('verdict')))}, there are no rivals to tell apart"
        )
    return out


def _rival(network: Network, row: Mapping[str, Any], fitted: Mapping[str, float]) -> Rival:
    """One of the `alternatives` of a diagnosis, its owner's parameters as `fitted`."""
    values = row["values"]
    effects = []
    for effect, where, value, options in zip(
        row["effects"], row["where"], values, row.get("options") or [{}] * len(values), strict=True
    ):
        chosen = dict(options)
        behind = chosen.pop("behind", "")
        if behind and behind not in {e.name for e in network.elements}:
            raise KeyError(behind)
        effects.append((Hypothesis(effect, tuple(where), tuple(chosen.items()), behind), dict(value)))
    structure = rebuilt(network, effects)
    x = structure.start
    for k, f in enumerate(structure.free):
        if f.owner < 0 and f.path in fitted:
            x[k] = min(max(f.forward(fitted[f.path]), f.low), f.high)
    return Rival(" and ".join(h.label for h, _ in effects), structure, x)


__all__ = ["Design", "Rival", "design", "next_experiment", "noise_of", "played", "rivals_of", "write_test"]
