"""The command line as a newcomer meets it: right answers, and one helpful line for wrong ones."""

import re
import subprocess
import sys

import numpy as np
import pytest
from program import assert_one_line, python, read_json, run

from isd_gym import Network, score
from isd_gym._commands._score_table import print_score
from isd_gym.benchmark.ceilings import reachable
from isd_gym.benchmark.policies import available, find
from isd_gym.benchmark.scoring import Conditions
from isd_gym.physics.elements import TYPES


def test_the_module_is_the_program_and_tells_its_version():
    done = python(
        "import runpy, sys; sys.argv[1:] = ['--version']; runpy.run_module('isd_gym', run_name='__main__')"
    )
    assert done.stdout.startswith("isd-gym ") and "Python" in done.stdout


def test_help_is_light_and_knows_the_commands_of_all_packages():
    """--help lists train, reproduce, ... with the first sentence of each, and imports none of their libraries."""
    code = (
        "import sys; sys.argv = ['isd-gym', '--help']; from isd_gym._commands import main\n"
        "try: main()\n"
        "except SystemExit: print([m for m in ('numpy', 'numba', 'torch', 'gymnasium') if m in sys.modules])"
    )
    done = python(code)
    assert done.stdout.strip().endswith("[]"), done.stderr
    for words in ("train    Train a policy", "reproduce  Compare every table"):
        assert words in done.stdout
    missed = run("trian")
    assert missed.returncode == 2 and "Did you mean 'train'?" in missed.stderr
    assert "--steps" in run("train --help").stdout


def test_score_ends_with_what_puts_it_in_place(tmp_path):
    """On the benchmark's own roads: the clairvoyant optimum, the causal bound and ceiling."""
    done = run("score passive lqg --full --json", tmp_path / "s.json")
    assert done.returncode == 0, done.stderr
    assert max(map(len, done.stdout.splitlines())) <= 80
    text = " ".join(done.stdout.split())
    for words in (
        "of the gain",
        "Clairvoyant optimum",
        "Causal LQ bound",
        "The causal ceiling is an estimate, not a proven bound",
    ):
        assert words in text
    assert "Left out" not in text
    data = read_json(tmp_path / "s.json")
    known = {"clairvoyant", "clairvoyant_point", "causal_bound", "ceiling_0"}
    assert known <= set(data["references"])
    best = float(
        re.search(r"acceleration (\S+) % at best", data["references"]["causal_bound"])[
            1
        ]
    )
    own = data["policies"][1]["body_acceleration_rms"]
    assert best < 100 * own["low"]  # nobody beats a bound
    point = data["references"][
        "clairvoyant_point"
    ]  # least cost, so less of what it is made of
    assert (
        -0.6 < point["body_acceleration_change"] < -0.2
        and -0.6 < point["suspension_travel_change"] < -0.1
    )
    assert "{" not in text
    ground, row = (
        next(r for r in data["policies"] if r["policy"] == name)
        for name in ("passive", "lqg")
    )
    before, after = (r["cost"]["value"] for r in (ground, row))
    least = reachable(Network.load("quarter-car-isd"), Conditions())["value"].mean()
    assert ground["share_of_reachable_gain"] == 0.0
    assert row["share_of_reachable_gain"] == pytest.approx(
        (before - after) / (before - least)
    )
    assert 0 < row["share_of_reachable_gain"] < row["share_of_causal_gain"] < 1


@pytest.mark.parametrize("word", ["policies", "networks", "card", "--help"])
def test_what_is_piped_has_80_columns(word):
    done = run(word, env={"COLUMNS": "80" if word == "--help" else "200"})
    assert done.returncode == 0, done.stderr
    assert max(map(len, done.stdout.splitlines())) <= 80
    if word == "--help":  # the list of commands is not cut
        assert "..." not in done.stdout.split("Drive and score:")[1]
        assert (
            " ".join(done.stdout.split()).count("with the conventional passive car.")
            == 1
        )


@pytest.mark.parametrize("width", [48, 80, 106, 200])
def test_a_score_folds_no_name_and_loses_no_figure(width, capsys, monkeypatch):
    monkeypatch.setattr("rich.console.Console.width", width)
    result = score(["isd-passive"], "half-car-isd", episodes=2, duration=0.5)
    shares = {f"share_of_{which}_gain": 10.0 for which in ("reachable", "causal", "lq")}
    for row in result.policies:
        row |= shares
    row |= {"policy": "mpc-friction-wheelbase", "fallbacks": 123456}
    row |= {name: 11.0 + i for i, name in enumerate(shares)}
    print_score(result, full=True)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    rows = [line for line in lines if "mpc-friction-wheelbase" in line]
    figures = " ".join(rows).replace("mpc-friction-wheelbase", "").split()
    assert not any("mpc" in line for line in lines if line not in rows)
    shown = {f"{row['cost']['value']:.3f}", f"{row['energy']['value']:.0f}"}
    assert {"1100", "1200", "1300", "123456"} | shown <= set(figures)
    for corner in ("front", "rear"):
        assert f"{row[f'suspension_travel_{corner}_rms']['value'] * 1e3:.2f}" in figures


