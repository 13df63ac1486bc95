"""The environments of Gymnasium.

- `environment`: one car, and many at once; `task` has the options.
- `history`, `sensors`, `pictures`: observations with memory, imperfect sensors, frames.
- `wrappers`: the same options for environments of other packages.
- `registration`, `autoload`: names for `gymnasium.make`.
"""
