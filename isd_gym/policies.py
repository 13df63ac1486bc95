"""Public path of `isd_gym.benchmark.policies`: policies by name."""

from .benchmark.policies import CONVENTIONAL, Idle, available, conventional, find, find_all, passive

__all__ = ["CONVENTIONAL", "Idle", "available", "conventional", "find", "find_all", "passive"]
