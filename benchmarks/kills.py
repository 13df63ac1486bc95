"""kill -9, full disks, caches that cannot be written, two at once: what is on the disk afterwards, and whether the next run is right.

python benchmarks/kills.py moments   # every moment at which a command changes the disk: the state then, and the command again from there
python benchmarks/kills.py kills     # kill -9 at random moments, and the command again
python benchmarks/kills.py full      # disks and files that take no more
python benchmarks/kills.py both      # two processes on one folder
python benchmarks/kills.py places    # no HOME, caches that cannot be written, two processes on one cold cache, forked and spawned environments

Commands: score --report, record, sweep, diagnose, train, each at its smallest, `--only` some of them. An output must be
absent, unchanged, or equal to the output of an undisturbed run. A kill deletes the memory of a process and leaves the disk. The states
of the disk before each change, copied within one run, are therefore the states that a kill can leave. Ends with 1 where anything was wrong.
"""

from __future__ import annotations

import os

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")  # processes are forked

import argparse
import contextlib
import fcntl
import io
import json
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

CHANGES = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.link", "os.symlink", "os.truncate"}


@dataclass(frozen=True)
class Case:
    """A command: preparation of the folder, the run, and the written result (None without a result)."""

    prepare: Callable[[Path], None]
    run: Callable[[], None]
    whole: Callable[[Path], Any]
    again: bool = True  # it may be run where its output is whole
    kills: int = 12


def cli(line: str) -> Callable[[], None]:
    def run() -> None:
        from isd_gym._commands import main

        sys.argv = ["isd-gym", *line.split()]
        main()

    return run


def nothing(folder: Path) -> None:
    pass


def read(path: Path) -> Any:
    return json.loads(path.read_text()) if path.exists() else None


def scored(folder: Path) -> Any:
    def figures(data: Any) -> Any:
        return data and [(r["policy"], r["cost"], r["energy"]) for r in data["policies"]]

    page = folder / "page"
    if page.exists():
        assert {p.name for p in page.iterdir()} >= {"score.json"}, "a page without its figures"
        assert any("</html>" in p.read_text() for p in page.glob("*.html")), "half a page"
    found = figures(read(page / "score.json")), figures(read(folder / "score.json"))
    return found if any(found) else None


def recorded(folder: Path) -> Any:
    if not (folder / "data").exists():
        return None
    import minari

    data = minari.MinariDataset(folder / "data")
    return [(e.rewards.tolist(), e.actions.tolist()) for e in data.iterate_episodes()]


def swept(folder: Path) -> Any:
    for item in (folder / "out").glob("*.json"):
        json.loads(item.read_text())
    data = read(folder / "out" / "sweep.json")
    return data and [[(p["policy"], p["cost"]) for p in c["policies"]] for c in data["conditions"]]


def grid(folder: Path) -> None:
    (folder / "grid.toml").write_text(
        'policies = ["isd-passive"]\nepisodes = 4\nbatch = 2\nduration = 0.5\n[axes]\nspeed = [10.0, 20.0]\n'
    )


def rig(folder: Path) -> None:
    """A mass on a spring that is pushed; its friction is what the model lacks."""
    import numpy as np

    from isd_gym.physics.network import Network
    from isd_gym.physics.simulate import simulate
    from isd_gym.records.data import Table, write_table

    model = {
        "schema": "isd-model/1",
        "masses": {"m": 10.0},
        "elements": [
            {"name": "k", "type": "linear_stiffness", "between": ["m", "ground"], "stiffness": 4000.0},
            {"name": "c", "type": "linear_damping", "between": ["m", "ground"], "damping": 30.0},
        ],
        "inputs": [{"name": "push", "quantity": "force", "at": "m", "unit": "N"}],
        "outputs": [{"name": "x", "quantity": "displacement", "at": "m", "unit": "m"}],
    }
    (folder / "model.json").write_text(json.dumps(model))
    rng = np.random.default_rng(0)
    t = np.arange(4000) * 5e-3
    push = 60 * sum(
        np.sin(2 * np.pi * f * t + p) for f, p in zip((0.7, 1.9, 3.7, 6.1), rng.uniform(0, 6, 4), strict=True)
    )
    x = simulate(Network.from_dict(model), t, {"push": push})["x"]
    x = x + 0.01 * x.std() * rng.standard_normal(len(x))
    write_table(folder / "data.csv", Table(t, {"push": push, "x": x}))


