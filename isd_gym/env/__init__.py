"""The environments of Gymnasium.

- `environment`: one car, and many at once; `task` has the options.
- `history`, `sensors`, `pictures`: observations with memory, imperfect sensors, frames.
- `registration`, `autoload`: names for `gymnasium.make`.
"""
