"""The causal linear-quadratic bound, and the position of the triples of Tables 7 and 8."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import brentq

from ...benchmark.lq_bounds import best_acceleration, lq_bound, lq_front
from ...benchmark.lq_bounds import reference as passive_rms
from ...benchmark.scoring import PAPER
from ...physics.road import paper_road
from ...view.report.plots import LOOKS, figure, number, percent
from .study import PRINTED, Claim, Section, Study, Table

if TYPE_CHECKING:
    from collections.abc import Sequence


def causal_bound(study: Study) -> Section:
    """Compare the causal bound with Tables 7 and 8.

    Args:
        study: Shared results.

    Returns:
        The section.
    """
    study.progress("causal bound", 0.0)
    base = passive_rms()
    (b7, a7), (b8, a8) = PAPER.values()
    change7 = [q / p - 1 for p, q in zip(b7, a7, strict=True)]
    change8 = [q / p - 1 for p, q in zip(b8, a8, strict=True)]
    asked = [
        ("Table 7's travel and tyre load", change7[1], change7[2], change7[0], None),
        (
            "the same against Table 7's own passive row",
            change7[1],
            change7[2],
            change7[0],
            b7,
        ),
        ("no worse in either", 0.0, 0.0, None, None),
        ("travel −10 %, tyre load +2.4 %", -0.10, 0.024, None, None),
        ("Table 8's travel and tyre load", change8[1], change8[2], change8[0], None),
    ]
    roads = {
        f"Table 7's, on a road that is flat below {c:g} cycle/m": replace(
            paper_road(), cutoff=c
        )
        for c in (0.002, 0.005, 0.011)
    }
    rows: list[Sequence[str]] = []
    found: list[dict[str, Any]] = []
    for i, (label, travel, tyre, claimed, against) in enumerate(asked):
        best = best_acceleration(travel, tyre, against=against)
        found.append(
            {
                "case": label,
                "travel": travel,
                "tyre": tyre,
                "bound": best.acceleration_change,
                "paper": claimed,
            }
        )
        rows.append(
            (
                label,
                percent(travel),
                percent(tyre),
                percent(best.acceleration_change),
                percent(claimed),
            )
        )
        study.progress("causal bound", (i + 1) / len(asked))
    for label, ground in roads.items():
        best = best_acceleration(change7[1], change7[2], road=ground)
        ours, claimed = best.acceleration_change, change7[0]
        found.append(
            {
                "case": label,
                "travel": change7[1],
                "tyre": change7[2],
                "bound": ours,
                "paper": claimed,
            }
        )
        rows.append(
            (
                label,
                percent(change7[1]),
                percent(change7[2]),
                percent(ours),
                percent(claimed),
            )
        )
    loosest = min(f["bound"] for f in found if f["paper"] == change7[0])
    study.figures["causal_bound"] = {"reference": base.tolist(), "cases": found}
    study.claims.append(
        Claim(
            "Table 7",
            f"acceleration {percent(change7[0])}, travel {percent(change7[1])}, tyre load {percent(change7[2])} in simulation",
            f"any force between body and wheel, full state, no limits: {percent(found[0]['bound'])} at that travel and tyre load "
            f"({percent(found[1]['bound'])} against the paper's own passive row)",
            f"not possible in expectation for any causal controller of this car; {percent(loosest)} is the most under any reading tried here",
        )
    )
    # equation (8) with motor forces of 100, 200, 400 N RMS
    eq8: list[Sequence[str]] = []
    eq8_figures = []
    thrust = 60.0 * 4.056
    for force in (100.0, 200.0, 400.0):

        def gap(log_effort: float, force: float = force) -> float:
            return (
                lq_bound(
                    PRINTED, weights=(1, 1e-6, 1e-6), effort=math.exp(log_effort)
                ).effort
                * thrust
                - force
            )

        point = lq_bound(
            PRINTED,
            weights=(1, 1e-6, 1e-6),
            effort=math.exp(brentq(gap, -25, 20, xtol=1e-3)),
        )
        change = point.triple / base - 1
        eq8_figures.append({"force": force, "change": change.tolist()})
        eq8.append((f"{force:.0f} N", *(percent(float(c)) for c in change)))
    study.figures["eq8_lq"] = eq8_figures
    study.evidence.append(
        (
            "can eq. (8) as printed reach Table 7?",
            "LQ optimum of acceleration, no friction, motor force of 100/200/400 N RMS: "
            + "/".join(r[1] for r in eq8) + ", tyre load " + "/".join(r[3] for r in eq8),
            "no; kept as a variant, ISDSuspensionEq8-v0",
        )
    )  # fmt: skip
    study.evidence.append(
        (
            "can anything reach Table 7?",
            f"causal LQ bound at its travel and tyre load: {percent(found[0]['bound'])}; Table 8's triple ({percent(change8[0])}) lies inside "
            f"its own ({percent(found[4]['bound'])})",
            "Table 7 is reported with the bound beside it; Table 8 is the ambition",
        )
    )
    fig = figure(7.2, 3.6)
    ax = fig.subplots()
    grid = np.linspace(-0.34, 0.06, 9 if study.quick else 17)
    for tyre, look in zip((change7[2], 0.027, 0.10), LOOKS[1:], strict=False):
        front = lq_front(tyre, list(grid))
        ax.plot(100 * front[:, 0], 100 * front[:, 1], color=look.colour, ls=look.line, lw=1.5,
                label=f"causal bound, tyre load {percent(tyre)}")  # fmt: skip
    ax.plot(0, 0, "s", color=LOOKS[0].colour, ms=6)
    ax.annotate(
        "conventional passive car",
        (0, 0),
        (-6, -3),
        textcoords="offset points",
        ha="right",
        va="top",
    )
    for name, c, marker, away, side in (
        ("Table 7", change7, "*", (-9, 0), "right"),
        ("Table 8", change8, "p", (9, 8), "left"),
    ):
        ax.plot(100 * c[1], 100 * c[0], marker, mfc="white", mec=LOOKS[0].colour, ms=10)
        ax.annotate(
            f"{name}, tyre {percent(c[2])}",
            (100 * c[1], 100 * c[0]),
            away,
            textcoords="offset points",
            ha=side,
            va="center",
        )
    ax.set_xlabel("change of suspension travel [%]")
    ax.set_ylabel("change of body acceleration [%]")
    ax.set_ylim(-32, 6)
    fig.legend(loc="outside upper left", ncols=3, fontsize=8)
    caption = (
        "The least acceleration of any causal controller over travel, at three tyre loads, against the conventional passive car. Below a line "
        "nothing is at that tyre load: Table 7's point lies below its own line (blue), Table 8's above its own (orange, dashed)."
    )
    picture = study.picture(
        fig,
        "causal_bound",
        "The causal bound",
        "Acceleration over travel: bound and the paper",
        caption,
    )
    return Section(
        "What any controller could reach",
        [
            "Whatever stands between body and wheel, its force acts on these two masses only. The linear-quadratic optimum of that force, "
            "with full state, without friction or limits, bounds every suspension on a road of white velocity, on average. It depends on the masses, the "
            "tyre and the shape of the road's spectrum alone: the changes depend neither on how rough the road is nor on the speed."
        ],
        [
            Table(
                "Best acceleration at a given travel and tyre load, against the conventional passive car "
                f"({number(base[0])} m/s², {number(1e3 * base[1])} mm, {number(base[2])} N)",
                ("case", "travel", "tyre load", "bound of acceleration", "the paper"),
                rows,
            ),
            Table(
                "Equation (8) as printed: the oil spring of 709 kN/m holds the device almost rigid",
                ("motor force, RMS", "acceleration", "travel", "tyre load"),
                eq8,
                "LQ optimum of acceleration with full state, friction left out.",
            ),
        ],
        [picture],
    )  # fmt: skip
