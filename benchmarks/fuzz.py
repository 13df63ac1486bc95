"""Files, actions, names and networks that nobody would send on purpose (`hostile.py`), by the hundred thousand.

python benchmarks/fuzz.py runs/fuzz --tries 1000000     # the same line again goes on where it stopped

Try `i` of a kind depends on the seed, the kind and `i` alone. A try is right where it ends in a result that makes sense or in an
`InputError` of one harmless line, within ten seconds of processor time (ten minutes by the clock), with nothing written outside its
folder. Tries run in blocks, each in a process of its own, so that a fault is counted and the next try goes on. DIR/fuzz.json keeps the
counts, what failed by its number, and how often each refusal was given: `--told` shows these.
"""

from __future__ import annotations

import os

os.environ.update(
    OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1"
)  # processes are forked, and one processor is meant

import argparse
import collections
import json
import math
import multiprocessing
import re
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
from hostile import KINDS, SHARES

from isd_gym._common.errors import InputError, harmless

SECONDS = 10
#: tries of one process; it costs a fraction of a second, and a second or two where libraries are loaded or laws compiled
BLOCK = {"actions": 40_000, "mat": 10_000, "parquet": 10_000, "mf4": 10_000}
USUAL_BLOCK = 5_000
#: processor time of a block beyond which it is stopped, also within a library that hears no signal
BLOCK_SECONDS = 600


class Hang(BaseException):
    """A try that does not end."""


def _late(*_: Any) -> None:
    raise Hang


def attempt(kind: str, seed: int, i: int, folder: Path) -> str:
    """One try: 'result', 'refused: why', or what went wrong. `folder` is empty before and after."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind), i])
    timed = hasattr(signal, "setitimer")
    try:
        if timed:
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            signal.setitimer(signal.ITIMER_REAL, 60 * SECONDS)
        KINDS[kind](rng, folder)
        return "result"
    except InputError as error:
        text = str(error)
        if harmless(text) and 0 < len(text) <= 1200:
            return "refused: " + text.replace(str(folder), "DIR")
        return f"a message of {len(text)} characters: {text[:80]!r}"
    except Hang:
        return f"hang: more than {SECONDS} s"
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} in {Path(last.filename).name}:{last.lineno}: {str(error)[:160]}"
    finally:
        if timed:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.setitimer(signal.ITIMER_REAL, 0)
        for left in os.scandir(folder):
            if left.is_dir(follow_symlinks=False):
                shutil.rmtree(left.path)
            else:
                os.unlink(left.path)


def block(kind: str, seed: int, start: int, count: int, progress: Path | None = None) -> dict[str, Any]:
    """`count` tries from `start`: counts of results and refusals, the refusals by their wording, the failures by their number."""
    counts = {"result": 0, "refused": 0}
    failures: dict[int, str] = {}
    told: collections.Counter[str] = collections.Counter()
    memory = "/dev/shm" if os.path.isdir("/dev/shm") else None
    handlers = {s: signal.signal(s, _late) for s in _signals()}
    at = os.open(progress, os.O_WRONLY | os.O_CREAT) if progress is not None else None
    before = os.getcwd()
    try:
        with tempfile.TemporaryDirectory(dir=memory) as outer, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            folder = Path(outer) / "inside"
            folder.mkdir()
            os.chdir(outer)  # what is written beside its folder is seen here
            if kind in ("actions", "parquet", "mat", "mf4"):
                attempt(kind, seed, 2**40, folder)  # compiles, or loads the libraries: not what is timed
            for i in range(start, start + count):
                if at is not None:
                    os.pwrite(at, b"%20d" % i, 0)
                said = attempt(kind, seed, i, folder)
                if said == "result":
                    counts["result"] += 1
                elif said.startswith("refused: "):
                    counts["refused"] += 1
                    told[wording(said[9:])] += 1
                else:
                    failures[i] = said
                if os.listdir(outer) != ["inside"]:
                    failures[i] = f"wrote outside its folder: {os.listdir(outer)}"
                    break
            os.chdir(before)
    finally:
        os.chdir(before)
        for s, handler in handlers.items():
            signal.signal(s, handler)
        if at is not None:
            os.close(at)
    return {"counts": counts, "failures": failures, "told": dict(told.most_common(300))}


def _signals() -> tuple[signal.Signals, ...]:
    return (signal.SIGPROF, signal.SIGALRM) if hasattr(signal, "setitimer") else ()


def wording(text: str) -> str:
    """A refusal without its names and numbers, so that refusals can be counted."""
    text = re.sub(r"'[^']*'|\"[^\"]*\"", "'…'", text)
    return re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "#", text)[:120]


def _work(kind: str, seed: int, start: int, count: int, progress: Path, answer: Path) -> None:
    if hasattr(os, "fork"):
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (BLOCK_SECONDS, BLOCK_SECONDS + 5))
    found = block(kind, seed, start, count, progress)
    used = os.times()
    found["seconds"] = used.user + used.system + used.children_user + used.children_system
    answer.write_text(json.dumps(found))


def apart(kind: str, seed: int, start: int, count: int, out: Path) -> tuple[dict[str, Any], int]:
    """A block in a process of its own, and how many tries it came to do: up to the one that took the process down."""
    progress, answer = out / f"{kind}.progress", out / f"{kind}.answer"
    for left in (progress, answer):
        left.unlink(missing_ok=True)
    context = multiprocessing.get_context("fork" if hasattr(os, "fork") else "spawn")
    process = context.Process(target=_work, args=(kind, seed, start, count, progress, answer))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forking with threads, which libraries keep
        process.start()
    process.join()
    if answer.exists():
        return json.loads(answer.read_text()), count
    at = int(progress.read_text()) if progress.exists() else start
    found: dict[str, Any] = {"counts": {}, "failures": {}, "told": {}, "seconds": 0.0}
    if at > start:  # the tries before, again
        found, done = apart(kind, seed, start, at - start, out)
        if done < at - start:
            return found, done
    found["failures"][str(at)] = f"fault: the process ended with {process.exitcode}"
    return found, at - start + 1


def run(out: Path, tries: int, seed: int, only: list[str] | None, minutes: float) -> dict[str, Any]:
    """Blocks of all kinds in turn until there are `tries`; goes on where it stopped. Returns what fuzz.json holds."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "fuzz.json"
    state = json.loads(file.read_text()) if file.exists() else {"seed": seed, "kinds": {}}
    kinds = only or list(KINDS)
    end = time.monotonic() + 60 * minutes
    goals = {k: math.ceil(tries * SHARES[k] / sum(SHARES[n] for n in kinds)) for k in kinds}
    for k in kinds:
        new = {"done": 0, "result": 0, "refused": 0, "failures": {}, "told": {}, "seconds": 0.0}
        state["kinds"].setdefault(k, new)
    while time.monotonic() < end:
        still = [k for k in kinds if state["kinds"][k]["done"] < goals[k]]
        if not still:
            break
        kind = min(still, key=lambda k: state["kinds"][k]["done"] / goals[k])
        mine = state["kinds"][kind]
        count = min(BLOCK.get(kind, USUAL_BLOCK), goals[kind] - mine["done"])
        found, done = apart(kind, state["seed"], mine["done"], count, out)
        mine["done"] += done
        mine["seconds"] += found["seconds"]
        for key, value in found["counts"].items():
            mine[key] += value
        mine["failures"] |= found["failures"]
        told = collections.Counter(mine["told"]) + collections.Counter(found["told"])
        mine["told"] = dict(told.most_common(300))
        temporary = out / "fuzz.json.new"
        temporary.write_text(json.dumps(state, indent=1) + "\n")
        temporary.replace(file)
        for i, said in found["failures"].items():
            print(f"{kind} {i}: {said}", flush=True)
    return state


