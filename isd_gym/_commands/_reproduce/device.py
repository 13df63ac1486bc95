"""Table 1: area ratio, inertance, stroke."""

from __future__ import annotations

import math

from ...view.report.plots import number, percent
from .study import Claim, Section, Study


def device(study: Study) -> Section:
    """Recompute Table 1: area ratio, inertance, stroke.

    Args:
        study: Shared results.

    Returns:
        The section.
    """
    main = math.pi / 4 * (0.063**2 - 0.020**2)
    deputy = math.pi / 4 * (0.032**2 - 0.012**2)
    ratio = main / deputy
    inertance = 5.6 * ratio**2
    stroke = 0.100 / ratio
    study.figures["table_1"] = {
        "area_ratio": ratio,
        "inertance": inertance,
        "stroke": stroke,
    }
    study.claims.append(
        Claim(
            "Table 6, eq. (5)",
            "inertance b = 95 kg",
            f"Table 1 through equation (5): {number(ratio, 4)}² · 5.6 kg = {number(inertance)} kg",
            f"holds within {percent(95 / inertance - 1, 0, sign=False)}; the mass of the deputy rod makes up the rest",
        )
    )
    row = ("stroke ±50 mm (Table 1)", f"the deputy's ±100 mm end the device's travel at ±{number(1e3 * stroke, 4)} mm",
           "an end stop stands there in the default network")  # fmt: skip
    study.evidence.append(row)
    return Section(
        "The device (Table 1)",
        [
            f"The areas of Table 1 give a ratio of {number(ratio, 4)} and, with the mover's 5.6 kg, an inertance of "
            f"{number(inertance)} kg. The deputy cylinder's stroke of ±100 mm is ±{number(1e3 * stroke, 4)} mm at the "
            "device's terminals, tighter than the ±50 mm that the main cylinder prints."
        ],
    )
