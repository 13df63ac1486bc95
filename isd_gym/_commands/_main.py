"""The entry of the program: exit status and one-line messages for bad input and interrupts."""

from __future__ import annotations

import os
import sys
import warnings
from typing import Any, TextIO

import typer

from .._common.errors import InputError, TyreContactWarning, plain
from ._app import app
from ._streams import prepare_streams


def main() -> None:
    """Run the command line. Bad input gives one line on stderr and exit status 2, Ctrl-C gives 130."""
    prepare_streams()
    os.environ["MPLBACKEND"] = (
        "Agg"  # pages need no window; a notebook's own backend may not be installed here
    )
    stopped = _listen()
    warnings.showwarning = _warn
    try:
        code = app(prog_name="isd-gym", standalone_mode=False)
        sys.stdout.flush()
    except InputError as error:
        typer.echo(f"isd-gym: {error}", err=True)
        code = 2
    except KeyboardInterrupt:
        code = 130
    except OSError as error:
        code = 130 if stopped else _broken(error)
    except Exception as error:
        if stopped:  # an error of the compiler after its callback was interrupted
            code = 130
        elif "cannot cache function" in str(
            error
        ):  # installed read-only, and the user has no home
            typer.echo(
                "isd-gym: no folder for the compiled kernel: set NUMBA_CACHE_DIR to a writable folder",
                err=True,
            )
            code = 2
        elif type(error).__module__.startswith("yaml.") and os.path.exists(
            ".numba_config.yaml"
        ):
            typer.echo(
                "isd-gym: numba cannot read .numba_config.yaml in this folder: correct or remove it",
                err=True,
            )
            code = 2
        elif hasattr(error, "format_message"):  # an error of the command line's parser
            code = _explain(error)
        else:
            raise
    if code == 130:
        typer.echo("isd-gym: stopped", err=True)
    sys.exit(code)


def _warn(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print a warning on stderr. Warnings about the tyre contact take one line; other warnings keep Python's format."""
    if issubclass(category, TyreContactWarning):
        typer.echo(f"isd-gym: {message}", err=True)
    else:
        (file or sys.stderr).write(
            warnings.formatwarning(message, category, filename, lineno, line)
        )


def _broken(error: OSError) -> int:
    """Return the exit status for an error of the system, printed as one line. A closed pipe prints nothing."""
    if not isinstance(error, BrokenPipeError):
        name = f": '{error.filename}'" if error.filename else ""
        typer.echo(
            f"isd-gym: {plain(f'{error.strerror or error}{name}', 400)}", err=True
        )
    # the reader of stdout has gone
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 1


def _listen() -> list[int]:
    """Watch for Ctrl-C, also where a callback of the compiler swallows the interrupt."""
    import signal
    import threading
    from _thread import interrupt_main

    stopped: list[int] = []
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return stopped  # a shell ignores the interrupt of background jobs

    def stop(number: int, frame: Any) -> None:
        stopped.append(number)
        raise KeyboardInterrupt

    def repeat() -> None:
        if hasattr(signal, "pthread_kill"):  # also wakes a sleeping thread
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        else:
            interrupt_main()

    usual = sys.unraisablehook

    def swallowed(unraisable: Any) -> None:
        if not stopped:
            usual(unraisable)
        elif isinstance(unraisable.exc_value, KeyboardInterrupt):
            again = threading.Timer(0.2, repeat)  # out of the callback
            again.daemon = True
            again.start()

    signal.signal(signal.SIGINT, stop)
    sys.unraisablehook = swallowed
    return stopped


def _explain(error: Any) -> int:
    """Print the error of a command line in one line, or the help where no command was given."""
    context = getattr(error, "ctx", None)
    text = " ".join(error.format_message().split())
    if not sys.argv[1:]:
        error.show()
    else:
        known = {
            c.name or getattr(c.callback, "__name__", "")
            for c in app.registered_commands
        }
        path = " ".join(["isd-gym", *(a for a in sys.argv[1:2] if a in known)])
        path = context.command_path if context is not None else path
        typer.echo(f"{path}: {plain(text, 400)} (see {path} --help)", err=True)
    return int(error.exit_code)
