"""A vehicle suspension with a hydraulic electric inerter, for control, learning and diagnosis.

Importing the package makes its environments known to Gymnasium and loads nothing else: the names below, and the modules
(`isd_gym.env.environment`, `isd_gym.physics.road`, ...), come with their first use.

What a suspension is: `elements`, `network`, `networks` (the built-in models). How it moves: `kernel`, `road`, `simulate`,
`vehicle`, `batch`. Records: `data`, `schemas`. Functional mock-up units: `fmi`. The environment: `task`, `env`, `cost`, `sb3`;
on it `benchmark` (policies, scores, cards, sweeps). The diagnosis: `discrepancy`. Views: `report`, `rendering`, `show`. The
program: `commands`.
"""

from __future__ import annotations

from .env import autoload as _autoload  # noqa: F401  registers the environments, now or after the import of Gymnasium

TYPE_CHECKING = False  # typing's own import costs 10 ms
if TYPE_CHECKING:
    from typing import Any

    from .benchmark.scoring import Score
    from .benchmark.scoring import score
    from .physics.cost import StageCost
    from .records.data import Table
    from .records.data import read_table
    from .diagnosis import Diagnosis
    from .diagnosis import diagnose
    from .env.environment import ISDSuspensionEnv
    from .env.environment import ISDSuspensionVectorEnv
    from .common.errors import InputError
    from .physics.network import Network
    from .physics.network import linearise
    from .physics.simulate import simulate

__version__ = "0.1.0"

#: public name -> its module; `simulate` is a callable module, see its end
_HOME = {
    "Diagnosis": "discrepancy",
    "ISDSuspensionEnv": "env",
    "ISDSuspensionVectorEnv": "env",
    "InputError": "errors",
    "Network": "network",
    "Score": "benchmark.scoring",
    "StageCost": "cost",
    "Table": "data",
    "diagnose": "discrepancy",
    "linearise": "network",
    "read_table": "data",
    "score": "benchmark.scoring",
}
__all__ = [*_HOME, "simulate"]


def __getattr__(name: str) -> Any:
    from importlib import import_module
    from importlib.util import find_spec

    if name in _HOME:
        value = getattr(import_module(f".{_HOME[name]}", __name__), name)
        globals()[name] = value
        return value
    if not name.startswith("_") and find_spec(f"{__name__}.{name}") is not None:
        return import_module(f".{name}", __name__)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
