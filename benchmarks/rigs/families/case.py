"""From a family's rig and a kind of what is hidden to a case: truth, records, the model as its owner believes it."""

from __future__ import annotations

import copy
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.signal import lfilter

from ..case import Case
from .bench import (
    COARSE,
    Drive,
    Fit,
    Rig,
    changed,
    outputs,
    run,
    scale,
    set_relative,
    shares,
)
from .effects import FIRST, Change, Hidden, cogging, coulomb, hardening, quadratic
from .plant import Array, Model, Run
from .rivals import imitated

if TYPE_CHECKING:
    from numpy.random import Generator
    from numpy.typing import NDArray

MAIN = {
    "linear_stiffness": "stiffness",
    "linear_damping": "damping",
    "inertance": "inertance",
    "coulomb_friction": "level",
    "motor": "thrust_constant",
}
"""The parameter of each type that the owner knows only roughly."""


@dataclass(frozen=True)
class Family:
    draw: Callable[[Generator], Rig]
    kinds: Mapping[str, Hidden]


# ------------------------------------------------------------------------------------------------------ the case
def spreads(rig: Rig, spread: float) -> dict[str, float]:
    """How well the owner knows each parameter (relative, one sigma): a damping three times as badly as the rest."""
    out = {f"{node}.mass": spread for node in rig.model["masses"]}
    for name in rig.model.get("bodies", {}):
        out |= {f"{name}.mass": spread, f"{name}.inertia.pitch": spread}
    for e in rig.model["elements"]:
        if e["type"] in MAIN:
            out[f"{e['name']}.{MAIN[e['type']]}"] = spread * (
                3.0 if e["type"] == "linear_damping" else 1.0
            )
    return {k: v for k, v in out.items() if k not in rig.known}


def unbounded(rig: Rig) -> dict[str, float]:
    """Every parameter, free to change by factors."""
    return dict.fromkeys(spreads(replace(rig, known=()), 1.0), 1.0)


Measure = Callable[[dict[str, Array]], float]


def sized(
    rig: Rig, make: Callable[[float], Change], aim: float, measure: Measure
) -> Change:
    """The change of the size at which `measure` of the channels comes to `aim`, within 15 % where it can be had."""
    x, low, high, best = 0.3, 1e-5, 30.0, (np.inf, 0.3)
    for _ in range(12):
        model = changed(rig.model, make(x), "trial")
        try:
            got = max(
                measure(
                    outputs(rig, model, run(rig, model, rig.drives[0], creep=COARSE))
                ),
                1e-9,
            )
        except ArithmeticError:
            got = np.inf
        best = min(best, (abs(np.log(got / aim)), x))
        low, high = (x, high) if got < aim else (low, x)
        if best[0] < 0.15 or high / low < 1.5:
            break
        step = (aim / got) ** 0.8 if np.isfinite(got) else 0.2
        x = float(np.clip(x * step, 1.2 * low, high / 1.2))
    return make(best[1])


SMALL = {
    "coulomb_friction": coulomb,
    "quadratic_damping": quadratic,
    "cubic_stiffness": hardening,
    "cogging_force": cogging,
}


def nuisances(rig: Rig, taken: set[str], r: Generator) -> Change:
    """One to three small effects, as every rig has, each moving its channels by less than 1.5 % of their deviation."""
    total, ran = Change(), run(rig, rig.model, rig.drives[0])
    plain = outputs(rig, rig.model, ran)

    def moved(y: dict[str, Array]) -> float:
        return max(shares(rig.model, y, plain).values())

    for _ in range(int(r.integers(1, 4))):
        name, pair = (
            str(r.choice(list(SMALL))),
            rig.pairs[int(r.integers(len(rig.pairs)))],
        )
        make, aim = (
            SMALL[name](r, scale(rig, ran, pair), pair),
            float(r.uniform(0.003, 0.012)),
        )
        if f"{name} {pair}" in taken:
            continue
        taken.add(f"{name} {pair}")
        change = sized(rig, make, aim, moved)
        model = changed(rig.model, change, "nuisance")
        if (
            moved(outputs(rig, model, run(rig, model, rig.drives[0], creep=COARSE)))
            < 0.015
        ):
            total += change
    return total


