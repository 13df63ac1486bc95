"""Public path of `isd_gym.benchmark.record`: rollouts as a Minari data set."""

from .benchmark.record import DATASET_ROOM, EPISODE_ROOM, ID, write_dataset

__all__ = ["DATASET_ROOM", "EPISODE_ROOM", "ID", "write_dataset"]
