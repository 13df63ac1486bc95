"""What `fuzz.py` sends: files, actions, names, folders and networks that nobody would send on purpose, by their kind.

A kind is a function of a random generator and an empty folder: it makes the thing there, hands it to the product, and looks
at what comes back. `InputError` is an answer; anything else that is raised is a find.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import pickle
import struct
import zipfile
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError
from isd_gym._common.files import claim_folder, whole_folder, write_text
from isd_gym.physics.network import Network, builtin_networks, linearise
from isd_gym.physics.road import road
from isd_gym.records.data import Table, check, read_table, write_table

if TYPE_CHECKING:
    from collections.abc import Callable

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


def spoil_bytes(rng: Rng, data: bytes, text: bool = False) -> bytes:
    """`data` with a few bytes changed, cut out, doubled or put in; a `text` with what stands in texts."""
    out = bytearray(data)
    for _ in range(1 if rng.random() < 0.4 else int(rng.integers(2, 7))):
        at = int(rng.integers(len(out) + 1))
        way = int(rng.integers(7))
        if text and way in (1, 5):  # a binary number would end it at the first gate
            way = 4
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
    for _ in range(1 if rng.random() < 0.6 else int(rng.integers(2, 5))):
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
    return spoil_bytes(rng, text, text=True) if rng.random() < 0.3 else text


# ------------------------------------------------------------------------------------------------ kinds


def use_network(net: Network) -> None:
    """What every command does with a model before it does anything else."""
    space = linearise(net)
    if not all(np.isfinite(m).all() for m in (space.A, space.B, space.C, space.D)):
        raise AssertionError("a state space that is not finite")
    assert Network.from_dict(json.loads(net.dumps())) == net


#: what the models that come with the package have not: what turns, tables, rates as inputs, a drive with a voltage, noise
TURNS: dict[str, Any] = {
    "schema": "isd-model/1",
    "masses": {"m": 2.0},
    "inertias": {"arm": 0.1},
    "elements": [
        {"name": "k", "type": "linear_stiffness", "between": ["m", "base"], "stiffness": 800.0},
        {"name": "t", "type": "tabulated_force", "between": ["m", "ground"], "elongation": [-0.1, 0.0, 0.1], "force": [-3.0, 0.0, 4.0],
         "interpolation": "smooth", "beyond": "slope"},
        {"name": "v", "type": "tabulated_force", "between": ["m", "base"], "elongation": [-0.1, 0.1], "rate": [-1.0, 0.0, 1.0],
         "force": [[-1.0, 0.0, 1.0], [-2.0, 0.0, 2.0]]},
        {"name": "g", "type": "gravity_sine", "between": ["arm", "ground"], "torque": 1.5},
        {"name": "d", "type": "linear_damping", "between": ["arm", "ground"], "damping": 0.01},
    ],
    "inputs": [
        {"name": "shaker", "quantity": "acceleration", "at": "base", "unit": "m/s^2"},
        {"name": "twist", "quantity": "torque", "at": "arm", "unit": "N m"},
    ],
    "outputs": [
        {"name": "a", "quantity": "acceleration", "at": "m", "unit": "g", "noise": 0.01, "offset": "free"},
        {"name": "w", "quantity": "angle", "at": "arm", "unit": "deg"},
    ],
    "uncertainty": {"k.stiffness": 0.05},
}  # fmt: skip


@cache
def _models() -> list[str]:
    try:
        return [
            *(Network.load(name).dumps() for name in builtin_networks()),
            Network.from_dict(TURNS).dumps(),
        ]
    except InputError as error:  # else every try would be refused
        raise AssertionError("what the tries begin with is refused") from error


def models(rng: Rng, folder: Path) -> None:
    tree = json.loads(pick(rng, _models()))
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
    (folder / "t.csv").write_bytes(spoil_bytes(rng, text, text=True) if rng.random() < 0.75 else text)
    if head[1].startswith("height") or rng.random() < 0.1:
        road(folder / "t.csv")
    else:
        table = read_table(folder / "t.csv", expected=pick(rng, (None, {"x": "m"}, {})))
        assert all(len(c) == len(table) for c in table.columns.values())


def binary(suffix: str) -> Callable[[Rng, Path], None]:
    @cache
    def seeds() -> list[bytes]:
        out = []
        with TemporaryDirectory() as place:
            path = Path(place) / f"t{suffix}"
            for n in (3, 40):
                t = np.arange(n) * 1e-3
                write_table(path, Table(t, {"x": np.sin(t), "y": t**2}, units={"x": "m"}))
                out.append(path.read_bytes())
        return out

    def tries(rng: Rng, folder: Path) -> None:
        path = folder / f"t{suffix}"
        path.write_bytes(spoil_bytes(rng, pick(rng, seeds())))
        table = read_table(path, expected=pick(rng, (None, {"x": "m"}, {})))
        assert all(len(c) == len(table) for c in table.columns.values())

    return tries


def use_policy(policy: Any, rng: Rng) -> None:
    for _ in range(3):
        seen = rng.standard_normal(policy.signals) * 10.0 ** rng.uniform(-3, 12)
        current = np.atleast_1d(policy.act(seen))
        assert np.isfinite(current).all() and np.abs(current).max() <= 5.0, current


@cache
def _shipped(name: str) -> tuple[str, bytes]:
    """The shipped policy: its JSON without the parts that are long and only told, and its weights."""
    from isd_gym.agents.policy import JSON_NAME, SHIPPED, WEIGHTS_NAME

    head = json.loads((SHIPPED / name / JSON_NAME).read_text())
    for part in ("training", "score"):
        head.pop(part, None)
    return json.dumps(head), (SHIPPED / name / WEIGHTS_NAME).read_bytes()


def policies(rng: Rng, folder: Path) -> None:
    from isd_gym.agents.policy import JSON_NAME, WEIGHTS_NAME, Policy

    told, blob = _shipped(pick(rng, ("ppo", "sac", "ppo-half-car")))
    head = json.loads(told)
    if rng.random() < 0.3:
        size = 8 + struct.unpack("<Q", blob[:8])[0]
        blob = spoil_bytes(rng, blob[:size]) + blob[size:] if rng.random() < 0.7 else spoil_bytes(rng, blob)
        head["weights"]["sha256"] = hashlib.sha256(blob).hexdigest()
        text = json.dumps(head).encode()
    else:
        if rng.random() < 0.9:
            head.pop("network", None)  # so that the rest is met more often
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
    inner = zipped(parts | {"w/data.pkl": body, "w/byteorder": b"little", "w/version": b"3\n"})
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
    from isd_gym.contrib.exports.archives import convert, read_normalize

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

    from isd_gym.physics import elements as el

    nodes = [f"n{i}" for i in range(int(rng.integers(1, 8)))]
    kinds = [t for t, c in el.TYPES.items() if c.place == "between" and not (c.scheduled or c.loaded)]

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


def stand(rng: Rng, folder: Path) -> Path:
    """Something, or nothing, at the place where the next is to write; beside it what is dear to somebody. Returns the place."""
    place, other = folder / "place", folder / "other"
    other.mkdir()
    (other / "dear.txt").write_text("dear")
    way = int(rng.integers(6))
    if way == 1:
        place.write_text("old")
    elif way == 2:
        place.symlink_to(pick(rng, (other, other / "dear.txt", folder / "nothing", place)))
    elif way == 3:
        os.mkfifo(place)
    elif way > 3:
        place.mkdir()
        names = ["mark.json", "page.html", "notes.txt", "mark.json", "a" * 200, "-rf", "\x1b[31m", "é"]
        for name in {str(n) for n in rng.choice(names, int(rng.integers(0, 4)))}:
            kind = rng.random()
            if kind < 0.7:
                (place / name).write_text("old")
            elif kind < 0.8:
                (place / name).mkdir()
            else:
                (place / name).symlink_to(pick(rng, (other, other / "dear.txt", other / "nothing")))
    if rng.random() < 0.2:  # what a process that was killed left
        (folder / ".isd-gym-dead" / "earlier" / pick(rng, ("place", "gone"))).mkdir(parents=True)
    return place


def writes(rng: Rng, folder: Path) -> None:
    """A folder or a file is written where something stands: then the new is there, or all is as it was, and nothing else touched."""
    place = stand(rng, folder)
    before, how, stops = seen(folder), int(rng.integers(3)), rng.random() < 0.2
    done = False
    try:
        if how == 0:
            with whole_folder(place, "page", "mark.json", ("mark.json", "page.html")) as made:
                (made / "mark.json").write_text("new")
                if stops:
                    raise InputError("stops")
        elif how == 1 and not place.is_fifo():  # a pipe waits for its reader
            write_text(place, "new")
        else:
            claim_folder(place, "page", "mark.json", ("mark.json", "page.html"))
        done = True
    finally:
        _compare(before, seen(folder), done, how)


def _compare(before: dict[str, str], after: dict[str, str], done: bool, how: int) -> None:
    """Of everything seen before and after a write of kind `how`: what may differ, and nothing else."""

    def outside(what: dict[str, str]) -> dict[str, str]:
        return {k: v for k, v in what.items() if not k.startswith(("place", "gone", ".isd-gym"))}

    def inside(what: dict[str, str]) -> dict[str, str]:
        return {k: v for k, v in what.items() if k.startswith("place")}

    was, now = outside(before), outside(after)
    if how == 1 and done and before.get("place", "").startswith("link"):
        for name in ("other/dear.txt", "nothing"):  # a file is written through the user's own link
            was.pop(name, None), now.pop(name, None)
    assert now == was, f"touched something else: {was} {now}"
    had, has = inside(before), inside(after)
    if not done:  # a folder that a dead process had taken away is put back
        assert has in (had, had | {"place": "folder"}), f"changed though it refused: {had} {has}"
    elif how == 0:
        assert has == {"place": "folder", "place/mark.json": "new"}, has
    elif how == 1 and had.get("place") != "pipe":
        assert has in ({"place": "new"}, had), has


def seen(folder: Path) -> dict[str, str]:
    """Everything within a folder: path -> text, or what it is; links are not followed."""
    out = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            out[name] = f"link to {os.readlink(path)}"
        elif path.is_dir():
            out[name] = "folder"
        else:
            out[name] = path.read_text() if path.is_file() else "pipe"
    return out


def grids(rng: Rng, folder: Path) -> None:
    """Grids of sweeps, JSON and TOML."""
    from isd_gym.contrib.sweep.grid import Grid

    tree = {
        "policies": ["isd-passive", "lqg"],
        "episodes": 8,
        "batch": 4,
        "duration": 2.0,
        "axes": {"speed": [10.0, 20.0], "road": ["paper", "C"], "noise": [0.0, 1.0]},
        "conditions": [{"name": "heavy", "factors": {"body.mass": 1.2}, "delay": 1, "preview": 0.1}],
    }
    if rng.random() < 0.3:
        text = (
            'policies = ["isd-passive", "lqg"]\nepisodes = 8\nbatch = 4\nduration = 2.0\n[axes]\nspeed = [10.0, 20.0]\n'
            '[[conditions]]\nname = "heavy"\nfactors = { "body.mass" = 1.2 }\n'
        )
        path = folder / "g.toml"
        path.write_bytes(spoil_bytes(rng, text.encode(), text=True))
    else:
        path = folder / "g.json"
        path.write_bytes(spoil_json(rng, tree))
    for task in Grid.load(path).tasks()[:3]:
        json.dumps(task.arguments, allow_nan=False)


def records(rng: Rng, folder: Path) -> None:
    """The data gate on channels that no rig measures."""
    n = int(rng.choice([1, 2, 3, 199, 200, 201, 260]))
    t = np.arange(n) * 10.0 ** float(rng.choice([-3.0, -2.0, -2.0, -7.0, 3.0]))

    def channel() -> np.ndarray:
        x = rng.standard_normal(n) * 10.0 ** float(rng.choice([-300, -9, -2, 0, 3, 9, 150, 300]))
        way = int(rng.integers(8))
        if way == 0:
            x[:] = x[0]
        elif way == 1:
            x = np.round(x)
        elif way == 2:
            x[int(rng.integers(n)) :] = pick(rng, (0.0, np.nan, np.inf, 1e308))
        elif way == 3:
            x = np.cumsum(x)
        elif way == 4:
            x = np.clip(x, -np.abs(x).mean(), np.abs(x).mean())
        elif way == 5:
            x = np.repeat(x, 5)[:n]
        elif way == 6:
            x[rng.random(n) < 0.05] *= 1e6
        return x

    if rng.random() < 0.3:
        at = int(rng.integers(n))
        t[at] = pick(rng, (np.nan, np.inf, 0.0, -1.0, 1e308, t[at] + 1e-4))
    table = Table(t, {"x": channel(), "y": channel(), "z": channel()})
    kinds = ("displacement", "velocity", "acceleration", "force", "current")
    with np.errstate(all="ignore"):
        found = check(
            table, inputs={"x": pick(rng, kinds)}, outputs={"y": pick(rng, kinds), "z": pick(rng, kinds)}
        )
    for finding in found:
        assert str(finding).isprintable() and len(str(finding)) < 1000, finding


def roads(rng: Rng, folder: Path) -> None:
    """Names of roads, and what the roads are."""
    words = [
        "paper",
        "A",
        "H",
        "iso-C",
        "bump",
        "pothole",
        "sweep",
        "flat",
        "+",
        "++",
        " ",
        ".",
        "..",
        "/",
        "~",
        "\0",
        "x",
    ]
    text = "".join(str(w) for w in rng.choice(words, int(rng.integers(1, 5))))
    found = road(
        pick(rng, (text, text.encode().decode("latin-1"), spoil_bytes(rng, text.encode()).decode("latin-1")))
    )
    assert found.profile is None or np.isfinite(found.profile).all()


def inspections(rng: Rng, folder: Path) -> None:
    """Loggers' files, with stamps of all sorts, gaps and repeats, looked at as `isd-gym inspect` does."""
    from isd_gym.contrib.inspection import inspect, lines

    n = int(rng.integers(2, 80))
    way = int(rng.integers(4))
    t = np.cumsum(rng.choice([0.01, 0.01, 0.01, 0.0, 0.5, -0.02], n, p=[0.5, 0.2, 0.2, 0.04, 0.04, 0.02]))
    stamps = [
        [f"{x:.4f}" for x in t],
        [f"2024-05-01T12:00:{x % 60:06.3f}" for x in t],
        [f"{1.7e9 + x:.3f}" for x in t],
        [f"12:00:{x % 60:06.3f}" for x in t],
    ][way]
    head = pick(rng, ("time,x [mm],y", "Zeit [s],x,y", "timestamp,acc_z (g),y [N]", "clock,x,x"))
    rows = [
        f"{s},{v:.5g},{w:.5g}"
        for s, v, w in zip(stamps, rng.standard_normal(n), np.cumsum(rng.standard_normal(n)), strict=True)
    ]
    text = "\n".join([head, *rows]).encode()
    (folder / "l.csv").write_bytes(spoil_bytes(rng, text, text=True) if rng.random() < 0.8 else text)
    with np.errstate(all="ignore"):
        found = inspect([folder / "l.csv"])
        json.dumps(found.to_dict(), allow_nan=False)
        assert all(line.isprintable() for line in lines(found))


