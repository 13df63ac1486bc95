"""A policy folder: weights as safetensors and `policy.json`; needs no torch, and executes no code.

from isd_gym.agents.policy import Policy

policy = Policy.load("runs/sac/policy")
policy.reset()
current = policy.act(observation)  # [A]
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from copy import copy
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy as safetensors

from isd_gym._common.errors import InputError, plain, shown
from isd_gym._common.files import whole_folder
from isd_gym._common.inputs import number, parse_json, read_bytes
from isd_gym.env.history import LARGEST
from isd_gym.physics.network import Network
from isd_gym.physics.vehicle import CURRENT_LIMIT, SLEW_LIMIT, vehicle

from ._memory import Memory, Recall

__all__ = [
    "Policy",
]


SCHEMA = "isd-policy/1"
JSON_NAME, WEIGHTS_NAME = "policy.json", "weights.safetensors"
_POLICY = ("policy", JSON_NAME, (JSON_NAME, WEIGHTS_NAME))
#: limits of a policy's files: bytes of a file, layers, neurons of a layer
FILE_LIMIT, LAYERS, WIDTH = 256 * 2**20, 32, 8192
FEATURE_LIMIT = 10.0  # features are clipped at ten times their scale
SHIPPED = Path(__file__).parent / "policies"


@dataclass(frozen=True)
class Head:
    """Conversion of a policy's output in [-1, 1] to the commanded current of each motor."""

    #: 'target' for a share of `limit`; 'increment' for the present current plus a share of `slew`; 'residual'
    #: for the law of the memory's filter plus an offset
    mode: str = "target"
    limit: float = CURRENT_LIMIT  # largest current [A]
    slew: float = SLEW_LIMIT  # largest change of current per control step [A]
    keep: float = 0.9  # factor on the offset of a residual at each step [-]
    gain: float = 0.5  # change of the offset of a residual at output 1 [A]

    def __post_init__(self) -> None:
        if self.mode not in ("target", "increment", "residual"):
            raise InputError(
                f"action mode must be target, increment or residual, not {shown(self.mode)}"
            )
        for key, most in (("limit", CURRENT_LIMIT), ("slew", SLEW_LIMIT)):
            value = number(getattr(self, key), f"the action's {key}")
            if not 0 < value <= most:
                raise InputError(
                    f"the action's {key} must be > 0 and at most {most:g} A, not {value:g}"
                )
        if not 0 <= number(self.keep, "the action's keep") <= 1:
            raise InputError(f"the action's keep must be 0 to 1, not {self.keep:g}")
        if abs(number(self.gain, "the action's gain")) > 2 * CURRENT_LIMIT:
            raise InputError(
                f"the action's gain must be at most {2 * CURRENT_LIMIT:g} A, not {self.gain:g}"
            )

    def current(
        self, share: np.ndarray, present: np.ndarray, recall: Recall | None = None
    ) -> np.ndarray:
        """Return the commanded currents (count, currents) [A] for outputs `share` (count, currents) in [-1,
        1] and present currents [A]; `recall` has the law and the offset of a residual."""
        if self.mode == "target":
            return share * np.float32(self.limit)
        if self.mode == "residual":
            assert recall is not None and recall.filter is not None
            offset = recall.features[:, -share.shape[1] :]
            offset *= np.float32(self.keep)
            offset += np.float32(self.gain) * share
            return np.clip(recall.filter.wanted + offset, -self.limit, self.limit)
        return np.clip(present + share * np.float32(self.slew), -self.limit, self.limit)


def read_safetensors(data: bytes, where: str = "weights") -> dict[str, np.ndarray]:
    """Return the tensors of a safetensors file by name; `where` is the file's name for messages."""
    try:
        return safetensors.load(data)
    except Exception as error:  # any error is a fault of the file
        raise InputError(f"{where}: not a safetensors file ({error})") from None


