"""Find where simulation and measurement disagree, name the missing effect, and add it.

Data go one way: `records` (reading, filtering, clock lags, training/validation/test split) and `problem` (what was
measured), `structure` and `hypotheses` (what could be missing, where),
`noise`, `objective`, `fit`, `initial`, `states`, `begin` (how a model is fitted, and where it stands at first), `candidate`, `screen`, `race`,
`refits`, `compare`, `search` (which models are fitted, which of two is kept),
`judge`, `trial`, `measure`, `evidence` (what held-out records say of them), `criteria` (what that allows to say), `explain`,
`words`, `result` (how it is said), `workflow` (all of it).

Packages: `records` (reading, filtering, multirate, clock lag, splitting), `planning` (plan and design of tests), `fmu` (diagnosis of a
co-simulation FMU), `unknown_input` (identification without a measured road).
"""

from typing import TYPE_CHECKING, Any

from .result import Contender, Diagnosis, Effect, Law, Place, Quantity, Trace
from .selection.criteria import CRITERIA, Criteria
from .selection.settings import SearchSettings
from .verdict.evidence import EffectEvidence, Evidence
from .verdict.gates import Gate
from .workflow import diagnose

if TYPE_CHECKING:
    from .planning import Plan, plan

__all__ = [
    "CRITERIA",
    "Contender",
    "Criteria",
    "Diagnosis",
    "Effect",
    "EffectEvidence",
    "Evidence",
    "Gate",
    "Law",
    "Place",
    "Plan",
    "Quantity",
    "SearchSettings",
    "Trace",
    "diagnose",
    "plan",
]


def __getattr__(name: str) -> Any:
    if name in ("Plan", "plan"):
        from . import planning

        return getattr(planning, name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
