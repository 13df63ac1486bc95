"""Figure 6: friction from the slow triangle."""

from __future__ import annotations

import numpy as np

from ...view.report.plots import LOOKS, MUTED, figure
from .rig import force_test
from .study import AMPLITUDE, RIG, RIG_PRINTED, TABLE_4, Claim, Section, Study


def slow_test(study: Study) -> Section:
    """Recompute Figure 6, the 0.1 Hz triangle.

    Args:
        study: Shared results.

    Returns:
        The section.
    """
    study.progress("force tests", 0.0)
    tests = {
        n: force_test(n, 0.1, periods=1, wave="triangle", step=1e-3)
        for n in (RIG, RIG_PRINTED)
    }
    plateau = {n: float(np.median(np.abs(f))) for n, (_, _, f) in tests.items()}
    peak = {n: float(np.percentile(np.abs(f), 99.5)) for n, (_, _, f) in tests.items()}
    level = plateau[RIG]
    study.figures["figure_6"] = {
        "series": {"plateau": level, "peak": peak[RIG]},
        "printed": {"peak": peak[RIG_PRINTED]},
        "paper": 500.0,
    }
    fig = figure(7.2, 2.9)
    axes = fig.subplots(1, 2)
    for ax, (time, _, force), title, look in zip(
        axes,
        tests.values(),
        ("oil spring in series", "as printed: in parallel (eq. 6)"),
        LOOKS[1:3],
        strict=True,
    ):
        ax.plot(time - time[0], force / 1e3, color=look.colour, ls="-", lw=1.2)
        ax.set_title(title)
        ax.set_xlabel("time [s]")
        ax.axhline(0.5, color=MUTED, lw=0.9, ls=":")
        ax.axhline(-0.5, color=MUTED, lw=0.9, ls=":")
    axes[0].set_ylabel("force [kN]")
    axes[0].set_ylim(-0.8, 0.8)
    caption = (
        "Figure 6 anew: force over one period of the 0.1 Hz triangle of 10 mm; dotted, the ±0.5 kN read from the paper's figure. "
        f"The scales differ: the printed arrangement adds the oil spring's triangle of ±{TABLE_4['oil.stiffness'] * AMPLITUDE / 1e3:.1f} kN."
    )
    study.claims.append(
        Claim(
            "Figure 6",
            "a square wave of 0.5 kN at 0.1 Hz shows the friction",
            f"series: ±{level:.0f} N, square; printed equation (6): ±{peak[RIG_PRINTED] / 1e3:.1f} kN, a triangle",
            "holds only with the oil spring in series; contradicts equations (6) and (8)",
        )
    )
    study.evidence.append(
        (
            "oil stiffness in parallel (eq. 6, 8)",
            f"0.1 Hz triangle: in parallel ±{peak[RIG_PRINTED] / 1e3:.1f} kN, in series ±{level:.0f} N; Figure 6 shows ±0.5 kN",
            "default network: oil spring in series",
        )
    )
    pictures = [
        study.picture(
            fig,
            "figure_6",
            "Figure 6",
            "Force over time at 0.1 Hz, two arrangements",
            caption,
        )
    ]
    return Section(
        "Friction from the slow test (Figure 6)",
        [
            f"With the oil spring in series the force of the slow test is a square wave whose plateau is {level:.0f} N: the "
            f"seal's 500 N and the leak's {level - 500:.0f} N. With the oil spring in parallel, as equation (6) has it, the same "
            f"device would answer with {peak[RIG_PRINTED] / 1e3:.1f} kN. The paper's figure and its equation cannot both be right."
        ],
        pictures=pictures,
    )
