"""Conversion of Stable-Baselines3 policies (.zip, with or without VecNormalize) to policies that need no torch.

An archive of Stable-Baselines3 holds pickles, and other programs execute code from the archive when they load
a pickle. No code is executed here: `torch.load(weights_only=True)` reads the weights (torch 2.6 or later;
CVE-2025-32434), and every class or function that a VecNormalize names is replaced by one that does nothing. An
archive from a stranger is therefore as safe as a policy folder.
"""

from __future__ import annotations

import io
import math
import os
import pickle
import pickletools
import re
import sys
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from isd_gym.agents._actors import actor_layers, build
from isd_gym.agents._entry import entry_of
from isd_gym.agents._memory import FRAMES, Memory
from isd_gym.agents.policy import Head, Policy

from isd_gym._common.errors import InputError, how_to_install, shown
from isd_gym._common.inputs import is_whole, number, parse_json, read_bytes, too_large
from isd_gym.env.history import BOUND
from isd_gym.physics.network import Network
from isd_gym.physics.vehicle import CURRENT_LIMIT, SLEW_RATE, Vehicle, vehicle

if TYPE_CHECKING:
    from isd_gym.benchmark.driving import Entry
    from isd_gym.physics.cost import StageCost

#: limit of the total unpacked size of an archive's parts [bytes]
ARCHIVE_LIMIT = 512 * 2**20


def _unzip(data: bytes, where: str) -> zipfile.ZipFile:
    """Return a zip archive; raise `InputError` for other data, and for an archive that is too large unpacked."""
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
        total = sum(part.file_size for part in archive.infolist())
    except Exception as error:  # a zip archive can be broken in many ways
        raise InputError(
            f"{where}: not a zip archive ({type(error).__name__})"
        ) from None
    if total > ARCHIVE_LIMIT:
        raise too_large(where, total, ARCHIVE_LIMIT)
    return archive


def _part(archive: zipfile.ZipFile, name: str, where: str) -> bytes:
    """Return the bytes of a part of an archive, never more than its declared size."""
    try:
        return archive.read(name)
    except Exception as error:
        raise InputError(
            f"{where}: part {shown(name)} cannot be read ({type(error).__name__})"
        ) from None


def read_torch(data: bytes, where: str) -> dict[str, np.ndarray]:
    """Return the arrays of a state dict saved by `torch.save`, without executing code of the file.

    Args:
        data: Content of the file.
        where: Name of the file, for messages.

    Returns:
        Array by name.

    Raises:
        InputError: The file holds no weights saved by torch, or torch is not installed.
    """
    try:
        import torch
    except ImportError:
        raise InputError(
            f"{where}: reading weights needs torch: {how_to_install('agents')}"
        ) from None
    _unzip(data, where)  # checks the unpacked size
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of unusual files
            state = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
        if (
            sum(tensor.numel() * tensor.element_size() for tensor in state.values())
            > ARCHIVE_LIMIT
        ):
            raise ValueError("tensors that overlap")
        return {str(name): tensor.numpy() for name, tensor in state.items()}
    except Exception as error:  # any error is a fault of the file
        raise InputError(
            f"{where}: not weights saved by torch ({type(error).__name__})"
        ) from None


class _Inert:
    """Stands for every class and function that a pickle names: keeps arguments and state, and does nothing else."""

    #: module and name in the pickle
    made = ""
    arguments: tuple[Any, ...] = ()
    state: Any = None

    def __new__(cls, *arguments: Any, **_: Any) -> _Inert:
        made = super().__new__(cls)
        made.arguments = arguments
        return made

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def __setitem__(self, key: Any, value: Any) -> None:
        """Skip an item."""


class _InertUnpickler(pickle.Unpickler):
    """Unpickler that replaces every class and function of a pickle by an inert class."""

    def find_class(self, module: str, name: str) -> Any:
        return type("_Inert", (_Inert,), {"made": f"{module}.{name}"})


#: limits of a pickle: opcodes, and tuples, whose hash is computed recursively
OPCODES, TUPLES = 1_000_000, 1000


def read_pickle(data: bytes) -> Any:
    """Return the content of a pickle without executing code of the pickle.

    Args:
        data: The pickle.

    Returns:
        Plain values; objects keep the arguments of the call (`arguments`) and the state (`state`) alone.

    Raises:
        InputError: The data are no pickle, or a pickle beyond the limits.
    """
    tuples = 0
    try:
        for step, (opcode, argument, _) in enumerate(pickletools.genops(data)):
            tuples += opcode.name.startswith("TUPLE")
            place = argument if opcode.name.endswith("BINPUT") else 0
            if max(step, place or 0) > OPCODES or tuples > TUPLES:
                raise ValueError("too large")
        return _InertUnpickler(io.BytesIO(data)).load()
    except Exception as error:  # any error is a fault of the file
        raise InputError(
            f"not a pickle that can be read ({type(error).__name__})"
        ) from None


