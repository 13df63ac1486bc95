"""Makes the environments of isd_gym known to Gymnasium, so that `gymnasium.make("ISDSuspension-v0")` needs no import.

The three files of this folder lie beside the installed package. Python calls `install` at its start: before 3.15 by
`isd_gym.pth`, from 3.15 on by `isd_gym.start` (PEP 829), which turns the line of `isd_gym.pth` off. To keep the start fast,
`install` imports nothing: the finder imports the package when a program imports `gymnasium.envs`.
"""

import sys


class Finder:
    """A finder that registers the environments when `gymnasium.envs` is imported."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        """Return the spec of `gymnasium.envs` that registers the environments; None for other modules."""
        if name != "gymnasium.envs":
            return None
        sys.meta_path[:] = [finder for finder in sys.meta_path if finder is not Finder]
        try:
            from isd_gym.env.autoload import spec_of
        except ImportError:  # the package was deleted, and this file was not
            return None
        return spec_of(name)


def install():
    """Put the finder in front of the others, once."""
    if Finder not in sys.meta_path:
        sys.meta_path.insert(0, Finder)
