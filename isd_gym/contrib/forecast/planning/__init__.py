"""Design of the test that decides between the candidates of a diagnosis.

`_excitation` has the test signals of a rig, `_design` chooses among them.
"""

from ._design import Design, Rival, design_test, next_experiment, played
from ._excitation import (
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
