"""Split of measured records into training, validation and test records."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..._common.arrays import Array
    from .._simulation.problem import Record, Role

#: Length of validation and test segments as a multiple of the rig's time scale, about 30 periods.
SEGMENT = 200.0
LEAST_SEGMENT = 40.0  # least length of the segments of a short record, as a multiple of the rig's time scale
#: Simulated time before a segment if laws with memory have the only states, as a multiple of the rig's time scale.
LEAD_IN = 100.0
LED_IN = 0.125  # largest share of a record that leads in: what happened before the record is unknown to a law with memory
WINDOWS = 8  # least number of windows in the search for the end of the motion, and of windows kept
STILL = 4.0  # ratio to the power of the quietest quarter of the windows below which a window is at rest
MOVES = 25.0  # least ratio of the largest power to that of a rest; a decay without rest of a larger ratio keeps more than half of its record


def split_records(
    data: list[Record],
    validate: list[Record],
    notes: list[str],
    time: float,
    lead: float = 0.0,
) -> tuple[list[Record], list[Role]]:
    """Return segments for training and held-out segments, alternately for validation and test, with their roles: held out are `validate`,
    the last third of the records, or that of the motion of a single one. `lead`: simulated time before a segment [s]. How is noted."""
    training, held = data, validate
    if not held and len(training) > 1:
        count = max(1, len(training) // 3)
        training, held = training[:-count], training[-count:]
        notes.append(
            f"held out for validation and test: {', '.join(r.name for r in held)}"
        )
    elif not held:
        (whole,) = training
        first, rest = _split_record(whole)
        training, held = [first], [rest]
        used = len(first) + len(rest)
        still = (
            f"; its last {1 - used / len(whole):.0%}, where nothing moves, is left out"
        )
        notes.append(
            "held out for validation and test: the last third of the motion of the only record"
            + still * (used < len(whole))
        )
    if lead:
        training, held = (
            [_led_in(r, lead) for r in records] for records in (training, held)
        )
    # sorted by content: sums over records do not depend on the order of the files
    held = sorted(held, key=lambda r: (r.measured.shape, r.measured.tobytes(), r.name))
    segments: list[Record] = []
    roles: list[Role] = []
    for n, r in enumerate(held):
        own = _pieces(r, time, lead)
        segments += own
        # the first half of every run may be driven and the second coast: neither half is for one purpose alone
        after = n % 2 if len(own) > 1 else 0
        roles += [
            "choose" if (after + k) % 2 == 0 else "report" for k in range(len(own))
        ]
    if "report" in roles:
        notes.append(
            f"{len(segments)} held-out segments, alternately for validation (choice of effects) and test (reported figures)"
        )
    else:
        notes.append(
            "too little is held out for test records: the reported figures are those of validation"
        )
    parts = [part for r in training for part in _pieces(r, time, lead)]
    fitted: list[Role] = ["fit"] * len(parts)
    return [*parts, *segments], fitted + roles


def _pieces(record: Record, time: float, lead: float) -> list[Record]:
    """Return the segments of a record: a slow drift that no model predicts begins anew in each."""
    seconds = SEGMENT * time
    if record.inputs:  # a short record with inputs gives two to four segments
        duration = len(record) * record.interval
        seconds = min(
            seconds, max(0.25 * duration, LEAST_SEGMENT * time), 0.5 * duration
        )
    return cut_segments(record, seconds, min(300, len(record) // 2), lead)


def _led_in(record: Record, lead: float) -> Record:
    """Return a record whose beginning, at most a share `LED_IN` of it and `lead` [s], is simulated but not compared."""
    first = int(min(lead / record.interval, LED_IN * len(record)))
    return record.part(first, len(record), record.name, first)


def _split_record(record: Record) -> tuple[Record, Record]:
    """Split a record after two thirds of the path of its outputs, since a decay hardly moves in its last third."""
    y = record.measured - record.measured.mean(axis=0)
    width = max(1, int(0.2 * record.pace / record.interval))
    smooth = np.apply_along_axis(
        lambda x: np.convolve(x, np.ones(width) / width, mode="valid"), 0, y
    )
    change = np.abs(np.diff(smooth, axis=0)) / np.maximum(y.std(axis=0), 1e-300)
    end = _find_rest(record, y)
    path = np.cumsum(np.sum(change, axis=1))[: max(end - width, 1)]
    at = int(np.searchsorted(path, 2 / 3 * path[-1])) + width // 2
    # a steep decay covers most of its path in its first moments
    at = min(max(at, end // 8, 32), end - max(end // 6, 32))
    return record.part(0, at, record.name), record.part(at, end, record.name)


def _find_rest(record: Record, y: Array) -> int:
    """Return the sample at which the rest of a record with outputs (n, channels) begins, if the rest is more than half of the record."""
    # the pace of a record at rest is the rest's
    length = max(
        16, min(math.ceil(6 * record.pace / record.interval), len(y) // (4 * WINDOWS))
    )
    count = len(y) // length
    if count < WINDOWS:
        return len(y)
    power = y[: count * length].reshape(count, length, -1).var(axis=1)
    rest = np.sort(power, axis=0)[: max(1, count // 4)].mean(axis=0)
    moving = np.flatnonzero((power > STILL * rest).any(axis=1))
    if not (power.max(axis=0) > MOVES * rest).any():
        return len(y)
    last = (int(moving[-1]) + 1) * length
    # a part of the rest is kept: a model must predict the rest, too
    return len(y) if last > len(y) // 2 else max(last + last // 4, WINDOWS * length)


def cut_segments(
    record: Record, seconds: float, least: int = 300, lead: float = 0.0
) -> list[Record]:
    """Cut a record into segments of equal length of at least some seconds, each with a lead [s] that is simulated but not compared."""
    count = max(1, int(len(record) * record.interval / seconds))
    count = min(count, max(1, len(record) // least))
    edges = np.linspace(0, len(record), count + 1).astype(int)
    before = int(lead / record.interval)
    return [record.part(a, b, record.name, before) for a, b in pairwise(edges)]
