"""Atomic writing of files and folders, without overwriting foreign content.

All output is prepared in a workshop, a locked folder ``.isd-gym-…`` beside the target, and takes the target's
place in one step. A killed process leaves its workshop behind; the next process that writes to the same place
removes the workshop.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path

from .errors import InputError, shown

try:
    import fcntl
except (
    ImportError
):  # Windows: workshops of killed processes stay until a user removes the folders
    fcntl = None  # type: ignore[assignment]

_PREFIX = ".isd-gym-"
_EARLIER = "earlier"


@contextmanager
def writing(path: str | Path, place: str | Path) -> Iterator[None]:
    """Name the result in errors of the system: those of a full disk name no file."""
    try:
        yield
    except BrokenPipeError:  # the reader of stdout has gone
        raise
    except OSError as error:
        named = [
            Path(os.fsdecode(name))
            for name in (error.filename, error.filename2)
            if name is not None
        ]
        if named and not any(Path(place) in file.parents for file in named):
            raise  # a file that is read meanwhile
        raise _cannot(Path(path), error) from None


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Give a temporary path that replaces `path` when the block succeeds, and is deleted when the block fails.

    A symbolic link is kept and its target is replaced. A device or pipe (/dev/stdout) receives the content
    and is never replaced.
    """
    path = Path(path)
    check_file(path)
    if os.path.islink(path) and os.path.isfile(path) and path.parent != Path("/dev"):
        path = path.resolve()
    elif os.path.exists(path) and not (
        os.path.isfile(path) and not os.path.islink(path)
    ):
        with tempfile.TemporaryDirectory() as folder:
            temporary = Path(folder) / f"out{path.suffix}"
            with writing(folder, folder):
                yield temporary
            _pour(temporary, path)
        return
    with _workshop(path) as shop:
        with writing(path, shop):
            yield shop / path.name
        try:
            _take_over(path, shop / path.name)
            os.replace(shop / path.name, path)
        except OSError as error:
            raise _cannot(path, error) from None


def _take_over(earlier: Path, made: Path) -> None:
    """Give a file mode and owner of the file that it replaces, if there is one."""
    if not earlier.exists():
        return
    held, new = earlier.stat(), made.stat()
    if hasattr(os, "chown") and (held.st_uid, held.st_gid) != (new.st_uid, new.st_gid):
        with suppress(PermissionError):  # only the administrator may give files away
            os.chown(made, held.st_uid, held.st_gid)
    shutil.copymode(earlier, made)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file atomically."""
    with whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def whole_folder(
    path: str | Path, kind: str, mark: str = "", parts: Sequence[str] = ()
) -> Iterator[Path]:
    """Give a temporary folder that replaces `path` when the block succeeds, and is deleted when the block fails.

    The path may be free, an empty folder, or an earlier result of the same kind. An earlier result holds the
    file `mark`, and otherwise only files and folders that match `parts`, without links; the earlier result is
    exchanged in a single step.
    """
    path = Path(path)
    check_folder(path, kind, mark, parts)
    make_folder(path.parent)
    with _workshop(path) as shop:
        made = shop / path.name
        with writing(path, shop):
            made.mkdir()
            yield made
        # the folder may have changed during a long computation
        check_folder(path, kind, mark, parts)
        try:
            if not path.exists():
                os.replace(made, path)
            elif not _exchange(made, path):
                (shop / _EARLIER).mkdir()
                # `_clear` restores the earlier folder after a kill at this point
                os.replace(path, shop / _EARLIER / path.name)
                try:
                    os.replace(made, path)
                except OSError:
                    os.replace(shop / _EARLIER / path.name, path)
                    raise
        except OSError as error:
            raise _cannot(path, error) from None


def claim_folder(
    path: str | Path, kind: str, mark: str | None, parts: Sequence[str]
) -> Path:
    """Create a folder for a result that grows in place, under the rules of `whole_folder`."""
    check_folder(path, kind, mark, parts)
    return make_folder(path)


def make_folder(path: str | Path) -> Path:
    """Create a folder and its missing parents."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot(path, error) from None
    return path


