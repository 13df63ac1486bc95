"""Reading what others made: plain files of bounded size, JSON of bounded depth, numbers that are numbers.

Everything that comes from a file passes through here or through `data`, so that a pipe, a bomb or a number of five
thousand digits is one line and not a traceback.
"""

from __future__ import annotations

import json
import math
import os
import stat
import sys
from typing import TYPE_CHECKING, Any

from .errors import InputError, shown

if TYPE_CHECKING:
    from pathlib import Path

#: environment variable that raises the limit on what a file may take in memory
LIMIT_VARIABLE = "ISD_GYM_READ_LIMIT_GB"
DEFAULT_LIMIT_GB = 1.0
JSON_LIMIT = 32 * 2**20  # bytes
DEPTH = 32  # of lists and objects within each other
DIGITS = 300  # of a whole number in JSON: what a float can hold


def memory_limit() -> int:
    """Bytes that the content of one file may take in memory; `ISD_GYM_READ_LIMIT_GB` says otherwise. Raises `InputError`."""
    text = os.environ.get(LIMIT_VARIABLE)
    if text is None:
        return int(DEFAULT_LIMIT_GB * 2**30)
    try:
        size = float(text)
    except ValueError:
        size = math.nan
    if not 0 < size < 1e6:
        raise InputError(f"{LIMIT_VARIABLE} must be a number of gigabytes > 0, not {shown(text)}")
    return int(size * 2**30)


def too_large(where: str, size: float, limit: float) -> InputError:
    """The line for what would take more than the limit (both in bytes)."""
    return InputError(
        f"{where}: would take {size / 2**30:.3g} GB, the limit is {limit / 2**30:.3g} (raise it with {LIMIT_VARIABLE})"
    )


def plain_file(path: str | Path) -> int:
    """Size [bytes] of the plain file at `path`; raises `InputError` where it is missing, a folder, a pipe or a device."""
    try:
        found = os.stat(path)
    except (OSError, ValueError) as error:
        missing = isinstance(error, FileNotFoundError | NotADirectoryError | ValueError)
        why = "no such file" if missing else f"cannot be read ({error.strerror})"  # type: ignore[union-attr]
        raise InputError(f"{path}: {why}") from None
    if stat.S_ISDIR(found.st_mode):
        raise InputError(f"{path}: it is a folder")
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: is a pipe or a device, not a file")
    return found.st_size


def read_bytes(path: str | Path, limit: int = JSON_LIMIT) -> bytes:
    """The bytes of a plain file of at most `limit` bytes; raises `InputError`."""
    size = plain_file(path)
    if size > limit:
        raise InputError(f"{path}: has {size / 2**20:.4g} MB, at most {limit / 2**20:.4g} are read")
    try:
        with open(path, "rb") as stream:
            data = stream.read(limit + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if len(data) > limit:  # it grew meanwhile, or its size was not told (/proc)
        raise InputError(f"{path}: more than {limit / 2**20:.4g} MB")
    return data


def parse_json(data: bytes | str, where: str) -> Any:
    """What the JSON text in `data` says; `where` begins the message of the `InputError`.

    A byte order mark is passed over. Refused are NaN and infinity, whole numbers that no float holds, more than
    `DEPTH` levels, and text that is no Unicode (lone surrogates).
    """
    try:
        text = data.decode("utf-8-sig") if isinstance(data, bytes) else data.removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: not JSON (byte {error.start} is no UTF-8)") from None

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

    try:
        found = json.loads(text, parse_int=whole, parse_float=real, parse_constant=constant)
    except json.JSONDecodeError as error:
        raise InputError(f"{where}: not JSON, line {error.lineno}: {error.msg}") from None
    except RecursionError:
        raise InputError(f"{where}: more than {DEPTH} levels within each other") from None
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
                    raise InputError(f"{where}: {shown(value)} is no Unicode text") from None
        if not below:
            return
        level = below
    raise InputError(f"{where}: more than {DEPTH} levels within each other")


def read_json(path: str | Path, where: str | None = None, limit: int = JSON_LIMIT) -> Any:
    """The content of a JSON file; see `read_bytes` and `parse_json`."""
    return parse_json(read_bytes(path, limit), where or str(path))


def is_number(value: Any) -> bool:
    """Whether `value` is a number that a float holds, finite; truth values are none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def number(value: Any, where: str) -> float:
    """`value` as a finite float; raises `InputError` for everything else, truth values among it."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where} must be a number, not {shown(value)}")
    if not is_number(value):
        raise InputError(f"{where} must be finite, not {shown(value)}")
    return float(value)
