"""Independent items of a sweep: on the cores of one machine (joblib), on a Ray cluster, or in shards of a job array.

A `Task` names a function and its arguments as plain JSON, and can be sent to any process or machine. Its
result is one file, written atomically, with a name derived from the task. A repeated call with the same
folder skips finished tasks.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import logging
import os
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..._common.errors import InputError, how_to_install
from ..._common.files import claim_folder, write_text
from ..._common.inputs import read_json

if TYPE_CHECKING:
    from pathlib import Path

SCHEMA = "isd-result/1"
ENGINES = ("local", "ray")


@dataclass(frozen=True)
class Task:
    """A function call; arguments and result are plain JSON.

    Attributes:
        function: "package.module:name".
        arguments: Arguments by name.
    """

    function: str
    arguments: Mapping[str, Any]

    @property
    def key(self) -> str:
        """Name of the task, equal on all machines."""
        text = json.dumps([self.function, self.arguments], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:24]

    def call(self) -> Any:
        """Call the function in this process.

        Returns:
            Result of the function.
        """
        module, _, name = self.function.partition(":")
        return getattr(importlib.import_module(module), name)(**self.arguments)


@dataclass
class Outcome:
    """Results and errors of tasks.

    Attributes:
        results: Result by key of a task.
        failed: One-line error by key of a task.
    """

    results: dict[str, Any] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)


#: tells whether the content of a file is a result of the task
Sound = Callable[[Task, Any], bool]


def _any(task: Task, result: Any) -> bool:
    return True


def stored(tasks: Sequence[Task], folder: Path, sound: Sound = _any) -> dict[str, Any]:
    """Return the results in a folder; broken files and implausible results are skipped.

    Args:
        tasks: The tasks.
        folder: Folder of the results.
        sound: Tells whether a result is plausible for a task.

    Returns:
        Result by key of a task.
    """
    out = {}
    for task in tasks:
        try:
            data = read_json(folder / f"{task.key}.json")
            if data["schema"] == SCHEMA and data["key"] == task.key and sound(task, data["result"]):
                out[task.key] = data["result"]
        except (ValueError, KeyError, TypeError, AttributeError):  # includes InputError
            continue
    return out


def shard(tasks: Sequence[Task], which: str | None) -> list[Task]:
    """Return the tasks of one job of a job array.

    Args:
        tasks: All tasks.
        which: "i/n" with i from 0 to n - 1; None for all tasks.

    Returns:
        Every n-th task from task i.

    Raises:
        InputError: The shard is invalid or empty.
    """
    if which is None:
        return list(tasks)
    try:
        i, n = (int(part) for part in which.split("/"))
    except ValueError:
        raise InputError(f"a shard is i/n, such as 0/8, not '{which}'") from None
    if not 0 <= i < n:
        raise InputError(f"shard {which}: i goes from 0 to n - 1")
    if i >= len(tasks):
        raise InputError(f"shard {which} is empty: there are {len(tasks)} items")
    return list(tasks)[i::n]


def run(
    tasks: Sequence[Task],
    folder: str | Path,
    *,
    jobs: int = 1,
    engine: str = "local",
    address: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    say: Callable[[str], None] = lambda line: None,
    sound: Sound = _any,
) -> Outcome:
    """Run all unfinished tasks; results are files in a folder.

    Args:
        tasks: The tasks.
        folder: Folder of the results.
        jobs: Number of processes on this machine.
        engine: 'local', or 'ray' for a Ray cluster.
        address: Address of the Ray cluster; "auto" for the cluster of this machine.
        progress: Called with the numbers of finished and of all tasks.
        say: Called with lines for the user.
        sound: Tells whether a stored result is plausible for a task.

    Returns:
        Results and errors.

    Raises:
        InputError: The folder cannot be written, an argument is invalid, or no cluster answers.
    """
    if engine not in ENGINES:
        raise InputError(f"no engine '{engine}': there are {', '.join(ENGINES)}")
    if jobs < 1:
        raise InputError(f"jobs must be at least 1, not {jobs}")
    folder = claim_folder(folder, "folder of results", None, ("*.json",))
    out = Outcome(stored(tasks, folder, sound))
    todo = [task for task in {t.key: t for t in tasks}.values() if task.key not in out.results]
    total = len(out.results) + len(todo)
    if progress is not None:
        progress(len(out.results), total)
    source = _local(todo, jobs) if engine == "local" else _ray(todo, address)
    told: set[str] = set()
    for task, answer in source:
        if answer.error is None:
            out.results[task.key] = answer.result
            out.failed.pop(task.key, None)
            head: dict[str, Any] = {"schema": SCHEMA, "key": task.key, "function": task.function}
            head |= {
                "arguments": dict(task.arguments),
                "host": answer.host,
                "seconds": round(answer.seconds, 3),
            }
            write_text(folder / f"{task.key}.json", json.dumps({**head, "result": answer.result}) + "\n")
        else:
            out.failed[task.key] = answer.error
            if answer.error not in told:  # reported once for all affected tasks
                told.add(answer.error)
                say(f"{_words(task)}: {answer.error}")
        if progress is not None:
            progress(len(out.results), total)
    return out


def _words(task: Task) -> str:
    return ", ".join(f"{k} {v}" for k, v in task.arguments.items() if isinstance(v, str | int | float))


@dataclass(frozen=True)
class Answer:
    """Outcome of a task.

    Attributes:
        result: Result; None after an error.
        error: One-line error; None after success.
        seconds: Duration [s].
        host: Name of the machine.
    """

    result: Any = None
    error: str | None = None
    seconds: float = 0.0
    host: str = ""


def answer(function: str, arguments: Mapping[str, Any], folder: str | None = None) -> Answer:
    """Run a task in this process; errors become part of the answer.

    Args:
        function: "package.module:name".
        arguments: Arguments by name.
        folder: Folder of relative file names in the arguments, if the folder exists on this machine.

    Returns:
        The answer.
    """
    begin = time.perf_counter()
    try:
        if folder is not None and os.path.isdir(folder):
            os.chdir(folder)
        result = Task(function, arguments).call()
        json.dumps(result, allow_nan=False)
    except Exception as error:  # the error of a task must not stop other tasks
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        own = isinstance(error, InputError)
        return Answer(error=text if own else f"{type(error).__name__}: {text}")
    return Answer(result, None, time.perf_counter() - begin, socket.gethostname())


def _call(task: Task, folder: str | None = None) -> tuple[Task, Answer]:
    return task, answer(task.function, task.arguments, folder)


def _local(todo: Sequence[Task], jobs: int) -> Iterator[tuple[Task, Answer]]:
    """Yield tasks with their answers, run by the processes of joblib."""
    if jobs == 1:
        yield from map(_call, todo)
        return
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    calls = (delayed(_call)(task) for task in todo)
    try:
        yield from Parallel(n_jobs=jobs, return_as="generator_unordered")(calls)
    except TerminatedWorkerError:
        raise InputError(
            "a worker died, perhaps for want of memory; what is done is kept: the same line goes on"
        ) from None


# --------------------------------------------------------------------------------------------- a Ray cluster


def _ray(todo: Sequence[Task], address: str | None) -> Iterator[tuple[Task, Answer]]:
    try:
        import ray
    except ImportError:
        raise InputError(f"the Ray engine needs Ray: {how_to_install('scale')}") from None
    own = not ray.is_initialized()
    if own:
        _reach(address)
        try:
            ray.init(address=address or "auto", log_to_driver=False, logging_level=logging.ERROR)
        except Exception as error:  # many reasons for a missing cluster
            if address is None and isinstance(error, ConnectionError):
                raise InputError(
                    "no Ray cluster runs on this machine: 'ray start --head' starts one, RAY_ADDRESS names another"
                ) from None
            text = str(error).splitlines()[0]
            raise InputError(f"no Ray cluster at '{address or 'auto'}': {text}") from None
    # the tasks of a lost node are given to other nodes
    remote = ray.remote(num_cpus=1, max_retries=1)(_call)
    here = os.getcwd()
    pending = {remote.remote(task, here): task for task in todo}
    try:
        while pending:
            (ready,), _ = ray.wait(list(pending), num_returns=1)
            task = pending.pop(ready)
            try:
                yield ray.get(ready)
            except ray.exceptions.RayError as error:
                yield task, Answer(error=f"its worker died twice ({type(error).__name__})")
    finally:
        for left in pending:  # after Ctrl-C, running tasks are not awaited
            with suppress(Exception):
                ray.cancel(left, force=True)
        if own:
            ray.shutdown()


def _reach(address: str | None) -> None:
    """Raise `InputError` if no server answers at host:port; Ray would wait for minutes."""
    host, colon, port = (address or "").rpartition(":")
    if not (colon and port.isdigit()) or "://" in host:
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=10.0).close()
    except (OSError, OverflowError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"no Ray cluster at '{address}': {why}") from None
