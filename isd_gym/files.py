"""Writing files and folders whole or not at all, and never where something of somebody else's lies.

All that is written is made in a workshop, a locked folder ``.isd-gym-…`` beside its place, and takes that place in one
step. A process that is killed leaves its workshop behind; the next process that writes to the same place clears the workshop.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import InputError, shown

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

try:
    import fcntl
except ImportError:  # Windows: workshops of the dead stay until somebody removes them
    fcntl = None  # type: ignore[assignment]

_PREFIX = ".isd-gym-"
_EARLIER = "earlier"


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """A temporary path that takes the place of `path` when the block ends well, and is gone when it does not.

    A link stays one, and what it points to is replaced. A device or pipe (/dev/stdout) is written into, never replaced.
    """
    path = Path(path)
    check_file(path)
    if os.path.islink(path) and os.path.isfile(path) and path.parent != Path("/dev"):
        path = path.resolve()
    elif os.path.exists(path) and not (os.path.isfile(path) and not os.path.islink(path)):
        with tempfile.TemporaryDirectory() as folder:
            temporary = Path(folder) / f"out{path.suffix}"
            yield temporary
            _pour(temporary, path)
        return
    with _workshop(path) as shop:
        yield shop / path.name
        try:
            os.replace(shop / path.name, path)
        except OSError as error:
            raise _cannot(path, error) from None


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to `path` atomically."""
    with whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def whole_folder(path: str | Path, kind: str, mark: str = "", parts: Sequence[str] = ()) -> Iterator[Path]:
    """A temporary folder that takes the place of `path` when the block ends well, and is gone when it does not.

    What stands at `path` may be nothing, an empty folder, or an earlier `kind`: a folder that holds the file `mark` and
    only files and folders that match `parts` (patterns such as ``*.png``), none of them a link; that one is exchanged
    for the new one in a single step. Raises `InputError` for any other.
    """
    path = Path(path)
    check_folder(path, kind, mark, parts)
    make_folder(path.parent)
    with _workshop(path) as shop:
        made = shop / path.name
        made.mkdir()
        yield made
        check_folder(path, kind, mark, parts)  # long work may lie between
        try:
            if not path.exists():
                os.replace(made, path)
            elif not _exchange(made, path):
                (shop / _EARLIER).mkdir()
                os.replace(
                    path, shop / _EARLIER / path.name
                )  # `_clear` puts it back, should we be killed here
                try:
                    os.replace(made, path)
                except OSError:
                    os.replace(shop / _EARLIER / path.name, path)
                    raise
        except OSError as error:
            raise _cannot(path, error) from None


def claim_folder(path: str | Path, kind: str, mark: str | None, parts: Sequence[str]) -> Path:
    """Make the folder `path` for a `kind` that grows in place, under the rule of `whole_folder`; returns it."""
    check_folder(path, kind, mark, parts)
    return make_folder(path)


