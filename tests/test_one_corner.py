"""What serves a quarter car alone refuses half and full cars, with one line each."""

import pytest

from isd_gym.driving import Crew, Entry, Idle, travel
from isd_gym.env import ISDSuspensionVectorEnv
from isd_gym.errors import InputError
from isd_gym.network import Network
from isd_gym.policies import conventional, find
from isd_gym.scoring import score

KINDS = {"half-car-isd": "half car", "full-car-passive": "full car"}


@pytest.mark.parametrize("policy", ["passive", "isd-passive", "skyhook", "lqg", "mpc", "ppo"])
@pytest.mark.parametrize("name", KINDS)
def test_a_policy_of_a_quarter_car_refuses_several_corners(policy, name):
    with pytest.raises(InputError, match=f"a policy of a quarter car.*is a {KINDS[name]}") as refused:
        find(policy, Network.load(name))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", KINDS)
def test_a_policy_at_the_wheel_and_a_score_refuse_several_corners(name):
    network = Network.load(name)
    env = ISDSuspensionVectorEnv(2, network=network)
    crew = Crew(Entry("mine", lambda: Idle("mine")), 2)
    with pytest.raises(InputError, match=f"'mine' is a policy of a quarter car.*is a {KINDS[name]}"):
        next(travel(crew, env, 1))
    with pytest.raises(InputError, match=f"a score is that of a quarter car.*is a {KINDS[name]}"):
        score(Entry("mine", lambda: Idle("mine")), network, episodes=2, duration=0.1)
    with pytest.raises(InputError, match=f"passive car is that of a quarter car.*is a {KINDS[name]}"):
        conventional(network)