# --------------------------------------------------------------------------------------------- policy


def _tanh(x: np.ndarray) -> np.ndarray:
    return np.tanh(x, out=x)


def _relu(x: np.ndarray) -> np.ndarray:
    return np.maximum(x, 0.0, out=x)


_ACTIVATIONS = {"tanh": _tanh, "relu": _relu}
_OUTPUTS = ("clip", "tanh")  # PPO clips its mean; SAC and TD3 squash their output


def _layers(
    weights: list[tuple[np.ndarray, np.ndarray]],
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return weights and biases as float32. Raise `InputError` for sizes and values that cannot be run."""
    if len(weights) > LAYERS:
        raise InputError(
            f"the policy has {len(weights)} layers, at most {LAYERS} are run"
        )
    with np.errstate(over="ignore"):
        layers = [
            (np.array(w, np.float32), np.array(b, np.float32)) for w, b in weights
        ]
    for i, (w, b) in enumerate(layers):
        if (
            w.ndim != 2
            or b.shape != w.shape[:1]
            or (i and w.shape[1] != len(layers[i - 1][1]))
        ):
            raise InputError(
                f"layer {i} of the weights does not fit: {w.shape} and {b.shape}"
            )
        if not 0 < min(w.shape) <= max(w.shape) <= WIDTH:
            raise InputError(
                f"layer {i} of the weights has sizes {w.shape}, at most {WIDTH} are run"
            )
        if not ((np.abs(w) <= LARGEST).all() and (np.abs(b) <= LARGEST).all()):
            raise InputError(
                f"layer {i} of the weights is not finite, or larger than {LARGEST:g}"
            )
    return layers


def _normalisation(
    mean: np.ndarray | None, scale: np.ndarray | None, features: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and scale of the features as float32. Raise `InputError` for invalid values."""
    with np.errstate(over="ignore", under="ignore"):
        mean = (
            np.zeros(features, np.float32)
            if mean is None
            else np.array(mean, np.float32)
        )
        scale = (
            np.ones(features, np.float32)
            if scale is None
            else np.array(scale, np.float32)
        )
    if mean.shape != (features,) or scale.shape != (features,):
        raise InputError(
            f"the normalisation needs {features} means and positive scales"
        )
    if not (
        (np.abs(mean) <= LARGEST).all()
        and (scale >= 1 / LARGEST).all()
        and (scale <= LARGEST).all()
    ):
        raise InputError(
            f"the normalisation needs means and positive scales of at most {LARGEST:g}"
        )
    return mean, scale


class Policy:
    """A multilayer perceptron on features of the observations, with the interface of the controllers in `baselines`.

    An observation ends with the present currents, one per output of the network.

    Args:
        weights: Weights (out, in) and biases (out,) of each layer.
        memory: Features of the observations; None for unchanged signals.
        head: Conversion of the output to a current; None for the target current.
        activation: Activation between the layers, 'tanh' or 'relu'.
        output: Activation after the last layer, 'tanh' or 'clip'.
        mean: Mean of the features (features,); None for zero.
        scale: Scale of the features (features,); None for one.
        clip: Bound of the normalised features.
        bound: Bound of the features before the normalisation.
        name: Name in scores.
        network: Network of the training; None if unknown.
        info: Further content of policy.json (origin, training, score).

    Raises:
        InputError: A shape or a value is invalid.
    """

    observation = "measured"
    preview = 0.0
    #: number of steps with a substitute command: always 0
    fallbacks = 0

    def __init__(
        self,
        weights: list[tuple[np.ndarray, np.ndarray]],
        *,
        memory: Memory | None = None,
        head: Head | None = None,
        activation: str = "tanh",
        output: str = "clip",
        mean: np.ndarray | None = None,
        scale: np.ndarray | None = None,
        clip: float = FEATURE_LIMIT,
        bound: float = math.inf,
        name: str = "policy",
        network: Network | None = None,
        info: Mapping[str, Any] | None = None,
    ) -> None:
        if not isinstance(activation, str) or activation not in _ACTIVATIONS:
            raise InputError(
                f"activation must be one of {', '.join(_ACTIVATIONS)}, not {shown(activation)}"
            )
        if output not in _OUTPUTS:
            raise InputError(
                f"output must be one of {', '.join(_OUTPUTS)}, not {shown(output)}"
            )
        if not weights:
            raise InputError("the policy has no layers")
        self.memory = memory or Memory()
        self.head = head or Head()
        if self.head.mode == "residual" and self.memory.filter is None:
            raise InputError("a residual action needs a memory with a filter")
        if not (isinstance(clip, int | float) and clip > 0):
            raise InputError(f"clip must be > 0, not {shown(clip)}")
        if not (isinstance(bound, int | float) and bound > 0):
            raise InputError(f"bound must be > 0, not {shown(bound)}")
        self.activation = activation
        self.output = output
        self.name = name
        self.clip = float(clip)
        self.bound = float(bound)
        #: network of the training
        self.model = network
        self.info = dict(info or {})
        self.weights = _layers(weights)
        #: number of currents that it commands
        self.currents = len(self.weights[-1][1])
        motors = 1 if network is None else len(vehicle(network).driven)
        if self.currents != motors and network is not None:
            raise InputError(
                f"the policy has {_counted(self.currents, 'output')}, network '{network.name}' has {_counted(motors, 'current')}"
            )
        inputs = self.weights[0][0].shape[1]
        frames = self.memory.frames
        self.mean, self.scale = _normalisation(mean, scale, inputs)
        features = inputs // frames
        self.signals = (features - self.memory.extra) // (1 + self.memory.order)
        given = frames * self.memory.width(self.signals)
        if given != inputs:
            raise InputError(
                f"the policy has {inputs} inputs, its memory gives {given}"
            )
        if self.signals <= self.currents:
            raise InputError(
                f"the policy reads {_counted(self.signals, 'signal')} and commands {_counted(self.currents, 'current')}"
            )
        self._check_filter()
        if self.memory.ahead:
            #: length of the previewed road [s]
            self.observation, self.preview = (
                "preview",
                self.memory.ahead * self.memory.step,
            )
        self._transposed = [(np.ascontiguousarray(w.T), b) for w, b in self.weights]
        self._act = _ACTIVATIONS[activation]
        self._recall: Recall | None = None

    def _check_filter(self) -> None:
        """Check that the filter of the memory reads signals of the observation and knows every current."""
        own = self.memory.filter
        if own is None:
            return
        if own.currents != self.currents:
            raise InputError(
                f"the policy commands {self.currents} currents, its memory's filter {own.currents}"
            )
        last = max(own.current + own.currents, len(own.D)) - 1
        if last >= self.signals:
            raise InputError(
                f"the policy reads signal {last}, the observation has {self.signals}"
            )

    # -------------------------------------------------------------------------------------- running

    def reset(self) -> None:
        """Clear the memory: a new episode begins."""
        self._recall = None

    def act(self, observation: np.ndarray) -> float | np.ndarray:
        """Return the commanded current for the next control step.

        Args:
            observation: Observation (signals,).

        Returns:
            Current [A], or currents (currents,) [A] of a car with several motors.
        """
        wanted: np.ndarray = self.act_batch(np.asarray(observation, np.float32)[None])[
            0
        ]
        return float(wanted) if self.currents == 1 else wanted

    def reset_batch(self, count: int) -> None:
        """Clear the memory of all cars.

        Args:
            count: Number of cars.
        """
        self._recall = None

    def act_batch(self, observations: np.ndarray) -> np.ndarray:
        """Return the commanded currents; each car has a separate memory.

        Args:
            observations: Observations (count, signals).

        Returns:
            Currents float32 [A], (count,) or (count, currents).

        Raises:
            InputError: The observations have another width.
        """
        obs = np.asarray(observations, np.float32)
        if not math.isfinite(obs.sum()):  # an invalid sensor value is read as zero
            obs = np.where(np.isfinite(obs), obs, np.float32(0.0))
        recall = self._recall
        if recall is None or len(recall.features) != len(obs):
            if obs.ndim != 2 or obs.shape[1] != self.signals + self.memory.ahead:
                road = (
                    f" and {self.memory.ahead} points of the road ahead"
                    if self.memory.ahead
                    else ""
                )
                raise InputError(
                    f"policy '{self.name}' wants observations of {self.signals} signals{road}, not shape {obs.shape[1:]}"
                )
            recall = self._recall = self.memory.start(obs)
        else:
            recall.see(obs)
        features = recall.features if self.memory.frames == 1 else recall.stacked()
        present = obs[:, self.signals - self.currents : self.signals]
        wanted = self.head.current(self.share(features), present, recall)
        if self.currents == 1:
            wanted = wanted[:, 0]
        if not math.isfinite(wanted.sum()):  # an overflow commands zero current
            wanted = np.where(np.isfinite(wanted), wanted, np.float32(0.0))
        return wanted

    def share(self, features: np.ndarray) -> np.ndarray:
        """Return the output of the network.

        Args:
            features: Features (count, features).

        Returns:
            Output (count, currents) in [-1, 1].
        """
        with np.errstate(over="ignore", invalid="ignore"):
            if self.bound < math.inf:
                features = np.clip(features, -self.bound, self.bound)
            x = np.clip((features - self.mean) / self.scale, -self.clip, self.clip)
            for w, b in self._transposed[:-1]:
                x = self._act(x @ w + b)
            w, b = self._transposed[-1]
            y = x @ w + b
        return np.tanh(y) if self.output == "tanh" else np.clip(y, -1.0, 1.0)

    def copy(self) -> Policy:
        """Return the policy with a separate memory."""
        other = copy(self)
        other._recall = None
        return other

    def at_speed(self, speed: float) -> Policy:
        """Return the policy with the delay of the rear road for a speed.

        Args:
            speed: Speed of the car [m/s].

        Returns:
            A changed copy; the same policy if it has no such delay.

        Raises:
            InputError: The speed is too low for the delay.
        """
        memory = self.memory.at(speed)
        if memory is self.memory:
            return self
        other = self.copy()
        other.memory = memory
        return other

    def check(self, network: Network | str | Path) -> None:
        """Check that a network has the inputs of the policy's network.

        Args:
            network: A network, a built-in name or a file.

        Raises:
            InputError: The inputs differ.
        """
        net = Network.load(network)
        motors = len(vehicle(net).driven)
        if self.model is not None and motors != self.currents:
            raise InputError(
                f"policy '{self.name}' was made for network '{self.model.name}' with {_counted(self.currents, 'current')}; "
                f"'{net.name}' has {motors}: choose a policy that was trained on such a car"
            )
        if self.model is not None and [c.to_dict() for c in net.inputs] != [
            c.to_dict() for c in self.model.inputs
        ]:
            raise InputError(
                f"policy '{self.name}' was made for network '{self.model.name}'; '{net.name}' has other inputs"
            )

    # ---------------------------------------------------------------------------------------- files

    def save(self, folder: str | Path) -> Path:
        """Write `policy.json` and the weights atomically.

        Args:
            folder: A new or empty folder, or an earlier policy, which is replaced as a whole.

        Returns:
            The folder.

        Raises:
            InputError: The folder holds other files, or cannot be written.
        """
        folder = Path(folder)
        tensors = {"normalisation.mean": self.mean, "normalisation.scale": self.scale}
        for i, (w, b) in enumerate(self.weights):
            tensors |= {f"layer.{i}.weight": w, f"layer.{i}.bias": b}
        blob = safetensors.save(tensors)
        head = {
            "schema": SCHEMA,
            "name": self.name,
            "weights": {
                "file": WEIGHTS_NAME,
                "sha256": hashlib.sha256(blob).hexdigest(),
            },
            "actor": {
                "layers": [list(w.shape) for w, _ in self.weights],
                "activation": self.activation,
                "output": self.output,
                "clip": self.clip if math.isfinite(self.clip) else None,
                **({"bound": self.bound} if math.isfinite(self.bound) else {}),
            },
            "memory": self.memory.to_dict(),
            "action": asdict(self.head),
            "network": self.model.to_dict() if self.model is not None else None,
        }
        with whole_folder(folder, *_POLICY) as place:
            (place / WEIGHTS_NAME).write_bytes(blob)
            text = json.dumps({**head, **self.info}, indent=1, allow_nan=False)
            (place / JSON_NAME).write_text(text + "\n", encoding="utf-8")
        return folder

    @classmethod
    def load(cls, folder: str | Path) -> Policy:
        """Read a policy.

        Args:
            folder: A policy folder, or the name of a shipped policy (ppo, sac).

        Raises:
            InputError: A file is missing, altered or invalid.
        """
        given, folder = folder, Path(folder)
        where = f"policy {shown(str(given), 200)}"
        if not os.path.exists(folder) and os.path.isfile(
            SHIPPED / str(given) / JSON_NAME
        ):
            folder = SHIPPED / str(given)
        if folder.suffix == ".zip":
            raise InputError(
                f"{shown(str(given), 200)} is a pickle, which can run code: convert it once with `isd-gym convert`"
            )
        head = parse_json(_read(folder, JSON_NAME), f"{where}: {JSON_NAME}")
        if not isinstance(head, dict) or head.get("schema") != SCHEMA:
            raise InputError(f"{where}: {JSON_NAME} is not of schema '{SCHEMA}'")
        blob = _read(folder, WEIGHTS_NAME)
        try:
            if hashlib.sha256(blob).hexdigest() != head["weights"]["sha256"]:
                raise InputError(
                    f"{WEIGHTS_NAME} was altered, its sha256 is not that of {JSON_NAME}"
                )
            tensors = read_safetensors(blob, WEIGHTS_NAME)
            actor = head["actor"]
            network = head.get("network")
            if not (network is None or isinstance(network, dict)):
                raise InputError(f"network must be an object, not {shown(network)}")
            training = head.get("training", {})
            if not isinstance(training, dict):
                raise InputError(f"training must be an object, not {shown(training)}")
            if not isinstance(training.get("versions", {}), dict):
                raise InputError(
                    f"training.versions must be an object, not {shown(training['versions'])}"
                )
            weights = [
                (tensors[f"layer.{i}.weight"], tensors[f"layer.{i}.bias"])
                for i in range(len(actor["layers"]))
            ]
            own = ("schema", "name", "weights", "actor", "memory", "action", "network")
            return cls(
                weights,
                memory=Memory.from_dict(head["memory"]),
                head=Head(**head["action"]),
                activation=actor["activation"],
                output=actor["output"],
                clip=math.inf if actor["clip"] is None else actor["clip"],
                bound=actor.get("bound", math.inf),
                mean=tensors["normalisation.mean"],
                scale=tensors["normalisation.scale"],
                name=plain(str(head["name"])),
                network=Network.load(network) if network else None,
                info={k: v for k, v in head.items() if k not in own},
            )
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"{where}: {JSON_NAME} lacks or garbles {error}") from None


def _counted(count: int, thing: str) -> str:
    return f"{count} {thing}{'s' * (count != 1)}"


def _read(folder: Path, name: str) -> bytes:
    if not os.path.exists(folder / name):
        raise InputError(f"policy {shown(str(folder), 200)}: no {name} there")
    return read_bytes(folder / name, FILE_LIMIT)