#: numeric types of pickled arrays
KINDS: dict[Any, np.dtype[Any]] = {
    "f4": np.dtype("<f4"),
    "f8": np.dtype("<f8"),
    "i8": np.dtype("<i8"),
}


def array(value: Any) -> np.ndarray:
    """Return a pickled array or number of numpy.

    Args:
        value: Part of `read_pickle`.

    Returns:
        The array.

    Raises:
        InputError: The value is no array of numbers.
    """
    shape: Any
    order: Any
    try:
        if isinstance(value, int | float) and not isinstance(value, bool):
            return np.array(float(value))
        shape, order = (), "C"
        if value.made.endswith("core.multiarray._reconstruct"):
            _, shape, kind, is_fortran, data = value.state
            order = "F" if is_fortran is True else "C"
        elif value.made.endswith("core.multiarray.scalar"):
            kind, data = value.arguments
        elif value.made.endswith("core.numeric._frombuffer"):
            data, kind, shape, order = value.arguments
        else:
            raise ValueError(value.made)
        is_native = kind.state is None or (
            kind.state[1] in "<|" and not any(kind.state[2:5])
        )
        if kind.made != "numpy.dtype" or not is_native:
            raise ValueError("dtype")
        return (
            np.frombuffer(bytes(data), KINDS[kind.arguments[0]])
            .reshape(shape, order=order)
            .copy()
        )
    except (
        ArithmeticError,
        AttributeError,
        IndexError,
        KeyError,
        TypeError,
        ValueError,
    ):
        raise InputError("not an array of numbers") from None


