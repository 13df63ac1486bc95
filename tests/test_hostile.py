"""Files of strangers: whatever is in them, the answer is a result or one line, and nothing outside is touched."""

import contextlib
import io
import itertools
import json
import os
import pickle
import struct
import sys
import zipfile
import zlib
from dataclasses import fields
from pathlib import Path
from time import process_time

import builders
import numpy as np
import pytest
from builders import channel, damper, spring
from isd_gym.agents._archives import (
    convert,
    read_normalize,
    read_pickle,
    read_torch,
)
from isd_gym.agents.policy import (
    JSON_NAME,
    SHIPPED,
    WEIGHTS_NAME,
    Head,
    Policy,
    read_safetensors,
)
from program import assert_one_line, python, read_json, refused, run, save_json

from isd_gym import InputError, Network, Table, linearise, read_table, simulate
from isd_gym._common.errors import plain, shown
from isd_gym._common.files import claim_folder, whole, whole_folder
from isd_gym.benchmark.policies import find
from isd_gym.benchmark.sweep.conditions import Grid, sweep
from isd_gym.benchmark.sweep.grid import belongings
from isd_gym.benchmark.sweep.items import stored
from isd_gym.physics import elements as el
from isd_gym.physics.elements import register_file
from isd_gym.physics.road import road
from isd_gym.records.data import _isolated as isolated
from isd_gym.records.data import write_table


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("score passive --duration inf", "--duration must be a finite number"),
        ("score passive --speed inf", "--speed must be a finite number"),
        ("score passive --episodes 1 --duration 1e12", "GB of memory"),
        ("score passive --duration 0.01 --episodes 1000000000000", "GB of memory"),
        (
            "score passive --duration 0.01 --episodes 99999999999999999999",
            "GB of memory",
        ),
        ("show passive --seconds 1e12", "--seconds: a drive"),
    ],
)
def test_a_huge_number_on_the_command_line_is_one_line(words, says):
    done = run(words)
    assert_one_line(done, says)
    assert not done.stdout


def test_names_are_shown_in_one_line_that_steers_nothing():
    assert shown("body") == "'body'" and shown("Straße 7 µm²") == "'Straße 7 µm²'"
    assert shown("a\nisd-gym: all fine") == r"'a\nisd-gym: all fine'"
    assert shown("\x1b[31mred\u202e\ud800\u2028") == r"'\x1b[31mred\u202e\ud800\u2028'"
    assert len(shown("x" * 10_000)) < 100
    assert (
        shown(10**400) == "a whole number of 401 digits"
        and shown({"a": 1}) == "an object"
    )
    assert str(InputError("first\nsecond\r\x1b[2J")) == r"first\nsecond\r\x1b[2J"
    assert len(str(InputError("x" * 100_000))) <= 1200
    assert plain("ok") == "ok"


@pytest.mark.parametrize(
    "name", ["x" * 5000, "x" * 300 + ".csv", "a\0b", "~" * 300 + "/policy.json"]
)
def test_a_name_that_no_file_can_have_is_one_line(name, tmp_path):
    for use in (Network.load, Policy.load, read_table, road, Grid.load, register_file):
        refused("", use, name)
    refused("", find, name, Network.load("quarter-car-isd"))
    refused("", claim_folder, tmp_path / name, *PLACE)
    refused("", whole_folder(tmp_path / name, *PLACE).__enter__)
    refused("", whole(tmp_path / name).__enter__)


