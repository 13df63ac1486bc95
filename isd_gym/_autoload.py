"""Registers the environments when Gymnasium is imported, so that `gymnasium.make` finds them without an import.

Gymnasium 1.0 dropped the entry-point plugins of earlier versions. A one-line .pth file, installed beside the package,
imports this module at start-up; it does nothing but wait for ``gymnasium.envs``.
"""

import sys


class _AfterGymnasium:
    """A finder that lets ``gymnasium.envs`` load as ever and registers the environments right after."""

    def find_spec(self, name, path=None, target=None):
        if name != "gymnasium.envs":
            return None
        import importlib.util

        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            return spec
        run = spec.loader.exec_module

        def exec_module(module):
            run(module)
            from .registration import register

            register()

        spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


if "gymnasium.envs" not in sys.modules:
    sys.meta_path.insert(0, _AfterGymnasium())