def make_folder(path: str | Path) -> Path:
    """Make the folder `path` and those above it, where they are not there; returns it. Raises `InputError`."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot(path, error) from None
    return path


@contextmanager
def held(folder: Path, kind: str) -> Iterator[None]:
    """Keep the folder of a `kind` that grows for this process alone; raises `InputError` where another has it."""
    handle = _lock(folder)
    if handle is None and fcntl is not None:
        raise InputError(f"another process is writing the {kind} in '{folder}'")
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


def reserve(folder: Path, size: int) -> None:
    """Raise `InputError` where `size` bytes more cannot be written in `folder`: for libraries that do not survive it."""
    path = folder / ".room"
    try:
        with path.open("wb") as stream:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(stream.fileno(), 0, size)
    except OSError as error:
        raise InputError(
            f"cannot write {size / 1e6:.3g} MB in '{folder.parent.parent}' ({error.strerror})"
        ) from None
    finally:
        with suppress(OSError):
            path.unlink()


def check_file(path: str | Path, *read: str | Path | None) -> None:
    """Raise `InputError` where no file can be written, or where it is one of those that are `read`: before long work, not after it."""
    path = Path(path)
    _nameable(path)
    if not os.path.isdir(path.parent):
        raise InputError(f"cannot write '{path}': no folder '{path.parent}'")
    if os.path.isdir(path):
        raise InputError(f"cannot write '{path}': it is a folder; name a file")
    for source in read:
        if (
            source is not None
            and os.path.isfile(source)
            and os.path.realpath(source) == os.path.realpath(path)
        ):
            raise InputError(f"cannot write '{path}': it is read; give another name")


def check_folder(path: str | Path, kind: str, mark: str | None = "", parts: Sequence[str] = ()) -> None:
    """Raise `InputError` where `whole_folder` would not write, so that long work does not begin in vain.

    Without a `mark` (None) the `parts` alone tell an earlier one.
    """
    path = Path(path)
    _nameable(path)
    if os.path.islink(path) or (os.path.exists(path) and not os.path.isdir(path)):
        raise InputError(f"cannot write a {kind} to '{path}': it is no folder")
    if not path.name or os.path.realpath(path) == os.getcwd():
        raise InputError(f"cannot write a {kind} to '{path}': name a folder of its own")
    if not os.path.isdir(path):
        return
    try:
        there = sorted((p for p in path.iterdir() if not p.name.startswith(_PREFIX)), key=lambda p: p.name)
    except OSError as error:
        raise _cannot(path, error) from None
    if there and mark is not None and mark not in {p.name for p in there}:
        raise InputError(
            f"folder '{path}' is not empty and holds no earlier {kind} (it holds {shown(there[0].name)}); name another"
        )
    for part in there:
        if part.is_symlink():
            raise InputError(
                f"folder '{path}' holds {shown(part.name)}, a link, which is no part of a {kind}; name another"
            )
        if not any(fnmatch(part.name, p) for p in parts):
            raise InputError(
                f"folder '{path}' also holds {shown(part.name)}, which is no part of a {kind}; name another"
            )


# ------------------------------------------------------------------------------------------- the workshop


def _nameable(path: Path) -> None:
    """Raise `InputError` for what no file can be called, or where nobody may look."""
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return  # told better by those who ask
    except OSError as error:
        raise _cannot(path, error) from None
    except ValueError as error:  # a NUL
        raise InputError(f"cannot write {shown(str(path), 200)} ({error})") from None


def _cannot(path: Path, error: OSError) -> InputError:
    return InputError(f"cannot write '{path}' ({error.strerror or error})")


@contextmanager
def _workshop(path: Path) -> Iterator[Path]:
    """A locked folder beside `path`, gone afterwards; those of processes that are gone are cleared first."""
    _clear(path.parent)
    handle = None
    try:
        while True:
            shop = Path(tempfile.mkdtemp(dir=path.parent, prefix=_PREFIX))
            handle = _lock(shop)
            if shop.is_dir():
                break
            if handle is not None:  # somebody cleared it before it was locked
                os.close(handle)
    except OSError as error:
        raise _cannot(path, error) from None
    try:
        yield shop
    finally:
        shutil.rmtree(shop, ignore_errors=True)
        if handle is not None:
            os.close(handle)


def _lock(shop: Path) -> int | None:
    """A handle that holds the lock of a workshop as long as its process lives; None where it cannot be had."""
    if fcntl is None:
        return None
    try:
        handle = os.open(shop, os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY)
    except OSError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    return handle


def _clear(folder: Path) -> None:
    """Remove the workshops that nobody works in, and put back what one of them had taken away."""
    try:
        stale = [p for p in folder.iterdir() if p.name.startswith(_PREFIX)]
    except OSError:
        return
    for shop in stale:
        handle = _lock(shop)
        if handle is None:
            continue
        try:
            for taken in (shop / _EARLIER).iterdir() if (shop / _EARLIER).is_dir() else ():
                if not (folder / taken.name).exists():
                    os.replace(taken, folder / taken.name)
            shutil.rmtree(shop, ignore_errors=True)
        except OSError:
            pass  # it is in nobody's way
        finally:
            os.close(handle)


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two folders in one step; False where the system or the file system cannot."""
    import ctypes

    calls = {"linux": ("renameat2", True), "darwin": ("renamex_np", False)}
    if sys.platform not in calls:
        return False
    name, at = calls[sys.platform]
    try:
        call = getattr(ctypes.CDLL(None, use_errno=True), name)
    except (OSError, AttributeError):
        return False
    first, second = os.fsencode(one.absolute()), os.fsencode(other.absolute())
    swap, here = ctypes.c_uint(2), ctypes.c_int(-100)  # RENAME_EXCHANGE, RENAME_SWAP; AT_FDCWD
    return call(*((here, first, here, second, swap) if at else (first, second, swap))) == 0


def _pour(source: Path, target: Path) -> None:
    try:
        with source.open("rb") as have, target.open("wb") as into:
            shutil.copyfileobj(have, into)
    except OSError as error:
        raise _cannot(target, error) from None
