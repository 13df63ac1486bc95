"""Find where simulation and measurement disagree, name the missing effect, and add it.

Data go one way, from the first of these packages to the last:

- `simulation`: records and channels, and what a model says of them;
- `records`: reading, filtering, several rates, feedback, training, validation and test parts;
- `estimation`: fits of a model with its initial states, clock lags and noise;
- `hypotheses`: effects that could be missing, at places, with the motion and the forces there;
- `selection`: which effects predict held-out records best;
- `verdict`: evidence, what it allows to say, and the words.

`workflow` runs all of it, `result_builder` makes the `result` of what it found, `prediction_errors` judges a model as it is, and
`planning` predicts what a test can show.
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
