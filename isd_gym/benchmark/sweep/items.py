"""Items of a sweep: on the cores of one machine (joblib), on a Ray cluster, or in shards of a job array.

An item holds the arguments of a function as plain JSON. The result of an item is one file, written atomically, with a
name derived from the item. A repeated call with the same folder skips finished items.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ..._common.errors import InputError, how_to_install
from ..._common.files import claim_folder, write_text
from ..._common.inputs import read_json

SCHEMA = "isd-result/1"
ENGINES = ("local", "ray")
#: arguments of the function by name
Item = Mapping[str, Any]
#: key of an item, its result, and a one-line error; None without an error
Answer = tuple[str, Any, str | None]


def key_of(item: Any) -> str:
    """Return the name of an item, equal on all machines.

    Args:
        item: The item, or other plain data.

    Returns:
        24 hexadecimal digits.
    """
    return hashlib.sha256(json.dumps(item, sort_keys=True).encode()).hexdigest()[:24]


def _content(key: str, item: Any, result: Any) -> dict[str, Any]:
    """Return the content of the file of a result; the digest tells files that were altered."""
    return {
        "schema": SCHEMA,
        "key": key,
        "item": item,
        "result": result,
        "digest": key_of(result),
    }


def stored(items: Sequence[Item], folder: Path) -> dict[str, Any]:
    """Return the results in a folder; broken files are skipped.

    Args:
        items: The items.
        folder: Folder of the results.

    Returns:
        Result by key of an item.
    """
    out = {}
    for key in map(key_of, items):
        try:
            data = read_json(folder / f"{key}.json")
        except InputError:
            continue
        if isinstance(data, dict) and data == _content(
            key, data.get("item"), data.get("result")
        ):
            out[key] = data["result"]
    return out


def shard(items: Sequence[Item], which: str | None) -> list[Item]:
    """Return the items of one job of a job array.

    Args:
        items: All items.
        which: "i/n" with i from 0 to n - 1; None for all items.

    Returns:
        Every n-th item from item i.

    Raises:
        InputError: The shard is invalid or empty.
    """
    if which is None:
        return list(items)
    try:
        i, n = (int(part) for part in which.split("/"))
    except ValueError:
        raise InputError(f"a shard is i/n, such as 0/8, not '{which}'") from None
    if not 0 <= i < n:
        raise InputError(f"shard {which}: i goes from 0 to n - 1")
    if i >= len(items):
        raise InputError(f"shard {which} is empty: there are {len(items)} items")
    return list(items)[i::n]


def run(
    function: Callable[..., Any],
    items: Sequence[Item],
    folder: str | Path,
    *,
    jobs: int = 1,
    engine: str = "local",
    address: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> dict[str, str]:
    """Run all unfinished items; results are files in a folder.

    Args:
        function: Function of the items, which other processes can import.
        items: The items.
        folder: Folder of the results.
        jobs: Number of processes on this machine.
        engine: 'local', or 'ray' for a Ray cluster.
        address: Address of the Ray cluster; None for the cluster of this machine.
        progress: Called with the numbers of finished and of all items.
        say: Called with lines for the user.

    Returns:
        One-line error by key of an item.

    Raises:
        InputError: The folder cannot be written, an argument is invalid, or no cluster answers.
    """
    if engine not in ENGINES:
        raise InputError(f"no engine '{engine}': there are {', '.join(ENGINES)}")
    folder = claim_folder(folder, "folder of results", None, ("*.json",))
    done = stored(items, folder)
    todo = {key: item for item in items if (key := key_of(item)) not in done}
    finished, total = len(done), len(done) + len(todo)
    tell = progress or (lambda finished, total: None)
    tell(finished, total)
    attempt = partial(_attempt, function)
    answers = (
        _local(attempt, todo, jobs)
        if engine == "local"
        else _ray(attempt, todo, address)
    )
    failed: dict[str, str] = {}
    for key, result, error in answers:
        if error is None:
            finished += 1
            write_text(
                folder / f"{key}.json",
                json.dumps(_content(key, todo[key], result)) + "\n",
            )
        else:
            if error not in failed.values():  # reported once for all affected items
                say(f"{_words(todo[key])}: {error}")
            failed[key] = error
        tell(finished, total)
    return failed


def _words(item: Item) -> str:
    return ", ".join(
        f"{k} {v}" for k, v in item.items() if isinstance(v, str | int | float)
    )


def _attempt(
    function: Callable[..., Any], key: str, item: Item, folder: str | None = None
) -> Answer:
    """Return the answer to an item; relative file names belong to `folder`, if that exists on this machine."""
    try:
        if folder is not None and os.path.isdir(folder):
            os.chdir(folder)
        result = function(**item)
        json.dumps(result, allow_nan=False)
    except InputError as error:
        return key, None, str(error)
    except Exception as error:  # the error of an item must not stop other items
        return key, None, f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
    return key, result, None


def _local(
    attempt: Callable[..., Answer], todo: Mapping[str, Item], jobs: int
) -> Iterator[Answer]:
    """Yield the answers, made by the processes of joblib."""
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    calls = (delayed(attempt)(key, item) for key, item in todo.items())
    try:
        yield from Parallel(n_jobs=jobs, return_as="generator_unordered")(calls)
    except TerminatedWorkerError:
        raise InputError(
            "a worker died, perhaps for want of memory; what is done is kept: the same line goes on"
        ) from None


def _ray(
    attempt: Callable[..., Answer], todo: Mapping[str, Item], address: str | None
) -> Iterator[Answer]:
    """Yield the answers, made by a Ray cluster; items of a lost node are given to other nodes."""
    try:
        import ray
    except ImportError:
        raise InputError(
            f"the Ray engine needs Ray: {how_to_install('scale')}"
        ) from None
    _reach(address)
    try:
        ray.init(
            address=address or "auto", log_to_driver=False, logging_level=logging.ERROR
        )
    except Exception as error:  # many reasons for a missing cluster
        text = str(error).splitlines()[0]
        raise InputError(
            f"no Ray cluster at '{address or 'auto'}' ('ray start --head' starts one here): {text}"
        ) from None
    remote = ray.remote(num_cpus=1, max_retries=1)(attempt)
    pending = {remote.remote(key, item, os.getcwd()): key for key, item in todo.items()}
    try:
        while pending:
            (ready,), _ = ray.wait(list(pending), num_returns=1)
            key = pending.pop(ready)
            try:
                yield ray.get(ready)
            except ray.exceptions.RayError as error:
                yield key, None, f"its worker died twice ({type(error).__name__})"
    finally:
        ray.shutdown()


def _reach(address: str | None) -> None:
    """Raise `InputError` if no server answers at host:port; Ray would wait for minutes."""
    host, colon, port = (address or "").rpartition(":")
    if not (colon and port.isdigit()) or "://" in host:
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=10.0).close()
    except (OSError, OverflowError) as error:
        raise InputError(f"no Ray cluster at '{address}': {error}") from None
