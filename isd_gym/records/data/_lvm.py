"""LabVIEW measurement files (``.lvm``): text with a header of the file, and a header before each segment of data.

References:
    National Instruments, "Specification for the LabVIEW Measurement File (.lvm)".
"""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..._common.errors import InputError, MissingColumn, shown
from .._formats import Refused
from .._formats.rasters import joined
from ._columns import Choice, Columns, did_you_mean, distinct, split_header
from ._text import number_in, read_text, text_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

TITLE, END, X, COMMENT = "LabVIEW Measurement", "***End_of_Header***", "X_Value", "Comment"
TIME = "time"


@dataclass
class _Segment:
    """Header of a segment, the row of names below the header, and the rows of data with their line numbers."""

    tags: dict[str, list[str]] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    rows: list[tuple[int, list[str]]] = field(default_factory=list)

    def start(self) -> float | None:
        """Return the start of the segment [s since 1970], or None without a valid date and time."""
        date, time = (self.tags.get(key, [""])[0].replace(",", ".") for key in ("Date", "Time"))
        try:
            seconds = float(time[time.rindex(":") + 1 :])
            then = dt.datetime.strptime(f"{date} {time[: time.rindex(':')]}", "%Y/%m/%d %H:%M")
        except ValueError:
            return None
        return then.replace(tzinfo=dt.UTC).timestamp() + seconds


def _segments(path: Path, text: str) -> tuple[dict[str, str], list[_Segment]]:
    """Return the tags of the file's header, and the segments."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    separator = "\t" if any("\t" in s for s in lines[:4]) else ","
    head: dict[str, str] = {}
    segments: list[_Segment] = []
    place, special = "file", False  # header of the file or of a segment, names, or data
    for number, line in enumerate(lines, 1):
        cells = [x.strip() for x in line.split(separator)]
        if cells[0] in ("***Start_Special***", "***End_Special***"):
            special = cells[0] == "***Start_Special***"
        elif special or not any(cells):
            continue
        elif cells[0] == END:
            place = "names" if place == "segment" else "data"
        elif place == "file":
            head[cells[0]] = separator.join(cells[1:]).strip(separator) if len(cells) > 1 else ""
            if cells[0] == "Decimal_Separator" and "," in line[len(cells[0]) :]:
                head[cells[0]] = ","
        elif cells[0] == "Channels":
            segments.append(_Segment({"Channels": cells[1:]}))
            place = "segment"
        elif not segments:
            raise InputError(f"{path}: line {number}: data without a header of their segment")
        elif place == "segment":
            segments[-1].tags[cells[0]] = cells[1:]
        elif place == "names":
            segments[-1].names, place = cells, "data"
        else:
            segments[-1].rows.append((number, cells))
    return head, [s for s in segments if s.rows]


def _stamped(path: Path, head: dict[str, str], segment: _Segment) -> list[Columns]:
    """Return the channels of a segment, grouped by equal time stamps."""
    comma = head.get("Decimal_Separator", ".") == ","
    names = segment.names
    if names and names[-1] == COMMENT:
        names = names[:-1]
    places = [k for k, name in enumerate(names) if name not in (X, "")]
    # without time stamps the cell below "X_Value" is empty; some writers omit the name
    shift = int(X not in names and not segment.rows[0][1][0])
    told = [segment.tags.get(key, []) for key in ("Y_Unit_Label", "X_Dimension", "X0", "Delta_X")]
    pairs = [split_header(names[k]) for k in places]
    labels = [told[0][i] if i < len(told[0]) else "" for i in range(len(places))]
    units = [unit or label for (_, unit), label in zip(pairs, labels, strict=True)]
    channels = distinct([name for name, _ in pairs], [names[k] for k in places], units)
    if len(set(channels)) < len(channels):
        twice = next(n for n in channels if channels.count(n) > 1)
        raise InputError(f"{path}: the header names {shown(twice)} twice")
    out: list[Columns] = []
    for i, (k, name, unit) in enumerate(zip(places, channels, units, strict=True)):
        dimension = told[1][i] if i < len(told[1]) and told[1][i] else "Time"
        if dimension.lower() != "time":
            raise InputError(f"{path}: {shown(name)} is recorded over {shown(dimension)}, not over time")
        values = _numbers(path, segment.rows, k + shift, name, comma)
        axis = max((j for j, n in enumerate(names[:k]) if n == X), default=None)
        if head.get("X_Columns", "One").lower() == "no" or axis is None:
            begin, step = (
                _first(path, key, row, i, comma) for key, row in zip(("X0", "Delta_X"), told[2:], strict=True)
            )
            time = begin + step * np.arange(len(values))
        else:
            time = _numbers(path, segment.rows, axis, X, comma)
        there = np.isfinite(time) & ~(np.isnan(values) & (np.cumsum(np.isfinite(values)[::-1])[::-1] == 0))
        time, values = time[there], values[there]
        if not len(time):
            raise InputError(f"{path}: {shown(name)} has no samples")
        for same in out:
            if len(same.values[TIME]) == len(time) and np.array_equal(same.values[TIME], time):
                same.values[name] = values
                break
        else:
            same = Columns({TIME: time, name: values}, {TIME: "s"})
            out.append(same)
        if unit:
            same.units[name] = unit
    return out


def _first(path: Path, key: str, row: list[str], channel: int, comma: bool) -> float:
    """Return a number of a segment's header for a channel."""
    text = row[channel] if channel < len(row) else ""
    try:
        value = float(text.replace(",", ".") if comma else text)
    except ValueError:
        value = math.nan
    if key == "X0" and not text:
        return 0.0
    if not math.isfinite(value) or (key == "Delta_X" and value <= 0):
        raise InputError(
            f"{path}: the header has no {key} for channel {channel + 1}, and the channel has no time stamps"
        )
    return value


