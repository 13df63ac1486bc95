"""Registration of the environments with Gymnasium; the import costs nothing."""

from __future__ import annotations

ENVIRONMENTS = {
    "ISDSuspension-v0": "quarter-car-isd",
    "ISDSuspensionEq8-v0": "quarter-car-eq8",
    "ISDHalfCar-v0": "half-car-isd",
    "ISDFullCar-v0": "full-car-isd",
}
#: environment by number of corners
BY_CORNERS = {1: "ISDSuspension-v0", 2: "ISDHalfCar-v0", 4: "ISDFullCar-v0"}
EPISODE_STEPS = 4000  # 20 s at 5 ms
#: Mean return from which on an environment counts as solved: the level of the best classical controllers on the 32 roads of
#: the score (`mpc-friction` -2627, `lqg` -2629; `mpc` -2645 and the passive car -3427 stay below). None where no card exists.
REWARD_THRESHOLDS = {"ISDSuspension-v0": -2630.0}


def register() -> None:
    """Register every environment of the package that Gymnasium does not know yet."""
    from gymnasium.envs.registration import register as add
    from gymnasium.envs.registration import registry

    for name, network in ENVIRONMENTS.items():
        if name not in registry:
            add(
                id=name,
                entry_point="isd_gym.env:ISDSuspensionEnv",
                vector_entry_point="isd_gym.env:ISDSuspensionVectorEnv",
                max_episode_steps=EPISODE_STEPS,
                reward_threshold=REWARD_THRESHOLDS.get(name),
                kwargs={"network": network},
            )