def test_networks_can_be_printed_and_read_back(tmp_path):
    text = run("networks force-rig").stdout
    (tmp_path / "mine.json").write_text(text)
    assert Network.load(tmp_path / "mine.json") == Network.load("force-rig")
    assert "quarter-car-eq8" in run("networks").stdout


def test_networks_lists_the_element_types():
    text = " ".join(run("networks --elements").stdout.split())
    assert "coulomb_friction F in f Sgn(v); level [N]" in text
    assert all(name in text for name in TYPES)


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ("scroe", "Did you mean 'score'?"),
        ("score passive --road moon", "no road 'moon'"),
        ("score passive --speed -3", "'--speed'"),
        ("score passive --json no/such/folder/x.json", "no folder"),
        ("simulate quarter-car-isd none.csv --out x.csv", "none.csv"),
        ("score", "Missing argument"),
        ("score mpcc", "did you mean 'mpc'?"),
        ("score passive --raod C", "--raod"),
        ("score passive --json there", "it is a folder"),
        (
            "simulate quarter-car-isd d.csv --out o.csv --step 0",
            "--step",
        ),
        ("show mpc --seconds nan --out a.mp4", "seconds"),
        (
            "reproduce --out r --json no/such/x.json",
            "no folder 'no/such'",
        ),
        ("train dqn --out r", "not 'dqn'"),
        ("score passive --network force-rig", "'force-rig' is no car"),
        (
            "score passive --network quater-car-isd",
            "did you mean 'quarter-car-isd'?",
        ),
        ("networks there", "cannot read model 'there': it is a folder"),
        ("sweep robust --out r --shard 9/8", "shard 9/8"),
        ("show mpc --against", "(see isd-gym show --help)"),
    ],
)
def test_a_slip_of_the_pen_is_one_line_and_leaves_nothing(args, message, tmp_path):
    (tmp_path / "there").mkdir()
    assert_one_line(run(args, cwd=tmp_path), message)
    assert [p.name for p in tmp_path.iterdir()] == ["there"]


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("--validate none.csv", "none.csv: no such file"),
        ("--rename road", "--rename wants COLUMN=CHANNEL"),
        ("--unit road=furlong", "furlong"),
        ("--uncertain body.mass=5", "wants a share from 0 to 1"),
        ("--out taken", "notes.txt"),
        ("--json no/such/x.json", "no folder"),
        ("--model nowhere.json", "nowhere"),
        (
            "--unit acceleration=g",
            "--unit: the model has no channel 'acceleration'",
        ),
        ("--unit rod=m", "did you mean 'road'?"),
        ("--rename a=body_acc", "--rename: the model has no channel 'body_acc'"),
        ("./d.csv", "d.csv: is named twice"),
        ("--validate e.csv ./d.csv", "d.csv: is among the records to fit"),
    ],
)
def test_a_diagnosis_is_not_begun_on_a_mistake(more, message, tmp_path):
    """Neither a record that judges itself, nor an option that would be passed over in silence."""
    car = Network.load("quarter-car-isd")
    names = ["time", *(c.name for c in (*car.inputs, *car.outputs))]
    rows = np.outer(0.01 * np.arange(5), np.ones(len(names)))
    np.savetxt(
        tmp_path / "d.csv", rows, delimiter=",", header=",".join(names), comments=""
    )
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "notes.txt").write_text("mine")
    words = "diagnose d.csv --model quarter-car-isd --out found"
    assert_one_line(run(words, more, cwd=tmp_path), message)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["d.csv", "taken"]


@pytest.mark.parametrize(
    ("missing", "args", "extra"),
    [
        pytest.param(
            "pygame",
            "show passive --out a.mp4",
            "render",
            marks=pytest.mark.slow,
        ),
        ("torch", "train ppo --out run", "agents"),
    ],
)
def test_a_missing_extra_is_named(missing, args, extra, tmp_path):
    code = (
        f"import sys; sys.modules[{missing!r}] = None; sys.argv = ['isd-gym', *{args.split()!r}]\n"
        "from isd_gym._commands import main; main()"
    )
    done = python(code, cwd=tmp_path)
    assert_one_line(done, f'pip install ".[{extra}]" in a clone')
    assert not list(tmp_path.iterdir())