@cache
def _car() -> Network:
    return Network.load("quarter-car-isd")


def maps(rng: Rng, folder: Path) -> None:
    """Test channel maps with random contents."""
    from isd_gym.contrib.inspection.map_file import map_content
    from isd_gym.records._loggers import ChannelMap

    tree = {
        "schema": "isd-map/1",
        "model": "rig",
        "loggers": [
            {"file": "a.csv", "stamps": {"column": "t", "unit": "ms"}, "lag": 0.01},
            {"file": "b.csv"},
        ],
        "channels": {
            "road": {"logger": 1, "column": "base", "unit": "mm", "sign": -1, "sure": 0.9, "why": "its name"},
            "current": {"logger": 1, "column": "i", "unit": "A"},
            "suspension_travel": {"logger": 2, "column": "x"},
        },
    }
    (folder / "map.json").write_bytes(spoil_json(rng, tree))
    made = ChannelMap.load(folder / "map.json")
    assert (
        ChannelMap.from_dict(json.loads(json.dumps(map_content(made)))).channels.keys()
        == made.channels.keys()
    )
    made.check(_car())


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
    "writes": writes,
    "grids": grids,
    "records": records,
    "roads": roads,
    "inspections": inspections,
    "maps": maps,
}
#: of a thousand tries: what is read by own code more often than what a library reads in another process
SHARES = {
    "models": 200,
    "csv": 180,
    "parquet": 25,
    "mat": 25,
    "mf4": 5,
    "policies": 100,
    "zips": 130,
    "actions": 120,
    "networks": 65,
    "writes": 40,
    "grids": 40,
    "records": 20,
    "roads": 20,
    "inspections": 20,
    "maps": 10,
}
