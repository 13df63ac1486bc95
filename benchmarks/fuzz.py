"""Files, actions and networks that nobody would send on purpose, by the hundred thousand.

python benchmarks/fuzz.py runs/fuzz --tries 1000000     # the same line again goes on where it stopped

Try `i` of a kind depends on the seed, the kind and `i` alone. A try is right where it ends in a result that makes sense or in an
`InputError` of one harmless line, within ten seconds of processor time (two minutes by the clock), with nothing written outside its folder. The tries run in a process
of their own, so that a fault is counted and the next try goes on; what failed is kept with its files' recipe, the number.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import math
import os
import pickle
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from isd_gym.data import Table, read_table, write_table
from isd_gym.errors import InputError
from isd_gym.network import Network, builtin_networks, linearise
from isd_gym.road import road

SECONDS = 10
BLOCK = 1000
HOSTILE: list[Any] = [
    None, True, False, 0, -1, 1, 5, 99, 2**31, 2**63, -(2**63), 10**40, 10**299, 0.0, -0.0, 1e-300, 1e-9, 1e9, 1e33, 1e308, -1e308,
    "", "x", "body", "ground", "time", "m", "N", "\n", "a\nisd-gym: all fine", "\x1b[31m", "\u202e", "\u2028", "é" * 50, "x" * 5000,
    "$\\frac$", "../../x", "/etc/passwd", [], {}, [[]], [1, 2], ["body", "wheel"], ["body", "body"], {"a": 1}, [None], [[1.0]], {"name": "x"},
]  # fmt: skip
TEXTS = [
    b"NaN",
    b"1e999",
    b"9" * 5000,
    b"[" * 3000,
    b'"\\ud800"',
    b"\xff",
    b"\0",
    b"\xef\xbb\xbf",
    b"{",
    b"}",
    b",",
    b'"',
    b"-",
    b"1e",
    b"\r",
    b"\n\n",
]

Rng = np.random.Generator


def pick(rng: Rng, values: Any) -> Any:
    return values[int(rng.integers(len(values)))]


def spoil_bytes(rng: Rng, data: bytes) -> bytes:
    """`data` with a few bytes changed, cut out, doubled or put in."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 7))):
        at = int(rng.integers(len(out) + 1))
        way = int(rng.integers(7))
        if way == 0 and at < len(out):
            out[at] = int(rng.integers(256))
        elif way == 1:
            out[at : at + 4] = struct.pack("<I", pick(rng, (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 15, 14, 1000)))
        elif way == 2:
            del out[at : at + int(rng.integers(1, 64))]
        elif way == 3:
            out[at:at] = out[at : at + int(rng.integers(1, 64))]
        elif way == 4:
            out[at:at] = pick(rng, TEXTS)
        elif way == 5 and len(out) > 8:
            out[at : at + 8] = struct.pack("<q", pick(rng, (0, -1, 2**62, 2**63 - 1, -(2**63), 8)))
        elif rng.random() < 0.3:
            del out[at:]
    return bytes(out)


def spoil_tree(rng: Rng, tree: Any) -> Any:
    """A JSON tree with a few values, keys or items replaced, dropped or doubled; changed in place."""
    for _ in range(int(rng.integers(1, 5))):
        place = tree
        while True:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            if not keys:
                break
            key = pick(rng, keys)
            if isinstance(place[key], dict | list) and rng.random() < 0.8:
                place = place[key]
                continue
            way = rng.random()
            if way < 0.55:
                place[key] = json.loads(json.dumps(pick(rng, HOSTILE)))
            elif way < 0.7 and isinstance(place[key], int | float):
                place[key] = float(place[key]) * 10.0 ** float(rng.uniform(-20, 20)) * pick(rng, (1, -1))
            elif way < 0.85:
                del place[key]
            elif isinstance(place, list):
                place.append(json.loads(json.dumps(place[key])))
            else:
                new = pick(rng, HOSTILE)
                place[str(new)] = place.pop(key)
            break
    return tree


def spoil_json(rng: Rng, tree: Any) -> bytes:
    text = json.dumps(spoil_tree(rng, tree) if rng.random() < 0.8 else tree).encode()
    return spoil_bytes(rng, text) if rng.random() < 0.3 else text


