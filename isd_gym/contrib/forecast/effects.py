"""Smallest nameable size of each effect under a planned test."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym.diagnosis._estimation.structure import owner_pair
from isd_gym.diagnosis._simulation.problem import BROKEN
from isd_gym.diagnosis._verdict.gates import decide
from isd_gym.physics.elements import parameter_fields

from .detectability import find_smallest_scale, refit_rival, simulate_effect
from .result import Amount, EffectForecast
from .sensitivity import FARTHEST, NEGLIGIBLE, is_rival
from .virtual_bench import REQUIRED_DEVIANCE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isd_gym._common.arrays import Array
    from isd_gym.diagnosis._estimation.structure import Hypothesis
    from isd_gym.physics.elements import Start

    from .detectability import SimulatedEffect
    from .planning._design import Progress
    from .sensitivity import Distances, LawShape, Sensitivities
    from .virtual_bench import VirtualBench

RIVALS = 4  # refitted per effect at most
CLEAR = 12.0  # multiple of the required distance above which a rival is not refitted


@dataclass(frozen=True, eq=False)
class _Rival:
    """A rival of one effect."""

    hypothesis: Hypothesis
    distance: float  # linearised, at the size of the effect's start
    #: closest starts of the rival, and their amplitudes at the size of the effect's start
    starts: list[tuple[LawShape, Array]]


def forecast_effects(
    bench: VirtualBench, responses: Sensitivities, wanted: Sequence[Hypothesis], progress: Progress
) -> tuple[list[EffectForecast], Array]:
    """Forecast the result of a diagnosis for each hypothesis.

    Args:
        bench: The virtual bench.
        responses: Sensitivities to all hypotheses.
        wanted: The hypotheses.
        progress: Function that receives the stage and the finished share.

    Returns:
        The forecasts, and the matrix of distances; see `Plan`.
    """
    linear, groups = responses.distances(), responses.by_hypothesis
    typical = {responses.shapes[k].hypothesis: t for t, k in enumerate(responses.typical)}
    forecasts, matrix = [], np.full((len(wanted), len(wanted)), np.nan)
    for n, h in enumerate(wanted):
        progress("sizes", n / len(wanted))
        if h.kind.loaded and bench.load_of(h) is None:  # under one load it is Coulomb friction
            rival = replace(h, effect="coulomb_friction", options=())
            labels = (rival.label,) if rival.stands(bench.network) else ()
            status = "confused" if labels else "hidden"
            forecasts.append(_make_forecast(bench, h, status, confused_with=labels))
            continue
        if h not in typical:
            forecasts.append(_make_forecast(bench, h, "untried"))
            continue
        t, scale = typical[h], 1.0
        if linear.response[t] < 1e-6:
            forecasts.append(_make_forecast(bench, h, "unseen"))
        elif linear.remainder[t] < NEGLIGIBLE * linear.response[t]:
            forecasts.append(_make_forecast(bench, h, "hidden"))
        else:
            shape = responses.shapes[responses.typical[t]]
            forecast, scale = _find_smallest_size(bench, shape, _rank_rivals(responses, linear, h, t))
            forecasts.append(forecast)
        for j, other in enumerate(wanted):
            if other == h:
                matrix[n, j] = scale * linear.remainder[t]
            elif other in groups:
                matrix[n, j] = scale * linear.to_shape[t, groups[other]].min()
    progress("sizes", 1.0)
    return forecasts, matrix


def _rank_rivals(responses: Sensitivities, linear: Distances, h: Hypothesis, t: int) -> list[_Rival]:
    """Return the rivals of a hypothesis, closest first; `t` is the index of the typical shape."""
    rivals = []
    for r, members in responses.by_hypothesis.items():
        if is_rival(responses.bench.network, r, h):
            order = sorted(members, key=lambda k: float(linear.to_shape[t, k]))
            starts = [
                (responses.shapes[k], linear.amplitude[t, k])
                for k in order[:2]
                if linear.amplitude[t, k].any()
            ]
            rivals.append(_Rival(r, float(linear.to_shape[t, order[0]]), starts))
    return sorted(rivals, key=lambda r: r.distance)


def _find_smallest_size(
    bench: VirtualBench, shape: LawShape, rivals: Sequence[_Rival]
) -> tuple[EffectForecast, float]:
    """Find the smallest size that a diagnosis names.

    Args:
        bench: The virtual bench.
        shape: The typical shape of the effect.
        rivals: Rivals, closest first.

    Returns:
        The forecast, and the size as a multiple of the start's size (1 if no size is named).
    """
    h, start = shape.hypothesis, shape.start
    found = _simulate_near_limit(bench, h, start)
    if found is None:
        return _make_forecast(bench, h, "untried"), 1.0
    effect, size, scale = found  # size as a multiple of the start's, scale of the size without rivals
    if not size * scale <= FARTHEST:
        limits = _limits(effect, FARTHEST / size, with_rivals=False)
        return _make_forecast(bench, h, "hidden", limited_by=limits), 1.0
    near = [r for r in rivals if r.distance * size * scale < CLEAR * math.sqrt(REQUIRED_DEVIANCE)][:RIVALS]
    named = math.inf
    for _ in range(2):
        _refit_rivals(effect, near, size)
        named = find_smallest_scale(effect.is_named)
        if not size * named <= FARTHEST or named < 1.6 * max(scale, 1.0):
            break
        try:
            effect = simulate_effect(bench, h, h.kind.grown(start, size * named))
        except BROKEN:
            break
        size, scale = size * named, 1.0
    reached = named if math.isfinite(named) else scale
    distances = [
        (r.hypothesis.label, math.sqrt(max(r.residual.excess_deviance(reached), 0.0))) for r in effect.rivals
    ]
    common: dict[str, Any] = {
        "varied": _scaled_parameters(h, start),
        "near": tuple(sorted(distances, key=lambda x: x[1])),
    }
    seen = find_smallest_scale(effect.is_significant)
    if math.isfinite(seen):
        common["seen"] = h.kind.grown(start, size * seen)
    if not size * named <= FARTHEST:
        confused = tuple(
            r.hypothesis.label for r in effect.rivals if not effect.is_distinguishable(r, FARTHEST / size)
        )
        confused = confused or tuple(label for label, _ in distances[:1])
        return _make_forecast(bench, h, "confused", confused_with=confused, **common), 1.0
    common["smallest"] = h.kind.grown(start, size * named)
    common["share"] = effect.evidence(named).effects[0].share
    limits = _limits(effect, 0.93 * named, with_rivals=True)
    return _make_forecast(bench, h, "named", limited_by=limits, **common), size * named


def _simulate_near_limit(
    bench: VirtualBench, h: Hypothesis, start: Start
) -> tuple[SimulatedEffect, float, float] | None:
    """Simulate an effect near the smallest size that is named without rivals.

    Returns:
        The simulated effect, the simulated size as a multiple of the start's size, and the smallest named size as a
        multiple of the simulated size. None if all simulations fail.
    """
    size, found = 1.0, None
    for _ in range(4):  # the response is not quite linear in the size
        try:
            effect = simulate_effect(bench, h, h.kind.grown(start, size))
        except BROKEN:
            if found is not None or size < 0.05:
                break
            size *= 0.2
            continue
        scale = find_smallest_scale(partial(effect.is_named, with_rivals=False))
        found = effect, size, scale
        if not math.isfinite(scale) or 0.8 < scale < 1.25 or size * scale > FARTHEST:
            break
        size *= min(max(scale, 0.05), 10.0)
    return found


def _refit_rivals(effect: SimulatedEffect, rivals: Sequence[_Rival], size: float) -> None:
    """Refit rivals to an effect of `size` times the start's size, and store the rivals in the effect."""
    effect.rivals = []
    for r in rivals:
        starts = [s.hypothesis.kind.sized(s.start, size * a[: len(s.columns)]) for s, a in r.starts]
        refitted = refit_rival(effect, r.hypothesis, starts) if starts else None
        if refitted is not None:
            effect.rivals.append(refitted)


