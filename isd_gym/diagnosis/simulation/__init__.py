"""The command `isd-gym simulate`: outputs of a model for the inputs of a table, and its errors on measured outputs."""

from __future__ import annotations

from ..._common.lazy import lazy

TYPE_CHECKING = False  # typing's own import costs 10 ms
if TYPE_CHECKING:
    from ._motions import state_of as state_of
    from ._record_fits import FittedInitialState as FittedInitialState
    from ._record_fits import initial_state as initial_state

#: public name -> its module
_HOME = {
    "FittedInitialState": "_record_fits",
    "initial_state": "_record_fits",
    "state_of": "_motions",
}
__all__ = [*_HOME]
__getattr__, __dir__ = lazy(__name__, _HOME)
