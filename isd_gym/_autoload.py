"""Registers the environments: at once where Gymnasium is loaded, else right after it, so that no import is needed.

Gymnasium 1.0 dropped the entry-point plugins of earlier versions. A one-line .pth file, installed beside the package,
imports this module at start-up; where there is no installation (a source tree on the path, a zip, a worker's folder),
`import isd_gym` does, and with it ``gymnasium.make("isd_gym:ISDSuspension-v0")``.
"""

from __future__ import annotations

import sys

from .registration import register

TYPE_CHECKING = False  # nothing that costs time: this runs whenever Python starts
if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType


class _AfterGymnasium:
    """A finder that lets ``gymnasium.envs`` load as ever and registers the environments right after."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name != "gymnasium.envs":
            return None
        from importlib.util import find_spec

        sys.meta_path.remove(self)
        spec = find_spec(name)
        if spec is None or spec.loader is None:
            return spec
        run = spec.loader.exec_module

        def exec_module(module: ModuleType) -> None:
            run(module)
            register()

        spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


if "gymnasium.envs" in sys.modules:
    register()
else:
    sys.meta_path.insert(0, _AfterGymnasium())
