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
from .._common.plugins import wing
from ._diagnose_result import print_diagnosis, write_result
from ._options import (
    ColumnsOption,
    ElementsOption,
    EngineOption,
    FileRateOption,
    JsonOption,
    MapOption,
    RenameOption,
    SignOption,
    UnitOption,
    channel_names,
    check_channels,
    check_records,
    complete,
    network_names,
    option,
    pairs,
    read_names,
)
from .console import check_file, lines

if TYPE_CHECKING:
    from ..physics.network import Network
    from ..records._loggers import Recording
    from ..records.data import Table

#: share of --max-seconds that is kept for the report; of 15 s at most
REPORT = 0.2


RecordsArgument = Annotated[
    list[Path],
    typer.Argument(
        help="Measured records with time and the model's channels (CSV, Excel, Parquet, .mat, .mf4, .tdms, .uff, .gz). Join files of several loggers "
        "by +: body.csv+wheel.mf4."
    ),
]
FolderOption = Annotated[Path, option("--out DIR", "Folder of the result.")]
NominalModelOption = Annotated[
    str | None,
    option(
        "--model",
        "Nominal model: a file, a built-in network, or an FMU (.fmu). Required, except for a folder of cases with "
        "their own model.json.",
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
TrustOption = Annotated[
    bool, option("--trust-fmu", "Run the compiled code of an .fmu. The code has your rights.")
]
CutOption = Annotated[
    str | None,
    option(
        "--cut NODE",
        "Without a measured road: node with an accelerometer. The motion of the node drives the part of the model above "
        "the node. The part below (tyre, road) is left out.",
    ),
]
UnmeasuredOption = Annotated[
    str | None,
    option(
        "--unmeasured INPUT",
        "Without a measured road: the unmeasured input, taken as white velocity in the likelihood of a linear model. Default: "
        'the input with "measured": false in the model file.',
    ),
]
TimeLimitOption = Annotated[
    float | None,
    option(
        "--max-seconds SECONDS",
        "Time after which the diagnosis ends [s], with what was found; the summary lists what was not tried. The first "
        "compilation of the kernels (isd-gym warm) does not count. The result then depends on the speed of the machine. "
        "Default: no limit; with --unmeasured 120 s of processor time.",
        min=1.0,
    ),
]
LagOption = Annotated[
    float, option("--max-lag", "Largest offset between the clocks of two loggers [s].", min=0.0)
]
ThreadsOption = Annotated[
    int | None,
    option(
        "--jobs",
        "Threads of a diagnosis (default 2), or processes of a fleet (default 1). The result is the same for any number.",
        min=1,
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
    trust_fmu: TrustOption = False,
    cut: CutOption = None,
    unmeasured: UnmeasuredOption = None,
    max_seconds: TimeLimitOption = None,
    max_lag: LagOption = 0.5,
    jobs: ThreadsOption = None,
    engine: EngineOption = "local",
    seed: Annotated[int, option("--seed", "Seed of the bootstrap that gives the probabilities.", min=0)] = 0,
    json_file: JsonOption = None,
) -> None:
    """Find where a model and measurements disagree, and which physical effect is missing.

    Writes DIR/diagnosis.json, DIR/model.json (the model with the effects found) and DIR/report.html. Without --validate
    whole records of DATA are held out, or the last third of a single record.

    For an .fmu the parameters are refitted (DIR/parameters.ssv). The equations inside an .fmu are hidden, so no effect is named.

    A folder with records, validation*.csv and model.json is one case. A folder of such folders (VEHICLE_2024-05-01) is a
    fleet: every case is diagnosed, and the table is DIR/fleet.html. The same command continues an interrupted fleet.

    A folder of cases takes --model, --map, --accept, --max-lag, --seed, --jobs and --engine only.

    Without a measured road, --cut diagnoses the part above a node with an accelerometer, and --unmeasured refits the
    model by its likelihood (DIR/unmeasured.json, DIR/model.json).

    Example: isd-gym diagnose test1.csv test2.csv --model rig.json --out found

    Without a road: isd-gym diagnose drive.csv --model car.json --cut wheel --out found
    """
    begun = monotonic()
    from ..diagnosis import SearchSettings, diagnose
    from ..view._report import check_target

    check_file(json_file)
    accept, validate = accept or [], validate or []
    if len(data) == 1 and data[0].is_dir() and not validate:
        data, validate, model = _files_of_case(data[0], model)
    if len(data) == 1 and data[0].is_dir():
        if any(
            (validate, rename, unit, sign, rate, columns, elements, cut, unmeasured, uncertain, max_seconds)
        ):
            raise InputError(
                "a folder of cases takes --model, --map, --accept, --max-lag, --seed, --jobs and --engine only"
            )
        steps = {"map": map_file and str(map_file), "accept": accept, "seed": seed, "max_lag": max_lag}
        wing("fleet").diagnose_fleet(data[0], out, model, steps, jobs or 1, engine, json_file)
        return
    if model is None:
        raise InputError("--model is missing: name the model to compare the records with")
    shares = _shares(uncertain)
    check_records(data, validate)
    about = {"Model": model, "Data": ", ".join(map(str, data))}
    if validate:
        about["Validation"] = ", ".join(map(str, validate))
    if Path(model).suffix.lower() == ".fmu":
        _check_fmu_options(elements, cut, unmeasured, map_file, max_seconds, rate)
        check_target(out)
        named = read_names(rename, unit, columns, sign)
        named["header"] = named.pop("columns")
        result = wing("fmi").diagnose_unit(model, trust_fmu, data, validate, accept, named, shares)
        print_diagnosis(result, json_file, write_result(result, out, about))
        return
    network = _load_network(model, elements, shares)
    options = channel_names(network, rename, unit, map_file, columns, sign, rate)
    if "by" in options:
        network = options["by"].measured(network)
    unmeasured = unmeasured or next((c.name for c in network.inputs if not c.measured and cut is None), None)
    if unmeasured is not None:
        check_channels([unmeasured], [c.name for c in network.inputs], "--unmeasured")
        if cut is not None:
            raise InputError("--cut and --unmeasured exclude each other: use one of them")
        wing("no_road").identify_without_road(
            [*data, *validate], network, unmeasured, accept, options, max_seconds, out, json_file
        )
        return
    check_target(out)
    with lines() as say, _time_limit(max_seconds, begun):
        fitted, held = (_read_records(files, network, cut, options) for files in (data, validate))
        settings = SearchSettings(max_lag=max_lag, jobs=jobs or 2, max_seconds=max_seconds)
        result = diagnose(
            fitted, network, validate=held, accept=accept, progress=say, seed=seed, cut=cut, settings=settings
        )
        say("writing the report")
        page = write_result(result, out, about | {"Seed": str(seed)})
    print_diagnosis(result, json_file, page)


def _files_of_case(folder: Path, model: str | None) -> tuple[list[Path], list[Path], str | None]:
    """Return the records, the held-out records and the model of a folder. A fleet remains the folder itself."""
    case = wing("fleet").case_itself(folder, model)
    if case is None:
        return [folder], [], model
    return [*map(Path, case.data)], [*map(Path, case.validate)], model or case.model


def _check_fmu_options(*values: object) -> None:
    """Raise `InputError` for an option that an FMU does not take."""
    names = ("--elements", "--cut", "--unmeasured", "--map", "--max-seconds", "--rate")
    for name, value in zip(names, values, strict=True):
        if value:
            raise InputError(f"{name} wants a network (isd-model/1): the inside of an FMU is hidden")


def _load_network(model: str, elements: list[Path] | None, uncertainty: dict[str, float]) -> Network:
    """Return the nominal model with the elements of --elements and the uncertainty of --uncertain."""
    from ..physics.elements import register_file
    from ..physics.network import Network

    for file in elements or ():
        register_file(file)
    network = Network.load(model)
    return replace(network, uncertainty={**network.uncertainty, **uncertainty}) if uncertainty else network


def _read_records(
    files: list[Path], network: Network, cut: str | None, options: dict[str, Any]
) -> list[Table | Recording]:
    """Return the records of files with the channels of the network, or of its part above --cut."""
    from ..physics.network import cut as cut_at
    from ..records._loggers.record_reading import records_of

    part = network if cut is None else cut_at(network, cut)
    wanted = (*part.inputs, *part.outputs)
    return [record for file in files for record in records_of(file, network, wanted, **options)]


def _time_limit(max_seconds: float | None, begun: float) -> AbstractContextManager[object]:
    """Return the context of --max-seconds, without the time that is kept for the report."""
    from ..diagnosis._simulation.time_limit import TimeLimit

    if max_seconds is None:
        return nullcontext()
    return TimeLimit(max_seconds - REPORT * min(max_seconds, 15.0), monotonic, begun).until(inf)


def _shares(uncertain: list[str] | None) -> dict[str, float]:
    """Return the values of --uncertain as numbers."""
    out = {}
    for name, text in pairs(uncertain, "--uncertain", "PARAMETER=SHARE").items():
        try:
            out[name] = float(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
        except ValueError:
            raise InputError(f"--uncertain {name}: wants a share such as 0.05, not {shown(text)}") from None
        if not 0.0 <= out[name] <= 1.0:
            raise InputError(f"--uncertain {name}: wants a share from 0 to 1 (0.05 or 5%), not {shown(text)}")
    return out