def diagnosed(folder: Path) -> Any:
    if not (folder / "found").exists():
        return None
    data, model = read(folder / "found" / "diagnosis.json"), read(folder / "found" / "model.json")
    assert data and model and "</html>" in (folder / "found" / "report.html").read_text(), "half a diagnosis"
    return data["verdict"], data["parameters"], data["gap"]


def train() -> None:
    import warnings

    import isd_gym.contrib.training.train as module
    from isd_gym.contrib.training.settings import PPOSettings

    warnings.simplefilter("ignore")
    module.BASELINES = ()  # type: ignore[assignment]
    module.VALIDATION_EPISODES = module.SCORE_EPISODES = 2
    few: dict[str, Any] = {"teacher": None, "evaluations": 4, "checkpoint_seconds": 0.0, "filter": False}
    settings = PPOSettings(steps=8192, cars=32, horizon=32, tail=16, batch=256, epochs=1, **few)
    module.train("ppo", "run", settings=settings, say=lambda line: print(line, flush=True))


def trained(folder: Path) -> Any:
    from isd_gym.agents.policy import Policy

    run = folder / "run"
    read(run / "run.json")
    for checkpoint in run.glob("checkpoint-*"):
        names = {p.name for p in checkpoint.iterdir()}
        # one that gives way to the next goes file by file; the next is whole by then
        assert names >= {"state.json", "learner.safetensors"} or checkpoint != max(run.glob("checkpoint-*"))
    if not (run / "policy").exists():
        return None
    info = Policy.load(run / "policy").info
    return (
        True if info["score"] is not None else None
    )  # roads differ after a resumption: the figures may, too


CASES = {
    "score": Case(
        nothing, cli("score lqg --episodes 2 --duration 1 --report page --json score.json"), scored
    ),
    "record": Case(nothing, cli("record lqg --episodes 2 --duration 1 --out data"), recorded, again=False),
    "sweep": Case(grid, cli("sweep grid.toml --out out"), swept),
    "train": Case(nothing, train, trained),
    "diagnose": Case(rig, cli("diagnose data.csv --model model.json --out found"), diagnosed, kills=4),
}


# ------------------------------------------------------------------------------------------- a process


#: handle and file of the output of each running process, by process number
_SAID: dict[int, tuple[int, Path]] = {}


def begin(run: Callable[[], None], folder: Path, log: Path, before: Callable[[], None] = lambda: None) -> int:
    """Number of a forked process that runs `run` in `folder`; what it says is in `log`."""
    said, out = os.pipe()  # no file: files may be limited
    fcntl.fcntl(out, fcntl.F_SETPIPE_SZ, 1 << 20)
    pid = os.fork()
    if pid:
        os.close(out)
        _SAID[pid] = said, log
        return pid
    code = 99
    try:
        os.chdir(folder)
        os.dup2(out, 1), os.dup2(out, 2)
        sys.stdout, sys.stderr = (os.fdopen(fd, "w", buffering=1, closefd=False) for fd in (1, 2))
        before()
        run()
        code = 0
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 98 * (error.code is not None)
    except BaseException as error:
        from isd_gym._common.errors import InputError

        if isinstance(error, InputError | OSError):  # as the command line would
            print(f"isd-gym: {error}", file=sys.stderr)
            code = 2 if isinstance(error, InputError) else 1
        else:
            traceback.print_exc()
    finally:
        sys.stdout.flush(), sys.stderr.flush()
        os._exit(code)


def ended(pid: int) -> int:
    """Exit status, negative for a signal."""
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    said, log = _SAID.pop(pid)
    os.set_blocking(said, False)
    with contextlib.suppress(BlockingIOError):
        log.write_bytes(os.read(said, 1 << 20))
    os.close(said)
    return code


def copies(root: Path, store: Path) -> Callable[[], None]:
    """Has this process copy `root` into a folder of `store` before each change that it makes there."""
    busy = False

    def told(event: str, args: tuple[Any, ...]) -> None:
        nonlocal busy
        if busy or event not in CHANGES:
            return
        if event == "open" and not (
            isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        ):
            return
        names = [os.fsdecode(a) for a in args[:2] if isinstance(a, str | bytes | os.PathLike)]
        if not any(os.path.abspath(n).startswith(str(root)) for n in names):
            return
        busy = True
        shutil.copytree(root, store / f"{len(os.listdir(store)):04d}", symlinks=True)
        busy = False

    return lambda: sys.addaudithook(told)


