"""`isd-gym policies`: the list of policies."""

from __future__ import annotations

from ._options import JsonOption
from .console import print_names, write_json


def command(json_file: JsonOption = None) -> None:
    """List the policies that score and show know by name.

    These commands also take a trained policy's folder or .zip.

    Example: isd-gym policies
    """
    from ..benchmark.policies import available

    known = available()
    write_json(json_file, {"policies": known})
    print_names(known)