def _numbers(path: Path, rows: list[tuple[int, list[str]]], place: int, name: str, comma: bool) -> np.ndarray:
    """Return the numbers of a column, NaN for gaps and for rows that are too short."""
    out = np.full(len(rows), math.nan)
    for k, (line, cells) in enumerate(rows):
        if place < len(cells):
            value = number_in(cells[place], comma)
            if value is None:
                raise InputError(
                    f"{path}: line {line}, column {shown(name)}: {shown(cells[place])} is not a number"
                )
            out[k] = value
    return out


def read_lvm_rasters(path: Path, columns: Sequence[str] | None = None) -> list[Columns]:
    """Return the rasters of a LabVIEW measurement file, with consecutive segments joined.

    A segment whose time stamps restart is placed by the date and time in its header, or one step after the
    preceding segment.

    Args:
        path: The file. A file without a header is read as plain text.
        columns: Names of all columns, for a file without a header row.

    Returns:
        One entry per raster, with the time stamps [s] under 'time'.

    Raises:
        InputError: The file cannot be read, or its segments hold different channels.
    """
    text = text_of(path)
    if not text.lstrip().startswith(TITLE):
        return [read_text(path, None, TIME, False, columns)]
    head, segments = _segments(path, text)
    if not segments:
        raise InputError(f"{path}: holds no data")
    parts = [_stamped(path, head, s) for s in segments]
    names = [[list(c.values) for c in part] for part in parts]
    if other := next((k for k, n in enumerate(names) if n != names[0]), None):
        raise InputError(
            f"{path}: segment {other + 1} has other channels than the first: save one segment per file"
        )
    origin = segments[0].start()
    out = parts[0]
    for segment, part in zip(segments[1:], parts[1:], strict=True):
        start = segment.start()
        for whole, more in zip(out, part, strict=True):
            last, time = whole.values[TIME], more.values[TIME]
            step = (last[-1] - last[0]) / max(len(last) - 1, 1)
            if time[0] <= last[-1]:
                since = 0.0 if start is None or origin is None else start - origin
                time = time + max(since, last[-1] + step - time[0])
            for name, values in more.values.items():
                whole.values[name] = np.r_[whole.values[name], time if name == TIME else values]
    return out


def read_lvm(
    path: Path, wanted: Choice, time: str, resample: bool, columns: Sequence[str] | None = None
) -> Columns:
    """Return columns of a LabVIEW measurement file on one row of time stamps, named 'time'.

    Args:
        path: The file.
        wanted: Names, or a function that chooses from the available names; None for all.
        time: Name of the wanted time column.
        resample: Interpolate channels on several rasters linearly to the finest raster.
        columns: Names of all columns, for a file without a header row.

    Returns:
        The wanted columns.

    Raises:
        InputError: The file cannot be read, or has several rasters.
        MissingColumn: A wanted column is missing.
    """
    if not text_of(path).lstrip().startswith(TITLE):
        return read_text(path, wanted, time, resample, columns)
    rasters = read_lvm_rasters(path, columns)
    found = {n: (r.values[TIME], x) for r in rasters for n, x in r.values.items() if n != TIME}
    chosen = wanted(list(found)) if callable(wanted) else wanted
    known = {*found, *(split_header(n)[0] for n in found), time, TIME}
    for name in chosen or ():
        if name not in known:
            raise MissingColumn(f"{path}: no column {shown(name)}; {did_you_mean(name, found)}", name)
    if chosen is not None:
        some = {n: x for n, x in found.items() if n in chosen or split_header(n)[0] in chosen}
        found = some or dict(list(found.items())[:1])
    try:
        values = dict(joined(found, TIME, resample))  # type: ignore[no-untyped-call]
    except Refused as error:
        raise InputError(f"{path}: {error}") from None
    return Columns(values, {n: u for r in rasters for n, u in r.units.items() if n in values})