class Tally:
    """What was seen, and what was wrong."""

    def __init__(self) -> None:
        self.seen: Counter[str] = Counter()
        self.wrong: list[str] = []

    def check(self, ok: bool, what: str) -> None:
        self.seen[what] += 1
        if not ok:
            self.wrong.append(what)

    def after(self, case: Case, folder: Path, log: Path, reference: Any, where: str) -> None:
        """The state after a disturbance, and the same command again from there."""
        had = self.state(case, folder, reference, where)
        code = ended(begin(case.run, folder, log))
        text = log.read_text()
        if had == "whole" and not case.again:
            self.check(code == 2 and "Traceback" not in text, f"{where}: whole, and refused the second time")
        else:
            good = code == 0 and "Traceback" not in text
            good = good and self.state(case, folder, reference, f"{where}, again") == "whole"
            self.check(
                good, f"{where}: again, and right" if good else f"{where}: again: {code} {text[-300:]!r}"
            )
        stale = [p.name for p in folder.rglob(".*") if p.name.startswith((".isd-gym", ".checkpoint"))]
        if code == 0:
            self.check(not stale, f"{where}: nothing left behind" if not stale else f"{where}: left {stale}")

    def state(self, case: Case, folder: Path, reference: Any, where: str) -> str:
        """'whole', 'nothing' or 'part' (of several outputs); anything half-written is wrong."""
        try:
            found = case.whole(folder)
        except Exception as error:
            self.check(False, f"{where}: half-written: {type(error).__name__}: {error}")
            return "half"
        if found is None or found == reference:
            return "nothing" if found is None else "whole"
        parts = isinstance(found, tuple) and all(
            f is None or f == r for f, r in zip(found, reference, strict=True)
        )
        self.check(
            parts, f"{where}: some of the outputs, whole" if parts else f"{where}: other than undisturbed"
        )
        return "part"


# ------------------------------------------------------------------------------------------- what is tried


def moments(place: Path, name: str, case: Case, tally: Tally, rng: random.Random, tries: int) -> None:
    """All states of the disk are looked at; from `tries` of them the command is run again."""
    folder, store, log = place / "whole", place / "moments", place / "log"
    folder.mkdir(), store.mkdir()
    case.prepare(folder)
    code = ended(begin(case.run, folder, log, copies(folder, store)))
    assert code == 0, log.read_text()
    reference = case.whole(folder)
    states = sorted(store.iterdir())
    for state in states:
        said = tally.state(case, state, reference, f"{name}: at a moment")
        tally.check(said != "half", f"{name}: at a moment: {said}")
    for state in rng.sample(states, min(tries, len(states))):
        tally.after(case, state, log, reference, f"{name}: from a moment")
        shutil.rmtree(state)


def kills(place: Path, name: str, case: Case, tally: Tally, rng: random.Random, tries: int) -> None:
    folder, log = place / "whole", place / "log"
    folder.mkdir()
    case.prepare(folder)
    clock = time.monotonic()
    assert ended(begin(case.run, folder, log)) == 0, log.read_text()
    lasts = time.monotonic() - clock
    reference = case.whole(folder)
    for i in range(tries):
        own = place / str(i)
        own.mkdir()
        case.prepare(own)
        pid = begin(case.run, own, log)
        time.sleep(rng.uniform(0, 1.1 * lasts))
        os.kill(pid, signal.SIGKILL)
        tally.check(True, f"{name}: {'ended before' if ended(pid) == 0 else 'killed'}")
        tally.after(case, own, log, reference, f"{name}: after a kill")
        shutil.rmtree(own)


#: whether small disks are made, which the administrator alone may
MOUNT = False


def full(place: Path, name: str, case: Case, tally: Tally, rng: random.Random, tries: int) -> None:
    """Files that grow to no more than so many bytes, over an earlier output, which stays or is replaced whole."""
    folder, log = place / "whole", place / "log"
    folder.mkdir()
    case.prepare(folder)
    assert ended(begin(case.run, folder, log)) == 0, log.read_text()
    reference = case.whole(folder)
    for i in range(tries):
        own = place / str(i)
        shutil.copytree(folder, own) if case.again and i % 2 else (own.mkdir(), case.prepare(own))
        limit = int(10 ** rng.uniform(0, 5.5))
        mounted = MOUNT and i % 2 == 0 and _disk(own, limit)
        before = (lambda: None) if mounted else _limits(limit)
        code = ended(begin(case.run, own, log, before))
        text = log.read_text()
        tally.check(
            code in (0, 1, 2) and "Traceback" not in text,
            f"{name}: full: {'one line' if code else 'no matter'}" if code in (0, 1, 2) and "Traceback" not in text
            else f"{name}: full at {limit}: {code} {text[-400:]!r}",
        )  # fmt: skip
        said = tally.state(case, own, reference, f"{name}: full")
        tally.check(said != "half", f"{name}: full: {said}")
        if mounted:
            subprocess.run(["umount", own], check=True)
        else:
            tally.after(case, own, log, reference, f"{name}: after a full disk")
        shutil.rmtree(own)


