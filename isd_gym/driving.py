"""Public path of `isd_gym.benchmark.driving`: driving an environment with a policy."""

from .benchmark.driving import Controller, Crew, Entry, Idle, Leg, travel

__all__ = ["Controller", "Crew", "Entry", "Idle", "Leg", "travel"]
