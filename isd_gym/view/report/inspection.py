"""Page of an inspection: every column as a picture, with its oddities and its channel."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...records.inspection.report import head, percent_of
from .plots import page as fill

if TYPE_CHECKING:
    from ...records.inspection.report import Inspection


def page(found: Inspection) -> str:
    """Return an inspection as one self-contained HTML page.

    Args:
        found: The inspection.

    Returns:
        HTML.
    """
    rows = []
    for f in found.facts:
        raster = found.files[f.file][f.raster]
        odd = [
            str(replace(o, column=""))
            for o in found.oddities
            if (o.where, o.column) == (raster.name, f.name)
        ]
        rows.append(
            {
                "facts": f,
                "file": raster.name,
                "odd": odd,
                "path": _path(raster.columns[f.name]),
            }
        )
    heads = [
        {
            "text": head(r),
            "odd": [
                str(o) for o in found.oddities if o.where == r.name and not o.column
            ],
        }
        for group in found.files
        for r in group
    ]
    made, matched = found.suggestion, []
    if made is not None and found.network is not None:
        for c in (*found.network.inputs, *found.network.outputs):
            pick, sure = made.channels.get(c.name, (None, 0.0))
            matched.append({"channel": c, "pick": pick, "sure": percent_of(sure)})
    return fill(
        "inspection.html",
        rows=rows,
        heads=heads,
        matched=matched,
        remarks=made.remarks if made else [],
        network=found.network.name if found.network else "",
    )


def _path(x: np.ndarray, width: int = 600, height: int = 60) -> str:
    """Return a column as an SVG path: from its smallest to its largest value in the time of every pixel."""
    if not np.isfinite(x).any():
        return ""
    lo, hi = float(np.nanmin(x)), float(np.nanmax(x))
    span = (hi - lo) or 1.0
    edges = np.linspace(0, len(x), min(width, len(x)) + 1).astype(int)
    out, pen = [], "M"
    for k, (a, b) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
        part = x[a:b]
        part = part[np.isfinite(part)]
        if not len(part):
            pen = "M"
            continue
        at = k * width / (len(edges) - 1)
        for v in dict.fromkeys(
            (float(part[0]), float(part.max()), float(part.min()), float(part[-1]))
        ):
            out.append(f"{pen}{at:.1f} {height * (hi - v) / span:.1f}")
            pen = "L"
    return "".join(out)
