"""Test records with a hidden effect: a seeded generator of rigs, made by `reference`, not by the kernel.

`make_case(kind, seed)` draws a true network, small unmodelled effects of a few per cent (nuisances), one
hidden effect or two or none, records of it with coloured noise, and the model as its owner believes it:
without the hidden effect and the nuisances, and with base parameters off by a few per cent. `ALL_KINDS` names
all kinds. Levels follow the shared blind rigs: 500 Hz, AR(1) noise of 26 to 40 dB, a road record imperfect by
0.2 %, the current held for 5 ms, another road with a bump for validation.

A force cell reads everything that acts between its terminals, so the record of an element's force holds the
effects that stand side by side with that element.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .make import ALL_KINDS, family, make_case
from .secret import Case

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["ALL_KINDS", "Case", "family", "make_case", "save"]


def save(cases: Iterable[Case], folder: Path | str) -> None:
    """Write cases as the shared blind rigs are: a folder each, and `truth.json`."""
    folder = Path(folder)
    truth = {}
    for case in cases:
        place = folder / case.name
        place.mkdir(parents=True, exist_ok=True)
        (place / "model.json").write_text(json.dumps(case.model, indent=1))
        for which, table in (("estimation", case.estimation), ("validation", case.validation)):
            np.savetxt(
                place / f"{which}.csv",
                np.column_stack(list(table.values())),
                fmt=["%.4f"] + ["%.6g"] * (len(table) - 1),
                delimiter=",",
                header=",".join(table),
                comments="",
            )
        truth[case.name] = case.record()
    (folder / "truth.json").write_text(json.dumps(truth, indent=1))
