"""Records from names on a command line: tables for uniform files, recordings for several loggers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from ..._common.errors import InputError, MissingColumn, hint, shown
from ..._common.units import convert
from ...physics.network import Channel, Network, without
from ..data import Table, read_table
from ..data._table import format_of
from ..data._text import SideBySide
from .mapping import ChannelMap, files_of, runs
from .recording import Raster, Recording, Signal, continuous, mended, rasters


def records_of(
    path: str | Path,
    network: Network,
    wanted: Sequence[Channel],
    *,
    by: ChannelMap | None = None,
    rename: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    columns: Sequence[str] | None = None,
    rate: float | None = None,
    signs: Mapping[str, int] | None = None,
) -> list[Table | Recording]:
    """Return the records of a name on the command line: one record, the pieces between gaps, or several runs of a file (`runs`)."""
    files = files_of(path)
    sources = {n: c for c, n in (rename or {}).items()}
    for option, given in (("--unit", units or {}), ("--sign", signs or {})):
        _check_used(option, given, files, network, sources, columns)
    if (
        by is None
        and rate is None
        and len(files) == 1
        and not format_of(files[0]).has_own_stamps
    ):
        expected = {c.name: c.unit for c in wanted}
        try:
            table = read_table(
                files[0],
                rename=rename,
                units=units,
                expected=expected,
                header=columns,
                signs=signs,
            )
        except SideBySide:
            table = None
        except MissingColumn as error:
            helps = (
                f"; --rename COLUMN={error.name} where it has another name, or --map FILE with the columns of all channels "
                "(isd-gym inspect --out FILE)"
            )
            raise InputError(f"{error}{helps}{without(network, error.name)}") from None
        if table is not None:
            return _pieces(table, wanted)
    found = runs(
        path,
        network,
        wanted,
        by=by,
        rename=rename,
        units=units,
        columns=columns,
        rate=rate,
        signs=signs,
    )
    out: list[Table | Recording] = []
    for r in found:
        whole = None if r.notes else r.table()
        out.append(r if whole is None else whole)
    return out


def _check_used(
    option: str,
    given: Mapping[str, object],
    files: Sequence[Path],
    network: Network,
    sources: Mapping[str, str],
    columns: Sequence[str] | None,
) -> None:
    """Raise `InputError` for a name that is neither a channel nor a column that is read: the option would have no effect."""
    known = {
        "time",
        *(c.name for c in (*network.inputs, *network.outputs)),
        *sources.values(),
    }
    rest = [name for name in given if name not in known]
    if not rest:
        return
    # an unreadable file is reported after the slip of the pen
    with suppress(InputError):
        known |= {
            r.stamp
            for f in files
            for r in rasters(f, stamp=sources.get("time"), columns=columns)
        }
    for name in rest:
        if name not in known:
            raise InputError(
                f"{option}: the model has no channel {shown(name)}, and none is read from such a column; {hint(name, sorted(known))}"
            )


def _pieces(table: Table, wanted: Sequence[Channel]) -> list[Table | Recording]:
    notes: list[str] = []
    smooth = {}
    for c in wanted:
        smooth[c.name], note = continuous(
            c.name, table.columns[c.name], table.units.get(c.name) or c.unit
        )
        if note:
            notes.append(f"{Path(table.source).name}: {note}")
    parts = mended(Raster(table.source, table.time, table.columns | smooth), notes)
    if not notes:
        return [table]
    out: list[Table | Recording] = []
    stem = Path(table.source).stem
    for k, part in enumerate(parts, 1):
        signals = {}
        for c in wanted:
            try:
                factor = convert(1.0, table.units.get(c.name) or c.unit, c.si)
            except InputError as error:
                raise InputError(
                    f"{table.source}: column '{c.name}': {error}"
                ) from None
            signals[c.name] = Signal(
                part.time, factor * part.columns[c.name], c.si, stem, c.name
            )
        name = stem if len(parts) == 1 else f"{stem} [{k}]"
        out.append(Recording(name, signals, {}, tuple(notes) if k == 1 else ()))
    return out
