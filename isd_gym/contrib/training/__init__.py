"""Training of the shipped policies: imitation of a controller, then PPO or SAC on groups of cars (`isd-gym train`)."""
