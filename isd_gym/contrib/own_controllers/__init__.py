"""Controllers of a user's own Python file: ``file.py:Class`` and ``file.py:function``.

The user names the file, hence the program runs it, as Python would.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError, hint, shown
from isd_gym.benchmark.driving import Entry

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType


def entry_of_file(name: str) -> Entry | None:
    """Return the controller of a name such as ``file.py:Class`` as an entry of a score.

    A class is called without arguments, once per car. Its objects have `reset()` and `act(observation)`, and
    optionally `name`, `observation`, `preview`, `fallbacks`, `reset_batch(count)` and `act_batch(observations)`
    (`driving.Controller`). A function is `act` of a controller without memory.
    """
    path, colon, attribute = name.rpartition(":")
    if not colon:
        path, attribute = name, ""
    if not path.endswith(".py"):
        return None
    file = Path(path)
    if not os.path.isfile(file):
        raise InputError(f"no Python file {shown(path, 200)}")
    module = _load(file)
    offered = [
        k for k, v in vars(module).items() if callable(v) and getattr(v, "__module__", "") == module.__name__
    ]
    made = getattr(module, attribute, None) if attribute else None
    if not callable(made):
        there = hint(attribute, offered) if offered else "there is none"
        raise InputError(f"{shown(path, 200)} needs the name of a class or function after a colon: {there}")
    first = OwnController(made, file, attribute)
    return Entry(first.name, lambda: OwnController(made, file, attribute))


def _load(file: Path) -> ModuleType:
    """Return the module of a file, which may import its neighbours."""
    spec = importlib.util.spec_from_file_location(f"{file.stem}_of_the_user", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    folder = str(file.resolve().parent)
    if folder not in sys.path:
        sys.path.append(folder)
    _call(file, spec.loader.exec_module, module)
    return module


def _call(file: Path, function: Callable[..., Any], *arguments: Any) -> Any:
    """Return the value of a call; raise `InputError` with the line of the file for any error."""
    try:
        return function(*arguments)
    except InputError:
        raise
    except Exception as error:
        frames = [f for f in traceback.extract_tb(error.__traceback__) if Path(f.filename) == file]
        line = frames[-1].lineno if frames else getattr(error, "lineno", None)
        place = f"{file}:{line}" if line else str(file)
        raise InputError(f"{place}: {type(error).__name__}: {error}") from None


class OwnController:
    """A user's controller (a class, or a function of the observation), whose errors and values are checked."""

    def __init__(self, made: Callable[..., Any], file: Path, attribute: str) -> None:
        self._file, self._label = file, f"{file}:{attribute}"
        self._own: Any = _call(file, made) if isinstance(made, type) else None
        act = getattr(self._own, "act", None) if isinstance(made, type) else made
        if not callable(act):
            raise InputError(f"{self._label} has no method act(observation)")
        self._act: Callable[[np.ndarray], Any] = act
        self.name = str(getattr(self._own, "name", attribute))
        self.observation = str(getattr(self._own, "observation", "measured"))
        if (preview := getattr(self._own, "preview", None)) is not None:
            self.preview = preview
        if callable(getattr(self._own, "act_batch", None)):  # a `Crew` asks for the attribute
            self.act_batch = self._act_batch

    @property
    def fallbacks(self) -> int:
        """Number of safe substitute decisions, if the controller counts them."""
        return int(getattr(self._own, "fallbacks", 0))

    def reset(self) -> None:
        """Clear the memory of the controller, if it has one."""
        if callable(reset := getattr(self._own, "reset", None)):
            _call(self._file, reset)

    def reset_batch(self, count: int) -> None:
        """Clear the memory of all cars."""
        if callable(reset := getattr(self._own, "reset_batch", None)):
            _call(self._file, reset, count)
        else:
            self.reset()

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Return the commanded current."""
        return self._numbers(_call(self._file, self._act, observation), "act")

    def _act_batch(self, observations: np.ndarray) -> np.ndarray:
        return self._numbers(_call(self._file, self._own.act_batch, observations), "act_batch")

    def _numbers(self, value: Any, method: str) -> np.ndarray:
        try:
            found = np.asarray(value, float)
        except (TypeError, ValueError):
            found = np.array(np.nan)
        if found.dtype == object or not np.isfinite(found).all():
            raise InputError(f"{self._label}: {method} returned {shown(value)}, not a current [A]")
        return found
