"""All sections on one page."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.files import check_folder, whole_folder, write_text
from ...view.report.plots import page, percent, style
from .causal_bound import causal_bound
from .device import device
from .identification import table_4
from .response import response
from .road_level import road_level
from .simulation import simulation
from .slow_test import slow_test
from .study import KIND, PARTS, SCHEMA, Progress, Section, Study, Table
from .sweep import sweep

if TYPE_CHECKING:
    from collections.abc import Callable

SECTIONS: tuple[Callable[[Study], Section], ...] = (
    device, slow_test, table_4, response, road_level, causal_bound, simulation, sweep,
)  # fmt: skip


def reproduce(
    out: Path, quick: bool = False, progress: Progress | None = None
) -> dict[str, Any]:
    """Reproduce and audit the paper: write ``index.html``, the figures as SVG and ``reproduction.json`` atomically.

    Args:
        out: Folder of the results.
        quick: Whether few and short episodes are driven.
        progress: Called with a task and its finished share.

    Returns:
        Figures, claims, tables and sentences (`isd-reproduction/1`).

    Raises:
        InputError: The folder holds other files, or cannot be written.
    """
    out = Path(out)
    check_folder(out, KIND, "reproduction.json", PARTS)
    with style(), whole_folder(out, KIND, "reproduction.json", PARTS) as place:
        study = Study(place, quick, progress or (lambda task, share: None))
        sections = [make_section(study) for make_section in SECTIONS]
        claims = Section(
            "The claims",
            [],
            [
                Table(
                    "",
                    ("in the paper", "it says", "computed here", "verdict"),
                    [(c.place, c.says, c.found, c.verdict) for c in study.claims],
                    texts=(0, 1, 2, 3),
                )
            ],
        )
        evidence = Section(
            "What the paper leaves open or contradicts, and what was decided",
            [],
            [
                Table(
                    "",
                    ("question", "evidence, computed afresh", "decision"),
                    study.evidence,
                    texts=(0, 1, 2),
                    wrap=True,
                )
            ],
        )
        sections = [claims, *sections, evidence]
        lead = _lead(study)
        result = {
            "schema": SCHEMA,
            "quick": quick,
            "lead": lead,
            "claims": [c.__dict__ for c in study.claims],
            "evidence": [
                dict(zip(("question", "evidence", "decision"), row, strict=True))
                for row in study.evidence
            ],
            "tables": [
                {
                    "section": s.title,
                    "title": t.title,
                    "heads": list(t.heads),
                    "rows": [list(r) for r in t.rows],
                    "note": t.note,
                }
                for s in sections
                for t in s.tables
            ],
            "figures": study.figures,
        }
        sub = (
            "Quick run: few and short episodes; figures scatter."
            if quick
            else "All figures computed by this run."
        )
        write_text(
            place / "reproduction.json",
            json.dumps(plain(result), indent=1, allow_nan=False) + "\n",
        )
        write_text(
            place / "index.html",
            page("reproduce.html", sections=sections, lead=lead, sub=sub),
        )
    return result


def _lead(study: Study) -> str:
    bound = study.figures["causal_bound"]["cases"]
    slow = study.figures["figure_6"]
    return (
        f"The force tests hold together only if the oil spring is in series, not in parallel as printed (0.1 Hz: {slow['series']['plateau']:.0f} N against "
        f"{slow['printed']['peak'] / 1e3:.1f} kN). Table 8's bench result ({percent(bound[4]['paper'])} acceleration) is possible. Table 7's simulation "
        f"({percent(bound[0]['paper'])}) is not: no causal controller does better than {percent(bound[0]['bound'])} at its travel and tyre load. "
        "The agreement with pure inertance in 2–5 Hz follows from the printed parameters in neither arrangement."
    )


def plain(value: Any) -> Any:
    """Return plain data for JSON; values that are not finite become null.

    Args:
        value: Any value.

    Returns:
        Plain data.
    """
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
