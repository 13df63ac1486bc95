"""Reading of untrusted files: regular files of bounded size, JSON of bounded depth, finite numbers.

All content of files passes through this module or through `data`. A pipe, a decompression bomb or a number of
five thousand digits then gives a one-line error instead of a traceback.
"""

from __future__ import annotations

import json
import math
import os
import stat
import sys
from pathlib import Path
from typing import Any

from .errors import InputError, shown

#: environment variable that raises the limit on the memory of a file's content
LIMIT_VARIABLE = "ISD_GYM_READ_LIMIT_GB"
DEFAULT_LIMIT_GB = 1.0
JSON_LIMIT = 32 * 2**20  # bytes
DEPTH = 32  # nesting levels of lists and objects
DIGITS = 300  # digits of an integer in JSON that fits a float


def memory_limit() -> int:
    """Return the number of bytes that the content of one file may occupy: 1 GB, or `ISD_GYM_READ_LIMIT_GB`."""
    text = os.environ.get(LIMIT_VARIABLE)
    if text is None:
        return int(DEFAULT_LIMIT_GB * 2**30)
    try:
        size = float(text)
    except ValueError:
        size = math.nan
    if not 0 < size < 1e6:
        raise InputError(
            f"{LIMIT_VARIABLE} must be a number of gigabytes > 0, not {shown(text)}"
        )
    return int(size * 2**30)


def too_large(where: str, size: float, limit: float) -> InputError:
    """Return the error for content beyond the memory limit."""
    return InputError(
        f"{where}: would take {size / 2**30:.3g} GB, the limit is {limit / 2**30:.3g} (raise it with {LIMIT_VARIABLE})"
    )


def check_memory(size: float, what: str, remedy: str) -> None:
    """Check before long work that its arrays fit into the memory of this machine."""
    try:
        there = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):  # a system that does not tell
        there = 16.0 * 2**30
    if not size < there:
        raise InputError(
            f"{what} would take {size / 2**30:.3g} GB of memory, of {there / 2**30:.3g}: {remedy}"
        )


def plain_file(path: str | Path) -> int:
    """Return the size of a regular file."""
    try:
        found = os.stat(path)
    except (OSError, ValueError) as error:
        missing = isinstance(error, FileNotFoundError | NotADirectoryError | ValueError)
        why = "no such file" if missing else f"cannot be read ({error.strerror})"  # type: ignore[union-attr]
        raise InputError(f"{path}: {why}") from None
    if stat.S_ISDIR(found.st_mode):
        raise InputError(f"{path}: is a folder, not a file")
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: is a pipe or a device, not a file")
    return found.st_size


def read_bytes(path: str | Path, limit: int = JSON_LIMIT) -> bytes:
    """Return the content of a regular file of limited size."""
    size = plain_file(path)
    if size > limit:
        raise InputError(
            f"{path}: has {size / 2**20:.4g} MB, at most {limit / 2**20:.4g} are read"
        )
    try:
        with open(path, "rb") as stream:
            data = stream.read(limit + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if len(data) > limit:  # the file grew meanwhile, or its reported size was 0 (/proc)
        raise InputError(f"{path}: more than {limit / 2**20:.4g} MB")
    return data


def parse_json(data: bytes | str, where: str) -> Any:
    """Return the content of a JSON text, without its byte order mark."""
    try:
        text = (
            data.decode("utf-8-sig")
            if isinstance(data, bytes)
            else data.removeprefix("\ufeff")
        )
    except UnicodeDecodeError as error:
        raise InputError(
            f"{where}: not JSON (byte {error.start} is no UTF-8)"
        ) from None

    def whole(digits: str) -> int:
        if len(digits) > DIGITS:
            raise InputError(f"{where}: a number of {len(digits)} digits")
        return int(digits)

    def real(digits: str) -> float:
        value = float(digits)
        if math.isinf(value):
            raise InputError(f"{where}: the number {shown(digits, 20)} is too large")
        return value

    def constant(name: str) -> Any:
        raise InputError(f"{where}: {name} is no number")

    def single(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(
                f"{where}: an object has the key {shown(twice)} twice: delete or rename one"
            )
        return found

    try:
        found = json.loads(
            text,
            parse_int=whole,
            parse_float=real,
            parse_constant=constant,
            object_pairs_hook=single,
        )
    except json.JSONDecodeError as error:
        raise InputError(
            f"{where}: not JSON, line {error.lineno}: {error.msg}"
        ) from None
    except RecursionError:
        raise InputError(f"{where}: more than {DEPTH} nested levels") from None
    _check_tree(found, where)
    return found


def _check_tree(found: Any, where: str) -> None:
    level = [found]
    for _ in range(DEPTH):
        below: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                below += value
                below += value.values()
            elif isinstance(value, list):
                below += value
            elif isinstance(value, str) and not value.isascii():
                try:
                    value.encode()
                except UnicodeEncodeError:
                    raise InputError(
                        f"{where}: {shown(value)} is no Unicode text"
                    ) from None
        if not below:
            return
        level = below
    raise InputError(f"{where}: more than {DEPTH} nested levels")


def read_json(path: str | Path, where: str | None = None) -> Any:
    """Return the content of a JSON file."""
    return parse_json(read_bytes(path), where or str(path))


def is_number(value: Any) -> bool:
    """Return whether a value is a finite number; truth values are not numbers."""
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and abs(value) <= sys.float_info.max
    )


def is_whole(value: Any, least: int, most: float = math.inf) -> bool:
    """Return whether a value is a whole number within limits; truth values and NumPy's whole numbers are none."""
    return (
        isinstance(value, int)
        and not isinstance(value, bool)
        and least <= value <= most
    )


def number(value: Any, where: str) -> float:
    """Return a value as a finite float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where} must be a number, not {shown(value)}")
    if not is_number(value):
        raise InputError(f"{where} must be finite, not {shown(value)}")
    return float(value)
