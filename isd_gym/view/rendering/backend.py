"""The drawing library pygame-ce, imported as `pygame`, and its display; a missing library or display is an `InputError` of one line."""

from __future__ import annotations

import importlib
import os
import sys
import warnings
from typing import Any

from ..._common.errors import InputError, how_to_install

NO_WINDOW = "cannot open a window: {}; use render_mode='rgb_array', or write a film"


def check_display() -> None:
    """Check, before long work, that a window can be opened."""
    pg = pygame()
    start_display(pg)
    pg.display.quit()


def start_display(pg: Any) -> None:
    """Start the display.

    Without a display SDL may choose a driver that shows nothing. Such a driver is used only where the environment variable
    SDL_VIDEODRIVER names it.
    """
    name = "SDL_VIDEODRIVER"
    choose = sys.platform.startswith("linux") and not os.environ.get(name)
    if choose:
        served = {"x11": "DISPLAY", "wayland": "WAYLAND_DISPLAY"}
        drivers = [
            driver for driver, display in served.items() if os.environ.get(display)
        ]
        if not drivers:
            raise InputError(NO_WINDOW.format("this machine has no display"))
        os.environ[name] = ",".join(drivers)
    try:
        pg.display.init()
    except pg.error as error:
        raise InputError(NO_WINDOW.format(str(error).strip().splitlines()[0])) from None
    finally:
        if choose:
            del os.environ[name]


def extra(module: str, doing: str, package: str) -> Any:
    """Import an optional module."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(
            f"{doing} needs {package}: {how_to_install('render')}"
        ) from None


def pygame() -> Any:
    """Return the module pygame."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    with warnings.catch_warnings():
        # pygame, where it stands in for pygame-ce, warns on import
        warnings.simplefilter("ignore")
        return extra("pygame", "drawing", "pygame-ce")
