"""JSON files of the benchmarks."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path


def read_json(path: Path) -> Any:
    """Return the content of a file."""
    return json.loads(path.read_text(encoding="utf-8"))


def save_json(path: Path, content: Any) -> None:
    """Write a file with a line for every value."""
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
