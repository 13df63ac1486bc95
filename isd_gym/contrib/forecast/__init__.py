"""What a test can show before it is run: `isd-gym plan`.

Modules, lower ones first:

- `planning`: test signals of a rig, and the test that distinguishes given rivals; a diagnosis reaches it as the wing `forecast`.
- `virtual_bench`: simulation of a test.
- `result`: results of a plan.
- `sensitivity`: linearised responses to all effects.
- `detectability`: evidence for one effect.
- `sensors`, `effects`, `general_test`: additional sensors, smallest nameable sizes, choice of a test without rivals.
- `workflow`: the function `plan`.
- `page`, `command`: the page and the command.
"""

from .general_test import design_general_test, estimate_output_noise, read_rivals
from .result import STATUS, EffectForecast, Plan, SensorGain
from .workflow import plan, read_planned_record

__all__ = [
    "STATUS",
    "EffectForecast",
    "Plan",
    "SensorGain",
    "design_general_test",
    "estimate_output_noise",
    "plan",
    "read_planned_record",
    "read_rivals",
]
