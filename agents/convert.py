"""Policies of Stable-Baselines3 (.zip, with or without VecNormalize) as policies that numpy alone can run.

An archive of Stable-Baselines3 holds pickles, and loading a pickle runs whatever code its maker put in. Here none is
run: the reader below builds arrays and inert placeholders, and nothing else. Even so, convert once and keep the
folder: it says what it is, and no other program needs to be as careful with it.
"""

from __future__ import annotations

import io
import json
import math
import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from isd_gym.batch import CURRENT_LIMIT
from isd_gym.env import N_MEASURED
from isd_gym.errors import InputError
from isd_gym.network import Network

from .memory import Memory
from .policy import Head, Policy

WARNING = (
    "an SB3 archive holds pickles, which run code wherever they are loaded as usual; only its weights are read here, "
    "and nothing of it is run"
)


class _Inert:
    """Stands in for any object of a pickle: it remembers its state and does nothing."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.state: Any = {}

    def __setstate__(self, state: Any) -> None:
        self.state = state


def _array(kind: Any, shape: Any, code: Any) -> np.ndarray:
    return np.ndarray.__new__(np.ndarray, (0,), "b")


def _from_buffer(data: Any, dtype: Any, shape: Any, order: Any, *rest: Any) -> np.ndarray:
    return np.frombuffer(data, dtype).reshape(shape, order=order)


def _scalar(dtype: Any, data: bytes) -> Any:
    return np.frombuffer(data, dtype)[0]


def _tensor(storage: np.ndarray, offset: int, size: tuple, stride: tuple, *rest: Any) -> np.ndarray:
    view = np.lib.stride_tricks.as_strided(
        storage[offset:], size, [s * storage.itemsize for s in stride], writeable=False
    )
    if size and offset + sum((n - 1) * s for n, s in zip(size, stride, strict=True)) >= len(storage):
        raise InputError("a tensor is larger than what is stored of it")
    return np.array(view)


_STORAGES = {
    "FloatStorage": np.float32,
    "DoubleStorage": np.float64,
    "LongStorage": np.int64,
    "BoolStorage": np.bool_,
}
_KNOWN: dict[tuple[str, str], Any] = {
    ("collections", "OrderedDict"): OrderedDict,
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("torch._utils", "_rebuild_tensor_v2"): _tensor,
    **{("torch", name): kind for name, kind in _STORAGES.items()},
    **{
        (f"numpy.{core}.{module}", name): made
        for core in ("core", "_core")
        for module, name, made in (
            ("multiarray", "_reconstruct", _array),
            ("multiarray", "scalar", _scalar),
            ("numeric", "_frombuffer", _from_buffer),
        )
    },
}


class _Reader(pickle.Unpickler):
    """An unpickler that knows arrays and tensors; every other global becomes `_Inert`."""

    def __init__(self, data: bytes, storages: Mapping[str, bytes] | None = None) -> None:
        super().__init__(io.BytesIO(data))
        self._storages = storages or {}

    def find_class(self, module: str, name: str) -> Any:
        return _KNOWN.get((module, name), _Inert)

    def persistent_load(self, pid: Any) -> np.ndarray:
        _, kind, key, *_ = pid
        return np.frombuffer(self._storages[key], kind)


def read_torch(data: bytes, where: str) -> dict[str, np.ndarray]:
    """The arrays of a state dict saved by `torch.save`, without torch and without running its pickle."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            files = {name.partition("/")[2]: archive.read(name) for name in archive.namelist()}
        if files.get("byteorder", b"little") != b"little":
            raise InputError(f"{where}: saved on a big-endian machine")
        storages = {k.removeprefix("data/"): v for k, v in files.items() if k.startswith("data/")}
        state = _Reader(files["data.pkl"], storages).load()
        return {k: v for k, v in state.items() if isinstance(v, np.ndarray)}
    except InputError:
        raise
    except Exception as error:  # a pickle can fail in any way
        raise InputError(f"{where}: not weights saved by torch ({type(error).__name__})") from None


def read_normalize(path: str | Path) -> tuple[np.ndarray, np.ndarray, float]:
    """(mean, scale, clip) of the observations in a saved VecNormalize, without running its pickle."""
    try:
        state = _Reader(Path(path).read_bytes()).load().state
        rms = state["obs_rms"].state
        mean, variance = np.asarray(rms["mean"], float), np.asarray(rms["var"], float)
        if not state.get("norm_obs", True):
            return np.zeros_like(mean), np.ones_like(mean), math.inf
        return mean, np.sqrt(variance + float(state["epsilon"])), float(state["clip_obs"])
    except OSError as error:
        raise InputError(f"cannot read '{path}': {error.strerror}") from None
    except Exception as error:
        raise InputError(f"'{path}' is not a saved VecNormalize ({type(error).__name__})") from None


