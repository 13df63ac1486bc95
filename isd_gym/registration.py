"""The environments, made known to Gymnasium; importing this costs nothing."""

from __future__ import annotations

ENVIRONMENTS = {
    "ISDSuspension-v0": "quarter-car-isd",
    "ISDSuspensionEq8-v0": "quarter-car-eq8",
    "ISDHalfCar-v0": "half-car-isd",
    "ISDFullCar-v0": "full-car-isd",
}
EPISODE_STEPS = 4000  # 20 s at 5 ms


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
                kwargs={"network": network},
            )
