"""Series laws along one line: links of a chain without masses carry the same force."""

from isd_gym.diagnosis._hypotheses.library import hypotheses
from isd_gym.diagnosis._selection.equivalent_laws import _series_alone
from isd_gym.physics.network import Network


def car():
    return Network.load("quarter-car-isd")


def law(effect, *where):
    return next(
        h for h in hypotheses(car()) if h.effect == effect and set(h.where) == set(where) and not h.behind
    )


def test_two_series_laws_give_way_to_one_at_every_link_of_their_line():
    compliance = law("series_compliance", "joint", "wheel"), {"stiffness": 5e6}
    play = law("backlash", "piston", "joint"), {"gap": 0.002}
    friction = law("coulomb_friction", "wheel", "ground"), {"level": 10.0}
    found = list(_series_alone(car(), [compliance, friction, play]))
    oil, device, damper = (
        frozenset(x) for x in (("body", "piston"), ("piston", "joint"), ("joint", "wheel"))
    )
    for effect, values, links in (
        (
            "series_compliance",
            {"stiffness": 5e6},
            {device, damper},
        ),  # beside the oil's spring it is only a spring
        ("backlash", {"gap": 0.002}, {oil, device, damper}),
    ):
        own = [effects for effects in found if effects[-1][0].effect == effect]
        assert {frozenset(effects[-1][0].where) for effects in own} == links
        assert all(
            effects[0] is friction and effects[-1][1] == values and len(effects) == 2 for effects in own
        )


def test_a_series_law_by_itself_stays():
    play = law("backlash", "piston", "joint"), {"gap": 0.002}
    elsewhere = law("backlash", "wheel", "road"), {"gap": 0.001}  # the wheel's mass ends the line
    assert not list(_series_alone(car(), [play]))
    assert not list(_series_alone(car(), [play, elsewhere]))
