"""Design of the test that decides between the candidates of a diagnosis.

`excitation` has the test signals of a rig, `design` chooses among them.
"""

from .design import Design, Rival, design_test, next_experiment, played
from .excitation import (
    KINDS,
    Excitation,
    Limits,
    Rig,
    infer_rig,
    list_excitations,
    make_excitation,
    make_record,
)

__all__ = [
    "KINDS",
    "Design",
    "Excitation",
    "Limits",
    "Rig",
    "Rival",
    "design_test",
    "infer_rig",
    "list_excitations",
    "make_excitation",
    "make_record",
    "next_experiment",
    "played",
]
