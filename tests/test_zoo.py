"""Settings for RL Baselines3 Zoo: whatever the Zoo passes on is an argument of the algorithm, and the wrapped cars drive."""

import inspect
from importlib import import_module
from pathlib import Path

import gymnasium
import numpy as np
import pytest

yaml = pytest.importorskip("yaml", reason="of isd-gym[docs]")
sb3 = pytest.importorskip("stable_baselines3", reason="of isd-gym[agents]")

pytestmark = pytest.mark.tools

FOLDER = Path(__file__).parents[1] / "examples" / "zoo"
ENVIRONMENTS = {"ISDSuspension-v0", "ISDHalfCar-v0", "ISDFullCar-v0"}
#: keys that the Zoo itself reads
ZOO = {"n_envs", "n_timesteps", "normalize", "env_wrapper"}


@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
def test_settings_are_arguments_of_the_algorithm(algorithm):
    settings = yaml.safe_load(
        (FOLDER / f"{algorithm.lower()}.yml").read_text(encoding="utf-8")
    )
    assert set(settings) == ENVIRONMENTS
    known = set(inspect.signature(getattr(sb3, algorithm).__init__).parameters)
    for name, own in settings.items():
        assert set(own) - ZOO <= known, name
        assert isinstance(own["n_timesteps"], float) and own["n_timesteps"] >= 1e6
        # the Zoo evaluates the text with torch.nn as nn
        policy = eval(
            own["policy_kwargs"], {"dict": dict, "nn": import_module("torch.nn")}
        )
        made = getattr(sb3, algorithm).policy_aliases["MlpPolicy"].__init__
        assert set(policy) <= set(inspect.signature(made).parameters)


@pytest.mark.filterwarnings(
    "ignore:.*precision lowered:UserWarning"
)  # RescaleAction's own space
@pytest.mark.parametrize("name", sorted(ENVIRONMENTS))
def test_wrapped_cars_take_actions_within_one(name):
    settings = yaml.safe_load((FOLDER / "ppo.yml").read_text(encoding="utf-8"))[name]
    env = gymnasium.make(name)
    limit = env.action_space.high
    for wrapper in settings["env_wrapper"]:
        path, options = (
            (wrapper, {}) if isinstance(wrapper, str) else next(iter(wrapper.items()))
        )
        module, _, kind = path.rpartition(".")
        env = getattr(import_module(module), kind)(env, **options)
    assert (env.action_space.high == 1.0).all() and (env.action_space.low == -1.0).all()
    env.reset(seed=0)
    for _ in range(20):
        observation, *_ = env.step(np.ones_like(limit))
    newest = observation.reshape(4, -1)[-1]
    currents = newest[[s.kind == "current" for s in env.unwrapped.task.measured]]
    np.testing.assert_allclose(
        currents, limit, rtol=1e-6
    )  # the whole range is reached, by 0.5 A in a step
