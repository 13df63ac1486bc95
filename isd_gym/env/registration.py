"""Registration of the environments with Gymnasium; the import costs nothing."""

from __future__ import annotations

ENVIRONMENTS = {
    "ISDSuspension-v0": "quarter-car-isd",
    "ISDSuspensionEq8-v0": "quarter-car-eq8",
    "ISDHalfCar-v0": "half-car-isd",
    "ISDFullCar-v0": "full-car-isd",
}
#: environments with the options that learning algorithms need: scaled signals with memory, a shaped reward, currents in
#: [-1, 1]. The cars are those of the others.
LEARNING = {
    "ISDSuspensionLearning-v0": "quarter-car-isd",
    "ISDHalfCarLearning-v0": "half-car-isd",
    "ISDFullCarLearning-v0": "full-car-isd",
}
#: the scale suits SAC with default hyperparameters: mean and worst of five seeds after 8,000 decisions are J -21.9 and
#: -20.0 % against passive at 10, -21.4 and -20.6 % at 3; PPO reaches -23.1 % at 1 and -23.3 % at 10
_LEARNING_OPTIONS = {
    "observation": "history",
    "reward": "shaped",
    "action": "share",
    "reward_scale": 10.0,
}
#: environment by number of corners
BY_CORNERS = {1: "ISDSuspension-v0", 2: "ISDHalfCar-v0", 4: "ISDFullCar-v0"}
EPISODE_STEPS = 4000  # 20 s at 5 ms
#: Mean return from which on an environment counts as solved: the best classical controller of the card, rounded down to a
#: multiple of 5 (`benchmarks/tracks.py` prints them). None where no card exists.
REWARD_THRESHOLDS = {
    "ISDFullCar-v0": -2375.0,
    "ISDHalfCar-v0": -2420.0,
    "ISDSuspension-v0": -2650.0,
}


def register() -> None:
    """Register every environment of the package that Gymnasium does not know yet."""
    from gymnasium.envs.registration import register as add
    from gymnasium.envs.registration import registry

    all_ids: list[tuple[str, str, dict[str, object]]] = [
        (name, network, {}) for name, network in ENVIRONMENTS.items()
    ]
    all_ids += [
        (name, network, _LEARNING_OPTIONS) for name, network in LEARNING.items()
    ]
    for name, network, options in all_ids:
        if name not in registry:
            add(
                id=name,
                entry_point="isd_gym.env._environment:ISDSuspensionEnv",
                vector_entry_point="isd_gym.env._environment:ISDSuspensionVectorEnv",
                reward_threshold=REWARD_THRESHOLDS.get(name),
                kwargs={"network": network, **options},
            )