def table(state: dict[str, Any]) -> str:
    """Return the table of tries and results by kind."""
    rows = [("kind", "tries", "results", "refused", "failures", "ms a try")]
    for kind, mine in state["kinds"].items():
        each = f"{1e3 * mine['seconds'] / max(mine['done'], 1):.2g}"
        rows.append((kind, mine["done"], mine["result"], mine["refused"], len(mine["failures"]), each))
    total = [sum(row[i] for row in rows[1:]) for i in range(1, 5)]
    rows.append(("all", *total, ""))
    return "\n".join("".join(f"{x:>10}" for x in row) for row in rows)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, help="folder that remembers how far it came")
    parser.add_argument("--tries", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--kind", nargs="*", choices=list(KINDS))
    parser.add_argument("--told", action="store_true", help="show how often each refusal was given, and stop")
    parser.add_argument("--again", nargs=2, metavar=("KIND", "NUMBER"), help="one try, with its traceback")
    given = parser.parse_args()
    out = given.out.absolute()
    if given.told:
        for kind, mine in json.loads((out / "fuzz.json").read_text())["kinds"].items():
            for text, count in list(mine["told"].items())[:40]:
                print(f"{kind:<10}{count:>8}  {text}")
    elif given.again:
        seed = json.loads((out / "fuzz.json").read_text())["seed"] if out.exists() else given.seed
        kind, i = given.again[0], int(given.again[1])
        with tempfile.TemporaryDirectory() as folder:
            KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind), i]), Path(folder))
    else:
        print(table(run(out, given.tries, given.seed, given.kind, given.minutes)))


if __name__ == "__main__":
    main()