def read_normalize(path: str | Path) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the normalisation of the observations in a saved VecNormalize, without executing its pickle.

    Args:
        path: The file.

    Returns:
        Mean (n,), scale (n,) and clip.

    Raises:
        InputError: The file is no saved VecNormalize.
    """
    data = read_bytes(path)
    try:
        state = getattr(read_pickle(data), "state", None)
        statistics = (
            getattr(state.get("obs_rms"), "state", None)
            if isinstance(state, dict)
            else None
        )
        if not isinstance(state, dict) or not isinstance(statistics, dict):
            raise InputError("no running mean of the observations")
        mean, variance = (
            array(statistics.get(key)).astype(float) for key in ("mean", "var")
        )
        if state.get("norm_obs", True) is not True:
            return np.zeros_like(mean), np.ones_like(mean), math.inf
        epsilon, clip = (
            number(array(state.get(k)).item(), k) for k in ("epsilon", "clip_obs")
        )
        if not (
            np.isfinite(mean).all()
            and np.isfinite(variance).all()
            and (variance >= 0).all()
        ):
            raise InputError("mean and variance are not finite")
        if not (clip > 0 and epsilon > 0):
            raise InputError("clip_obs and epsilon are not > 0")
        return mean, np.sqrt(variance + epsilon), clip
    except InputError as error:
        raise InputError(f"'{path}' is not a saved VecNormalize ({error})") from None


def _space(data: Mapping[str, Any], name: str, where: str) -> Mapping[str, Any]:
    space = data.get(name)
    if not isinstance(space, Mapping) or "Box" not in str(space.get(":type:")):
        raise InputError(f"{where}: its {name.replace('_', ' ')} is not a Box")
    return space


def _shape(space: Mapping[str, Any]) -> str:
    shape = space.get("_shape")
    short = (
        isinstance(shape, list)
        and len(shape) < 6
        and all(isinstance(n, int) for n in shape)
    )
    return str(shape) if short else shown(shape)


def _bounds(space: Mapping[str, Any]) -> set[float]:
    """Return the different upper bounds of a space; raise `ValueError` for other text than numbers."""
    return {
        float(word)
        for word in str(space.get("high", "[1.]"))[:20_000].strip("[] ").split()
    }


#: options of the training that decide how a policy is run, with their values
TRAINED = {
    "observation": ("measured", "history"),
    "action": ("current", "share", "increment"),
}
#: built-in cars, to tell which of them an archive was trained on
CARS = ("quarter-car-isd", "half-car-isd", "full-car-isd")


def trained_options(text: str) -> dict[str, str]:
    """Return the options of a training from a text such as ``observation=history,action=increment``.

    Args:
        text: Pairs NAME=VALUE, joined by commas; names are those of `TRAINED`, and `normalize`.

    Returns:
        Value by name.

    Raises:
        InputError: A name or a value is unknown.
    """
    out = {}
    for pair in text.split(","):
        name, _, value = (word.strip() for word in pair.partition("="))
        if name not in (*TRAINED, "normalize") or not value:
            raise InputError(
                f"{shown(pair)} is no option of a training: there are observation=measured or history, "
                "action=current, share or increment, normalize=FILE or none"
            )
        out[name] = value
    return out


def _features(
    where: str,
    car: Vehicle,
    seen: Mapping[str, Any],
    acts: Mapping[str, Any],
    given: Mapping[str, str | None],
) -> tuple[Memory, Head, float]:
    """Return features, conversion of the output, and bound of the action space, of an archive for a car.

    The options of the training are the given ones, else those that the environment left in the archive, else
    those that the spaces of the archive show.
    """
    noted = seen.get("isd_gym")
    noted = noted if isinstance(noted, Mapping) else {}
    asked: dict[str, Any] = {k: given.get(k) or noted.get(k) for k in TRAINED}
    step = number(noted.get("control_step", 5e-3), f"{where}: its control step")
    if not 1e-3 <= step <= 1.0:
        raise InputError(f"{where}: its control step is {step:g} s")
    shape = seen.get("_shape")
    try:
        high = _bounds(acts)
        (limit,) = high
    except ValueError:
        raise InputError(
            f"{where}: the bound of its actions is {shown(acts.get('high'))}"
        ) from None
    if asked["observation"] is None:
        try:
            is_scaled = _bounds(seen) == {BOUND}
        except ValueError:
            is_scaled = False
        w = _width("history", car, step)
        asked["observation"] = (
            "history" if is_scaled and shape == [w * _frames(shape, w)] else "measured"
        )
    if asked["action"] is None:
        asked["action"] = "share" if limit == 1.0 else "current"
    for name, known in TRAINED.items():
        if asked[name] not in known:
            raise InputError(
                f"{where} was trained with {name} {shown(asked[name])}; archives are driven with "
                f"{' or '.join(known)}"
            )
    wanted = _width(asked["observation"], car, step)
    currents = len(car.driven)
    frames = _frames(shape, wanted) if acts.get("_shape") == [currents] else 1
    if shape != [frames * wanted]:
        others = [
            f"{kind} of {name}"
            for name in CARS
            for kind in TRAINED["observation"]
            if shape == [_width(kind, vehicle(Network.load(name)), step)]
        ]
        fits = (
            f"; it fits {others[0]}, see --network and --trained-with" if others else ""
        )
        raise InputError(
            f"{where} was trained on observations of shape {_shape(seen)}, this car gives [{wanted}]{fits}"
        )
    if acts.get("_shape") != [currents]:
        raise InputError(
            f"{where} was trained for actions of shape {_shape(acts)}, network '{car.network.name}' takes [{currents}]"
        )
    if limit not in (1.0, CURRENT_LIMIT):
        raise InputError(
            f"{where} was trained for actions up to {limit:g}, neither 1 nor {CURRENT_LIMIT:g} A"
        )
    memory = (
        Memory.of(car, step) if asked["observation"] == "history" else Memory(step=step)
    )
    memory = replace(memory, frames=frames)
    is_increment = asked["action"] == "increment"
    return (
        memory,
        Head("increment", slew=min(SLEW_RATE * step, CURRENT_LIMIT))
        if is_increment
        else Head(),
        limit,
    )


def _frames(shape: Any, width: int) -> int:
    """Return the number of observations of a width in a stack of a shape; 1 if the shape is no stack."""
    is_flat = (
        isinstance(shape, list)
        and len(shape) == 1
        and is_whole(shape[0], width, FRAMES * width)
    )
    return shape[0] // width if is_flat and shape[0] % width == 0 else 1


def _width(observation: str, car: Vehicle, step: float) -> int:
    signals = len(car.measured)
    return Memory.of(car, step).width(signals) if observation == "history" else signals


def normalize_beside(archive: Path) -> Path | None:
    """Return the saved VecNormalize beside an archive.

    Args:
        archive: The .zip file.

    Returns:
        The first existing file of: <stem>_vecnormalize.pkl, <stem>.pkl, the name that the `CheckpointCallback` of
            Stable-Baselines3 gives, vecnormalize.pkl. None without such a file.
    """
    stem = archive.stem
    names = [f"{stem}_vecnormalize.pkl", f"{stem}.pkl"]
    if parts := re.fullmatch(r"(.*)_(\d+)_steps", stem):
        names.append(f"{parts[1]}_vecnormalize_{parts[2]}_steps.pkl")
    found = (archive.with_name(name) for name in (*names, "vecnormalize.pkl"))
    return next((path for path in found if os.path.isfile(path)), None)


def convert(
    archive: str | Path,
    *,
    normalize: str | Path | None = None,
    network: str | Path | Network | None = "quarter-car-isd",
    observation: str | None = None,
    action: str | None = None,
    name: str | None = None,
) -> Policy:
    """Return the deterministic policy of a PPO, A2C, SAC, TD3, DDPG or TQC archive of Stable-Baselines3.

    Nothing of the archive is executed. The environments of this package leave their options in the archive. Without
    them, observations within ±10 of the right width are a history, and actions in [-1, 1] are shares of the
    current's limit.

    Args:
        archive: The .zip file.
        normalize: File of its saved VecNormalize; None for a file beside the archive (`normalize_beside`), "none"
            for no normalisation.
        network: Network of the training; None if unknown.
        observation: Observation of the training, 'measured' or 'history'; None to find it.
        action: Action of the training, 'current', 'share' or 'increment'; None to find it.
        name: Name of the policy; None for the stem of the file.

    Returns:
        The policy.

    Raises:
        InputError: The file is no such archive, or was trained for other spaces.
    """
    path = Path(archive)
    where = shown(str(archive), 200)
    file = _unzip(read_bytes(path, ARCHIVE_LIMIT), where)
    if "data" not in file.namelist():
        raise InputError(
            f"{where} is not an archive of Stable-Baselines3, or not a whole one: it has no part 'data'"
        )
    data = parse_json(_part(file, "data", where), where)
    if not isinstance(data, Mapping):
        raise InputError(
            f"{where} is not an archive of Stable-Baselines3: its data is {shown(data)}"
        )
    seen = _space(data, "observation_space", where)
    acts = _space(data, "action_space", where)
    car = vehicle(Network.load(network if network is not None else "quarter-car-isd"))
    memory, head, high = _features(
        where, car, seen, acts, {"observation": observation, "action": action}
    )
    if normalize is None:
        normalize = normalize_beside(path)
    elif str(normalize) == "none":
        normalize = None
    state = read_torch(_part(file, "policy.pth", where), where)
    try:
        kind, _ = actor_layers(state)
        given = data.get("policy_kwargs", {})
        given = given if isinstance(given, Mapping) else {}
        text = str(given.get("activation_fn", "Tanh" if kind == "ppo" else "ReLU"))
        activation = next(
            (
                a
                for a in ("tanh", "relu")
                if f".{a}'" in text.lower() or a == text.lower()
            ),
            None,
        )
        if activation is None:
            raise InputError(f"activation {shown(text)} is not supported (Tanh, ReLU)")
        if given.get("squash_output") is True and kind == "ppo":
            raise InputError("squash_output of PPO is not supported")
        extractor = str(given.get("features_extractor_class", "FlattenExtractor"))
        if "FlattenExtractor" not in extractor:
            raise InputError(f"features extractor {shown(extractor)} is not supported")
        # the environment clips its histories
        bound = BOUND if memory.scale else math.inf
        mean, scale, clip = (
            read_normalize(normalize) if normalize else (None, None, math.inf)
        )
        if (
            mean is not None
            and scale is not None
            and len(mean) * memory.frames == seen["_shape"][0]
        ):
            # normalised, then stacked
            mean, scale = (
                np.tile(mean, memory.frames),
                np.tile(scale, memory.frames),
            )
        return build(
            state,
            activation=activation,
            memory=memory,
            head=head,
            high=high,
            mean=mean,
            scale=scale,
            clip=clip,
            bound=bound,
            name=name or path.stem,
            network=Network.load(network) if network is not None else None,
            info={
                "algorithm": kind,
                "origin": f"converted from {path.name}",
                **({"normalisation": Path(normalize).name} if normalize else {}),
            },
        )
    except InputError as error:
        text = str(error)
        raise InputError(text if where in text else f"{where}: {text}") from None


def open_policy(
    name: str,
    model: Network,
    cost: StageCost,
    control_step: float,
    options: dict[str, Any],
) -> Entry | None:
    """Return the policy of an archive as an entry of a score.

    Args:
        name: The .zip file.
        model: Network of the score.
        cost: Without effect.
        control_step: Control step [s].
        options: `trained`, options of the training (`trained_options`); others as for a policy folder.

    Returns:
        The entry; None for other names.
    """
    if not name.lower().endswith(".zip"):
        return None
    given: dict[str, Any] = dict(
        trained_options(options["trained"]) if options.get("trained") else {}
    )
    policy = convert(name, network=model, **given)
    if "normalisation" in policy.info and "normalize" not in given:
        print(
            f"{name}: normalised by '{policy.info['normalisation']}' beside it",
            file=sys.stderr,
        )
    return entry_of(policy, name, model, control_step, options)
