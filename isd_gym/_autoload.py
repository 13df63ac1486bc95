"""Registers the environments: at once where Gymnasium is loaded, else right after it, so that no import is needed.

Gymnasium 1.0 dropped the entry-point plugins of earlier versions. A one-line .pth file, installed beside the package, puts a
finder in front of the imports when Python starts. The line imports nothing, since it runs whenever Python starts: the finder
imports this module when ``gymnasium.envs`` is imported. Where there is no installation (a source tree on the path, a zip, a
worker's folder), `import isd_gym` does, and with it ``gymnasium.make("isd_gym:ISDSuspension-v0")``.
"""

from __future__ import annotations

import sys

from .registration import register

TYPE_CHECKING = False  # typing's own import costs 10 ms
if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

#: name of the finder that the .pth file puts in front
AT_START = "isd_gym_at_start"


class _AfterGymnasium:
    """A finder that lets ``gymnasium.envs`` load as ever and registers the environments right after."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return spec_of(name) if name == "gymnasium.envs" else None


def spec_of(name: str) -> ModuleSpec | None:
    """Return the spec of a module that registers the environments once the module is loaded; None for an unknown module.

    Args:
        name: Name of the module, ``gymnasium.envs``.
    """
    from importlib.util import find_spec

    sys.meta_path[:] = [f for f in sys.meta_path if not _is_own(f)]
    spec = find_spec(name)
    if spec is None or spec.loader is None:
        return spec
    run = spec.loader.exec_module

    def exec_module(module: ModuleType) -> None:
        run(module)
        register()

    spec.loader.exec_module = exec_module  # type: ignore[method-assign]
    return spec


def _is_own(finder: object) -> bool:
    return isinstance(finder, _AfterGymnasium) or getattr(finder, "__name__", "") == AT_START


if "gymnasium.envs" in sys.modules:
    register()
else:
    sys.meta_path.insert(0, _AfterGymnasium())