def test_a_folder_of_a_sweep_may_hold_anything(tmp_path):
    """What is no result is done again; links and what belongs to somebody are left alone."""
    grid = Grid.from_dict({"policies": ["isd-passive"], "episodes": 1, "duration": 0.1})
    merged, _ = sweep(grid, tmp_path / "out")
    folder = tmp_path / "out" / "items"
    items = sorted(folder.iterdir())
    good = read_json(items[0])
    result = good["result"]
    strange = [{}, [], None, result | {"measures": {}}, result | {"fallbacks": "many"}]
    for name, value in {"tyre_load_rms": -1.2e15, "current_rms": 10**40, "cost": True}.items():  # fmt: skip
        strange.append(result | {"measures": result["measures"] | {name: [value]}})
    texts = [json.dumps(good | {"result": one}) for one in strange]
    for text in [*texts, "[" * 100_000, json.dumps(good | {"key": "another"})]:
        items[0].write_text(text)
        assert len(stored(grid.all_items(), folder)) == len(items) - 1
    assert sweep(grid, tmp_path / "out")[0] == merged
    (tmp_path / "dear").write_text("dear")
    items[0].unlink()
    items[0].symlink_to(tmp_path / "dear")
    refused("a link", sweep, grid, tmp_path / "out")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("dear")
    refused("thesis.tex", sweep, grid, tmp_path / "mine")
    assert (tmp_path / "dear").read_text() == "dear"


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="no endless file")
def test_a_grid_that_names_an_endless_file_is_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert belongings(["/dev/zero", str(tmp_path / "pipe"), "a\0b", "x" * 5000]) == {}


class Calls:
    """Pickles as a call of whatever is asked for."""

    def __init__(self, made, *args, state=None):
        self.parts = (made, args) if state is None else (made, args, state)

    def __reduce__(self):
        return self.parts


def torch_file(state):
    """A state dict's file whose tensors are described by `state`: name -> (size, stride, offset), 24 floats stored."""

    def text(value):
        return b"X" + struct.pack("<I", len(value)) + value.encode()

    def whole_number(value):
        return b"\x8a\x08" + struct.pack("<q", value)

    def tuple_of(values):
        return b"(" + b"".join(map(whole_number, values)) + b"t"

    out = b"\x80\x02}("
    for name, (size, stride, offset) in state.items():
        out += text(name) + b"ctorch._utils\n_rebuild_tensor_v2\n("
        out += (
            b"("
            + text("storage")
            + b"ctorch\nFloatStorage\n"
            + text("0")
            + text("cpu")
            + whole_number(24)
        )
        out += b"tQ" + whole_number(offset) + tuple_of(size) + tuple_of(stride)
        out += b"\x89ccollections\nOrderedDict\n)RtR"
    numbers = np.arange(24, dtype="<f4").tobytes()
    return zipped({"w/data.pkl": out + b"u.", "w/version": b"3\n", "w/data/0": numbers})


def zipped(parts):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    return buffer.getvalue()


@pytest.mark.parametrize(
    "tensor",
    [
        ((4,), (-1_000_000,), 0),  # four megabytes before the buffer
        ((4,), (1,), -8),
        ((5, 5), (5, 1), 0),
        ((2,), (2**62,), 0),
        ((2**62, 2**62), (0, 0), 0),
        ((10**9,), (0,), 0),  # four gigabytes out of one number
        ((-1,), (1,), 0),
    ],
)
def test_a_tensor_outside_its_buffer_is_refused(tensor):
    refused("not weights saved by torch", read_torch, torch_file({"a": tensor}), "w")


def normalize_file(path, mean):
    """A saved VecNormalize whose mean is the pickled `mean`."""
    rms = Calls(Plain, state={"mean": mean, "var": np.ones(6)})
    thing = Calls(Plain, state={"obs_rms": rms, "epsilon": 1e-8, "clip_obs": 10.0})
    path.write_bytes(pickle.dumps(thing, 4))
    return path


class Plain:
    pass


#: constructors that numpy pickles, under the names of the installed version
RECONSTRUCT, SCALAR = np.zeros(0).__reduce__()[0], np.float64(0.0).__reduce__()[0]
HOSTILE_MEANS = {
    "pointers of bytes": Calls(np.ndarray, (1, 6), "O", b"\x41" * 48),
    "objects in disguise": Calls(
        np.ndarray, (6,), Calls(np.dtype, "V8", False, True, state=(3, "|", None, ("a",), {"a": (np.dtype("O"), 0)}, 8, 1, 0)), b"\x41" * 48
    ),
    "a dtype's state": Calls(
        RECONSTRUCT, np.ndarray, (0,), b"b",
        state=(1, (6,), Calls(np.dtype, "f8", False, True, state=(3, "|", None, None, None, 8, 1, 63)), False, b"\x41" * 48),
    ),
    "a dtype of objects": Calls(
        RECONSTRUCT, np.ndarray, (0,), b"b",
        state=(1, (6,), np.dtype("O"), False, [1] * 6),
    ),
    "objects": np.array([None] * 6, object),
    "code": Calls(os.system, "exit 1"),
    "less than told": Calls(
        RECONSTRUCT, np.ndarray, (0,), b"b",
        state=(1, (2**40,), np.dtype("f8"), False, b"\x00" * 48),
    ),
    "a scalar of objects": Calls(SCALAR, np.dtype("O"), b"\x41" * 8),
    "not finite": np.full(6, np.nan),
}  # fmt: skip


