"""Learning: training with PPO and SAC, policies, exports."""

if (
    __name__ != "isd_gym.agents"
):  # a second copy, found in the source tree, would have classes of its own
    raise ImportError("the package is imported as isd_gym.agents, not agents")
