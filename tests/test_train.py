"""`isd-gym train`: stock Stable-Baselines3 by a recipe, in a folder that goes on."""

import pytest
from isd_gym.agents.policy import Policy
from program import assert_one_line, refused, run, save_json

from isd_gym._commands import train
from isd_gym._commands.train import ranges, read_recipe
from isd_gym.env import Options

library = pytest.importorskip("stable_baselines3")
from stable_baselines3.common.callbacks import BaseCallback  # noqa: E402

PPO = {
    "n_steps": 16,
    "batch_size": 32,
    "n_epochs": 1,
    "learning_rate": {"start": 1e-3, "end": 0.0, "end_fraction": 1.0},
}
SAC = {
    "learning_starts": 20,
    "batch_size": 8,
    "buffer_size": 200,
    "policy_kwargs": {"net_arch": [8]},
}


def recipe(folder, algorithm="PPO", **changes):
    """A recipe of a second, as a file."""
    arguments = PPO if algorithm == "PPO" else SAC
    plan = {
        "algorithm": algorithm,
        "steps": 64,
        "cars": 2,
        "environment": {},
        "arguments": arguments,
        **changes,
    }
    file = folder / "recipe.json"
    save_json(file, plan)
    return str(file)


class Stop(BaseCallback):
    """Ctrl-C after 32 decisions."""

    def _on_step(self):
        if self.num_timesteps >= 32:
            raise KeyboardInterrupt
        return True


def test_shipped_recipes_are_read_as_files_are():
    for name in ("ppo", "sac"):
        assert read_recipe(name)["algorithm"] == name.upper()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"algorithm": "DQN"}, "one of PPO"),
        ({"cars": "many"}, "cars must be like 512"),
        ({"environment": {"speed": 3.0}}, "--speed"),
        ({"extra": 1}, "must have the fields algorithm"),
    ],
)
def test_a_recipe_that_is_none_is_one_line(changes, says, tmp_path):
    refused(says, read_recipe, recipe(tmp_path, **changes))


def test_ranges_are_options_of_the_environment(tmp_path):
    file = tmp_path / "ranges.json"
    file.write_text('{"body.mass": [0.8, 1.2]}')
    assert Options(**ranges(str(file))).randomize
    robust = Options(**ranges("robust"))
    assert robust.randomize["road"] and not robust.sensors.perfect


@pytest.mark.filterwarnings("ignore")  # tensorboard warns of itself
@pytest.mark.parametrize(
    ("algorithm", "car"),
    [
        ("SAC", "quarter-car-isd"),
        pytest.param("PPO", "half-car-isd", marks=pytest.mark.slow),
    ],
)
def test_a_training_goes_on_where_ctrl_c_stopped_it(
    algorithm, car, tmp_path, monkeypatch
):
    command = ["train", recipe(tmp_path, algorithm), "--out", "run", "--network", car]
    with monkeypatch.context() as patch:
        patch.setattr(train, "checkpoint", lambda out: Stop())
        done = run(*command, cwd=tmp_path)
    assert done.returncode == 130 and "saved after 32 decisions" in done.stderr
    done = run(*command, cwd=tmp_path)
    assert done.returncode == 0 and "going on after 32 of 64 decisions" in done.stderr
    assert "on 32 scoring roads; policy in 'run/policy'" in done.stdout
    policy = Policy.load(tmp_path / "run" / "policy")
    assert (
        policy.currents == {"half-car-isd": 2, "quarter-car-isd": 1}[car]
        and policy.info["training"]["recipe"]["algorithm"] == algorithm
    )
    assert list((tmp_path / "run" / "tensorboard").iterdir())
    model = getattr(library, algorithm).load(tmp_path / "run" / "model.zip")
    assert (
        model.num_timesteps == model.scores[-1][0] == 64
    )  # a slow machine scores at checkpoints, too
    assert_one_line(
        run(*command, "--seed 1", cwd=tmp_path), "holds another training", "--out"
    )


@pytest.mark.filterwarnings("ignore")
def test_an_argument_that_the_algorithm_lacks_is_one_line(tmp_path):
    file = recipe(tmp_path, arguments={"n_step": 3})
    assert_one_line(
        run("train", file, "--out run", cwd=tmp_path), "PPO does not take", "n_step"
    )
