"""`isd-gym card`: the references of the benchmark, and scores among them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from ._card_table import print_track


def command(
    scores: Annotated[
        list[Path] | None,
        typer.Argument(help="Scores to compare with the card: files of isd-gym score --json."),
    ] = None,
    card: Annotated[str, typer.Option("--card", help="Built-in card or a file.")] = "ISDSuspension-v0",
    write: Annotated[
        Path | None,
        typer.Option(
            "--write",
            help="Write a card of the scores instead, one track per score, named after its file.",
            metavar="FILE",
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

        from ..files import write_text

        if not found:
            raise InputError("--write wants scores to make a card of")
        tracks = [
            cards.track(score, path.stem, str(score.get("command", "")))
            for score, path in zip(found, scores or (), strict=True)
        ]
        made = cards.make("ISDSuspension-v0", tracks, datetime.date.today().isoformat())
        write_text(write, json.dumps(made) + "\n")
        typer.echo(
            f"{len(tracks)} track{'' if len(tracks) == 1 else 's'} in {write}, digest {made['digest'][:16]}"
        )
        return
    held = cards.load(card)
    names = [cards.match(score, held)["track"] for score in found]
    for one in held["tracks"]:
        if names and one["track"] not in names:
            continue
        print_track(held, one["track"], [s for s, n in zip(found, names, strict=True) if n == one["track"]])
