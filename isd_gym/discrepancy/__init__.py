"""Find where simulation and measurement disagree, name the missing effect, and add it.

Data go one way: `records` and `problem` (what was measured), `structure` and `hypotheses` (what could be missing, where),
`noise`, `fit`, `initial` (how a model is fitted), `candidate`, `screen`, `race`, `search` (which models are fitted),
`judge`, `trial`, `measure`, `evidence` (what held-out records say of them), `criteria` (what that allows to say), `explain`,
`experiments`, `words`, `result` (how it is said), `workflow` (all of it);
`blackbox` and `unit` do what can be done of that for a model without an inside.
"""

from .criteria import CRITERIA, Criteria, Gate
from .evidence import EffectEvidence, Evidence
from .result import Contender, Diagnosis, Effect, Law, Place, Quantity, Trace
from .settings import SearchSettings
from .unit import diagnose_unit
from .workflow import diagnose

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
    "Quantity",
    "SearchSettings",
    "Trace",
    "diagnose",
    "diagnose_unit",
]