def _limits(effect: SimulatedEffect, scale: float, *, with_rivals: bool) -> tuple[str, ...]:
    """Return the gates that an effect fails at a multiple of the simulated size, and rivals that are too close."""
    evidence = effect.evidence(scale, with_rivals=with_rivals)
    failed = [g.name for g in decide(evidence, effect.bench.criteria).gates if not g.passed]
    rivals = (
        f"distinguishable: {', '.join(evidence.indistinguishable)}"
        if evidence.indistinguishable
        else "distinguishable"
    )
    return tuple(rivals if name == "distinguishable" else name for name in failed) or (
        "agrees within what is material",
    )


def _scaled_parameters(h: Hypothesis, start: Start) -> tuple[str, ...]:
    """Return the parameters that scale with the effect's size."""
    one, two = h.kind.grown(start, 1.0), h.kind.grown(start, 2.0)
    return tuple(key for key in one if one[key] != two[key])


def _make_forecast(
    bench: VirtualBench,
    h: Hypothesis,
    status: str,
    smallest: Mapping[str, float] | None = None,
    seen: Mapping[str, float] | None = None,
    **more: Any,
) -> EffectForecast:
    """Make the forecast of a hypothesis; see `EffectForecast` for the arguments."""
    units = {f.name: f.metadata["unit"] for f in parameter_fields(h.kind)}
    if h.place == "channel":
        own = next(c.unit for c in bench.network.outputs if c.name == h.where[0])
        units = {k: own if u == "unit of the channel" else u for k, u in units.items()}

    def amounts(values: Mapping[str, float] | None) -> dict[str, Amount]:
        return {k: Amount(float(v), units[k]) for k, v in (values or {}).items() if k in units}

    where = tuple(owner_pair(bench.network, h) or h.where)
    forecast = EffectForecast(h.label, h.effect, where, tuple(h.choices.items()), status, **more)
    return replace(forecast, smallest=amounts(smallest), seen=amounts(seen))