@pytest.mark.parametrize("how", HOSTILE_MEANS)
def test_no_array_is_made_of_a_pickle_s_own_constructors(how, tmp_path):
    if (
        how == "a dtype's state"
    ):  # its flags say "objects inside": passed over, the numbers are numbers
        mean, _, _ = read_normalize(
            normalize_file(tmp_path / "n.pkl", HOSTILE_MEANS[how])
        )
        assert (
            mean.dtype == np.float64 and (mean == np.frombuffer(b"\x41" * 8)[0]).all()
        )
        return
    path = normalize_file(tmp_path / "n.pkl", HOSTILE_MEANS[how])
    refused("is not a saved VecNormalize", read_normalize, path)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x80\x04.",
        b"\x80\x04(((((",
        b"r\xff\xff\xff\x7f.",  # a memo of two thousand million places
        b"\x80\x04N" + b"\x85" * 200_000 + b".",  # a tuple in a tuple in ...
        b"\x80\x04}" + b"N" + b"\x85" * 200_000 + b"Ns.",  # ... as a key
        b"L" + b"9" * 5000 + b"L\n.",
        b"cos\nsystem\n(S'exit 1'\ntR.",
        b"\x80\x04\x95\xff\xff\xff\xff\xff\xff\xff\x7fN.",
    ],
)
def test_a_hostile_pickle_is_an_outline_or_one_line(data):
    with contextlib.suppress(InputError):
        read_pickle(data)


def archive(path, data=None, parts=None, **change):
    """A Stable-Baselines3 PPO archive of one hidden layer, without Stable-Baselines3."""
    shapes = {
        "mlp_extractor.policy_net.0.weight": ((4, 6), (6, 1), 0),
        "mlp_extractor.policy_net.0.bias": ((4,), (1,), 0),
        "action_net.weight": ((1, 4), (4, 1), 0),
        "action_net.bias": ((1,), (1,), 0),
    } | (parts or {})
    box = {":type:": "<class 'gymnasium.spaces.box.Box'>"}
    data = data or {
        "observation_space": box | {"_shape": [6]},
        "action_space": box | {"_shape": [1], "high": "[1.]"},
        "policy_kwargs": {},
    }  # fmt: skip
    weights = torch_file({k: v for k, v in shapes.items() if v})
    path.write_bytes(zipped({"data": json.dumps(data | change), "policy.pth": weights}))
    return path


BOX = {":type:": "Box"}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"observation_space": BOX | {"_shape": 5}}, "shape 5"),
        ({"observation_space": 5}, "not a Box"),
        (
            {"action_space": BOX | {"_shape": [1], "high": "much"}},
            "bound of its actions is 'much'",
        ),
        ({"action_space": BOX | {"_shape": [10**400]}}, "digits"),
        (
            {"policy_kwargs": {"activation_fn": "\x1b[31m"}},
            r"activation '\\x1b\[31m' is not supported",
        ),
    ],
)
def test_an_archive_s_description_may_be_anything(change, says, tmp_path):
    refused(says, convert, archive(tmp_path / "m.zip", **change))


