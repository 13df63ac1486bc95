"""The program `isd-gym` within the process of the tests, where a start of its own takes seconds of imports; what is wrong is refused in one line."""

from __future__ import annotations

import contextlib
import io
import json
import signal
import subprocess
import sys
import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from isd_gym import InputError

if TYPE_CHECKING:
    from pathlib import Path


class Done(NamedTuple):
    """A finished run of the program."""

    returncode: int
    stdout: str
    stderr: str


def run(
    *words: Any, cwd: Path | None = None, env: dict[str, str] | None = None
) -> Done:
    """Return what the program prints and ends with; nothing of the process is changed afterwards.

    A text among the words is a part of a command line.
    """
    from isd_gym._commands import main

    line = ["isd-gym"]
    for word in words:
        line += word.split() if isinstance(word, str) else [str(word)]

    out, err, interrupt = io.StringIO(), io.StringIO(), signal.getsignal(signal.SIGINT)
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        if cwd is not None:
            patch.chdir(cwd)
        for name, value in {"MPLBACKEND": "Agg", **(env or {})}.items():
            patch.setenv(name, value)
        patch.setattr(sys, "argv", line)
        patch.setattr(sys, "unraisablehook", sys.unraisablehook)
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                main()
        except SystemExit as end:
            code = end.code
        finally:
            signal.signal(signal.SIGINT, interrupt)
    return Done(int(code or 0), out.getvalue(), err.getvalue())


def python(
    code: str, *words: Any, cwd: Path | None = None, env: dict[str, str] | None = None
) -> Done:
    """Return what a program of Python prints and ends with, in a process of its own."""
    command = [sys.executable, "-c", code, *map(str, words)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=cwd, env=env
    )
    return Done(done.returncode, done.stdout, done.stderr)


def printed(*words: Any, cwd: Path | None = None) -> str:
    """Return what the program prints, which must end well."""
    done = run(*words, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done.stdout


def read_json(path: Path) -> Any:
    """Return the content of a JSON file."""
    return json.loads(path.read_text(encoding="utf-8"))


def save_json(path: Path, content: Any) -> None:
    """Write a JSON file."""
    path.write_text(json.dumps(content), encoding="utf-8")


def assert_one_line(done: Done, *words: str) -> None:
    """Assert that the program refused its input: status 2, and one line on stderr with these words."""
    assert done.returncode == 2, done.stderr
    assert all(w in done.stderr for w in words), done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr


def refused(words, call, /, *given, **options):
    """Assert that a call ends in an `InputError` of one harmless line with these words (any if none are given), and return the line."""
    with pytest.raises(InputError, match=words or None) as error:
        call(*given, **options)
    text = str(error.value)
    assert text.isprintable() and len(text) < 1500
    return text
