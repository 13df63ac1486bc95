"""Section 4.1: the road that gives the passive row of Table 7."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...benchmark.lq_bounds import linear_car, stationary
from ...benchmark.lq_bounds import reference as passive_rms
from ...benchmark.scoring import PAPER
from ...physics.road import PRINTED_KAPPA, paper_road
from ...view.report.plots import number, percent
from .study import SERIES, Claim, Section, Study, Table

if TYPE_CHECKING:
    from collections.abc import Sequence


def road_level(study: Study) -> Section:
    """Compare passive cars and road levels with Table 7.

    Args:
        study: Shared results.

    Returns:
        The section.
    """
    base = passive_rms()
    isd = stationary(linear_car(SERIES))[0]
    readings = [
        ("κ = 5·10⁻⁷ m³/cycle (used here)", base),
        (
            "κ = 5·10⁻⁶ m³/cycle, as printed",
            passive_rms(road=paper_road(PRINTED_KAPPA)),
        ),
        (
            "κ = G₀ n₀² with G₀ = 5·10⁻⁶ m³, n₀ = 0.1",
            passive_rms(road=paper_road(PRINTED_KAPPA * 0.01)),
        ),
    ]
    (b7, _), _ = PAPER.values()
    rows: list[Sequence[str]] = [
        ("Table 7, passive", number(b7[0], 4), number(1e3 * b7[1]), number(b7[2]))
    ]
    rows += [
        (label, number(x[0]), number(1e3 * x[1]), number(x[2])) for label, x in readings
    ]
    rows.append(
        (
            "ISD without current and without friction, κ = 5·10⁻⁷",
            number(isd[0]),
            number(1e3 * isd[1]),
            number(isd[2]),
        )
    )
    study.figures["passive"] = {label: x.tolist() for label, x in readings} | {
        "isd_frictionless": isd.tolist()
    }
    study.evidence += [
        (
            "which “passive”?",
            f"spring and damper in parallel: {number(base[0])} m/s², {number(1e3 * base[1])} mm, {number(base[2])} N in expectation "
            f"(Table 7: {b7[0]}, {1e3 * b7[1]:.1f}, {b7[2]:.0f}); ISD without friction: {number(1e3 * isd[1])} mm",
            "the conventional car is what policies are compared with",
        ),
        (
            "road level",
            f"printed κ = 5e-6: {number(readings[1][1][0])} m/s²; read with n₀ = 0.1: {number(readings[2][1][0])} m/s²; κ = 5e-7: {number(base[0])} m/s²",
            "κ = 5e-7; the printed value is the road 'paper-printed'",
        ),
    ]
    study.claims.append(
        Claim(
            "Table 6",
            "road roughness G₀ = 5·10⁻⁶ m³/cycle",
            f"gives the passive car {number(readings[1][1][0])} m/s²; a tenth of it gives {number(base[0])} (Table 7: {b7[0]})",
            "off by a factor of ten in power, if the passive car is spring and damper in parallel",
        )
    )
    return Section(
        "Which passive car, on which road",
        [
            "Acceleration and tyre load of Table 7's passive row are met by the conventional car, spring and damper in parallel with Table 6's values, if the "
            f"road is ten times smoother (in power) than printed: {percent(base[0] / b7[0] - 1)} and {percent(base[2] / b7[2] - 1)}. Its travel is not: "
            f"{number(1e3 * base[1])} mm, {percent(base[1] / b7[1] - 1)}. All is in expectation, from the Lyapunov equation."
        ],
        [
            Table(
                "",
                (
                    "RMS of the passive car",
                    "acceleration [m/s²]",
                    "travel [mm]",
                    "tyre load [N]",
                ),
                rows,
            )
        ],
    )