# ------------------------------------------------------------------------------------------------ kinds


def use_network(net: Network) -> None:
    """What every command does with a model before it does anything else."""
    space = linearise(net)
    if not all(np.isfinite(m).all() for m in (space.A, space.B, space.C, space.D)):
        raise AssertionError("a state space that is not finite")
    assert Network.from_dict(json.loads(net.dumps())) == net


def models(rng: Rng, folder: Path) -> None:
    tree = Network.load(pick(rng, builtin_networks())).to_dict()
    (folder / "m.json").write_bytes(spoil_json(rng, tree))
    use_network(Network.load(folder / "m.json"))


def csv_tables(rng: Rng, folder: Path) -> None:
    n = int(rng.integers(1, 30))
    sep, comma = pick(rng, ((",", False), (";", True), ("\t", True), (" ", False), (";", False)))
    head = pick(
        rng,
        (
            ["time [s]", "x [mm]"],
            ["time", "x"],
            ["distance [m]", "height [mm]"],
            ["Time (ms)", "x", "remark"],
            ["s", "m"],
        ),
    )
    lines = [sep.join(head)]
    for k in range(n):
        cells = [f"{0.01 * k:.6g}", f"{rng.standard_normal():.6g}", "ok"][: len(head)]
        lines.append(sep.join(c.replace(".", ",") if comma else c for c in cells))
    text = "\n".join(lines).encode()
    (folder / "t.csv").write_bytes(spoil_bytes(rng, text) if rng.random() < 0.75 else text)
    if rng.random() < 0.5:
        road(folder / "t.csv")
    else:
        table = read_table(folder / "t.csv", expected=pick(rng, (None, {"x": "m"}, {})))
        assert all(len(c) == len(table) for c in table.columns.values())


def binary(suffix: str) -> Callable[[Rng, Path], None]:
    seeds: list[bytes] = []

    def tries(rng: Rng, folder: Path) -> None:
        path = folder / f"t{suffix}"
        if not seeds:
            for n in (3, 40):
                t = np.arange(n) * 1e-3
                write_table(path, Table(t, {"x": np.sin(t), "y": t**2}, units={"x": "m"}))
                seeds.append(path.read_bytes())
        path.write_bytes(spoil_bytes(rng, pick(rng, seeds)))
        table = read_table(path, expected=pick(rng, (None, {"x": "m"}, {})))
        assert all(len(c) == len(table) for c in table.columns.values())

    return tries


def use_policy(policy: Any, rng: Rng) -> None:
    for _ in range(3):
        seen = rng.standard_normal(policy.signals) * 10.0 ** rng.uniform(-3, 12)
        current = policy.act(seen)
        assert math.isfinite(current) and abs(current) <= 5.0, current


def policies(rng: Rng, folder: Path) -> None:
    from agents.policy import JSON_NAME, SHIPPED, WEIGHTS_NAME, Policy

    source = SHIPPED / pick(rng, ("ppo", "sac"))
    head, blob = json.loads((source / JSON_NAME).read_text()), (source / WEIGHTS_NAME).read_bytes()
    if rng.random() < 0.3:
        size = 8 + struct.unpack("<Q", blob[:8])[0]
        blob = spoil_bytes(rng, blob[:size]) + blob[size:] if rng.random() < 0.7 else spoil_bytes(rng, blob)
        head["weights"]["sha256"] = hashlib.sha256(blob).hexdigest()
        text = json.dumps(head).encode()
    else:
        for part in ("training", "score", "network"):
            if rng.random() < 0.9:
                head.pop(part, None)  # so that the rest is met more often
        text = spoil_json(rng, head)
    (folder / JSON_NAME).write_bytes(text)
    (folder / WEIGHTS_NAME).write_bytes(blob)
    use_policy(Policy.load(folder), rng)


