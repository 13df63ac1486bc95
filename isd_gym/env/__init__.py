"""The environments of Gymnasium.

- `_environment`: one car, and many at once; `task` has the options.
- `history`, `_sensors`, `_pictures`: observations with memory, imperfect sensors, frames.
- `registration`, `autoload`: names for `gymnasium.make`.
"""

from __future__ import annotations

from .._common.lazy import lazy

TYPE_CHECKING = False  # typing's own import costs 10 ms
if TYPE_CHECKING:
    from ._environment import ISDSuspensionEnv as ISDSuspensionEnv
    from ._environment import ISDSuspensionVectorEnv as ISDSuspensionVectorEnv
    from ._sensors import Sensors as Sensors
    from .task import RELATIVE_SCALE as RELATIVE_SCALE
    from .task import Options as Options

#: public name -> its module
_HOME = {
    "ISDSuspensionEnv": "_environment",
    "ISDSuspensionVectorEnv": "_environment",
    "Options": "task",
    "RELATIVE_SCALE": "task",
    "Sensors": "_sensors",
}
__all__ = [*_HOME]
__getattr__, __dir__ = lazy(__name__, _HOME)
