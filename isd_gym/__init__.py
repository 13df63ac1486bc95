"""A vehicle suspension with a hydraulic electric inerter, for control, learning and diagnosis.

Importing the package makes its environments known to Gymnasium and loads nothing else: the names below, and the modules
(`isd_gym.physics.road`, `isd_gym.sb3`, ...), come with their first use. Modules whose names begin with `_` are private.

Rooms, lower ones first:

- `_common`: errors, files, units.
- `records`: what was measured, and its files.
- `physics`: what a suspension is and how it moves.
- `env`: the environments of Gymnasium; `sb3` gives them to Stable-Baselines3.
- `benchmark`: policies, scores and cards; `baselines` and `agents` have controllers and trained policies.
- `diagnosis`: which effect a model lacks.
- `view`: pages and pictures.
- `_commands`: the program.
"""

from __future__ import annotations

from ._common.lazy import lazy
from ._common.version import __version__ as __version__
from .env import autoload as _autoload  # noqa: F401  registers the environments, now or after the import of Gymnasium

TYPE_CHECKING = False  # typing's own import costs 10 ms
if TYPE_CHECKING:
    from ._common.errors import InputError as InputError
    from ._common.errors import MissingColumn as MissingColumn
    from ._common.errors import ReportError as ReportError
    from ._common.errors import TyreContactWarning as TyreContactWarning
    from .benchmark.scoring import Score as Score
    from .benchmark.scoring import score as score
    from .diagnosis import Diagnosis as Diagnosis
    from .diagnosis import diagnose as diagnose
    from .env._environment import ISDSuspensionEnv as ISDSuspensionEnv
    from .env._environment import ISDSuspensionVectorEnv as ISDSuspensionVectorEnv
    from .physics.cost import StageCost as StageCost
    from .physics.network import Network as Network
    from .physics.network import linearise as linearise
    from .physics.simulate import simulate as simulate
    from .records.data import Table as Table
    from .records.data import read_table as read_table

#: public name -> its module
_HOME = {
    "Diagnosis": "diagnosis",
    "ISDSuspensionEnv": "env._environment",
    "ISDSuspensionVectorEnv": "env._environment",
    "InputError": "_common.errors",
    "MissingColumn": "_common.errors",
    "Network": "physics.network",
    "ReportError": "_common.errors",
    "Score": "benchmark.scoring",
    "StageCost": "physics.cost",
    "Table": "records.data",
    "TyreContactWarning": "_common.errors",
    "diagnose": "diagnosis",
    "linearise": "physics.network",
    "read_table": "records.data",
    "score": "benchmark.scoring",
    "simulate": "physics.simulate",
}
__all__ = [*_HOME]
__getattr__, __dir__ = lazy(__name__, _HOME)
