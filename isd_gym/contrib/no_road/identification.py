"""Refit of a linear model without a measured road, and search for a missing linear effect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from isd_gym._common.errors import InputError, shown
from isd_gym.diagnosis._estimation.noise import floors_of
from isd_gym.diagnosis._estimation.structure import base_structure, unchecked
from isd_gym.diagnosis._hypotheses.library import hypotheses
from isd_gym.diagnosis._records.reading import read_record
from isd_gym.diagnosis._simulation.problem import Problem
from isd_gym.diagnosis._simulation.time_limit import TimeLimit
from isd_gym.physics.network import Network
from isd_gym.physics.network._frames import order_told
from isd_gym.records._loggers.recording import Recording
from isd_gym.records.data import Table

from .decision import decide
from .estimation import LINEAR, build_model, fit_effect, fit_model

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from .kalman import KalmanModel
    from .result import UnknownInputResult

MAX_SECONDS = 120.0  # limit of the processor time of a search [s]


def identify(
    data: Sequence[Table | Recording | str | Path],
    model: Network | str | Path | Mapping[str, Any],
    *,
    road: str | None = None,
    effects: bool = True,
    accept: Sequence[str] = (),
    max_seconds: float = MAX_SECONDS,
) -> UnknownInputResult:
    """Refit a model to records without their road, and name a missing linear effect.

    Args:
        data: Tables or files with the outputs and inputs of the model except the road.
        model: The nominal model.
        road: The unmeasured input; by default the input with ``"measured": false``, or the only moved node.
        effects: Whether to search for missing linear effects.
        accept: Names of data checks to reduce to warnings.
        max_seconds: Limit of processor time [s]. The search stops at the limit, with a note.

    Returns:
        Verdict, refitted model and determined parameters.

    Raises:
        InputError: Data or model do not allow an identification without the road.
    """
    if not max_seconds > 0:
        raise InputError(f"the time limit must be > 0 s, not {max_seconds:g} s")
    nominal = Network.load(model)
    notes: list[str] = []
    start = prepare_model(data, nominal, road, accept, notes)
    network = start.structure.network
    clock = TimeLimit(max_seconds)
    x = np.array([p.mean for p in start.priors])
    nominal_fit = fit_model(start, x, clock, fixed=len(start.structure.free))
    refit = fit_model(start, nominal_fit.x, clock)
    candidates = [
        h
        for h in hypotheses(network)
        # in the frame of the road no effect can be tied to the ground, whose distance is unknown
        if effects and h.effect in LINEAR and not order_told(network, (h.where[0], h.where[-1]))
    ]
    tried, done = [], 0
    for h in candidates:
        fit = None if clock.is_over else fit_effect(refit, h, clock)
        if clock.is_over:
            break
        done += 1
        if fit is not None:
            tried.append((h, fit))
    tried.sort(key=lambda item: item[1].deviance)
    if clock.is_over:
        notes.append(
            f"the time limit of {max_seconds:g} s stopped the search: {done} of {len(candidates)} linear effects were tried"
            + ("" if refit.converged else ", and the refit had not converged")
        )
    return decide(nominal, nominal_fit, refit, tried, (done, len(candidates)), clock, notes)


def prepare_model(
    data: Sequence[Table | Recording | str | Path],
    nominal: Network,
    road: str | None,
    accept: Sequence[str],
    notes: list[str],
) -> KalmanModel:
    """Return the Kalman model of the records at the start of a fit; arguments and errors as in `identify`."""
    network, name = _move_to_road_frame(nominal, road)
    # the channels without the road: a network would have to move the node
    channels = unchecked(network, inputs=tuple(c for c in network.inputs if c.name != name))
    tables = [data] if isinstance(data, Table | Recording | str | Path) else data
    records = [read_record(t, channels, notes, accept) for t in tables]
    if not records:
        raise InputError("data: no records")
    step = records[0].step
    for r in records:
        if r.reading is not None:
            raise InputError(
                f"{r.name}: its channels have several sampling rates or clocks. Identification without the road needs one "
                "sampling rate and one clock; --cut accepts such records"
            )
        if abs(r.step - step) > 1e-3 * step:
            raise InputError("the records are sampled at different rates: resample them to one")
    problem = Problem(channels, records)
    spread = problem.deviation() / problem.factors
    noise = np.array([f.deviation for f in floors_of(problem)]) / problem.factors
    rows = []
    for r in records:
        u = np.array([r.inputs[c.name] for c in channels.inputs]).reshape(-1, len(r)).T
        y = (r.measured - r.measured.mean(axis=0)) / problem.factors
        # about the mean the model is linear about rest: sensor offsets and mean inputs have no effect
        rows.append((np.ascontiguousarray(u - u.mean(axis=0)), np.ascontiguousarray(y)))
    noise = np.clip(noise, 1e-4 * spread, 0.3 * spread)
    return build_model(base_structure(network), name, tuple(rows), step, noise)


def _move_to_road_frame(network: Network, road: str | None) -> tuple[Network, str]:
    """Return a network in the frame of its unmeasured road, driven by the road's velocity, and the road's name."""
    unmeasured = [c for c in network.moving if not c.measured]
    moving = [c for c in network.moving if c.name == road] if road else unmeasured or list(network.moving)
    if len(moving) != 1 or moving[0].quantity != "displacement":
        known = ", ".join(c.name for c in network.moving) or "none"
        raise InputError(
            f"the road that was not measured must be one moved node's displacement (there are: {known}), not {shown(road)}"
        )
    (c,) = moving
    for o in network.outputs:
        if o.quantity == "force" and o.at == c.at:
            raise InputError(
                f"output '{o.name}' is a force at '{c.at}', the node whose motion is unknown: leave it out"
            )
    velocity = network.probe(c.name, "velocity", at=c.at)
    inputs = tuple(velocity if o is c else o for o in network.inputs)
    between = tuple(e for e in network.elements if e.place == "between")
    return replace(network, inputs=inputs, elements=between), c.name
