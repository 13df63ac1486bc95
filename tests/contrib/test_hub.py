"""A folder for a model hub: what a hub reads in the card, the film, and a policy that loads out of it."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from program import refused

from isd_gym import _commands as cli
from isd_gym.agents.policy import Policy
from isd_gym.contrib import hub

pytest.importorskip("pygame", reason="films need isd-gym[render]")
pytest.importorskip("imageio_ffmpeg", reason="films need isd-gym[render]")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    policy = Policy.load("ppo")
    policy.info["training"]["command"] = "isd-gym `train`\n---\nlicense: none"  # of a stranger
    return hub.write(policy, tmp_path_factory.mktemp("hub") / "mine", episodes=2, seconds=0.2)


def test_the_card_says_what_hubs_read(folder, monkeypatch):
    yaml = pytest.importorskip("yaml", reason="of isd-gym[docs]")
    text = (folder / "README.md").read_text(encoding="utf-8")
    _, head, body = text.split("---\n", 2)
    meta = yaml.safe_load(head)
    # the filter for Stable-Baselines3 reads the library
    assert meta["library_name"] == "stable-baselines3" and "license" not in meta
    assert {"ISDSuspension-v0", "reinforcement-learning", "stable-baselines3"} <= set(meta["tags"])
    (model,) = meta["model-index"]
    assert model["name"] == "ppo-ISDSuspension-v0"
    (result,) = model["results"]
    assert result["task"]["type"] == "reinforcement-learning"
    assert result["dataset"] == {"name": "ISDSuspension-v0", "type": "ISDSuspension-v0"}
    metrics = {m["type"]: m["value"] for m in result["metrics"]}
    found = json.loads((folder / "score.json").read_text())
    costs = np.array(found["raw"]["ppo"]["cost"])
    # the return of an episode of 4000 steps, as the environment itself would add it up
    assert metrics["mean_reward"] == f"{-4000 * costs.mean():.2f} +/- {4000 * costs.std():.2f}"
    assert metrics["cost_j"] == pytest.approx(costs.mean(), abs=5e-5)
    assert -0.4 < metrics["change_of_cost_against_passive"] < -0.1
    names = {}  # the code of the card drives
    monkeypatch.chdir(folder)
    exec(body.split("```python\n")[1].split("```")[0], names)
    assert np.isfinite(names["reward"]) and names["reward"] < 0.0
    assert "| 1 | `ppo` |" in body and "`passive`" in body and "&#96;train&#96;" in body


def test_it_holds_the_policy_the_film_and_nothing_else(folder):
    imageio = pytest.importorskip("imageio.v3")
    assert sorted(p.name for p in folder.iterdir()) == sorted(hub.HUB[2])
    own, again = folder, Policy.load("ppo").save(folder.parent / "again")
    assert len({(f / "weights.safetensors").read_bytes() for f in (own, again)}) == 1
    about = imageio.immeta(folder / "replay.mp4", plugin="FFMPEG")
    assert about["duration"] == pytest.approx(0.22, abs=0.05) and about["size"][0] > 600


def test_a_policy_for_a_car_of_its_own_has_no_environment():
    policy = Policy.load("ppo")
    assert policy.model is not None
    policy.model = replace(policy.model, name="my-car")
    refused("'my-car', which no environment has", hub.environment_of, policy)


def test_the_name_of_a_policy_is_text_in_the_card(folder):
    policy = Policy.load("ppo")
    policy.name = "<script>|`** [x](javascript:alert(1))"
    text = hub._card(policy, policy.name, json.loads((folder / hub.SCORE).read_text()))
    body = text.split("\n---\n", 1)[1]
    assert "<script" not in body and "[x](" not in body and body.lstrip().startswith("# &#60;script&#62;")


def test_the_command(tmp_path, monkeypatch, capsys):
    seen = {}
    written = lambda policy, folder, progress: seen.update(name=policy.name) or folder  # noqa: E731
    monkeypatch.setattr(hub, "write", written)
    monkeypatch.setattr(sys, "argv", ["isd-gym", "convert", "ppo", "--hub", str(tmp_path / "mine")])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert not end.value.code
    assert seen == {"name": "ppo"} and "can be uploaded" in capsys.readouterr().out
