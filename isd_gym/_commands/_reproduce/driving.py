"""Policies driven for the paper's tables, and rows of the tables."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ...benchmark.ceilings import reachable as known_optimum
from ...benchmark.policies import find, passive
from ...benchmark.scoring import Score, score
from ...physics.cost import StageCost
from ...physics.network import Network
from ...view.report.plots import percent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .study import Study

#: controllers driven on the series network
DRIVEN = ("isd-passive", "lqg", "mpc-paper", "mpc", "mpc-friction")


def drive_all(
    study: Study, plant: str, names: Sequence[str], episodes: int, duration: float
) -> Score:
    """Drive policies on a plant.

    Args:
        study: Shared results.
        plant: Name of the network.
        names: Names of the policies.
        episodes: Number of episodes.
        duration: Length of an episode [s].

    Returns:
        The score.
    """
    network = Network.load(plant)

    def tell(name: str, share: float) -> None:
        study.progress(f"{name}, {plant}", share)

    known = known_optimum(network, episodes=episodes, duration=duration)
    return score(
        [find(n, network) for n in names], network, reference=passive(network), episodes=episodes, duration=duration,
        clairvoyant=None if known is None else known["value"], progress=tell,
    )  # fmt: skip


def triple(row: dict[str, Any]) -> list[float]:
    """Return the changes of acceleration, travel and tyre load of a row of a score, as fractions.

    Args:
        row: Row of a score.

    Returns:
        Three changes.
    """
    return [
        row[k].get("change", math.nan)
        for k in ("body_acceleration_rms", "suspension_travel_rms", "tyre_load_rms")
    ]


def _score_row(row: dict[str, Any], label: str) -> Sequence[str]:
    cells = [f"{row['policy']}{label}", f"{row['cost']['value']:.3f}"]
    for key, scale, digits in (
        ("body_acceleration_rms", 1.0, 3),
        ("suspension_travel_rms", 1e3, 2),
        ("tyre_load_rms", 1.0, 0),
    ):
        q = row[key]
        cells.append(
            f"{q['value'] * scale:.{digits}f}\u00a0({percent(q.get('change'))})"
        )
    return (*cells, percent(row["share_of_reachable_gain"], 0, sign=False))


def score_rows(found: Score, label: str) -> list[Sequence[str]]:
    """Return the rows of a table of a score.

    Args:
        found: The score.
        label: Suffix of the names.

    Returns:
        Rows of texts.
    """
    return [_score_row(row, label) for row in found.policies]


def own_cost(found: Score) -> float:
    """Return the mean cost of the reference.

    Args:
        found: The score.

    Returns:
        Mean cost [-].
    """
    return float(next(iter(found.runs.values())).cost(StageCost()).mean())
