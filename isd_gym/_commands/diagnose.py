"""`isd-gym diagnose`: what a model lacks, from measured records."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from math import inf
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._common.errors import InputError, shown
from ._diagnose_result import print_diagnosis, write_result
from ._options import (
    ColumnsOption,
    ElementsOption,
    FileRateOption,
    JsonOption,
    MapOption,
    RenameOption,
    SignOption,
    UnitOption,
    channel_names,
    check_records,
    complete,
    network_names,
    option,
    pairs,
)
from .console import check_file, lines

if TYPE_CHECKING:
    from ..physics.network import Network
    from ..records.data import Table
    from ..records.loggers import Recording

#: share of --max-seconds that is kept for the report; of 15 s at most
REPORT = 0.2


RecordsArgument = Annotated[
    list[Path],
    typer.Argument(
        help="Measured records with time and the model's channels (CSV, Excel, Parquet, .mat, .mf4, .tdms). Join files of several loggers "
        "by +: body.csv+wheel.mf4."
    ),
]
FolderOption = Annotated[Path, option("--out DIR", "Folder of the result.")]
NominalModelOption = Annotated[
    str | None,
    option(
        "--model",
        "Nominal model: a file or a built-in network. Required, except for a folder with its own model.json.",
        autocompletion=complete(network_names),
    ),
]
ValidateOption = Annotated[
    list[Path] | None,
    option(
        "--validate DATA...",
        "Held-out records. One part chooses the effect, the rest gives the reported errors. Without this option some of "
        "DATA are held out.",
    ),
]
AcceptOption = Annotated[
    list[str] | None,
    option(
        "--accept CHECK",
        "Data check that only warns: held, jumps, magnitude, length, silent, copies, sign, all. May be repeated.",
    ),
]
UncertainOption = Annotated[
    list[str] | None,
    option(
        "--uncertain PARAMETER=SHARE",
        "Relative standard deviation of a parameter (0.05 or 5%). The parameter is then refitted. Overrides the model file.",
    ),
]
CutOption = Annotated[
    str | None,
    option(
        "--cut NODE",
        "Without a measured road: node with an accelerometer. The motion of the node drives the part of the model above "
        "the node. The part below (tyre, road) is left out.",
    ),
]
TimeLimitOption = Annotated[
    float | None,
    option(
        "--max-seconds SECONDS",
        "Time after which the diagnosis ends [s], with what was found; the summary lists what was not tried. The first "
        "compilation of the kernels (isd-gym warm) does not count. The result then depends on the speed of the machine.",
        min=1.0,
    ),
]
LagOption = Annotated[
    float,
    option(
        "--max-lag", "Largest offset between the clocks of two loggers [s].", min=0.0
    ),
]
ThreadsOption = Annotated[
    int,
    option(
        "--jobs", "Number of threads. The result is the same for any number.", min=1
    ),
]


def command(
    data: RecordsArgument,
    out: FolderOption,
    model: NominalModelOption = None,
    validate: ValidateOption = None,
    rename: RenameOption = None,
    unit: UnitOption = None,
    sign: SignOption = None,
    map_file: MapOption = None,
    columns: ColumnsOption = None,
    rate: FileRateOption = None,
    accept: AcceptOption = None,
    elements: ElementsOption = None,
    uncertain: UncertainOption = None,
    cut: CutOption = None,
    max_seconds: TimeLimitOption = None,
    max_lag: LagOption = 0.5,
    jobs: ThreadsOption = 2,
    json_file: JsonOption = None,
) -> None:
    """Find where a model and measurements disagree, and which physical effect is missing.

    Writes DIR/diagnosis.json, DIR/model.json (the model with the effects found) and DIR/report.html. Without --validate
    whole records of DATA are held out, or the last third of a single record.

    In place of DATA, --validate and --model, a folder may hold them: records, validation*.csv and model.json.

    Without a measured road, --cut diagnoses the part above a node with an accelerometer.

    Example: isd-gym diagnose test1.csv test2.csv --model rig.json --out found

    Without a road: isd-gym diagnose drive.csv --model car.json --cut wheel --out found
    """
    begun = monotonic()
    from ..diagnosis import SearchSettings, diagnose
    from ..view.report import check_target

    check_file(json_file)
    accept, validate = accept or [], validate or []
    if len(data) == 1 and data[0].is_dir():
        data, validate, model = _files_of_case(data[0], validate, model)
    if model is None:
        raise InputError(
            "--model is missing: name the model to compare the records with"
        )
    shares = _shares(uncertain)
    check_records(data, validate)
    about = {"Model": model, "Data": ", ".join(map(str, data))}
    if validate:
        about["Validation"] = ", ".join(map(str, validate))
    network = _load_network(model, elements, shares)
    options = channel_names(network, rename, unit, map_file, columns, sign, rate)
    if "by" in options:
        network = options["by"].measured(network)
    check_target(out)
    with lines() as say, _time_limit(max_seconds, begun):
        fitted, held = (
            _read_records(files, network, cut, options) for files in (data, validate)
        )
        settings = SearchSettings(max_lag=max_lag, jobs=jobs, max_seconds=max_seconds)
        result = diagnose(
            fitted,
            network,
            validate=held,
            accept=accept,
            progress=say,
            cut=cut,
            settings=settings,
        )
        say("writing the report")
        page = write_result(result, out, about)
    print_diagnosis(result, json_file, page)


def _files_of_case(
    folder: Path, validate: list[Path], model: str | None
) -> tuple[list[Path], list[Path], str | None]:
    """Return the records, the held-out records and the model of a folder. Options have priority."""
    from ..records.data._table import suffixes

    records = sorted(p for p in folder.iterdir() if p.suffix.lower() in suffixes())
    held = [p for p in records if p.name.startswith("validation")]
    fitted = [p for p in records if p not in held]
    if not fitted:
        raise InputError(
            f"{folder}: holds no records to fit (tables: {' '.join(suffixes())})"
        )
    own = folder / "model.json"
    return fitted, validate or held, model or (str(own) if own.is_file() else None)


def _load_network(
    model: str, elements: list[Path] | None, uncertainty: dict[str, float]
) -> Network:
    """Return the nominal model with the elements of --elements and the uncertainty of --uncertain."""
    from ..physics.elements import register_file
    from ..physics.network import Network

    for file in elements or ():
        register_file(file)
    network = Network.load(model)
    return (
        replace(network, uncertainty={**network.uncertainty, **uncertainty})
        if uncertainty
        else network
    )


def _read_records(
    files: list[Path], network: Network, cut: str | None, options: dict[str, Any]
) -> list[Table | Recording]:
    """Return the records of files with the channels of the network, or of its part above --cut."""
    from ..physics.network import cut as cut_at
    from ..records.loggers.record_reading import records_of

    part = network if cut is None else cut_at(network, cut)
    wanted = (*part.inputs, *part.outputs)
    return [
        record
        for file in files
        for record in records_of(file, network, wanted, **options)
    ]


def _time_limit(
    max_seconds: float | None, begun: float
) -> AbstractContextManager[object]:
    """Return the context of --max-seconds, without the time that is kept for the report."""
    from ..diagnosis._simulation.time_limit import TimeLimit

    if max_seconds is None:
        return nullcontext()
    return TimeLimit(
        max_seconds - REPORT * min(max_seconds, 15.0), monotonic, begun
    ).until(inf)


def _shares(uncertain: list[str] | None) -> dict[str, float]:
    """Return the values of --uncertain as numbers."""
    out = {}
    for name, text in pairs(uncertain, "--uncertain", "PARAMETER=SHARE").items():
        try:
            out[name] = float(text.removesuffix("%")) * (
                0.01 if text.endswith("%") else 1.0
            )
        except ValueError:
            raise InputError(
                f"--uncertain {name}: wants a share such as 0.05, not {shown(text)}"
            ) from None
        if not 0.0 <= out[name] <= 1.0:
            raise InputError(
                f"--uncertain {name}: wants a share from 0 to 1 (0.05 or 5%), not {shown(text)}"
            )
    return out