def archive(rng: Rng) -> dict[str, bytes]:
    """The parts of a Stable-Baselines3 archive of one small layer, with one of them spoilt."""

    def text(value: str) -> bytes:
        return b"X" + struct.pack("<I", len(value)) + value.encode()

    def tensor(key: str, size: tuple[int, ...], count: int) -> bytes:
        strides = [int(np.prod(size[i + 1 :])) for i in range(len(size))]
        row = lambda v: b"(" + b"".join(b"K" + bytes([x]) for x in v) + b"t"  # noqa: E731
        stored = (
            b"("
            + text("storage")
            + b"ctorch\nFloatStorage\n"
            + text(key)
            + text("cpu")
            + b"K"
            + bytes([count])
            + b"tQ"
        )
        return (
            b"ctorch._utils\n_rebuild_tensor_v2\n("
            + stored
            + b"K\0"
            + row(size)
            + row(strides)
            + b"\x89ccollections\nOrderedDict\n)RtR"
        )

    sizes = {
        "mlp_extractor.policy_net.0.weight": (4, 6),
        "mlp_extractor.policy_net.0.bias": (4,),
        "action_net.weight": (1, 4),
        "action_net.bias": (1,),
    }
    body, parts = b"\x80\x02}(", {}
    for i, (name, size) in enumerate(sizes.items()):
        body += text(name) + tensor(str(i), size, int(np.prod(size)))
        parts[f"w/data/{i}"] = rng.standard_normal(size).astype("<f4").tobytes()
    body += b"u."
    box = {":type:": "<class 'gymnasium.spaces.box.Box'>"}
    data = {
        "observation_space": box | {"_shape": [6]},
        "action_space": box | {"_shape": [1], "high": "[1.]"},
        "policy_kwargs": {},
    }
    way = rng.random()
    if way < 0.5:
        body = spoil_bytes(rng, body)
    inner = zipped(parts | {"w/data.pkl": body, "w/byteorder": b"little"})
    if 0.5 <= way < 0.65:
        inner = spoil_bytes(rng, inner)
    return {
        "data": spoil_json(rng, data) if 0.65 <= way < 0.9 else json.dumps(data).encode(),
        "policy.pth": inner,
    }


def zipped(parts: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        for name, data in parts.items():
            file.writestr(name, data)
    return buffer.getvalue()


def zips(rng: Rng, folder: Path) -> None:
    from agents.convert import convert, read_normalize

    if rng.random() < 0.2:
        normal = pickle.dumps(
            _Saved(
                {
                    "obs_rms": _Saved({"mean": np.zeros(6), "var": np.ones(6)}),
                    "epsilon": 1e-8,
                    "clip_obs": 10.0,
                }
            ),
            int(rng.integers(2, 6)),
        )
        (folder / "n.pkl").write_bytes(spoil_bytes(rng, normal))
        read_normalize(folder / "n.pkl")
        return
    data = zipped(archive(rng))
    (folder / "m.zip").write_bytes(spoil_bytes(rng, data) if rng.random() < 0.15 else data)
    use_policy(convert(folder / "m.zip"), rng)


class _Saved:
    def __init__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)


_ENVS: list[Any] = []


def actions(rng: Rng, folder: Path) -> None:
    import gymnasium as gym

    if not _ENVS:
        _ENVS.extend((gym.make("ISDSuspension-v0").unwrapped, gym.make_vec("ISDSuspension-v0", 3).unwrapped))
        for env in _ENVS:
            env.reset(seed=0)
    values = [
        *HOSTILE,
        10**400,
        float("nan"),
        float("inf"),
        1j,
        b"5",
        np.float16(1),
        np.array(["5"]),
        np.array([[1.0]]),
        object(),
        np.zeros((3, 1), object),
    ]
    one = (
        pick(rng, values) if rng.random() < 0.7 else float(10.0 ** rng.uniform(-5, 300) * pick(rng, (1, -1)))
    )
    many = len(_ENVS) == 2 and rng.random() < 0.5
    action = (
        pick(rng, ([one], one, (one,), [one] * 2))
        if not many
        else pick(rng, ([[one]] * 3, [one] * 3, one, [[one], [1.0], [0.0]]))
    )
    observation, reward, *_ = _ENVS[1 if many else 0].step(action)
    assert np.isfinite(observation).all() and np.isfinite(reward).all()


