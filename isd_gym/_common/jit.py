"""Compilation with numba, kept on disk so that a damaged or missing file means a new compilation and never an error.

numba reads files that were cut short, or whose content changed, without a check: the program ends in an
error of the pickle module, or runs damaged code. Here each file starts with a digest of its content.
"""

from __future__ import annotations

import errno
import hashlib
import pickle
import warnings
from collections.abc import Callable
from typing import Any

import numba as nb
from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile

from .errors import InputError


class _Files(IndexDataCacheFile):
    """Index and data files of a function, the data with a digest."""

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except OSError:
            raise
        except Exception:  # of pickle, of any kind
            return {}

    def _load_data(self, name: str) -> Any:
        path = self._data_path(name)
        with open(path, "rb") as file:
            digest, data = file.read(32), file.read()
        if hashlib.sha256(data).digest() != digest:
            raise OSError(errno.EIO, "damaged", path)  # numba compiles again
        try:
            return pickle.loads(data)
        except (
            ImportError
        ) as error:  # compiled with a law whose module this process has not
            raise OSError(errno.EIO, str(error), path) from error

    def _save_data(self, name: str, data: Any) -> None:
        dumped = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(hashlib.sha256(dumped).digest() + dumped)


class _Kept(FunctionCache):
    """Compiled versions of a function on disk."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        own = self._cache_file
        self._cache_file = _Files(self._cache_path, "", own._source_stamp)
        for name in ("_index_name", "_index_path", "_data_name_pattern"):
            setattr(self._cache_file, name, getattr(own, name))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except OSError:  # an index that cannot be read
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except OSError as error:
            why = error.strerror or error
            warnings.warn(
                f"the compiled kernel cannot be kept in '{self._cache_path}' ({why}); NUMBA_CACHE_DIR names another folder",
                RuntimeWarning,
                stacklevel=2,
            )


_compilations = event.TimingListener()
event.register("numba:compile", _compilations)


def compile_seconds() -> float:
    """Return the time that this process has spent on the compilation of kernels [s]; loading compiled kernels does not count."""
    return float(_compilations.duration) if _compilations.done else 0.0


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function with numba and keeps the result on disk."""

    def decorate(function: Callable[..., Any]) -> Any:
        made = nb.njit(function, **options)
        if made is not function:  # NUMBA_DISABLE_JIT leaves it as it is
            made._cache = _Kept(function)
        return made

    return decorate


def check_compiler() -> None:
    """Check that numba compiles."""
    if nb.config.DISABLE_JIT:  # type: ignore[attr-defined]
        raise InputError(
            "NUMBA_DISABLE_JIT is set, in the environment or in .numba_config.yaml of this folder, but the kernel "
            "runs only compiled: unset NUMBA_DISABLE_JIT"
        )
