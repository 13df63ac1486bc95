"""Benchmark cards: references episode by episode, paired with scores of others on the same roads and on no others."""

import json

import numpy as np
import pytest
import tracks
from program import assert_one_line, refused, run, save_json

from isd_gym import score
from isd_gym.benchmark import cards
from isd_gym.benchmark.scoring import Conditions
from isd_gym.env.registration import EPISODE_STEPS, REWARD_THRESHOLDS

ON = {"episodes": 4, "duration": 0.5}


@pytest.fixture(scope="module")
def card():
    held = score(["passive", "isd-passive", "skyhook"], **ON).to_dict()
    return cards.make(
        "ISDSuspension-v0",
        [cards.track(held, "brief", "isd-gym score ...")],
        "2026-01-01",
    )


def test_a_submitted_score_is_paired_as_if_all_had_driven_together(card):
    theirs = json.loads(json.dumps(score(["add"], **ON).to_dict()))
    rows = cards.ranking(card, "brief", [theirs])
    assert [r["cost"]["value"] for r in rows] == sorted(
        r["cost"]["value"] for r in rows
    )
    (own,) = (r for r in rows if r["submitted"])
    together = score(["passive", "skyhook", "add"], **ON)
    expected = {r["policy"]: r for r in together.policies}["add"]["cost"]
    for key in (
        "value",
        "change",
        "low",
        "high",
    ):  # the episodes of a score have nine digits
        assert own["cost"][key] == pytest.approx(expected[key], rel=1e-7, abs=1e-8)
    ratio = (
        np.mean(together.raw["add"]["cost"]) / np.mean(together.raw["skyhook"]["cost"])
        - 1
    )
    assert own["against"]["skyhook"]["change"] == pytest.approx(ratio, rel=1e-6)
    assert "passive" in own["against"]


def test_a_reference_driven_again_is_the_reference(card):
    again = score(["skyhook"], **ON).to_dict()
    for elsewhere in (1.0, 1.0 + 1e-9):  # another machine rounds otherwise
        again["raw"]["skyhook"]["cost"] = [
            elsewhere * j for j in again["raw"]["skyhook"]["cost"]
        ]
        assert not any(r["submitted"] for r in cards.ranking(card, "brief", [again]))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda s: s.update(seed=1), "on no track .* another seed"),
        (lambda s: s.update(road="C"), "another road"),
        (
            lambda s: s["policies"][0].update(preview={"value": 0.1, "unit": "s"}),
            "another preview",
        ),
        (lambda s: s.update(sensors={"noise": 1.0}), "another sensors"),
        (
            lambda s: s["roads"][2].__setitem__(3, s["roads"][2][3] + 1e-4),
            "roads are not those",
        ),
        (lambda s: s.pop("roads"), "which roads"),
        (lambda s: s.pop("raw"), "no single episodes"),
        (
            lambda s: s["raw"]["add"]["cost"].__setitem__(0, float("nan")),
            "4 finite numbers",
        ),
        (lambda s: s["raw"]["add"]["cost"].pop(), "4 finite numbers"),
    ],
)
def test_a_score_on_other_roads_or_without_episodes_is_refused(card, change, why):
    theirs = score(["add"], **ON).to_dict()
    change(theirs)
    refused(why, cards.ranking, card, "brief", [theirs])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            lambda s: s["policies"][0]["cost"].pop("unit"),
            r"policies\[0\].cost: 'unit' is a required",
        ),
        (lambda s: s.pop("speed"), "has no 'speed'"),
        (
            lambda s: s["raw"]["add"].update(cost=[1e300] * 3),
            r"raw.add.cost\[\d\]: 1e\+300 is greater than",
        ),
    ],
)
def test_a_garbled_score_is_one_line(change, says, tmp_path):
    theirs = score(["add"], **ON).to_dict()
    path = tmp_path / "score.json"
    save_json(path, theirs)
    assert cards.read_score(path) == json.loads(json.dumps(theirs))
    change(theirs)
    save_json(path, theirs)
    refused(says, cards.read_score, path)


