"""Registration of the environments: at once if Gymnasium is loaded, otherwise directly after its import.

At the start of Python, `isd_gym_start` puts a finder in front of the imports, which imports this module when
`gymnasium.envs` is imported. Without an installation (a source tree on the path, a zip archive), `import isd_gym` does
the same, and hence ``gymnasium.make("isd_gym:ISDSuspension-v0")``.
"""

from __future__ import annotations

import sys

from .registration import register

TYPE_CHECKING = False  # typing's own import costs 10 ms
if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

#: name of the finder of earlier installations
AT_START = "isd_gym_at_start"


class _AfterGymnasium:
    """A finder that loads ``gymnasium.envs`` as usual and then registers the environments."""

    def find_spec(
        self,
        name: str,
        path: Sequence[str] | None = None,
        target: ModuleType | None = None,
    ) -> ModuleSpec | None:
        return spec_of(name) if name == "gymnasium.envs" else None


def spec_of(name: str) -> ModuleSpec | None:
    """Return the spec of a module that registers the environments after its import; None for an unknown
    module."""
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
    return (
        isinstance(finder, _AfterGymnasium)
        or getattr(finder, "__name__", "") == AT_START
    )


if "gymnasium.envs" in sys.modules:
    register()
else:
    sys.meta_path.insert(0, _AfterGymnasium())
