"""`isd-gym card`: the references of the benchmark, and scores among them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Any

import typer

from .._common.errors import InputError, plain
from ..env.registration import ENVIRONMENTS
from ._card_table import print_track
from ._options import option


def command(
    scores: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Scores to compare with the card: files of isd-gym score --json."
        ),
    ] = None,
    card: Annotated[
        str | None,
        option(
            "--card",
            "Built-in card (ISDSuspension-v0, ISDHalfCar-v0, ISDFullCar-v0, quarter-car-active, quarter-car-semiactive) or a file. Default: the card of the scores' car.",
        ),
    ] = None,
    write: Annotated[
        Path | None,
        option(
            "--write FILE",
            "Write a card of the scores instead, one track per score, named after its file.",
        ),
    ] = None,
) -> None:
    """Show the references of the benchmark, best first, with other scores among them.

    A score must be on the same roads. Its policies are compared with each reference episode by episode.

    Example: isd-gym card score.json
    """
    from ..benchmark import cards

    found = [cards.read_score(path) for path in scores or ()]
    if write is not None:
        import datetime

        from .._common.files import write_text

        if not found:
            raise InputError("--write wants scores to make a card of")
        tracks = [
            cards.track(score, path.stem, _command(score))
            for score, path in zip(found, scores or (), strict=True)
        ]
        made = cards.make(
            _environment(found), tracks, datetime.date.today().isoformat()
        )
        write_text(write, json.dumps(made) + "\n")
        typer.echo(
            f"{len(tracks)} track{'' if len(tracks) == 1 else 's'} in {write}, digest {made['digest'][:16]}"
        )
        return
    own = _environment(found) if card is None else card
    held = cards.load(
        own if card is not None or own in cards.built_in() else "ISDSuspension-v0"
    )
    names = [cards.match(score, held)["track"] for score in found]
    for one in held["tracks"]:
        if names and one["track"] not in names:
            continue
        print_track(
            held,
            one["track"],
            [s for s, n in zip(found, names, strict=True) if n == one["track"]],
        )


def _environment(scores: list[dict[str, Any]]) -> str:
    """Return the environment of the scores' car; the quarter car's without scores or for another car.

    Raises `InputError` for scores of different cars.
    """
    from ..benchmark.tracks import TRACKS

    names = dict.fromkeys(str(score.get("network")) for score in scores)
    if len(names) > 1:
        raise InputError(
            f"the scores are of different cars: {', '.join(map(plain, names))}"
        )
    known = {track.network: track.card for track in TRACKS.values()}
    known |= {network: name for name, network in ENVIRONMENTS.items()}
    return known.get(next(iter(names), ""), "ISDSuspension-v0")


def _command(score: dict[str, Any]) -> str:
    """Return the command of a score without its file of results."""
    return re.sub(r" --json[ =]\S+", "", str(score.get("command", "")))