def test_broken_archives_are_one_line(tmp_path):
    path = tmp_path / "m.zip"
    assert convert(archive(path)).act(np.zeros(6)) == 5.0
    refused(
        "'action_net.bias' is missing",
        convert,
        archive(path, parts={"action_net.bias": None}),
    )
    refused(
        "does not fit",
        convert,
        archive(path, parts={"action_net.weight": ((4,), (1,), 0)}),
    )
    path.write_bytes(zipped({"data": "[1]", "policy.pth": b""}))
    refused("its data is a list", convert, path)
    path.write_bytes(zipped({"data": "[" * 100_000, "policy.pth": b""}))
    refused("levels|not JSON", convert, path)
    path.write_bytes(zipped({"data": '{"a": ' + "9" * 5000 + "}", "policy.pth": b""}))
    refused("5000 digits", convert, path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as bomb:
        for i in range(3):
            with bomb.open(f"part{i}", "w", force_zip64=True) as part:
                for _ in range(200):
                    part.write(bytes(2**20))
    assert path.stat().st_size < 2**20
    refused("would take 0.586 GB", convert, path)


def spoilt(tmp_path, **change):
    """A shipped policy whose policy.json has other values at the given paths ('memory.filter.current')."""
    folder = tmp_path / "policy"
    folder.mkdir(exist_ok=True)
    head = read_json(SHIPPED / "ppo" / JSON_NAME)
    for path, value in change.items():
        *outer, last = path.split(".")
        place = head
        for key in outer:
            place = place[key]
        place[last] = value
    save_json(folder / JSON_NAME, head)
    (folder / WEIGHTS_NAME).write_bytes((SHIPPED / "ppo" / WEIGHTS_NAME).read_bytes())
    return folder


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("memory.filter.current", 99, "reads signal 99"),
        ("memory.filter.current", "text", "place of a signal"),
        ("memory.filter.A", [[1.0]], "shape"),
        ("memory.filter.B", 5, "lists"),
        ("memory.filter.K", [[1e300]], "finite"),
        ("memory.filter.B", [1.0], "filter"),
        ("memory.scale", [0.0] * 6, "scale|memory"),
        ("memory.leak", [[9, 1.0, 1.0]], "leak|memory"),
        ("memory.order", 10**9, "order"),
        ("memory", [], "memory"),
        ("actor.clip", "wide", "clip"),
        ("actor.layers", 5, "layers|len"),
        ("actor.layers", list(range(10_000)), "layer.3"),
        ("actor.activation", ["tanh"], "activation"),
        ("action.limit", 50.0, "limit must be > 0 and at most 5 A, not 50"),
        ("action.mode", "jump", "mode"),
        ("network", "/etc/passwd", "network must be an object"),
        ("weights", None, "garbles"),
        ("training", {"versions": "new"}, "versions must be an object"),
        ("name", "x", None),
    ],
)
def test_a_policy_folder_with_a_strange_value_is_one_line(path, value, says, tmp_path):
    folder = spoilt(tmp_path, **{path: value})
    if says is None:
        assert Policy.load(folder).name == value
    else:
        refused(says, Policy.load, folder)


def test_a_policy_commands_no_more_than_the_limits_and_always_a_number():
    rng = np.random.default_rng(0)
    first = 1e11 * rng.standard_normal((64, 6))
    inner = 1e12 * np.sign(rng.standard_normal((64, 64)))
    weights = [first, *[inner] * 7, rng.standard_normal((1, 64))]
    big = [(np.clip(w, -1e12, 1e12), np.zeros(len(w))) for w in weights]
    for mode in ("target", "increment"):
        policy = Policy(big, activation="relu", head=Head(mode=mode))
        for _ in range(20):
            seen = 10.0 ** rng.uniform(-3, 30, 6) * rng.choice([-1, 1], 6)
            current = policy.act(seen)
            assert np.isfinite(current) and abs(current) <= 5.0
    for name, value in {"limit": 6.0, "slew": 50.0, "keep": 2.0, "gain": np.inf}.items():  # fmt: skip
        refused("", Head, **{name: value})
    ones = [(np.ones((1, 6)), np.zeros(1))]
    for name, value in {"clip": np.nan, "scale": np.zeros(6)}.items():
        refused("", Policy, ones, **{name: value})
    refused("larger", Policy, [(np.full((1, 6), 1e300), np.zeros(1))])


WEIGHT = {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}