def networks(rng: Rng, folder: Path) -> None:
    """Networks of any shape whose numbers lie anywhere within the hard limits."""
    from dataclasses import fields

    from isd_gym import elements as el

    nodes = [f"n{i}" for i in range(int(rng.integers(1, 8)))]
    kinds = [t for t, c in el.TYPES.items() if c.place == "between"]

    def amount(meta: Any) -> float:
        low, high = max(meta["minimum"], -meta["maximum"]), meta["maximum"]
        if rng.random() < 0.1:
            return float(pick(rng, (low, high)))
        plausible = [v for v in meta["range"] if math.isfinite(v) and v != 0] or [1.0]
        return float(
            np.clip(pick(rng, plausible) * 10.0 ** rng.normal(0, 1 if rng.random() < 0.7 else 5), low, high)
        )

    elements = []
    for i in range(int(rng.integers(1, 12))):
        cls = el.TYPES[pick(rng, kinds)]
        pair = list(rng.choice([*nodes, "ground"], 2, replace=False)) if nodes else ["ground", "n0"]
        numbers = {f.name: amount(f.metadata) for f in fields(cls) if "unit" in f.metadata}
        choices = {k: pick(rng, v) for k, v in cls.choices.items()}
        elements.append(
            {"name": f"e{i}", "type": cls.type, "between": [str(n) for n in pair], **numbers, **choices}
        )
    channels: dict[str, list[Any]] = {"inputs": [], "outputs": []}
    channels["inputs"].append(
        {"name": "u", "quantity": pick(rng, ("displacement", "force")), "at": pick(rng, nodes), "unit": "mm"}
    )
    channels["inputs"][0]["unit"] = {"displacement": "m", "force": "N"}[channels["inputs"][0]["quantity"]]
    for j in range(int(rng.integers(0, 4))):
        quantity = pick(rng, ("displacement", "velocity", "acceleration"))
        unit = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2"}[quantity]
        channels["outputs"].append(
            {"name": f"y{j}", "quantity": quantity, "at": pick(rng, nodes), "unit": unit}
        )
    masses = {
        n: float(10.0 ** rng.uniform(-9, 9) if rng.random() < 0.3 else 10.0 ** rng.uniform(-1, 3))
        for n in nodes
        if rng.random() < 0.7
    }
    use_network(
        Network.from_dict({"schema": "isd-model/1", "masses": masses, "elements": elements, **channels})
    )


KINDS: dict[str, Callable[[Rng, Path], None]] = {
    "models": models,
    "csv": csv_tables,
    "parquet": binary(".parquet"),
    "mat": binary(".mat"),
    "mf4": binary(".mf4"),
    "policies": policies,
    "zips": zips,
    "actions": actions,
    "networks": networks,
}
#: of a hundred tries
SHARES = {
    "models": 24,
    "csv": 16,
    "parquet": 4,
    "mat": 6,
    "mf4": 2,
    "policies": 16,
    "zips": 14,
    "actions": 10,
    "networks": 8,
}


class Hang(BaseException):
    """A try that does not end."""


