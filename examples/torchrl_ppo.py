"""PPO of TorchRL on cars that share roads: python examples/torchrl_ppo.py [--updates N]. Needs torchrl."""

from __future__ import annotations

import argparse
import time

import gymnasium
import torch
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from isd_gym.benchmark.driving import cost_of

#: options without knowledge of the car: cars on the same road are compared
RELATIVE = {"reward": "relative", "action": "increment", "hold": 2, "reward_scale": 1.0}
CARS, HORIZON, EPOCHS, BATCHES = 512, 128, 2, 16


def network(outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(21, 64),
        nn.Tanh(),
        nn.Linear(64, 64),
        nn.Tanh(),
        nn.Linear(64, outputs),
    )


def train(updates: int) -> nn.Module:
    """The actor (21 numbers to mean and spread of the action) after so many updates."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    cars = gymnasium.make_vec(
        "ISDSuspensionLearning-v0",
        CARS,
        cars_per_road=8,
        autoreset_mode="same_step",
        **RELATIVE,
    )
    env = GymWrapper(cars)
    body = network(2)
    with torch.no_grad():  # begin with next to no action but the exploration
        body[-1].weight *= 0.1
        body[-1].bias[1] = -1.2
    actor = ProbabilisticActor(
        TensorDictModule(
            nn.Sequential(body, NormalParamExtractor()),
            ["observation"],
            ["loc", "scale"],
        ),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(network(1), in_keys=["observation"])
    loss = ClipPPOLoss(
        actor, critic, entropy_bonus=False, critic_coeff=1.0, loss_critic_type="l2"
    )
    advantage = GAE(gamma=0.98, lmbda=1.0, value_network=critic)
    optimizer = torch.optim.Adam(loss.parameters(), 1e-3)
    frames = CARS * HORIZON
    collected = Collector(
        env,
        actor,
        frames_per_batch=frames,
        total_frames=updates * frames,
        auto_register_policy_transforms=True,
    )
    for data in collected:
        for _ in range(EPOCHS):
            with torch.no_grad():
                advantage(data)
            rows = data.reshape(-1)
            rows["advantage"] = (rows["advantage"] - rows["advantage"].mean()) / rows[
                "advantage"
            ].std()
            for some in torch.randperm(frames).chunk(BATCHES):
                told = loss(rows[some])
                optimizer.zero_grad()
                (told["loss_objective"] + told["loss_critic"]).backward()
                optimizer.step()
    return body


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--updates", type=int, default=60)
    given = parser.parse_args()
    begin = time.process_time()
    body = train(given.updates)
    seconds = time.process_time() - begin
    with torch.no_grad():
        j = cost_of(
            lambda features: body(torch.from_numpy(features))[:, :1].numpy(),
            action="increment",
        )
    steps = given.updates * CARS * HORIZON / 1e6
    print(
        f"J {j:.3f} after {steps:.1f} million steps, {seconds:.0f} s of processor time (passive: 0.869)"
    )


if __name__ == "__main__":
    main()