@pytest.mark.parametrize(
    "header",
    [
        {"a": WEIGHT | {"data_offsets": [-8, 0]}},
        {"a": WEIGHT | {"shape": [2**40]}},
        {"a": WEIGHT | {"dtype": "O"}},
        {"a": WEIGHT | {"dtype": ["F32"]}},
        {"a": WEIGHT | {"data_offsets": [0, 10**400]}},
        {"a": 5},
        [1],
        {str(i): WEIGHT for i in range(1000)},
    ],
)
def test_a_header_of_weights_may_be_anything(header):
    text = json.dumps(header).encode()
    size = struct.pack("<Q", len(text))
    refused("safetensors|digits", read_safetensors, size + text + bytes(8))
    refused("safetensors", read_safetensors, struct.pack("<Q", 2**63) + text)


def model(**change):
    return Network.load("quarter-car-isd").to_dict() | change


def element(**change):
    data = model()
    data["elements"][0] |= change
    return data


def output(**change):
    data = model()
    data["outputs"][0] |= change
    return data


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (element(type=["linear_stiffness"]), "unknown type a list"),
        (output(quantity={"a": 1}), "unknown quantity an object"),
        (output(unit=["m"]), "unknown unit a list"),
        (element(stiffness=10**400), "must be finite, not a whole number of 401 digits"),
        (element(stiffness=1e308), r"stiffness must be at most 1e\+12 N/m"),
        (element(between=["body", ["wheel"]]), "two node names"),
        (element(between=["body", "a\nisd-gym: all fine"]), r"'a\\nisd-gym: all fine' cannot be a name"),
        (element(name="\x1b[31m"), r"'\\x1b\[31m' cannot be a name"),
        (element(name="x" * 10_000), "cannot be a name"),
        (output(name="=1+1|cmd"), "'=1.1.cmd' cannot begin with =: a spreadsheet takes it as a formula"),
        (model(masses={"body": 10**400}), "positive number of kg"),
        (model(masses={"body": 1e300}), "1e-09 to 1e"),
        (model(masses={str(i): 1.0 for i in range(5000)}), "at most"),
        (model(elements=[{}] * 5000), "at most"),
        (model(uncertainty={"body.mass": 10**400}), "finite"),
        (model(name=["x"]), "name must be a text"),
        (model(schema={"\x1b": 1}), "schema is an object"),
        (model() | {"\x1b[2J\n" * 99: 1}, "unknown key"),
    ],
)  # fmt: skip
def test_a_model_may_hold_anything(data, says):
    refused(says, Network.load, data)


def test_every_number_of_every_element_has_a_hard_limit():
    table = {"elongation": [0.0, 1.0], "force": [0.0, 1.0]}
    for kind, cls in el.TYPES.items():
        usual = {"name": "x", "where": ("a", "b") if cls.place == "between" else ("a",)}
        usual |= table if kind == "tabulated_force" else {}
        numbers = [f for f in fields(cls) if "unit" in f.metadata]
        for f in numbers:
            low = f.metadata["range"][0]
            usual[f.name] = max(low, 1e-3) if np.isfinite(low) else 1.0
        cls(**usual)
        for f in numbers:
            for value in (1.5e33, -1e308, np.nan, 10**400, "1", True, None, [1.0]):
                refused(f"{f.name} must be", cls, **{**usual, f.name: value})


