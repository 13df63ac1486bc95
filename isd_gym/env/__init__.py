"""The environments of Gymnasium.

- `_environment`: one car, and many at once; `_task` has the options.
- `_history`, `_sensors`, `_pictures`: observations with memory, imperfect sensors, frames.
- `wrappers`: the same options for environments of other packages.
- `registration`, `autoload`: names for `gymnasium.make`.
"""

from __future__ import annotations

TYPE_CHECKING = False  # typing's own import costs 10 ms
if TYPE_CHECKING:
    from typing import Any

    from ._environment import ISDSuspensionEnv as ISDSuspensionEnv
    from ._environment import ISDSuspensionVectorEnv as ISDSuspensionVectorEnv
    from ._sensors import Sensors as Sensors
    from ._task import RELATIVE_SCALE as RELATIVE_SCALE
    from ._task import Options as Options

#: public name -> its module
_HOME = {
    "ISDSuspensionEnv": "_environment",
    "ISDSuspensionVectorEnv": "_environment",
    "Options": "_task",
    "RELATIVE_SCALE": "_task",
    "Sensors": "_sensors",
}
__all__ = [*_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    from importlib import import_module

    value = globals()[name] = getattr(import_module(f".{_HOME[name]}", __name__), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