def _limits(size: int) -> Callable[[], None]:
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


def _disk(folder: Path, size: int) -> bool:
    """A disk of `size` bytes (whole pages) at `folder`, with what was there; False where none may be mounted."""
    held = folder.with_name("held")
    shutil.copytree(folder, held)
    room = sum(p.stat().st_size + 8192 for p in held.rglob("*")) + size + 65536
    command = ["mount", "-t", "tmpfs", "-o", f"size={room}", "tmpfs", str(folder)]
    done = subprocess.run(command, capture_output=True, check=False).returncode == 0
    if done:
        shutil.copytree(held, folder, dirs_exist_ok=True)
    shutil.rmtree(held)
    return done


def both(place: Path, name: str, case: Case, tally: Tally, rng: random.Random, tries: int) -> None:
    folder = place / "whole"
    folder.mkdir()
    case.prepare(folder)
    assert ended(begin(case.run, folder, place / "log")) == 0, (place / "log").read_text()
    reference = case.whole(folder)
    for i in range(max(tries // 4, 1)):
        own = place / str(i)
        own.mkdir()
        case.prepare(own)
        logs = [place / "one", place / "other"]
        codes = [ended(pid) for pid in [begin(case.run, own, log) for log in logs]]
        texts = [log.read_text() for log in logs]
        good = 0 in codes and set(codes) <= {0, 2} and not any("Traceback" in t for t in texts)
        how = "both" if codes == [0, 0] else "one, the other told in a line"
        tally.check(
            good,
            f"{name}: two at once: {how}"
            if good
            else f"{name}: two at once: {codes} {[t[-300:] for t in texts]}",
        )
        said = tally.state(case, own, reference, f"{name}: two at once")
        tally.check(said == "whole", f"{name}: two at once: {said}")
        stale = [p.name for p in own.rglob(".*") if p.name.startswith((".isd-gym", ".checkpoint"))]
        tally.check(not stale, f"{name}: two at once: left {stale or 'nothing'}")
        shutil.rmtree(own)


COLD = "score passive lqg --episodes 1 --duration 0.5 --json"


def places(place: Path, tally: Tally) -> None:
    """Fresh processes in environments where something is missing."""
    score = [
        sys.executable,
        "-m",
        "isd_gym.commands",
        *COLD.split(),
    ]
    usual = {
        k: v
        for k, v in os.environ.items()
        if k not in ("NUMBA_CACHE_DIR", "MPLCONFIGDIR", "HOME", "XDG_CACHE_HOME")
    }
    paths = os.pathsep.join(
        [str(Path(__file__).resolve().parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    usual |= {"PYTHONPATH": paths}
    kept = os.environ.get("NUMBA_CACHE_DIR", str(place / "kept"))
    nobody = (
        ["setpriv", "--reuid", "65534", "--regid", "65534", "--clear-groups"] if os.geteuid() == 0 else []
    )
    closed = place / "closed"
    closed.mkdir(mode=0o555)

    def told(what: str, env: dict[str, str], prefix: list[str], cold: Path | None = None) -> None:
        out = place / f"{what.replace(' ', '-')}.json"
        place.chmod(0o777)
        if cold is not None:
            cold.mkdir()
            cold.chmod(0o777)
        done = subprocess.run(
            [*prefix, *score, str(out)], capture_output=True, text=True, env=env, cwd=place, check=False
        )
        lines = [s for s in done.stderr.splitlines() if s.strip()]
        good = "Traceback" not in done.stderr and (
            (done.returncode == 0 and read(out) is not None)
            or (done.returncode == 2 and len(lines) == 1 and not out.exists())
        )
        how = "right" if done.returncode == 0 else f"one line: {lines[-1][:100] if lines else ''}"
        tally.check(good, f"{what}: {how}" if good else f"{what}: {done.returncode} {done.stderr[-600:]!r}")

    told("no HOME", usual | {"NUMBA_CACHE_DIR": kept}, [])
    told(
        "no folder for matplotlib",
        usual | {"NUMBA_CACHE_DIR": kept, "HOME": "/dev/null", "MPLCONFIGDIR": "/dev/null/x"},
        [],
    )
    told("a cache folder that cannot be", usual | {"NUMBA_CACHE_DIR": "/dev/null/x", "HOME": "/dev/null"}, [])
    told(
        "a cache folder that is closed", usual | {"NUMBA_CACHE_DIR": str(closed), "HOME": "/dev/null"}, nobody
    )
    told("a closed install and no HOME", usual, nobody)
    cold = place / "cold"
    cold.mkdir()
    outs = [place / f"cold{i}.json" for i in (0, 1)]
    env = usual | {"NUMBA_CACHE_DIR": str(cold)}
    runs = [
        subprocess.Popen(
            [*score, str(o)], env=env, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
        )
        for o in outs
    ]
    said = [p.communicate()[1] for p in runs]
    results = [scored_alone(o) for o in outs]
    good = results[0] is not None and results[0] == results[1] and not any("Traceback" in s for s in said)
    tally.check(good, "two on one cold cache: both right" if good else f"two on one cold cache: {said}")
    for how in ("fork", "spawn"):
        code = (
            "import gymnasium, numpy as np\n"
            "if __name__ == '__main__':\n"
            "    make = lambda: gymnasium.make('isd_gym:ISDSuspension-v0')\n"
            f"    a = gymnasium.vector.AsyncVectorEnv([make] * 2, context='{how}')\n"
            "    b = gymnasium.vector.SyncVectorEnv([make] * 2)\n"
            "    x, y = a.reset(seed=3)[0], b.reset(seed=3)[0]\n"
            "    for k in range(200):\n"
            "        u = np.full((2, 1), np.sin(0.1 * k), np.float32)\n"
            "        x, y = a.step(u), b.step(u)\n"
            "        assert all(np.array_equal(x[i], y[i]) for i in range(4))\n"
            "    a.close()\n"
        )
        (place / "vector.py").write_text(code)
        env = usual | {"NUMBA_CACHE_DIR": kept}
        done = subprocess.run(
            [sys.executable, "vector.py"], cwd=place, env=env, capture_output=True, text=True, check=False
        )
        good = done.returncode == 0 and "Traceback" not in done.stderr
        tally.check(
            good, f"AsyncVectorEnv, {how}: as one after the other" if good else f"{how}: {done.stderr[-500:]}"
        )


def scored_alone(path: Path) -> Any:
    data = read(path)
    return data and [(r["policy"], r["cost"], r["energy"]) for r in data["policies"]]


WAYS = {"moments": moments, "kills": kills, "full": full, "both": both}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=[*WAYS, "places"])
    parser.add_argument("--only", nargs="*", choices=list(CASES), default=list(CASES))
    parser.add_argument("--tries", type=int, help="of a command (by default what fits its cost)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--mount", action="store_true", help="full: also on small disks of memory (needs root)"
    )
    given = parser.parse_args()
    global MOUNT
    MOUNT = given.mount
    tally, rng = Tally(), random.Random(given.seed)
    with tempfile.TemporaryDirectory(prefix="kills-") as root:
        if given.what == "places":
            places(Path(root), tally)
        else:
            for name in given.only:
                case = CASES[name]
                ready = Path(root) / f"{name}-ready"
                ready.mkdir()
                case.prepare(ready)
                # imported and compiled here, so that the processes that are killed spend their time on their work
                here = os.getcwd()
                os.chdir(ready)
                try:
                    with contextlib.redirect_stdout(io.StringIO()):
                        case.run()
                except SystemExit as error:
                    assert not error.code, f"{name} ended with {error.code}"
                finally:
                    os.chdir(here)
                place = Path(root) / name
                place.mkdir()
                WAYS[given.what](place, name, case, tally, rng, given.tries or case.kills)
                shutil.rmtree(place)
    for what, count in sorted(tally.seen.items()):
        print(f"{count:>6}  {what}")
    for what in tally.wrong:
        print(f"WRONG  {what}")
    sys.exit(bool(tally.wrong))


if __name__ == "__main__":
    main()