#: what is hidden must leave so much, in shares of the signal: times the noise, and in any case
TOLD = (2.0, 0.05)
#: and no more, or nobody would have believed the model
MOST = 1.2
#: what the nearest rival must leave, for an effect that has a name, and for one that has none
ALONE, NAMELESS = (0.5, 0.012), (1.5, 0.04)


def make_case(family: Family, kind: str, seed: int) -> Case:
    """One case of `kind` ("family.what"); every choice is drawn from `kind` and `seed`."""
    hidden = family.kinds[kind.split(".", 1)[1]]
    for attempt in range(60):
        r = np.random.default_rng([zlib.crc32(kind.encode()), seed, attempt])
        try:
            case = _attempt(family, hidden, kind, seed, r)
        except ArithmeticError:
            continue
        if case is not None:
            return case
    raise ArithmeticError(f"{kind} {seed}: no rig on which this could be told")


def _attempt(
    family: Family, hidden: Hidden, kind: str, seed: int, r: Generator
) -> Case | None:
    rig = family.draw(r)
    spread = float(r.choice([0.02, 0.03, 0.05, 0.10]))
    stated = spreads(rig, spread)
    snr_db = float(r.uniform(*rig.snr_db))
    noise = 10 ** (-snr_db / 20)
    channel = rig.model["outputs"][0]["name"]
    answer = hidden.answer
    if isinstance(answer, list):
        answer = [
            [effect, channel if place == FIRST else place] for effect, place in answer
        ]
    change = hide(rig, hidden, channel, stated, noise, r)
    if change is None:
        return None
    small = nuisances(
        rig, {f"{e['type']} {tuple(e.get('between', ()))}" for e in change.elements}, r
    )
    without = changed(rig.model, small, "nuisance")
    true = changed(without, change, "hidden")
    runs = [run(rig, true, drive) for drive in rig.drives]
    seen = [outputs(rig, true, ran) for ran in runs]
    if not told(rig, hidden, change, runs[0], seen[0], noise):
        return None
    left = Fit(rig, seen[0], stated).left()
    if hidden.parts and not max(TOLD[0] * noise, TOLD[1]) < max(left.values()) < MOST:
        return None
    visibility = shares(
        rig.model, outputs(rig, without, run(rig, without, rig.drives[0])), seen[0]
    )
    if not hidden.parts:
        visibility = dict.fromkeys(visibility, 0.0)
    owner = copy.deepcopy(rig.model)
    owner["uncertainty"] = stated
    for path, sigma in stated.items():
        set_relative(owner, path, sigma * r.uniform(-1.0, 1.0))
    sensors = Noise.draw(
        r, owner, {k: float(np.std(y)) for k, y in seen[0].items()}, snr_db
    )
    records = [
        sensors.record(r, rig, drive, y)
        for drive, y in zip(rig.drives, seen, strict=True)
    ]
    played = [
        {"type": "backlash", "gap": gap, "in": spring} for spring, gap in change.play
    ]
    truth = {
        "model": true,
        "hidden": [dict(e) for e in change.elements]
        + played
        + [dict(e) for _, e in change.bushings],
        "nuisances": [dict(e) for e in small.elements],
    }
    second = records[1] if len(records) > 1 else None
    return Case(
        kind,
        seed,
        owner,
        records[0],
        second,
        copy.deepcopy(answer),
        truth,
        snr_db,
        spread,
        visibility,
        left,
    )


