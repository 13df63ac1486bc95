"""The program `isd-gym` under its public path. Its commands are in `isd_gym.commands`."""

from .commands import app, main

__all__ = ["app", "main"]

if __name__ == "__main__":
    main()
