"""Plan and design of tests before a diagnosis.

Modules, lower ones first:

- `excitation`: test signals of a rig.
- `virtual_bench`: simulation of a test.
- `plan_result`: results of a plan.
- `sensitivity`: linearised responses to all effects.
- `detectability`: evidence for one effect.
- `sensors`, `forecast`, `design`: additional sensors, smallest nameable sizes, choice of a test.
- `workflow`: the function `plan`.
"""

from .design import (
    Design,
    design_general_test,
    design_test,
    estimate_output_noise,
    next_experiment,
    played,
    read_rivals,
)
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
from .plan_result import STATUS, EffectForecast, Plan, SensorGain
from .workflow import plan, read_planned_record

__all__ = [
    "KINDS",
    "STATUS",
    "Design",
    "EffectForecast",
    "Excitation",
    "Limits",
    "Plan",
    "Rig",
    "SensorGain",
    "design_general_test",
    "design_test",
    "estimate_output_noise",
    "infer_rig",
    "list_excitations",
    "make_excitation",
    "make_record",
    "next_experiment",
    "plan",
    "played",
    "read_planned_record",
    "read_rivals",
]