#: what runs in the background of a shell ignores Ctrl-C, and its children inherit that
LISTEN = "signal.signal(signal.SIGINT, signal.default_int_handler)"


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_is_one_line_and_leaves_nothing(tmp_path):
    """Stopped in the middle of the drives, whose start the first line of a policy shows."""
    code = (
        "import signal, sys, isd_gym.benchmark.scoring as s; drive = s.drive\n"
        f"{LISTEN}\n"
        "def stopping(*args, **kwargs):\n"
        "    import os, signal; os.kill(os.getpid(), signal.SIGINT); return drive(*args, **kwargs)\n"
        "s.drive = stopping; sys.argv = ['isd-gym', 'score', 'passive', '--report', 'r', '--json', 's.json']\n"
        "from isd_gym._commands import main; main()"
    )
    done = python(code, cwd=tmp_path)
    assert done.returncode == 130, done.stderr
    assert done.stderr == "isd-gym: stopped\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize(
    "then", ["raise RuntimeError('no compiled object yet')", "time.sleep(20)"]
)
def test_ctrl_c_in_a_callback_that_swallows_it(then):
    """As in a callback of the compiler: it goes on, or fails with an error of its own."""
    code = (
        "import sys, time, os, signal, ctypes, isd_gym.benchmark.scoring as s\n"
        f"{LISTEN}\n"
        "@ctypes.CFUNCTYPE(None)\n"
        "def callback():\n"
        "    os.kill(os.getpid(), signal.SIGINT); time.sleep(0.01)\n"
        "def swallowing(*args, **kwargs):\n"
        f"    callback(); {then}\n"
        "s.drive = swallowing; sys.argv = ['isd-gym', 'score', 'passive']\n"
        "from isd_gym._commands import main; main()"
    )
    done = python(code)
    assert (done.returncode, done.stderr) == (130, "isd-gym: stopped\n")


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="its devices")
def test_the_answer_into_a_pipe_a_full_disk_or_a_link(tmp_path):
    """A device is written into, not replaced; a link stays one; what cannot be written is one line."""
    (tmp_path / "link.json").symlink_to("target.json")
    (tmp_path / "target.json").write_text("old")
    program = f"{sys.executable} -m isd_gym"
    told = f"{program} score passive --episodes 1 --duration 0.1 --json"
    for command, code, error in (
        (f"{told} link.json", 0, ""),
        (f"{told} /dev/stdout | cat > piped", 0, ""),
        (
            f"{told} /dev/full",
            2,
            "isd-gym: cannot write '/dev/full' (No space left on device)",
        ),
        (
            f"{program} networks force-rig > /dev/full",
            1,
            "isd-gym: No space left on device",
        ),
        (f"{program} networks quarter-car-isd | true; exit ${{PIPESTATUS[0]}}", 1, ""),
    ):
        shell = ["bash", "-c", command]
        done = subprocess.run(
            shell, capture_output=True, text=True, check=False, cwd=tmp_path
        )
        assert done.stderr.strip() == error
        # a quick program is done before its reader goes
        assert done.returncode == code or "| true" in command
    assert (tmp_path / "link.json").is_symlink()
    assert read_json(tmp_path / "target.json")["schema"] == "isd-score/1"
    assert '"schema": "isd-score/1"' in (tmp_path / "piped").read_text()


def test_nowhere_to_keep_the_kernel_is_one_line():
    """numba's own words where neither the package's folder nor the user's can be written."""
    code = (
        "import sys, numba.core.caching as c\n"
        "c.CacheImpl._locator_classes = []\n"
        "sys.argv = ['isd-gym', 'score', 'passive']\n"
        "from isd_gym._commands import main; main()"
    )
    done = python(code)
    assert_one_line(done, "set NUMBA_CACHE_DIR")


def test_policies_lists_what_can_be_scored(tmp_path):
    done = run("policies --json", tmp_path / "p.json")
    known = read_json(tmp_path / "p.json")["policies"]
    assert known == available() and all(known.values())
    assert {"passive", "isd-passive", "mpc", "lqg", "ppo", "sac"} <= set(known)
    for name in known:
        assert name in done.stdout
        car = name.removeprefix("ppo-") if name.endswith("-car") else "quarter-car"
        assert find(name, Network.load(f"{car}-isd"), speed=20.0).name


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("isd-gym sc", {"score"}), ("isd-gym score mpc-f", {"mpc-friction"}), ("isd-gym networks force", {"force-rig"}),
     ("isd-gym train --rand", {"--randomize"})],
)  # fmt: skip
def test_the_shell_completes(typed, offered):
    asked = {"COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" "))}
    done = run(env={"_ISD_GYM_COMPLETE": "complete_bash", **asked})
    assert offered <= set(done.stdout.split()), done.stdout + done.stderr
