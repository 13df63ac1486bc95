"""The map of `isd-gym inspect --out` (`isd-map/1`), which `--map` of other commands reads."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from ..._common.files import write_text
from ..loggers.mapping import SCHEMA, ChannelMap, Column, Logger

if TYPE_CHECKING:
    from pathlib import Path


def _column(column: Column) -> dict[str, Any]:
    out: dict[str, Any] = {"logger": column.logger, "column": column.column}
    if column.unit:
        out["unit"] = column.unit
    if column.sign != 1:
        out["sign"] = column.sign
    if column.sure is not None:
        out["sure"] = round(column.sure, 3)
    return out | ({"why": column.why} if column.why else {})


def _logger(logger: Logger) -> dict[str, Any]:
    out: dict[str, Any] = {"file": logger.file}
    told = (("column", logger.stamp), ("unit", logger.unit), ("rate", logger.rate))
    stamps = {k: v for k, v in told if v}
    if logger.columns:
        out["columns"] = list(logger.columns)
    return (
        out
        | ({"stamps": stamps} if stamps else {})
        | ({} if logger.lag is None else {"lag": logger.lag})
    )


def map_content(of: ChannelMap) -> dict[str, Any]:
    """Return the content of a map file."""
    return {
        "schema": SCHEMA,
        "model": of.model,
        "loggers": [_logger(x) for x in of.loggers],
        "channels": {n: _column(c) for n, c in of.channels.items()},
    }


def save_map(of: ChannelMap, path: str | Path) -> None:
    """Write a map file atomically, one channel per line."""
    loggers = ",\n  ".join(
        json.dumps(_logger(x), ensure_ascii=False) for x in of.loggers
    )
    channels = ",\n".join(
        f"  {json.dumps(n, ensure_ascii=False)}: {json.dumps(_column(c), ensure_ascii=False)}"
        for n, c in of.channels.items()
    )
    head = f'{{"schema": "{SCHEMA}", "model": {json.dumps(of.model)}'
    text = f'{head},\n "loggers": [\n  {loggers}],\n "channels": {{\n{channels}}}}}\n'
    write_text(path, text)
