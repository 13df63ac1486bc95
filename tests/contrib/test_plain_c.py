"""A policy and the friction MPC as C: compiled without a warning, it commands what Python commands, to rounding."""

import ctypes
import json
import shutil
import subprocess

import gymnasium as gym
import numpy as np
import pytest
from program import assert_one_line, refused, run

from isd_gym import baselines
from isd_gym.agents._memory import Memory
from isd_gym.agents.policy import SHIPPED, Head, Policy
from isd_gym.contrib.exports import mpc_in_c
from isd_gym.contrib.exports.policy_in_c import export_c
from isd_gym.physics._vehicle import vehicle
from isd_gym.physics.network import Network

compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_compiler = pytest.mark.skipif(compiler is None, reason="no C compiler")
NAMES = sorted(p.parent.name for p in SHIPPED.glob("*/policy.json"))


def _library(source, folder):
    """The source, compiled without a warning."""
    library = folder / "own.so"
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off"]
    subprocess.run([compiler, *flags, "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def _compiled(policy, folder):
    """(reset, step) of the policy as C, through a shared library."""
    header, source = export_c(policy, folder)
    loaded = _library(source, folder)
    name, width = source.stem, policy.weights[0][0].shape[1]
    step = getattr(loaded, f"{name}_step")
    met = 0 if policy.memory.echo is None else policy.memory.echo.weights(policy.memory.step)[:, :, 0].size
    late = policy.memory.late
    past = (max(policy.memory.ages) + 1) * len({column for column, _, _ in late}) if late else 0
    state, several = (ctypes.c_float * (width + met + past + 16))(), (ctypes.c_float * policy.currents)()

    def command(observation):
        row = np.ascontiguousarray(observation, np.float32).ctypes.data_as(ctypes.POINTER(ctypes.c_float))
        if policy.currents > 1:
            step.restype = None
            step(state, row, several)
            return np.array(several)
        step.restype = ctypes.c_float
        return float(step(state, row))

    return lambda: getattr(loaded, f"{name}_reset")(state), command, header.read_text()


def _observations(policy, steps):
    kind = policy.info["env"]["id"]
    env = gym.make(kind, observation=policy.observation, preview=policy.preview or None)
    obs, _ = env.reset(seed=3)
    policy.reset()
    seen = [obs]
    for _ in range(steps - 1):
        obs, *_ = env.step(np.atleast_1d(policy.act(obs)))
        seen.append(obs)
    return np.array(seen)


@needs_compiler
@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_policy_is_the_same_in_c(name, tmp_path):
    policy = Policy.load(name)
    reset, command, header = _compiled(policy, tmp_path / "c")
    seen = _observations(policy, 400)
    assert np.abs(seen[:, policy.signals - policy.currents : policy.signals]).max() > 1.0  # it drives
    # sums in single precision in another order, over a recursion: NumPy's order differs between processors (2e-4 A or less on
    # some, 3.5e-4 A on others for the estimate of a whole car), the C code's does not
    close = 2e-4 if policy.currents == 1 else 5e-4
    for _ in range(2):  # a reset forgets everything
        policy.reset()
        reset()
        own = [policy.act(row) for row in seen]
        np.testing.assert_allclose([command(row) for row in seen], own, atol=close)
    assert "body_acceleration [m/s^2]" in header and "0.005 s" in header


@needs_compiler
@pytest.mark.parametrize("mode", ["target", "increment"])
@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_heads_activations_and_broken_readings(mode, activation, tmp_path):
    rng = np.random.default_rng(0)
    memory = Memory((1.0, 0.01, 0.2, 0.01, 0.05, 2.5), (0.3,) * 6, order=2, leak=((0, 1.0, 0.1),), ahead=3)
    width = memory.width(6)
    weights = [(rng.normal(size=(8, width)), rng.normal(size=8)), (rng.normal(size=(1, 8)), np.zeros(1))]
    heads = {"head": Head(mode), "activation": activation, "output": "tanh", "name": "7 of*/9"}
    policy = Policy(weights, memory=memory, **heads)
    reset, command, _ = _compiled(policy, tmp_path)
    reset()
    rows = rng.normal(size=(30, 9)).astype(np.float32) * 0.1
    rows[7, 2] = np.nan
    rows[9, 0] = np.inf
    own = [policy.act(row) for row in rows]
    np.testing.assert_allclose([command(row) for row in rows], own, atol=2e-5)


@needs_compiler
@pytest.mark.parametrize("speed", [20.0, 11.0])
def test_a_history_of_a_whole_car_is_the_same_in_c(speed, tmp_path):
    """The front corners, as they were, move with the speed: 2.7 m are 27 or 49 control steps."""
    rng = np.random.default_rng(0)
    memory = Memory.of(vehicle(Network.load("full-car-isd")))
    width = memory.width(23)
    first = 0.2 * rng.normal(size=(8, width)), rng.normal(size=8)
    weights = [first, (rng.normal(size=(4, 8)), np.zeros(4))]
    policy = Policy(weights, memory=memory, head=Head("increment"), activation="tanh", output="clip")
    policy = policy.at_speed(speed)
    assert max(policy.memory.ages) == round(2.7 / speed / 5e-3)
    assert Memory.from_dict(json.loads(json.dumps(policy.memory.to_dict()))) == policy.memory
    reset, command, header = _compiled(policy, tmp_path)
    rows = rng.normal(size=(120, 23)).astype(np.float32) * np.array(memory.scale, np.float32)
    for _ in range(2):
        reset(), policy.reset()
        own = [policy.act(row) for row in rows]
        np.testing.assert_allclose([command(row) for row in rows], own, atol=2e-4)
    assert f"for {speed:g} m/s" in header


def test_onnx_does_not_pretend_to_know_the_road(tmp_path):
    pytest.importorskip("onnx")
    from isd_gym.contrib.exports.onnx import export_onnx

    refused("--c DIR", export_onnx, Policy.load("ppo-preview-0.1"), tmp_path / "p.onnx")


def _compiled_mpc(controller, folder):
    header, source = mpc_in_c.export_c(controller, folder)
    loaded = _library(source, folder)
    step, reset = getattr(loaded, f"{source.stem}_step"), getattr(loaded, f"{source.stem}_reset")
    step.restype = ctypes.c_double
    state = (ctypes.c_double * 4096)()

    def command(observation):
        row = np.ascontiguousarray(observation, float)
        return step(state, row.ctypes.data_as(ctypes.POINTER(ctypes.c_double)))

    return lambda: reset(state), command, header.read_text()


@needs_compiler
@pytest.mark.parametrize("name", ["mpc-friction", "mpc-friction-preview", "mpc-robust"])
@pytest.mark.parametrize("road", ["paper", "E"])
def test_the_mpc_is_the_same_in_c(name, road, tmp_path):
    options = {"preview": 0.1} if "preview" in name else {}
    controller = baselines.make(name, **options)
    reset, command, header = _compiled_mpc(controller, tmp_path)
    looks = {"observation": controller.observation, "preview": controller.preview or None}
    env = gym.make("ISDSuspension-v0", road=road, **looks)
    obs, _ = env.reset(seed=3)
    controller.reset()
    seen, own = [], []
    for _ in range(500):
        seen.append(obs)
        own.append(controller.act(obs))
        obs, *_ = env.step(np.array([own[-1]]))
    assert np.abs(own).max() > (3.0 if road == "E" else 1.0)  # E is at the limits and on the end stop
    for _ in range(2):  # a reset forgets everything
        reset()
        # the plan ends where it stops to improve: sums in another order move a command by less than a microampere
        np.testing.assert_allclose([command(row) for row in seen], own, rtol=0.0, atol=1e-6)
    assert "body_acceleration [m/s^2]" in header and "0.005 s" in header


@needs_compiler
def test_broken_readings_are_what_python_makes_of_them(tmp_path):
    controller = baselines.make("mpc-friction")
    reset, command, _ = _compiled_mpc(controller, tmp_path)
    reset()
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(40, 6)) * [1.0, 0.01, 0.2, 0.01, 0.05, 1.0]
    rows[7, 2], rows[9, 0], rows[12, 5], rows[13, 5], rows[20, 1] = np.nan, np.inf, np.nan, 40.0, -1e300
    own = [controller.act(row) for row in rows]
    assert np.isfinite(own).all()
    np.testing.assert_allclose([command(row) for row in rows], own, atol=1e-7)


def test_what_has_no_c_is_one_line(tmp_path):
    refused("no C for 'lqg'", mpc_in_c.export_c, baselines.make("lqg"), tmp_path)
    bare = baselines.make("mpc-friction", model="quarter-car-passive")
    refused("car with a motor", mpc_in_c.export_c, bare, tmp_path)


def test_the_command_writes_it(tmp_path):
    done = run("convert", "mpc-friction", "--c", tmp_path / "c")
    assert done.returncode == 0 and (tmp_path / "c" / "mpc_friction.h").is_file(), done.stderr
    refused = run("convert", "mpc-friction", "--onnx", tmp_path / "x.onnx")
    assert_one_line(refused, "with --c DIR alone")
