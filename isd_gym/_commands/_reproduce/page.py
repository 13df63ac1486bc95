"""The reproduction on one page."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..._common.files import check_folder, whole_folder, write_text
from ...view.report.plots import page, style
from . import car, rig
from .study import Study

FOLDER = (
    "reproduction",
    "reproduction.json",
    ("index.html", "reproduction.json", "*.svg"),
)
SCHEMA = "isd-reproduction/1"
CLAIM_HEADS = ("in the paper", "it says", "computed here", "verdict")
CAR_TITLE = "The car: RMS, and change against the passive car (Tables 7 and 8)"
CAR_HEADS = ("", "cost J", "acceleration [m/s²]", "travel [mm]", "tyre load [N]")
PARTS: tuple[Callable[[Study], None], ...] = (
    rig.table_1,
    rig.figure_6,
    rig.table_4,
    rig.figures_3_4,
    rig.figure_7,
    car.road_level,
    car.drive,
)


def check_target(out: Path) -> None:
    """Check before long work that a reproduction can be written to a folder."""
    check_folder(out, *FOLDER)


def reproduce(
    out: Path,
    quick: bool = False,
    progress: Callable[[str, float], None] = lambda task, share: None,
) -> dict[str, Any]:
    """Reproduce and audit the paper: write ``index.html``, the figures as SVG and ``reproduction.json`` atomically.

    Args:
        out: Folder of the results.
        quick: Whether few and short episodes are driven.
        progress: Called with a task and its finished share.

    Returns:
        Claims, rows of the table of cars, and figures (`isd-reproduction/1`).

    Raises:
        InputError: The folder holds other files, or cannot be written.
    """
    with style(), whole_folder(out, *FOLDER) as place:
        study = Study(place, quick, progress)
        for make in PARTS:
            make(study)
        result: dict[str, Any] = {
            "schema": SCHEMA,
            "quick": quick,
            "claims": [vars(claim) for claim in study.claims],
            "cars": study.cars,
            "figures": study.figures,
        }
        text = json.dumps(result, indent=1, allow_nan=False) + "\n"
        write_text(place / "reproduction.json", text)
        claims = [list(claim.values()) for claim in result["claims"]]
        tables = {"": (CLAIM_HEADS, claims), CAR_TITLE: (CAR_HEADS, study.cars)}
        html = page("reproduce.html", study=study, tables=tables)
        write_text(place / "index.html", html)
    return result