def test_large_networks_answer_or_are_refused_within_seconds():
    def chain(n):
        nodes = ["ground", *(f"n{i}" for i in range(n))]
        pairs = list(enumerate(itertools.pairwise(nodes)))
        links = [spring(a, b, 1e3, f"k{i}") for i, (a, b) in pairs]
        links += [damper(a, b, 1e3, f"c{i}") for i, (a, b) in pairs]
        force = channel("f", "force", nodes[-1])
        return builders.model("", links, [force], masses={m: 1.0 for m in nodes[1:]})

    begin = process_time()
    assert len(linearise(chain(250)).A) == 500
    refused("at most", Network.load, chain(5000))
    assert process_time() - begin < 20


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"\xef\xbb\xbf" + json.dumps(model()).encode(), None),
        (b"[" * 100_000, "levels|not JSON"),
        (b'{"schema": ' + b"[" * 500 + b"]" * 500 + b"}", "levels"),
        (
            b'{"schema": "isd-model/1", "elements": [' + b"9" * 5000 + b"]}",
            "5000 digits",
        ),
        (b'{"schema": NaN}', "NaN is no number"),
        (
            b'{"schema": "isd-model/1", "masses": {"body": 1.0, "body": 345.0}}',
            "key 'body' twice",
        ),
        (b'{"elements": [{"name": "a"}], "elements": []}', "key 'elements' twice"),
        (b'{"schema": 1e999}', "too large"),
        (b'{"schema": "\\ud800"}', "no Unicode text"),
        (b"\xff\xfe{", "not JSON"),
        (b"", "not JSON"),
    ],
)
def test_a_model_s_file_may_hold_anything(content, says, tmp_path):
    path = tmp_path / "m.json"
    path.write_bytes(content)
    if says is None:
        assert Network.load(path) == Network.load("quarter-car-isd")
    else:
        refused(says, Network.load, path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
def test_a_pipe_for_a_file_is_one_line_and_nobody_waits(tmp_path):
    for name in ("m.json", "p/policy.json", "m.zip"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        os.mkfifo(tmp_path / name)
    for call in (
        lambda: Network.load(tmp_path / "m.json"),
        lambda: Policy.load(tmp_path / "p"),
        lambda: convert(tmp_path / "m.zip"),
        lambda: read_normalize(tmp_path / "m.zip"),
    ):
        refused("pipe", call)


PLACE = ("thing", "thing.json", ("thing.json", "*.png"))


def write_thing(folder, text="new"):
    with whole_folder(folder, *PLACE) as place:
        (place / "thing.json").write_text(text)


def test_a_folder_of_somebody_else_is_left_alone(tmp_path):
    write_thing(tmp_path / "a")
    write_thing(tmp_path / "a", "again")
    assert (tmp_path / "a" / "thing.json").read_text() == "again"
    secret = tmp_path / "secret.png"
    secret.write_text("mine")
    (tmp_path / "a" / "plot.png").symlink_to(secret)
    refused("'plot.png', a link", write_thing, tmp_path / "a")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    refused("not a folder", write_thing, tmp_path / "b")
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "thing.json\n").write_text("")
    refused(r"'thing.json\\n'", write_thing, tmp_path / "c")
    refused("", claim_folder, tmp_path / "c", *PLACE)
    assert secret.read_text() == "mine"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b", "c", "secret.png"]


KILLED = """
import os, signal, sys
from pathlib import Path
import isd_gym._common.files as files
where, when = sys.argv[1], sys.argv[2]
die = lambda *a: os.kill(os.getpid(), signal.SIGKILL)
if when == "fallback":  # a system that cannot exchange, killed between the two renames
    files._exchange = lambda a, b: False
    replace, calls = os.replace, []
    def second(a, b):
        calls.append(a)
        die() if len(calls) == 2 else replace(a, b)
    os.replace = second
elif when == "after":
    exchange = files._exchange
    files._exchange = lambda a, b: (exchange(a, b), die())
with files.whole_folder(where, "thing", "thing.json", ("thing.json",)) as place:
    (place / "thing.json").write_text("new")
    if when == "within":
        die()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="kill -9")
@pytest.mark.parametrize(
    ("when", "text"), [("within", "old"), ("fallback", "old"), ("after", "new")]
)
def test_a_kill_at_any_moment_loses_no_folder_and_leaves_nothing_for_long(
    when, text, tmp_path
):
    write_thing(tmp_path / "a", "old")
    assert python(KILLED, tmp_path / "a", when).returncode == -9
    write_thing(tmp_path / "b")  # the next write in that place clears up
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b"]
    assert (tmp_path / "a" / "thing.json").read_text() == text


def test_the_workshop_of_a_living_process_is_not_cleared(tmp_path):
    with (
        whole_folder(tmp_path / "a", *PLACE) as place,
        whole(tmp_path / "x.json") as file,
    ):
        write_thing(tmp_path / "b")
        (place / "thing.json").write_text("still here")
        file.write_text("here too")
    assert (tmp_path / "a" / "thing.json").read_text() == "still here"
    assert (tmp_path / "x.json").read_text() == "here too"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b", "x.json"]


def table(tmp_path, suffix, n=100):
    path = tmp_path / f"t{suffix}"
    write_table(path, Table(np.arange(n) * 1e-3, {"x": np.sin(np.arange(float(n)))}))
    return path


#: begin of a helper's program whose reader of .mat files is another one
OTHER = f"import os, sys; sys.path.append({str(Path(__file__).parents[1])!r}); import isd_gym.records._formats.mat as m; "


def test_a_fault_of_a_library_is_an_error_and_the_next_file_is_read(
    tmp_path, monkeypatch
):
    path = table(tmp_path, ".mat")
    isolated._stop()  # a helper that has read many files ends with the next one
    read_table(path)
    assert isolated._helper is not None
    dies = "m.read = lambda *a: os.kill(os.getpid(), 11)"
    monkeypatch.setattr(isolated, "PROGRAM", OTHER + dies + isolated.PROGRAM)
    isolated._stop()
    refused("library that reads it crashed", read_table, path)
    monkeypatch.undo()
    assert len(read_table(path)) == 100


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of a process")
def test_an_endless_file_is_given_up(tmp_path, monkeypatch):
    path = table(tmp_path, ".mat")
    monkeypatch.setattr(isolated, "SECONDS", 0.1)
    endless = "m.read = lambda *a: [None for _ in iter(int, 1)]"
    monkeypatch.setattr(isolated, "PROGRAM", OTHER + endless + isolated.PROGRAM)
    isolated._stop()
    refused("more than 0 s", read_table, path)
    isolated._stop()


def test_what_would_unpack_to_too_much_is_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setenv("ISD_GYM_READ_LIMIT_GB", "0.02")
    parquet = pytest.importorskip("pyarrow.parquet")
    import pyarrow

    same = pyarrow.array(np.zeros(4_000_000))
    table = pyarrow.table({"time": same, "x": same})
    large = tmp_path / "b.parquet"
    parquet.write_table(table, large, compression="zstd")
    words = "would take .* GB, the limit is 0.02 .*ISD_GYM_READ_LIMIT_GB"
    refused(words, read_table, large)
    head = b"MATLAB 5.0".ljust(124) + b"\x00\x01IM"
    packed = zlib.compress(struct.pack("<II", 14, 2**29) + bytes(60_000_000), 9)
    content = head + struct.pack("<II", 15, len(packed)) + packed
    (tmp_path / "b.mat").write_bytes(content)
    refused("the limit is 0.02", read_table, tmp_path / "b.mat")
    (tmp_path / "b.csv").write_text("time,x\n" + "0,1\n" * 1_000_000)
    refused("the limit is 0.02", read_table, tmp_path / "b.csv")
    monkeypatch.setenv("ISD_GYM_READ_LIMIT_GB", "0.5")
    assert len(read_table(large)) == 4_000_000
    monkeypatch.setenv("ISD_GYM_READ_LIMIT_GB", "much")
    refused("must be a number of gigabytes", read_table, large)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time,x\n0,1\n1," + "9" * 200_000 + "\n", "line 3 has 200002 characters"),
        ("time," + "x" * 200_000 + "\n0,1\n1,2\n", "line 1 has"),
        ('time,x\n0,"' + "a" * 131_060 + "\n", "."),
        (
            ",".join(f"c{i}" for i in range(20_000))
            + "\n"
            + ",".join("1" * 20_000)
            + "\n",
            "20000 columns",
        ),
        ("time,x\x1b[31m\n0,1\n", r"it has: time, x\\x1b\[31m"),
        ("time,x\n0,1\n1,\x1b]0;owned\x07\n", r"'\\x1b\]0;owned\\x07' is not a number"),
    ],
)
def test_a_text_table_may_hold_anything(text, says, tmp_path):
    path = tmp_path / "t.csv"
    path.write_text(text)
    refused(says, read_table, path, expected={"x": "m"})


def test_reading_says_nothing_on_stderr_and_ends_with_its_process(tmp_path):
    """Destructors of the libraries complain about broken files."""
    path = table(tmp_path, ".mf4")
    path.write_bytes(path.read_bytes()[:700] + bytes(4000))
    code = """import sys, os, warnings; warnings.simplefilter("error")
from isd_gym.records.data import _isolated as isolated, read_table
for _ in range(3):
    try: read_table(sys.argv[1])
    except Exception as error: assert type(error).__name__ == "InputError"
print(isolated._helper.process.pid)"""
    done = python(code, path)
    assert (done.returncode, done.stderr) == (0, "")
    with pytest.raises(OSError):
        os.kill(int(done.stdout), 0)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_forked_process_has_a_reader_of_its_own(tmp_path):
    path = table(tmp_path, ".mat")
    code = """import os, sys; from isd_gym.records.data import read_table
read_table(sys.argv[1]); pid = os.fork(); n = len(read_table(sys.argv[1]))
if pid == 0: os._exit(0 if n == 100 else 1)
status = os.waitpid(pid, 0)[1]; n += len(read_table(sys.argv[1])); print(n, status)"""
    done = python(code, path)
    assert (done.stdout, done.stderr) == ("200 0\n", "")


def test_a_record_whose_time_is_no_time_does_not_hang():
    inputs = {"road": np.zeros(3), "current": np.zeros(3)}
    for time, says in (
        ([0, 1e6, 2e6], "larger step"),
        ([0, 1e300, 2e300], "within"),
        ([0, 1e-3, np.inf], "finite"),
    ):
        refused(says, simulate, "quarter-car-isd", np.array(time), inputs)


def test_what_is_not_finite_is_not_written(tmp_path):
    runaway = builders.element(
        "a", "cubic_stiffness", "body", "ground", stiffness=-1e15
    )
    network = Network.load("quarter-car-isd").with_element(
        spring("body", "ground", 1.0, "c")
    )
    network.with_element(runaway).save(tmp_path / "m.json")
    t = np.arange(2000) * 1e-3
    write_table(
        tmp_path / "d.csv", Table(t, {"road": 100 * np.sin(20 * t), "current": 0 * t})
    )
    done = run("simulate m.json d.csv --out o.csv", cwd=tmp_path)
    assert_one_line(done, "fails at t = ")
    assert not (tmp_path / "o.csv").exists()


def spoilt_text(rng, text):
    """Return a text with a few bytes changed, cut out, doubled or put in."""
    out = bytearray(text.encode())
    for _ in range(int(rng.integers(1, 5))):
        at, length = int(rng.integers(len(out))), int(rng.integers(1, 40))
        change = int(rng.integers(4))
        if change == 0:
            out[at] = int(rng.integers(256))
        elif change == 1:
            del out[at : at + length]
        elif change == 2:
            out[at:at] = out[at : at + length]
        else:
            out[at:at] = [
                b"1e400",
                b"-1",
                b"null",
                b"[]",
                b"\x00",
                b"NaN",
                b'"ground"',
                b",",
            ][int(rng.integers(8))]
    return bytes(out)


def rows_of_a_table():
    rows = [f"{0.01 * k:.2f},{np.sin(0.1 * k):.4f},{k % 7}" for k in range(40)]
    return "\n".join(["time,force [kN],travel [mm]", *rows, ""])


SPOILABLE = {
    "model.json": (
        lambda: json.dumps(Network.load("quarter-car-isd").to_dict()),
        linearise,
    ),
    "table.csv": (rows_of_a_table, read_table),
}


@pytest.mark.parametrize("name", SPOILABLE)
def test_a_spoilt_file_is_a_result_or_one_line(name, tmp_path):
    make, use = SPOILABLE[name]
    text, path, answers = make(), tmp_path / name, {"result": 0, "refused": 0}
    for seed in range(100):
        path.write_bytes(spoilt_text(np.random.default_rng(seed), text))
        try:
            with np.errstate(all="ignore"):
                use(str(path))
            answers["result"] += 1
        except InputError as error:
            assert str(error).isprintable()
            answers["refused"] += 1
    assert min(answers.values()) > 0, answers
    assert [p.name for p in tmp_path.iterdir()] == [name]
