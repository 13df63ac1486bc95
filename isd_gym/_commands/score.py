"""`isd-gym score`: policies on the same roads, paired with the passive car."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from .._common.errors import InputError
from ._card_table import print_track
from ._options import (
    DurationOption,
    JsonOption,
    NetworkOption,
    PoliciesArgument,
    PreviewOption,
    RoadOption,
    SeedOption,
    SpeedOption,
    TrainedOption,
    option,
)
from ._score_table import print_score
from .console import check_file, progress, warm_up, write_json

EpisodesOption = Annotated[
    int,
    option("--episodes", "Number of roads. All policies drive the same roads.", min=1),
]
CardOption = Annotated[
    str | None,
    option(
        "--against CARD",
        "Compare with a benchmark card: ISDSuspension-v0, ISDHalfCar-v0, ISDFullCar-v0, or a file. Its references are not driven again.",
    ),
]
SensorsOption = Annotated[
    str,
    option(
        "--sensors",
        "Sensor imperfections, joined by commas: noise=1, delay=1 (control steps), road_error=0.001 (m), road_lag=0.01 (s), road_range=3 (m).",
    ),
]
ControllerModelOption = Annotated[
    str | None,
    option("--model", "Model of the controllers. Default: the vehicle itself."),
]
TrackOption = Annotated[
    str | None,
    option(
        "--track",
        "Track of the benchmark, such as standard, active-c or semiactive-bump: car, road, speed, road ahead and number of roads at once.",
    ),
]
PointOption = Annotated[
    str | None,
    option(
        "--point",
        "Point of the body at which ISO 2631-1 is evaluated. Default: the driver, if the network has one.",
    ),
]


#: parameters of the command that a track sets
SET_BY_TRACK = ("network", "road", "speed", "preview", "episodes")


def _refuse_conditions(context: typer.Context) -> None:
    """Raise `InputError` for options beside --track that the track sets."""
    named = context.get_parameter_source("track")
    conditions = [p for p in context.command.params if p.name in SET_BY_TRACK]
    given = [
        p.opts[0]
        for p in conditions
        if context.get_parameter_source(str(p.name)) == named
    ]
    if given:
        raise InputError(f"--track sets {', '.join(given)}; leave out one or the other")


def command(
    context: typer.Context,
    policies: PoliciesArgument,
    track: TrackOption = None,
    road: RoadOption = "paper",
    speed: SpeedOption = 20.0,
    episodes: EpisodesOption = 32,
    seed: SeedOption = None,
    duration: DurationOption = 20.0,
    preview: PreviewOption = None,
    against: CardOption = None,
    sensors: SensorsOption = "",
    network: NetworkOption = "quarter-car-isd",
    model: ControllerModelOption = None,
    point: PointOption = None,
    report: Annotated[
        Path | None, option("--report DIR", "Write a page with plots to this folder.")
    ] = None,
    trained_with: TrainedOption = None,
    json_file: JsonOption = None,
    full: Annotated[
        bool,
        option("--full", "Print every table, and the bounds and published figures."),
    ] = False,
) -> None:
    """Score policies on the same roads and compare them with the conventional passive car.

    The table shows the cost J and the RMS of body acceleration, suspension travel and dynamic tyre load. Each number has
    its change against passive with a 95 % interval. --full adds peaks, energy, times, pitch, roll and each corner, and,
    where their conditions hold, the known bounds. They are means over random roads, so use at least 32 episodes of 20 s.

    Example: isd-gym score passive isd-passive mpc
    """
    from ..benchmark.ceilings import bounds_beside
    from ..benchmark.policies import find_all, passive
    from ..benchmark.scoring import IDLE, LEARN, Conditions, idle_policies, unscored
    from ..benchmark.scoring import score as run
    from ..env import Sensors
    from ..physics.network import Network
    from ..physics.road import road as find_road
    from ..physics.vehicle import vehicle

    chosen = None
    if track is not None:
        from ..benchmark.tracks import find_track

        chosen = find_track(track)
        _refuse_conditions(context)
        network = chosen.network
        road = chosen.road
        speed = chosen.speed
        preview = chosen.preview or None
        episodes = chosen.episodes
    check_file(json_file, network, model, road)
    senses = Sensors.of(sensors)
    if report is not None:
        from ..view.report import check_report

        check_report(report)
    plant = Network.load(network)
    drives = Conditions(find_road(road), speed, episodes, seed, duration, senses)
    drives.check(vehicle(plant))
    belief = Network.load(model) if model else None
    ahead: dict[str, Any] = {} if preview is None else {"preview": preview}
    entries = find_all(
        policies, plant, model=belief, speed=speed, trained=trained_with, **ahead
    )
    if chosen is not None:
        chosen.check(entries)
    card = place = None
    if against is not None:
        from ..benchmark import cards

        card = cards.load(against)
        place = cards.match(unscored(entries, plant, drives).to_dict(), card)["track"]
    with progress() as update:
        warm_up(update)
        result = run(
            entries,
            plant,
            reference=passive(plant),
            point=point,
            progress=update,
            **vars(drives),
        )
    result.model = belief if belief != plant else None
    result.references |= bounds_beside(result)
    made = result.to_dict() | {"command": " ".join(["isd-gym", *sys.argv[1:]])}
    write_json(json_file, made)
    if report is not None:
        from ..view.report import score_report

        page = score_report(result, report)
        typer.echo(f"report: {page}", err=True)
    print_score(result, full=full)
    for name in idle_policies(result):
        typer.echo(
            f"'{name}' costs what zero current costs, within {100 * IDLE:g} %. {LEARN}",
            err=True,
        )
    if card is not None and place is not None:
        print_track(card, place, [made])
