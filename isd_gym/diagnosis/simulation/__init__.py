"""The command `isd-gym simulate`: outputs of a model for the inputs of a table, and its errors on measured outputs."""

from __future__ import annotations

from ..._common.lazy import lazy

TYPE_CHECKING = False  # typing's own import costs 10 ms
if TYPE_CHECKING:
    from ._initial_state_fit import FittedInitialState as FittedInitialState
    from ._initial_state_fit import initial_state as initial_state
    from ._motions import state_of as state_of

#: public name -> its module
_HOME = {
    "FittedInitialState": "_initial_state_fit",
    "initial_state": "_initial_state_fit",
    "state_of": "_motions",
}
__all__ = [*_HOME]
__getattr__, __dir__ = lazy(__name__, _HOME)
