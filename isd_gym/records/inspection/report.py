"""Content and oddities of loggers' files, and the columns of a model's channels: as data and as lines."""

from __future__ import annotations

import math
import textwrap
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.errors import InputError, plain, shown
from ..data._columns import did_you_mean
from ..loggers.mapping import ChannelMap, Logger
from ..loggers.recording import EPOCH, Raster, continuous, rasters
from .facts import Facts, Oddity, facts_of, odd_stamps, odd_values
from .map_file import map_content

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from ...physics.network import Network
    from .match import Suggestion

# end of the year 9999 [s since 1970]; later stamps are no dates
LAST_STAMP = 253402300799.0


@dataclass(frozen=True)
class Inspection:
    """Result of `inspect`.

    Attributes:
        files: Rasters of every file.
        facts: Properties of the columns.
        oddities: Remarks on columns and time stamps.
        network: The model; None without a model.
        suggestion: Columns of the model's channels; None without a model.
        columns: Names that files without a header row were given.
        rate: Sampling rate that files without time stamps were given [Hz].
    """

    files: list[list[Raster]]
    facts: list[Facts]
    oddities: list[Oddity]
    network: Network | None = None
    suggestion: Suggestion | None = None
    columns: tuple[str, ...] = ()
    rate: float | None = None

    def map(self, model: str) -> ChannelMap:
        """Return the suggestion as a map for ``--map``.

        Args:
            model: File of the model.

        Returns:
            The map.

        Raises:
            InputError: No channel has a column.
        """
        if self.suggestion is None or not self.suggestion.channels:
            raise InputError(f"no column was found for any channel of '{model}'")
        return self.suggestion.map(self.files, model, self.columns, self.rate)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data, with null for values that are not finite.

        Returns:
            Plain data.
        """
        columns = [
            {
                k: None if isinstance(v, float) and not math.isfinite(v) else v
                for k, v in asdict(f).items()
            }
            | {"file": self.files[f.file][f.raster].source}
            for f in self.facts
        ]
        out: dict[str, Any] = {
            "schema": "isd-inspection/1",
            "columns": columns,
            "oddities": [asdict(o) for o in self.oddities],
        }
        if self.suggestion is not None:
            name = self.network.name if self.network else ""
            out["map"] = map_content(
                self.suggestion.map(self.files, name, self.columns, self.rate)
            )
            out["missing"], out["remarks"] = (
                self.suggestion.missing,
                self.suggestion.remarks,
            )
        return out


def inspect(
    paths: list[Path],
    network: Network | None = None,
    *,
    units: dict[str, str] | None = None,
    stamps: str | None = None,
    columns: Sequence[str] | None = None,
    rate: float | None = None,
    by: ChannelMap | None = None,
    signs: Mapping[str, int] | None = None,
) -> Inspection:
    """Inspect loggers' files of one run, and match columns with the channels of a model.

    Args:
        paths: The files.
        network: The model; None to inspect the files alone.
        units: Unit by column, with priority over the units in the files.
        stamps: Column of the time stamps.
        columns: Names for files without a header row.
        rate: Sampling rate of files without time stamps [Hz].
        by: Columns of channels that are known, with their units and signs; None for a search among all columns.
        signs: Known factors 1 or -1 by channel.

    Returns:
        Properties, remarks and a suggested map.

    Raises:
        InputError: A file cannot be read, or a column does not exist.
    """
    known_columns = by.channels if by else {}
    units = dict(units or {}) | {
        c.column: c.unit for c in known_columns.values() if c.unit
    }
    loggers = [*(by.loggers if by else ()), *[Logger()] * len(paths)]
    groups = [
        rasters(
            p,
            stamp=own.stamp or stamps,
            unit=own.unit or units.get("time"),
            units=units,
            columns=own.columns or columns,
            rate=own.rate or rate,
        )
        for p, own in zip(paths, loggers, strict=False)
    ]
    known = {n for group in groups for r in group for n in (*r.columns, r.stamp)} | {
        "time"
    }
    for given in known_columns.values():
        if given.column not in known:
            raise InputError(
                f"no column {shown(given.column)}; {did_you_mean(given.column, known)}"
            )
    for name in units:
        if name not in known:
            raise InputError(
                f"--unit: no column {shown(name)} (there are {', '.join(sorted(map(plain, known))[:12])})"
            )
    facts: list[Facts] = []
    odd = _repeated_columns(groups)
    groups = [[_continuous(raster, units, odd) for raster in group] for group in groups]
    for i, group in enumerate(groups):
        for k, raster in enumerate(group):
            odd += odd_stamps(raster)
            for f in facts_of(raster, i, k, units):
                facts.append(f)
                odd += odd_values(raster, f)
    found = None
    if network is not None:
        from .match import suggest

        found = suggest(groups, facts, network, known_columns, signs)
    return Inspection(groups, facts, odd, network, found, tuple(columns or ()), rate)


def _repeated_columns(groups: list[list[Raster]]) -> list[Oddity]:
    """Return a remark for each file with the columns of an earlier file: another run, not another logger."""
    first: dict[frozenset[str], str] = {}
    odd = []
    for group in groups:
        names = frozenset(name for raster in group for name in raster.columns)
        name = group[0].name
        if names in first:
            text = f"the same columns as {plain(first[names])}"
            odd.append(
                Oddity(name, "", text, "if they are two runs, inspect one of them")
            )
        first.setdefault(names, name)
    return odd


def _continuous(raster: Raster, units: Mapping[str, str], odd: list[Oddity]) -> Raster:
    """Return a raster with continuous angles, and add a remark for each changed column."""
    smooth = dict(raster.columns)
    for name, values in raster.columns.items():
        unit = units.get(name) or raster.units.get(name, "")
        smooth[name], note = continuous(name, values, unit)
        if note:
            odd.append(Oddity(raster.name, name, note.removeprefix(f"{name}: ")))
    return replace(raster, columns=smooth)


# ------------------------------------------------------------------------------------------------ the terminal


def _number(x: float) -> str:
    if not math.isfinite(x):
        return "-"
    return f"{x:.3g}" if abs(x) < 1e5 else f"{x:.1e}"


def _cut(text: str, width: int) -> str:
    text = plain(text, 200)
    return text if len(text) <= width else text[: width - 1] + "…"


def head(raster: Raster) -> str:
    """Return a raster in one line: file, number of samples, duration, rate.

    Args:
        raster: The raster.

    Returns:
        A line.
    """
    t = raster.time[np.isfinite(raster.time)]
    if not len(t):
        return f"{raster.name}: no stamps"
    span = t.max() - t.min()
    begin = f"from {t[0]:.6g} s"
    if EPOCH < t[0] < LAST_STAMP:
        from datetime import UTC, datetime

        begin = f"from {datetime.fromtimestamp(float(t[0]), UTC):%Y-%m-%d %H:%M:%S} UTC"
    rate = f"{raster.rate:.5g} Hz" if raster.rate > 0 else "no rate"
    return f"{raster.name}: {len(raster)} samples, {rate}, {span:.5g} s {begin}"


def lines(found: Inspection, width: int = 80) -> list[str]:
    """Return an inspection as lines for a terminal.

    Args:
        found: The inspection.
        width: Number of characters of a line.

    Returns:
        Lines.
    """
    name = min(max((len(f.name) for f in found.facts), default=6), 26, width - 44)
    out: list[str] = []
    for i, group in enumerate(found.files):
        for k, raster in enumerate(group):
            out.append(head(raster))
            out.append(
                f"  {'column':<{name}} {'unit':<6} {'least':>8} {'largest':>8} {'RMS':>8} {'Hz':>6}"
            )
            for f in found.facts:
                if (f.file, f.raster) == (i, k):
                    out.append(
                        f"  {_cut(f.name, name):<{name}} {_cut(f.unit or '-', 6):<6} {_number(f.least):>8} "
                        f"{_number(f.largest):>8} {_number(f.deviation):>8} {_number(f.band):>6}"
                    )
            out.append("")
    if found.facts:
        out.append("RMS: about the mean. Hz: half of the power lies below.")
    if found.oddities:
        out += ["", "Odd:"]
        for o in found.oddities:
            where = f"{o.where}, " if len(found.files) > 1 or not o.column else ""
            out += _folded(f"{where}{o}", width)
    if found.suggestion is not None and found.network is not None:
        out += ["", *_matched(found, width)]
    return out


def _folded(text: str, width: int) -> list[str]:
    return textwrap.wrap(
        plain(text, 600), width, initial_indent="  ", subsequent_indent="    "
    )


def _matched(found: Inspection, width: int) -> list[str]:
    made, network = found.suggestion, found.network
    assert made is not None and network is not None
    channels = [*network.inputs, *network.outputs]
    name = min(max(len(c.name) for c in channels), 24)
    picks = [pick for pick, _ in made.channels.values()]
    wide = min(max([len(p.facts.name) + (p.sign < 0) for p in picks] + [12]), 22)
    out = [
        f"Columns for {plain(network.name, 40)}:",
        f"  {'channel':<{name}} {'column':<{wide}} {'unit':<6} {'sure':>6}  why",
    ]
    for c in channels:
        if c.name not in made.channels:
            out.append(
                f"  {_cut(c.name, name):<{name}} {'(none found)':<{wide}} {c.unit}"
            )
            continue
        pick, sure = made.channels[c.name]
        column = ("-" if pick.sign < 0 else "") + pick.facts.name
        why = "; ".join(pick.why)
        row = f"  {_cut(c.name, name):<{name}} {_cut(column, wide):<{wide}} {_cut(pick.unit, 6):<6} {percent_of(sure):>6}  "
        out += textwrap.wrap(
            row + why, width, subsequent_indent=" " * min(len(row), width - 20)
        )
    for remark in made.remarks:
        out += _folded(remark, width)
    return out


def percent_of(sure: float) -> str:
    return ">99 %" if sure > 0.995 else f"{100 * sure:.0f} %"
