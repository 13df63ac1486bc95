"""Pages and pictures.

- `rendering`: frames and films of cars.
- `report`: pages of a score and of a diagnosis.
"""

from __future__ import annotations

from .._common.lazy import lazy

TYPE_CHECKING = False  # typing's own import costs 10 ms
if TYPE_CHECKING:
    from .report import score_report as score_report
    from .report import write_report as write_report

#: public name -> its module
_HOME = {
    "score_report": "report",
    "write_report": "report",
}
__all__ = [*_HOME]
__getattr__, __dir__ = lazy(__name__, _HOME)
