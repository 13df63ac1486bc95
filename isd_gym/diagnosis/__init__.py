"""Find where simulation and measurement disagree, name the missing effect, and add it.

Data go one way, from the first of these packages to the last:

- `_simulation`: records and channels, and what a model says of them;
- `_records`: reading, resampling, filtering, feedback, training, validation and test parts;
- `_estimation`: fits of a model with its initial states, clock lags and noise;
- `_hypotheses`: effects that could be missing, at places, with the motion and the forces there;
- `_selection`: which effects predict held-out records best;
- `_verdict`: evidence, what it allows to say, and the words.

`_workflow` runs the packages, and `_result_builder` makes the `result`.
`_planning` designs the test that would decide between candidates.
"""

from ._hypotheses.library import Hypothesis, hypotheses
from ._selection.criteria import CRITERIA, Criteria
from ._selection.settings import SearchSettings
from ._verdict.evidence import Evidence
from ._verdict.gates import Gate
from ._workflow import diagnose
from .result import Diagnosis, Effect, LawSet, Place, Quantity, Trace

__all__ = [
    "CRITERIA",
    "Criteria",
    "Diagnosis",
    "Effect",
    "Evidence",
    "Gate",
    "Hypothesis",
    "LawSet",
    "Place",
    "Quantity",
    "SearchSettings",
    "Trace",
    "diagnose",
    "hypotheses",
]