def check_file(path: str | Path, *read: str | Path | None) -> None:
    """Check before long work that a file can be written."""
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
            raise InputError(
                f"cannot write '{path}': it is an input file; give another name"
            )


def check_folder(
    path: str | Path, kind: str, mark: str | None = "", parts: Sequence[str] = ()
) -> None:
    """Check before long work that `whole_folder` would write; with `mark` None, an earlier result is recognised by `parts` alone."""
    path = Path(path)
    _nameable(path)
    if os.path.islink(path) or (os.path.exists(path) and not os.path.isdir(path)):
        raise InputError(f"cannot write a {kind} to '{path}': it is not a folder")
    if not path.name or os.path.realpath(path) == os.getcwd():
        raise InputError(f"cannot write a {kind} to '{path}': name a folder of its own")
    if not os.path.isdir(path):
        return
    try:
        there = sorted(
            (p for p in path.iterdir() if not p.name.startswith(_PREFIX)),
            key=lambda p: p.name,
        )
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
    """Raise `InputError` for a name that is impossible or not accessible."""
    try:
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return  # callers give a better message
    except OSError as error:
        raise _cannot(path, error) from None
    except ValueError as error:  # a NUL
        raise InputError(f"cannot write {shown(str(path), 200)} ({error})") from None


def _cannot(path: Path, error: OSError) -> InputError:
    return InputError(f"cannot write '{path}' ({error.strerror or error})")


@contextmanager
def _workshop(path: Path) -> Iterator[Path]:
    """Give a locked folder beside `path` that is deleted afterwards; workshops of killed processes are cleared first."""
    _clear(path.parent)
    handle = None
    try:
        while True:
            shop = Path(tempfile.mkdtemp(dir=path.parent, prefix=_PREFIX))
            handle = lock(shop)
            if shop.is_dir():
                break
            if handle is not None:  # another process cleared the folder before the lock
                os.close(handle)
    except OSError as error:
        raise _cannot(path, error) from None
    try:
        yield shop
    finally:
        shutil.rmtree(shop, ignore_errors=True)
        if handle is not None:
            os.close(handle)


def lock(shop: Path) -> int | None:
    """Return a handle that locks a workshop for the life of this process, or None without a lock."""
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
    """Remove abandoned workshops, and restore an earlier folder that an abandoned workshop had moved."""
    try:
        stale = [p for p in folder.iterdir() if p.name.startswith(_PREFIX)]
    except OSError:
        return
    for shop in stale:
        handle = lock(shop)
        if handle is None:
            continue
        try:
            for taken in (
                (shop / _EARLIER).iterdir() if (shop / _EARLIER).is_dir() else ()
            ):
                if not (folder / taken.name).exists():
                    os.replace(taken, folder / taken.name)
            shutil.rmtree(shop, ignore_errors=True)
        except OSError:
            pass  # an abandoned folder does no harm
        finally:
            os.close(handle)


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two folders in one step; return False if the system or the file system cannot."""
    import ctypes

    calls = {"linux": ("renameat2", True), "darwin": ("renamex_np", False)}
    if sys.platform not in calls:
        return False
    name, at = calls[sys.platform]
    try:
        call = getattr(ctypes.CDLL(None, use_errno=True), name)
    except (OSError, AttributeError):
        return False
    first = os.fsencode(one.absolute())
    second = os.fsencode(other.absolute())
    # RENAME_EXCHANGE, RENAME_SWAP; AT_FDCWD
    swap, here = (
        ctypes.c_uint(2),
        ctypes.c_int(-100),
    )
    return (
        call(*((here, first, here, second, swap) if at else (first, second, swap))) == 0
    )


def _pour(source: Path, target: Path) -> None:
    try:
        with source.open("rb") as have, target.open("wb") as into:
            shutil.copyfileobj(have, into)
    except OSError as error:
        raise _cannot(target, error) from None
