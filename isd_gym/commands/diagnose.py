"""`isd-gym diagnose`: what a model lacks, from measured records."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..common.errors import InputError, shown
from ..common.plugins import wing
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
    column_names,
    complete,
    network_names,
    pairs,
    signs_of,
)
from .console import check_file, lines

if TYPE_CHECKING:
    from ..physics.network import Network

#: share of --max-seconds that is kept for the report; of 15 s at most
REPORT = 0.2


DataArgument = Annotated[
    list[Path],
    typer.Argument(
        help="Measured records with time and the model's channels (CSV, Excel, Parquet, .mat, .mf4, .tdms, .uff, .gz). Join files of several loggers "
        "by +: body.csv+wheel.mf4."
    ),
]

OutOption = Annotated[Path, typer.Option("--out", help="Folder of the result.", metavar="DIR")]

ModelOption = Annotated[
    str | None,
    typer.Option(
        help="Nominal model: a file, a built-in network, or an FMU (.fmu). Required, except for a folder of cases with "
        "their own model.json.",
        autocompletion=complete(network_names),
    ),
]

ValidateOption = Annotated[
    list[Path] | None,
    typer.Option(
        help="Held-out records. One part chooses the effect, the rest gives the reported errors. Without this option some of "
        "DATA are held out.",
        metavar="DATA...",
    ),
]

AcceptOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Data check that only warns: held, jumps, magnitude, length, silent, copies, sign, all. May be repeated.",
        metavar="CHECK",
    ),
]

UncertainOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Relative standard deviation of a parameter (0.05 or 5%). The parameter is then refitted. Overrides the model file.",
        metavar="PARAMETER=SHARE",
    ),
]

TrustFmuOption = Annotated[
    bool, typer.Option("--trust-fmu", help="Run the compiled code of an .fmu. The code has your rights.")
]

CutOption = Annotated[
    str | None,
    typer.Option(
        help="Without a measured road: node with an accelerometer. The motion of the node drives the part of the model above "
        "the node. The part below (tyre, road) is left out.",
        metavar="NODE",
    ),
]

UnmeasuredOption = Annotated[
    str | None,
    typer.Option(
        help="Without a measured road: the unmeasured input, taken as white velocity in the likelihood of a linear model. Default: "
        'the input with "measured": false in the model file.',
        metavar="INPUT",
    ),
]

MaxSecondsOption = Annotated[
    float | None,
    typer.Option(
        help="Time after which the diagnosis ends [s], with what was found; the summary lists what was not tried. The first "
        "compilation of the kernels (isd-gym warm) does not count. The result then depends on the speed of the machine. "
        "Default: no limit; with --unmeasured 120 s of processor time.",
        min=1.0,
        metavar="SECONDS",
    ),
]

MaxLagOption = Annotated[
    float, typer.Option(help="Largest offset between the clocks of two loggers [s].", min=0.0)
]

JobsOption = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        help="Threads of a diagnosis (default 2), or processes of a fleet (default 1). The result is the same for any number.",
        min=1,
    ),
]

SeedOption = Annotated[int, typer.Option(help="Seed of the bootstrap that gives the probabilities.", min=0)]


def command(
    data: DataArgument,
    out: OutOption,
    model: ModelOption = None,
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
    trust_fmu: TrustFmuOption = False,
    cut: CutOption = None,
    unmeasured: UnmeasuredOption = None,
    max_seconds: MaxSecondsOption = None,
    max_lag: MaxLagOption = 0.5,
    jobs: JobsOption = None,
    engine: EngineOption = "local",
    seed: SeedOption = 0,
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
    check_file(json_file)
    if len(data) == 1 and data[0].is_dir() and not validate:
        case = wing("fleet").case_itself(data[0], model)
        if case is not None:  # the folder is one case
            data, validate = [*map(Path, case.data)], [*map(Path, case.validate)]
            model = model or case.model
    if len(data) == 1 and data[0].is_dir():
        refused = (
            validate,
            rename,
            unit,
            sign,
            rate,
            columns,
            elements,
            cut,
            unmeasured,
            uncertain,
            max_seconds,
        )
        if any(refused):
            raise InputError(
                "a folder of cases takes --model, --map, --accept, --max-lag, --seed, --jobs and --engine only"
            )
        steps = {"map": map_file and str(map_file), "accept": accept or [], "seed": seed, "max_lag": max_lag}
        wing("fleet").diagnose_fleet(data[0], out, model, steps, jobs or 1, engine, json_file)
        return
    if model is None:
        raise InputError("--model is missing: name the model to compare the records with")
    shares = _shares(uncertain)
    check_records(data, validate or [])
    records = _Records(model, data, validate or [], accept or [], out, json_file, shares)
    if Path(model).suffix.lower() == ".fmu":
        given = {"elements": elements, "cut": cut, "unmeasured": unmeasured, "map": map_file}
        _check_unit_options({**given, "max-seconds": max_seconds, "rate": rate})
        named = {
            "rename": pairs(rename, "--rename", "COLUMN=CHANNEL"),
            "units": pairs(unit, "--unit", "CHANNEL=UNIT"),
            "header": column_names(columns),
            "signs": signs_of(sign),
        }
        records.diagnose_unit(named, trust_fmu)
        return
    network, options = _network(model, elements, shares, (rename, unit, map_file, columns, sign, rate))
    unmeasured = unmeasured or next((c.name for c in network.inputs if not c.measured and cut is None), None)
    if unmeasured is not None:
        if cut is not None:
            raise InputError("--cut and --unmeasured exclude each other: use one of them")
        records.identify_without_road(network, unmeasured, options, max_seconds)
        return
    settings = {"max_lag": max_lag, "jobs": jobs or 2, "max_seconds": max_seconds}
    records.diagnose(network, options, cut, seed, settings, begun)


@dataclass(frozen=True)
class _Records:
    """The records of a command, its model and where the result is written."""

    model: str
    data: list[Path]
    validate: list[Path]
    #: names of data checks that only warn
    accept: list[str]
    out: Path
    json_file: Path | None
    #: relative standard deviations of --uncertain by parameter
    shares: dict[str, float]

    @property
    def about(self) -> dict[str, str]:
        """What the report says of its sources."""
        held = {"Validation": ", ".join(map(str, self.validate))} if self.validate else {}
        return {"Model": self.model, "Data": ", ".join(map(str, self.data)), **held}

    def diagnose_unit(self, named: dict[str, Any], trust: bool) -> None:
        """Refit the parameters of an FMU."""
        from ..view.report import check_target

        check_target(self.out)
        result = wing("fmi").diagnose_unit(
            self.model, trust, self.data, self.validate, self.accept, named, self.shares
        )
        print_diagnosis(result, self.json_file, write_result(result, self.out, self.about))

    def identify_without_road(
        self, network: Network, unmeasured: str, options: dict[str, Any], max_seconds: float | None
    ) -> None:
        """Refit a linear model with an input that was not measured."""
        check_channels([unmeasured], [c.name for c in network.inputs], "--unmeasured")
        files = [*self.data, *self.validate]
        wing("no_road").identify_without_road(
            files, network, unmeasured, self.accept, options, max_seconds, self.out, self.json_file
        )

    def diagnose(
        self,
        network: Network,
        options: dict[str, Any],
        cut: str | None,
        seed: int,
        settings: dict[str, Any],
        begun: float,
    ) -> None:
        """Diagnose the records; the time since `begun` counts to --max-seconds."""
        from ..diagnosis import SearchSettings, diagnose
        from ..diagnosis.simulation.time_limit import TimeLimit
        from ..physics.network import cut as cut_at
        from ..records.loggers.record_reading import records_of
        from ..view.report import check_target

        check_target(self.out)
        part = network if cut is None else cut_at(network, cut)
        wanted, seconds = (*part.inputs, *part.outputs), settings["max_seconds"]
        limit = seconds and TimeLimit(seconds - REPORT * min(seconds, 15.0), monotonic, begun)
        with lines() as say, limit.until(inf) if limit else nullcontext():
            fitted, held = (
                [r for f in files for r in records_of(f, network, wanted, **options)]
                for files in (self.data, self.validate)
            )
            result = diagnose(
                fitted,
                network,
                validate=held,
                accept=self.accept,
                progress=say,
                seed=seed,
                cut=cut,
                settings=SearchSettings(**settings),
            )
            say("writing the report")
            page = write_result(result, self.out, self.about | {"Seed": str(seed)})
        print_diagnosis(result, self.json_file, page)


def _network(
    model: str, elements: list[Path] | None, shares: dict[str, float], names: tuple[Any, ...]
) -> tuple[Network, dict[str, Any]]:
    """Return the nominal model and how columns give its channels; `names` are the values of the options of `channel_names`."""
    from ..physics import elements as el
    from ..physics.network import Network

    for file in elements or ():
        el.register_file(file)
    network = Network.load(model)
    if shares:
        network = replace(network, uncertainty={**network.uncertainty, **shares})
    options = channel_names(network, *names)
    return options["by"].measured(network) if "by" in options else network, options


def _check_unit_options(given: dict[str, Any]) -> None:
    """Raise `InputError` for an option that an FMU cannot take."""
    for option, value in given.items():
        if value:
            raise InputError(f"--{option} wants a network (isd-model/1): the inside of an FMU is hidden")


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
