"""The command `isd-gym record`: rollouts as a Minari data set for offline reinforcement learning."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._common.errors import InputError, how_to_install
from .._common.files import whole_folder

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..physics.network import Network
    from .driving import Entry

__all__ = ["write_dataset"]

#: memory beside the numbers of an episode, and of a data set [bytes]
EPISODE_ROOM, DATASET_ROOM = 32_768, 2**20
#: a Minari id: (namespace/)name-vN; other names are folders
ID = re.compile(r"(?:[-\w]+/)*[-\w]+-v\d+")


def write_dataset(
    entry: Entry,
    out: str | Path,
    network: Network,
    *,
    episodes: int = 32,
    seed: int = 0,
    duration: float = 20.0,
    road: str = "paper",
    speed: float = 20.0,
    progress: Callable[[float], None] | None = None,
) -> Path:
    """Drive a policy and write observations, actions and rewards as a Minari data set.

    Episode i is the environment with the seed ``seed + i``. Observations are float32 (steps + 1, n). Actions
    are float32 (steps, currents), the commanded current of each motor [A]. The data set stores its environment with the complete
    network; `recover_environment()` creates the environment. An error leaves no files behind.

    Args:
        entry: The policy (`isd_gym.benchmark.policies.find`), on its own plant, if any.
        out: A Minari id ('isd/mpc-v0', for `minari.load_dataset`, in Minari's folder), or a new folder (for
            `minari.MinariDataset`).
        network: The plant of policies without a plant of their own.
        episodes: Number of episodes.
        seed: Seed of the first episode.
        duration: Length of an episode [s].
        road: Name of a road.
        speed: Speed [m/s].
        progress: Called with the finished share, from 0 to 1.

    Returns:
        Folder of the data set's files.

    Raises:
        InputError: The target exists or cannot be written, Minari is missing, or an argument is invalid.
    """
    try:
        import h5py  # noqa: F401
        import minari
        from minari.data_collector import EpisodeBuffer
        from minari.dataset.minari_storage import MinariStorage
    except ImportError as error:
        raise InputError(f"recording needs {error.name}: {how_to_install('record')}") from None
    import gymnasium as gym
    import numpy as np

    from ..env._environment import ISDSuspensionVectorEnv
    from ..env._task import CONTROL_STEP
    from ..env.registration import BY_CORNERS
    from ..physics._vehicle import vehicle
    from ..physics.network import builtin_networks
    from .driving import Crew, travel
    from .scoring import check_size

    if episodes < 1:
        raise InputError(f"episodes must be at least 1, not {episodes}")
    steps = round(duration / CONTROL_STEP) if 0 < duration < float("inf") else 0
    if steps < 1:
        raise InputError(f"duration must be at least {CONTROL_STEP} s, not {duration}")
    plant = entry.network or network
    check_size(vehicle(plant), episodes, duration)
    folder, dataset_id = _place(str(out), entry.name)
    crew = Crew(entry, episodes)
    kwargs: dict[str, Any] = {
        "network": plant.name if _is_builtin(plant, builtin_networks()) else plant.to_dict(),
        "allow_passive": True,
        "road": road,
        "speed": speed,
        "observation": crew.observation,
        "duration": duration,
        **({"preview": crew.preview} if crew.preview else {}),
    }
    env = ISDSuspensionVectorEnv(episodes, **kwargs, max_episode_steps=steps, autoreset_mode="disabled")
    seen, acted = env.single_observation_space, env.single_action_space
    observations = np.empty((episodes, steps + 1, *seen.shape), np.float32)  # type: ignore[misc]
    actions = np.empty((episodes, steps, *acted.shape), np.float32)  # type: ignore[misc]
    rewards = np.empty((episodes, steps))
    for leg in travel(crew, env, steps, seed=seed, dtype=np.float32, progress=progress):
        k = leg.step
        observations[:, k], observations[:, k + 1] = leg.seen, leg.ahead
        actions[:, k], rewards[:, k] = leg.actions, leg.rewards
    name = BY_CORNERS.get(len(env.task.vehicle.corners), BY_CORNERS[1])
    spec = gym.make(name, **kwargs, max_episode_steps=steps).spec
    last = np.zeros(steps, bool)
    last[-1] = True
    data = folder
    if ID.fullmatch(str(out)):  # Minari's layout: an existing namespace, with the files in data/
        from minari.namespace import create_namespace, list_local_namespaces

        namespace = dataset_id.rpartition("/")[0]
        if namespace and namespace not in list_local_namespaces():
            create_namespace(namespace)
        data = folder / "data"
    with whole_folder(folder, "data set") as temporary:
        # HDF5 crashes the process on a full disk
        size = observations.nbytes + actions.nbytes + rewards.nbytes + 2 * rewards.size
        _reserve(temporary, int(1.1 * size) + episodes * EPISODE_ROOM + DATASET_ROOM)
        storage = MinariStorage.new(
            temporary / data.relative_to(folder),
            seen,
            acted,
            env_spec=spec,
        )
        storage.update_metadata(
            {
                "dataset_id": dataset_id,
                "minari_version": minari.__version__,
                "algorithm_name": entry.name,
                "description": f"{entry.name} on {plant.name}, road {road}, {speed:g} m/s; episode i: seed {seed} + i",
                "requirements": ["isd-gym"],
            }
        )
        storage.update_episodes(
            EpisodeBuffer(
                id=i,
                seed=seed + i,
                observations=observations[i],
                actions=actions[i],
                rewards=rewards[i],
                terminations=np.zeros(steps, bool),
                truncations=last,
                infos={},
            )
            for i in range(episodes)
        )
    return data


def _is_builtin(network: Network, names: list[str]) -> bool:
    return network.name in names and type(network).load(network.name) == network


def _place(out: str, policy: str) -> tuple[Path, str]:
    """Return the new folder and the id of the data set for `out`, a Minari id or a folder."""
    if ID.fullmatch(out):
        from minari.storage import get_dataset_path

        folder = get_dataset_path(out)
        if os.path.exists(folder):
            raise InputError(f"Minari has a data set '{out}' already: choose another name or version")
        return folder, out
    folder = Path(out)
    if os.path.exists(folder):
        raise InputError(f"'{out}' exists already: choose another folder")
    if not os.path.isdir(folder.absolute().parent):
        raise InputError(f"cannot write '{out}': no folder '{folder.parent}'")
    # absolute: Minari's storage fails with a relative path
    return folder.absolute(), f"isd/{re.sub(r'[^-0-9A-Za-z_]', '-', policy)}-v0"


def _reserve(folder: Path, size: int) -> None:
    """Check that a number of bytes can be written, for libraries that crash on a full disk."""
    path = folder / ".room"
    try:
        with path.open("wb") as stream:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(stream.fileno(), 0, size)
    except OSError as error:
        raise InputError(
            f"cannot write {size / 1e6:.3g} MB in '{folder.parent.parent}' ({error.strerror})"
        ) from None
    finally:
        with suppress(OSError):
            path.unlink()