def actor_layers(state: Mapping[str, np.ndarray]) -> tuple[str, list[tuple[np.ndarray, np.ndarray]]]:
    """(algorithm, layers) of the deterministic actor in an SB3 state dict: ppo (and a2c), sac or td3 (and ddpg)."""
    if "action_net.weight" in state:
        kind, hidden, last = "ppo", "mlp_extractor.policy_net.", "action_net"
    elif "actor.mu.weight" in state:
        kind, hidden, last = "sac", "actor.latent_pi.", "actor.mu"
    elif "actor.mu.0.weight" in state:
        kind, hidden, last = "td3", "actor.mu.", ""
    else:
        raise InputError("no MlpPolicy of PPO, SAC or TD3")
    if any("features_extractor" in key and not key.startswith("critic") for key in state):
        raise InputError(
            "its features extractor has weights of its own; only the flat MlpPolicy can be converted"
        )
    numbers = sorted(
        int(k.removeprefix(hidden).removesuffix(".weight"))
        for k in state
        if k.startswith(hidden) and k.endswith(".weight")
    )
    names = [f"{hidden}{i}" for i in numbers] + ([last] if last else [])
    return kind, [(state[f"{n}.weight"], state[f"{n}.bias"]) for n in names]


def build(
    state: Mapping[str, np.ndarray],
    *,
    activation: str,
    memory: Memory,
    head: Head,
    high: float = 1.0,
    **options: Any,
) -> Policy:
    """Policy of an SB3 state dict (arrays); `high` is the bound of the action space it was trained on."""
    kind, layers = actor_layers(state)
    if kind == "ppo" and high != 1.0:  # PPO's mean is in the action's unit, SAC's and TD3's in [-1, 1]
        layers[-1] = (layers[-1][0] / high, layers[-1][1] / high)
    return Policy(
        layers,
        memory=memory,
        head=head,
        activation=activation,
        output="clip" if kind == "ppo" else "tanh",
        **options,
    )


def _space(data: Mapping[str, Any], name: str, where: str) -> Mapping[str, Any]:
    space = data.get(name)
    if not isinstance(space, Mapping) or "Box" not in str(space.get(":type:")):
        raise InputError(f"{where}: its {name.replace('_', ' ')} is not a Box")
    return space


def convert(
    archive: str | Path,
    *,
    normalize: str | Path | None = None,
    network: str | Path | Network | None = "quarter-car-isd",
    memory: Memory | None = None,
    head: Head | None = None,
    name: str | None = None,
) -> Policy:
    """The deterministic policy of an SB3 PPO, SAC or TD3 .zip; `normalize`: its saved VecNormalize.

    An action space of +-1 is taken as a share of the current's limit. Raises `InputError` in one line for anything
    that is no such archive or was trained for other spaces.
    """
    path = Path(archive)
    try:
        with zipfile.ZipFile(path) as file:
            data = json.loads(file.read("data"))
            weights = file.read("policy.pth")
    except OSError as error:
        raise InputError(f"cannot read '{path}': {error.strerror}") from None
    except (zipfile.BadZipFile, KeyError, ValueError):
        raise InputError(f"'{path}' is not an archive of Stable-Baselines3") from None
    where = f"'{path}'"
    seen = _space(data, "observation_space", where).get("_shape")
    acts = _space(data, "action_space", where)
    memory = memory or Memory()
    wanted = memory.width(N_MEASURED)
    if list(seen or []) != [wanted]:
        raise InputError(f"{where} was trained on observations of shape {seen}, this car gives [{wanted}]")
    if list(acts.get("_shape") or []) != [1]:
        raise InputError(
            f"{where} was trained for actions of shape {acts.get('_shape')}, the car has one current"
        )
    high = float(str(acts.get("high", "[1.]")).strip("[] "))
    if high not in (1.0, CURRENT_LIMIT):
        raise InputError(f"{where} was trained for actions up to {high:g}, neither 1 nor {CURRENT_LIMIT:g} A")
    state = read_torch(weights, where)
    try:
        kind, _ = actor_layers(state)
        given = data.get("policy_kwargs", {})
        text = str(given.get("activation_fn", "Tanh" if kind == "ppo" else "ReLU"))
        activation = next(
            (a for a in ("tanh", "relu") if f".{a}'" in text.lower() or a == text.lower()), None
        )
        if activation is None:
            raise InputError(f"activation {text} is not supported (Tanh, ReLU)")
        mean, scale, clip = read_normalize(normalize) if normalize else (None, None, math.inf)
        return build(
            state,
            activation=activation,
            memory=memory,
            head=head or Head(),
            high=high,
            mean=mean,
            scale=scale,
            clip=clip,
            name=name or path.stem,
            network=Network.load(network) if network is not None else None,
            info={"algorithm": kind, "origin": f"converted from {path.name}"},
        )
    except InputError as error:
        text = str(error)
        raise InputError(text if where in text else f"{where}: {text}") from None
