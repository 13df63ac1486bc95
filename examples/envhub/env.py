"""Environments for LeRobot's EnvHub: `make_env("USER/isd-gym", n_envs=8, trust_remote_code=True)` loads this file.

Upload this file with a `requirements.txt` of one line, `isd-gym`. The observation is LeRobot's `agent_pos`.
"""

import gymnasium as gym

TASKS = (
    "quarter-car-isd",
    "quarter-car-active",
    "quarter-car-semiactive",
    "half-car-isd",
    "full-car-isd",
)


def _make(network):
    env = gym.make("ISDSuspension-v0", network=network)
    space = gym.spaces.Dict({"agent_pos": env.observation_space})
    return gym.wrappers.TransformObservation(
        env, lambda seen: {"agent_pos": seen}, space
    )


def make_env(n_envs=1, use_async_envs=False):
    """Return `{"isd_gym": {task: vector environment}}`, one task for each car of `TASKS`."""
    kind = gym.vector.AsyncVectorEnv if use_async_envs else gym.vector.SyncVectorEnv
    return {
        "isd_gym": {
            i: kind([lambda n=n: _make(n)] * n_envs) for i, n in enumerate(TASKS)
        }
    }
