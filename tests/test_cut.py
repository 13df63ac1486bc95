"""A network cut at a node whose motion was measured: what is left moves as the whole did."""

import numpy as np
import pytest
from builders import channel, friction

from isd_gym import simulate
from isd_gym._common.errors import InputError
from isd_gym.physics.network import Network, cut, rejoin


def car():
    data = Network.load("quarter-car-isd").to_dict()
    data["outputs"].append(channel("wheel_acceleration", "acceleration", "wheel"))
    data["uncertainty"] = {
        "body.mass": 0.05,
        "wheel.mass": 0.05,
        "tyre.stiffness": 0.05,
        "damper.damping": 0.05,
    }
    return Network.load(data)


def driven():
    t = np.arange(0, 4, 1e-3)
    return t, {
        "road": 0.008 * np.sin(9 * t) ** 3 + 0.003 * np.sin(41 * t) ** 2,
        "current": 2.0 * np.sign(np.sin(5 * t)),
    }


def test_what_is_above_the_cut_moves_as_in_the_whole_car():
    t, inputs = driven()
    whole = simulate(car(), t, inputs)
    part = cut(car(), "wheel")
    assert part.moved_nodes == ("wheel",) and "tyre" not in {e.name for e in part.elements}
    assert [c.name for c in part.inputs] == ["wheel_acceleration", "current"]
    assert set(part.uncertainty) == {"body.mass", "damper.damping"}
    out = simulate(part, t, {"wheel_acceleration": whole["wheel_acceleration"], "current": inputs["current"]})
    assert set(out) == {"body_acceleration", "suspension_travel", "device_travel"}
    for name, y in out.items():
        assert np.std(y - whole[name]) < 0.01 * np.std(whole[name])


def test_a_displacement_is_taken_before_an_acceleration():
    data = car().to_dict()
    data["outputs"].append(channel("hub", "displacement", "wheel", unit="mm"))
    part = cut(Network.load(data), "wheel")
    assert part.inputs[0].name == "hub" and part.inputs[0].unit == "mm"
    assert "wheel_acceleration" not in {c.name for c in part.outputs}  # the input tells it


def test_what_was_found_in_a_part_comes_back_into_the_whole():
    part = cut(car(), "wheel").with_parameters({"damper.damping": 1400.0})
    part = part.with_element(friction("body", "wheel", 80.0))
    whole = rejoin(car(), part)
    assert whole.parameters["damper.damping"] == 1400.0 and whole.parameters["rub.level"] == 80.0
    assert whole.parameters["tyre.stiffness"] == car().parameters["tyre.stiffness"]
    assert whole.inputs == car().inputs and whole.uncertainty == car().uncertainty
    assert rejoin(car(), cut(car(), "wheel")).parameters == car().parameters


@pytest.mark.parametrize(
    ("node", "words"),
    [
        ("roof", "no node 'roof'"),
        ("road", "moved by an input already"),
        ("piston", "no output measures the motion of 'piston'"),
        ("body", "the other nodes are all connected without 'body'"),
    ],
)
def test_a_cut_that_makes_no_sense_is_said_in_a_line(node, words):
    with pytest.raises(InputError, match=words):
        cut(car(), node)
