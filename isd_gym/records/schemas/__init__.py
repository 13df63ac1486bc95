"""JSON Schemas (draft 2020-12) of the file formats: `isd-model/1`, `isd-score/1`, `isd-diagnosis/1` and the others in `NAMES`.

The files ``isd-*.json`` in this folder are shipped for editors and other programs. A schema describes the structure of
a file. References within a file (a node that exists, a motor of a given name) are checked by
`isd_gym.physics.network.Network.load`, with one-line errors.
"""

from __future__ import annotations

import functools
import json
from importlib import resources
from typing import Any

from ..._common.errors import InputError, plain

__all__ = [
    "load",
]


NAMES = (
    "isd-model-1",
    "isd-score-1",
    "isd-card-1",
    "isd-diagnosis-1",
    "isd-map-1",
)


def load(name: str) -> dict[str, Any]:
    """Return a shipped schema.

    Args:
        name: Name of the format, such as 'isd-model/1' or 'isd-model-1'.

    Raises:
        InputError: No such schema exists.
    """
    stem = name.replace("/", "-")
    if stem not in NAMES:
        known = ", ".join(n[:-2] + "/1" for n in NAMES)
        raise InputError(f"no schema '{name}': there are {known}")
    return json.loads(
        (resources.files(__name__) / f"{stem}.json").read_text(encoding="utf-8")
    )


def check(data: Any, name: str, where: str) -> None:
    """Raise `InputError` with the place unless plain data have the structure of a format such as
    'isd-score/1'; `where` begins the message."""
    from jsonschema.exceptions import best_match

    error = best_match(_validator(name).iter_errors(data))
    if error is not None:
        place = error.json_path.removeprefix("$").removeprefix(".")
        raise InputError(
            f"{where}: {place + ': ' if place else ''}{plain(error.message, 200)}"
        )


@functools.cache
def _validator(name: str) -> Any:
    from jsonschema import Draft202012Validator

    return Draft202012Validator(load(name))
