"""Writing files and folders whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path

from .errors import InputError


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place when the block ends well, and is gone when it does not.

    A link stays one, and what it points to is replaced. A device or pipe (/dev/stdout) is written into, never replaced.
    """
    path = Path(path)
    check_file(path)
    if path.is_symlink() and path.is_file() and path.parent != Path("/dev"):
        path = path.resolve()
    elif path.exists() and not (path.is_file() and not path.is_symlink()):
        with tempfile.TemporaryDirectory() as folder:
            temporary = Path(folder) / f"out{path.suffix}"
            yield temporary
            _pour(temporary, path)
        return
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    except OSError as error:
        raise InputError(f"cannot write '{path}' ({error.strerror})") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _pour(source: Path, target: Path) -> None:
    try:
        with source.open("rb") as have, target.open("wb") as into:
            shutil.copyfileobj(have, into)
    except OSError as error:
        raise InputError(f"cannot write '{target}' ({error.strerror})") from None


def check_file(path: str | Path) -> None:
    """Raise `InputError` where no file can be written: before long work, not after it."""
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(f"cannot write '{path}': no folder '{path.parent}'")
    if path.is_dir():
        raise InputError(f"cannot write '{path}': it is a folder; name a file")


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to `path` atomically."""
    with whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def whole_folder(path: str | Path, kind: str, mark: str, parts: Sequence[str]) -> Iterator[Path]:
    """A temporary folder beside `path` that takes its place when the block ends well, and is gone when it does not.

    What stands at `path` may be nothing, an empty folder, or an earlier `kind`: a folder that holds the file `mark` and
    only files that match `parts` (patterns such as ``*.png``); that one is replaced. Raises `InputError` for any other.
    """
    path = Path(path)
    check_folder(path, kind, mark, parts)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}-"))
    except OSError as error:
        raise InputError(f"cannot write '{path}' ({error.strerror})") from None
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o777 & ~mask)
        check_folder(path, kind, mark, parts)  # long work may lie between
        try:
            if path.exists():
                earlier = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}-"))
                os.replace(path, earlier)
                try:
                    os.replace(temporary, path)
                except OSError:
                    os.replace(earlier, path)
                    raise
                shutil.rmtree(earlier, ignore_errors=True)
            else:
                os.replace(temporary, path)
        except OSError as error:
            raise InputError(f"cannot write '{path}' ({error.strerror})") from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def check_folder(path: str | Path, kind: str, mark: str, parts: Sequence[str]) -> None:
    """Raise `InputError` where `whole_folder` would not write, so that long work does not begin in vain."""
    path = Path(path)
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        raise InputError(f"cannot write a {kind} to '{path}': it is no folder")
    if not path.name or path.resolve() == Path.cwd():
        raise InputError(f"cannot write a {kind} to '{path}': name a folder of its own")
    if not path.is_dir():
        return
    there = sorted(p.name for p in path.iterdir())
    strange = [n for n in there if not any(fnmatch(n, p) for p in parts)]
    if there and mark not in there:
        raise InputError(
            f"folder '{path}' is not empty and holds no earlier {kind} (it holds {there[0]}); name another"
        )
    if strange:
        raise InputError(
            f"folder '{path}' also holds {strange[0]}, which is no part of a {kind}; name another"
        )