def test_a_garbled_card_with_a_right_digest_is_one_line(card, tmp_path):
    held = json.loads(json.dumps(card))
    held["tracks"][0]["policies"]["skyhook"]["episodes"]["cost"].pop()
    path = tmp_path / "card.json"
    save_json(path, {**held, "digest": cards.digest(held)})
    refused("'skyhook' must have 4 episodes", cards.load, path)
    del held["tracks"][0]["policies"]["passive"]
    save_json(path, {**held, "digest": cards.digest(held)})
    refused(r"tracks\[0\].policies: 'passive' is a required property", cards.load, path)


def test_a_card_is_frozen(card, tmp_path):
    path = tmp_path / "card.json"
    save_json(path, card)
    assert cards.load(path) == card
    held = json.loads(json.dumps(card))
    held["tracks"][0]["policies"]["skyhook"]["episodes"]["cost"][0] *= 0.99
    save_json(path, held)
    refused("was altered", cards.load, path)
    refused("nowhere", cards.load, "nowhere")


def test_the_command_makes_cards_and_scores_against_them(tmp_path):
    def go(*words):
        done = run(*words)
        assert not done.returncode, done.stderr
        return " ".join(done.stdout.split())

    on = "--episodes 3 --duration 0.5"
    go("score passive skyhook --json", tmp_path / "brief.json", on)
    assert "1 track in" in go(
        "card", tmp_path / "brief.json", "--write", tmp_path / "card.json"
    )
    against = ("score add --against", tmp_path / "card.json", on)
    assert "add against skyhook" in go(*against)

    def driven(*args, **kwargs):
        raise AssertionError("driven before it was refused")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("isd_gym.benchmark.scoring.drive", driven)
        for name, value in {
            "duration": 0.6,
            "seed": 1,
            "road": "C",
            "sensors": "noise=1",
        }.items():
            done = run(*against, f"--{name} {value}")
            assert_one_line(done, f"another {name}")
    assert (
        "brief: change" in (shown := go("card", "--card", tmp_path / "card.json"))
        and "skyhook" in shown
    )


def test_the_shipped_cards_are_whole():
    for name in cards.built_in():
        card = cards.load(name)
        for track in card["tracks"]:
            rows = cards.ranking(card, track["track"])
            assert len(rows) == len(track["policies"]) >= 4
            speed, duration = (track[k]["value"] for k in ("speed", "duration"))
            own = Conditions(track["road"], speed, 2, track["seed"], duration)
            assert np.allclose(
                own.fingerprints, track["roads"][:2], rtol=1e-6, atol=1e-9
            )


@pytest.mark.parametrize("name", sorted(REWARD_THRESHOLDS))
def test_the_reward_threshold_is_the_best_classical_controller(name):
    from gymnasium.envs.registration import registry

    card = cards.load(name)
    threshold = tracks.reward_threshold(card)
    assert threshold == REWARD_THRESHOLDS[name] == registry[name].reward_threshold, (
        "run benchmarks/tracks.py"
    )
    rows = cards.ranking(card, "standard")
    returns = {row["policy"]: -EPISODE_STEPS * row["cost"]["value"] for row in rows}
    best = max(
        total for policy, total in returns.items() if policy not in tracks.LEARNED
    )
    assert threshold <= best < threshold + 5
    assert max(returns["passive"], returns["skyhook"], returns["mpc"]) < threshold


def test_the_card_of_a_score_is_the_card_of_its_car(tmp_path):
    files = {}
    for network in ("quarter-car-isd", "half-car-isd"):
        held = score(
            ["passive", "skyhook"], network, episodes=2, duration=0.3
        ).to_dict()
        files[network] = tmp_path / f"{network}.json"
        held["command"] = (
            f"isd-gym score passive skyhook --network {network} --json {files[network]}"
        )
        save_json(files[network], held)

    half = files["half-car-isd"]
    assert run("card", half, "--write", tmp_path / "card.json").returncode == 0
    card = cards.load(tmp_path / "card.json")
    assert card["environment"] == "ISDHalfCar-v0"
    assert (
        card["tracks"][0]["command"]
        == "isd-gym score passive skyhook --network half-car-isd"
    )
    assert run("card", half, "--card", tmp_path / "card.json").returncode == 0
    assert_one_line(run("card", half), "no track of ISDHalfCar-v0")
    assert_one_line(
        run("card", *files.values(), "--write", tmp_path / "both.json"),
        "different cars",
    )
    assert not (tmp_path / "both.json").exists()
