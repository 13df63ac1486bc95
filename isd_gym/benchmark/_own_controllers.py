"""Controllers of a user's own Python file: ``file.py:Class`` and ``file.py:function``.

The user names the file, hence the program runs it, as Python would.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import traceback
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any

from .._common.errors import InputError, hint, shown
from .driving import Driver, Entry

if TYPE_CHECKING:
    from collections.abc import Callable


def entry_of_file(name: str) -> Entry | None:
    """Return the controller of a name such as ``file.py:Class`` as an entry of a score.

    A class is called without arguments, once per car; its objects are controllers (`driving.Controller`). A function
    is `act` of a controller without memory.
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
        k
        for k, v in vars(module).items()
        if callable(v) and getattr(v, "__module__", "") == module.__name__
    ]
    made = getattr(module, attribute, None) if attribute else None
    if not callable(made):
        there = hint(attribute, offered) if offered else "there is none"
        raise InputError(
            f"{shown(path, 200)} needs the name of a class or function after a colon: {there}"
        )

    def make() -> Any:
        own = _call(file, made) if isinstance(made, type) else SimpleNamespace(act=made)
        return _Located(own, file)

    first = make()
    Driver(first, f"{path}:{attribute}")  # checks the interface before long work
    return Entry(str(getattr(first, "name", attribute)), make)


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
        frames = [
            f
            for f in traceback.extract_tb(error.__traceback__)
            if Path(f.filename) == file
        ]
        line = frames[-1].lineno if frames else getattr(error, "lineno", None)
        place = f"{file}:{line}" if line else str(file)
        raise InputError(f"{place}: {type(error).__name__}: {error}") from None


class _Located:
    """An object of a user's file, whose errors are told with the line of the file."""

    def __init__(self, own: Any, file: Path) -> None:
        self._own, self._file = own, file

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        value = getattr(self._own, name)
        return partial(_call, self._file, value) if callable(value) else value
