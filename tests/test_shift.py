"""A score of controllers whose model is not the vehicle."""

from program import read_json, run, save_json

from isd_gym import Network
from isd_gym.records.schemas import check


def test_a_score_names_the_shift_between_vehicle_and_model(tmp_path):
    car = Network.load("quarter-car-isd")
    heavy = car.with_parameters({"body.mass": 1.2 * car.parameters["body.mass"]})
    save_json(tmp_path / "heavy.json", heavy.to_dict())
    words = "score passive lqg --network heavy.json --episodes 1 --duration 0.5"
    done = run(words, "--model quarter-car-isd --json s.json", cwd=tmp_path)
    assert "model quarter-car-isd; vehicle against it: body.mass x 1.2" in " ".join(
        done.stdout.split()
    )
    found = read_json(tmp_path / "s.json")
    assert found["model"] == {"name": "quarter-car-isd", "shift": {"body.mass": 1.2}}
    check(found, "isd-score-1", "s.json")
    done = run(words, "--model heavy.json --json s.json", cwd=tmp_path)
    assert "vehicle against it" not in done.stdout
    assert "model" not in read_json(tmp_path / "s.json")
