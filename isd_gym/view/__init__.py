"""Pages and pictures.

- `_rendering`: frames and films of cars.
- `_report`: pages of a score and of a diagnosis.
"""

from __future__ import annotations

TYPE_CHECKING = False  # typing's own import costs 10 ms
if TYPE_CHECKING:
    from typing import Any

    from ._report import score_report as score_report
    from ._report import write_report as write_report

#: public name -> its module
_HOME = {
    "score_report": "_report",
    "write_report": "_report",
}
__all__ = [*_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    from importlib import import_module

    value = globals()[name] = getattr(import_module(f".{_HOME[name]}", __name__), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
