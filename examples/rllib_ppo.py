"""PPO of RLlib (new stack) on cars that share roads: python examples/rllib_ppo.py [--updates N]. Needs ray[rllib]."""

from __future__ import annotations

import argparse
import time
from typing import Any

import gymnasium
import numpy as np
import torch
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.tune.registry import register_env

from isd_gym.benchmark.driving import cost_of

#: options without knowledge of the car: cars on the same road are compared
RELATIVE = {"reward": "relative", "action": "increment", "hold": 2, "reward_scale": 1.0}
CARS, HORIZON = 256, 128


def roads(config: dict[str, Any]) -> gymnasium.vector.VectorEnv:
    return gymnasium.make_vec(
        "ISDSuspensionLearning-v0", config["num_envs"], cars_per_road=8, **RELATIVE
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--updates", type=int, default=60)
    given = parser.parse_args()
    register_env("cars-on-roads", roads)
    config = (
        PPOConfig()
        .environment("cars-on-roads")
        .env_runners(
            num_env_runners=0,  # in this process
            num_envs_per_env_runner=CARS,
            gym_env_vectorize_mode="vector_entry_point",
            rollout_fragment_length=HORIZON,
            batch_mode="truncate_episodes",
        )
        .training(
            gamma=0.98,
            lambda_=1.0,
            lr=1e-3,
            train_batch_size_per_learner=CARS * HORIZON,
            minibatch_size=CARS * HORIZON // 16,
            num_epochs=2,
            clip_param=0.2,
            vf_clip_param=np.inf,
            use_kl_loss=False,
        )
        .rl_module(
            model_config=DefaultModelConfig(
                fcnet_hiddens=[64, 64], fcnet_activation="tanh", vf_share_layers=False
            )
        )
        .debugging(seed=0)
    )
    begin = time.process_time()
    algorithm = config.build_algo()
    for update in range(given.updates):
        algorithm.train()
        print(f"update {update + 1}, {time.process_time() - begin:.0f} s")
    seconds = time.process_time() - begin
    module = algorithm.get_module()

    def act(features: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            told = module.forward_inference({"obs": torch.from_numpy(features)})[
                "action_dist_inputs"
            ]
        actions: np.ndarray = told[:, :1].numpy()
        return actions

    steps = given.updates * CARS * HORIZON / 1e6
    print(
        f"J {cost_of(act, action='increment'):.3f} after {steps:.1f} million steps, {seconds:.0f} s of processor time (passive: 0.869)"
    )


if __name__ == "__main__":
    main()