def hide(
    rig: Rig,
    hidden: Hidden,
    channel: str,
    stated: dict[str, float],
    noise: float,
    r: Generator,
) -> Change | None:
    """Return the hidden change at a size that leaves the drawn share of error; None where no size leaves that share.

    The error is that of a fit with all parameters free, so that the shape of the law alone is visible. For linear
    hidden effects, the fit holds the parameters that the owner holds.
    """
    if not hidden.parts:
        return Change()
    ran = run(rig, rig.model, rig.drives[0])
    places = [
        (shape, channel if place == FIRST else place) for shape, place in hidden.parts
    ]
    parts = [shape(r, scale(rig, ran, place), place) for shape, place in places]
    weights = np.exp(r.uniform(-0.3, 0.3, len(parts)))
    spread = stated if hidden.linear else unbounded(rig)

    def make(x: float) -> Change:
        return sum(
            (part(x * w) for part, w in zip(parts, weights, strict=True)), Change()
        )

    def left(y: dict[str, Array]) -> float:
        return max(Fit(rig, y, spread, 0.05 if hidden.linear else 0.01).left().values())

    least = max(TOLD[0] * noise, TOLD[1], hidden.gap[0])
    aim = float(
        np.exp(r.uniform(np.log(least), np.log(max(hidden.gap[1], 1.2 * least))))
    )
    change = sized(rig, make, aim, left)
    model = changed(rig.model, change, "trial")
    reached = left(outputs(rig, model, run(rig, model, rig.drives[0], creep=COARSE)))
    return change if reached > 0.7 * least else None


def told(
    rig: Rig,
    hidden: Hidden,
    change: Change,
    ran: Run,
    seen: dict[str, Array],
    noise: float,
) -> bool:
    """Whether no law of the library but the hidden one could be meant."""
    unknown = hidden.answer == "unknown"
    times, least = NAMELESS if unknown else ALONE
    if not hidden.parts or hidden.linear:
        return True
    gap = max(Fit(rig, seen, unbounded(rig), 0.01).left().values())
    for i, e in enumerate(change.elements):
        if "between" not in e or e["type"] in (
            "linear_stiffness",
            "linear_damping",
            "inertance",
        ):
            continue
        first, second = e["between"]
        d, v = (q[first] - q[second] for q in (ran.position, ran.velocity))
        _, rest = imitated(ran.link[f"hidden_{i + 1}"], d, v, e["type"])
        if gap * rest < max(times * noise, least):
            return False
    return True


@dataclass(frozen=True)
class Noise:
    """What the sensors add: white noise, noise with a memory of one sample, or steps of a quantised reading."""

    sort: dict[str, str]
    level: dict[str, float]
    offset: dict[str, float]

    @classmethod
    def draw(
        cls, r: Generator, model: Model, deviation: Mapping[str, float], snr_db: float
    ) -> Noise:
        sort, offset = {}, {}
        for o in model["outputs"]:
            stepped = o["quantity"] == "displacement" and r.random() < 0.35
            sort[o["name"]] = (
                "quantised" if stepped else str(r.choice(["white", "memory"]))
            )
            offset[o["name"]] = (
                deviation[o["name"]] * r.uniform(-0.5, 0.5)
                if o.get("offset") == "free"
                else 0.0
            )
        return cls(
            sort, {k: d * 10 ** (-snr_db / 20) for k, d in deviation.items()}, offset
        )

    def record(
        self, r: Generator, rig: Rig, drive: Drive, y: Mapping[str, Array]
    ) -> dict[str, NDArray[Any]]:
        table: dict[str, NDArray[Any]] = {"time": np.arange(rig.size) * rig.interval}
        for i in rig.model["inputs"]:
            column = drive.inputs[i["name"]].value
            if i["quantity"] == "displacement":
                column = column + 10 ** (-rig.input_db / 20) * np.std(
                    column
                ) * r.standard_normal(rig.size)
            table[i["name"]] = column
        for k, column in y.items():
            column, level = column + self.offset[k], self.level[k]
            if self.sort[k] == "quantised":
                step = np.sqrt(12.0) * level
                table[k] = step * np.round(
                    (column + 0.05 * step * r.standard_normal(rig.size)) / step
                )
            elif self.sort[k] == "white":
                table[k] = column + level * r.standard_normal(rig.size)
            else:
                memory = 0.5
                white = (
                    level * np.sqrt(1 - memory**2) * r.standard_normal(rig.size + 50)
                )
                table[k] = column + lfilter([1.0], [1.0, -memory], white)[50:]
        return table