def attempt(kind: str, seed: int, i: int, folder: Path) -> str:
    """One try: 'result', 'refused', or what went wrong. `folder` is empty before and after."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind), i])

    def late(*_: Any) -> None:
        raise Hang

    timed = hasattr(signal, "setitimer")
    if timed:
        usual = [signal.signal(s, late) for s in (signal.SIGPROF, signal.SIGALRM)]
    try:
        if timed:
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            signal.setitimer(signal.ITIMER_REAL, 12 * SECONDS)
        KINDS[kind](rng, folder)
        return "result"
    except InputError as error:
        text = str(error)
        return (
            "refused"
            if text.isprintable() and 0 < len(text) <= 1200
            else f"a message of {len(text)} characters: {text[:80]!r}"
        )
    except Hang:
        return f"hang: more than {SECONDS} s"
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} in {Path(last.filename).name}:{last.lineno}: {str(error)[:160]}"
    finally:
        if timed:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.setitimer(signal.ITIMER_REAL, 0)
            for s, handler in zip((signal.SIGPROF, signal.SIGALRM), usual, strict=True):
                signal.signal(s, handler)
        for left in folder.iterdir():
            shutil.rmtree(left) if left.is_dir() else left.unlink()


def block(kind: str, seed: int, start: int, count: int, progress: Path | None = None) -> dict[str, Any]:
    """`count` tries from `start`: counts of results and refusals, and the failures by their number."""
    counts, failures = {"result": 0, "refused": 0}, {}
    with tempfile.TemporaryDirectory() as outer, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(outer) / "inside"
        folder.mkdir()
        before = os.getcwd()
        os.chdir(outer)  # what is written beside its folder is seen here
        try:
            if kind in ("actions", "parquet", "mat", "mf4"):
                attempt(kind, seed, 2**40, folder)  # compiles, or loads the libraries: not what is timed
            for i in range(start, start + count):
                if progress is not None:
                    progress.write_text(str(i))
                said = attempt(kind, seed, i, folder)
                if said in counts:
                    counts[said] += 1
                else:
                    failures[i] = said
                if os.listdir(outer) != ["inside"]:
                    failures[i] = f"wrote outside its folder: {os.listdir(outer)}"
                    break
        finally:
            os.chdir(before)
    return {"counts": counts, "failures": failures}


def run(out: Path, tries: int, seed: int, only: list[str] | None, minutes: float) -> None:
    """Blocks of all kinds in turn, each in a process of its own, until there are `tries`; goes on where it stopped."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "fuzz.json"
    state = json.loads(file.read_text()) if file.exists() else {"seed": seed, "kinds": {}}
    kinds = only or list(KINDS)
    end = time.monotonic() + 60 * minutes
    goals = {k: math.ceil(tries * SHARES[k] / sum(SHARES[n] for n in kinds)) for k in kinds}
    for k in kinds:
        state["kinds"].setdefault(k, {"done": 0, "result": 0, "refused": 0, "failures": {}, "seconds": 0.0})
    while time.monotonic() < end:
        open_kinds = [k for k in kinds if state["kinds"][k]["done"] < goals[k]]
        if not open_kinds:
            break
        kind = min(open_kinds, key=lambda k: state["kinds"][k]["done"] / goals[k])
        mine = state["kinds"][kind]
        count, start = min(BLOCK, goals[kind] - mine["done"]), mine["done"]
        begin = time.monotonic()
        command = [
            sys.executable,
            __file__,
            str(out),
            "--block",
            kind,
            str(state["seed"]),
            str(start),
            str(count),
        ]
        (out / "progress").unlink(missing_ok=True)
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        mine["seconds"] += time.monotonic() - begin
        try:
            found = json.loads(done.stdout)
        except ValueError:  # it went down: the number of the try is in the file
            place = out / "progress"
            at = int(place.read_text()) if place.exists() else start
            found = (
                block_of(out, kind, state["seed"], start, at - start)
                if at > start
                else {"counts": {}, "failures": {}}
            )
            why = f"fault: exit {done.returncode}: {done.stderr.strip().splitlines()[-1:] or ''}"
            found["failures"][str(at)] = why
            count = at - start + 1
        mine["done"] += count
        for key, value in found["counts"].items():
            mine[key] += value
        mine["failures"] |= found["failures"]
        temporary = out / "fuzz.json.new"
        temporary.write_text(json.dumps(state, indent=1) + "\n")
        temporary.replace(file)
        for i, said in found["failures"].items():
            print(f"{kind} {i}: {said}", flush=True)
    for kind, mine in state["kinds"].items():
        print(
            f"{kind:<10} {mine['done']:>8} tries  {mine['result']:>8} results  {mine['refused']:>8} refused  {len(mine['failures']):>4} failures"
        )


def block_of(out: Path, kind: str, seed: int, start: int, count: int) -> dict[str, Any]:
    """The tries before one that took its process down, again."""
    command = [sys.executable, __file__, str(out), "--block", kind, str(seed), str(start), str(count)]
    with contextlib.suppress(ValueError):
        return json.loads(subprocess.run(command, capture_output=True, text=True, check=False).stdout)
    return {"counts": {}, "failures": {}}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, help="folder that remembers how far it came")
    parser.add_argument("--tries", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=math.inf)
    parser.add_argument("--kind", nargs="*", choices=list(KINDS))
    parser.add_argument(
        "--block", nargs=4, metavar=("KIND", "SEED", "START", "COUNT"), help=argparse.SUPPRESS
    )
    given = parser.parse_args()
    if given.block:
        kind, *numbers = given.block
        print(json.dumps(block(kind, *map(int, numbers), progress=given.out.absolute() / "progress")))
        return
    run(given.out.absolute(), given.tries, given.seed, given.kind, given.minutes)


if __name__ == "__main__":
    main()
