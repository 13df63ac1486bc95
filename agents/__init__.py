"""Learning: training with PPO and SAC, policies, exports."""

# a second copy, found in the source tree, would have classes of its own
if __name__ != "isd_gym.agents":
    raise ImportError("the package is imported as isd_gym.agents, not agents")
