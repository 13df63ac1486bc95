"""Self-contained pages of a diagnosis and a score.

`plots` sets the style and assembles pages. `charts` draws charts that are described as data.
"""

from __future__ import annotations

from .diagnosis import check_target, write_report
from .score import check_report, score_report

__all__ = [
    "check_report",
    "check_target",
    "score_report",
    "write_report",
]
