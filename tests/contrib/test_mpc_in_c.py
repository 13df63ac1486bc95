"""The friction MPC as C: compiled without a warning, it commands what Python commands, to rounding."""

import ctypes
import shutil
import subprocess

import gymnasium as gym
import numpy as np
import pytest
from program import assert_one_line, run

from isd_gym import baselines
from isd_gym._common.errors import InputError
from isd_gym.contrib.exports.mpc_in_c import export_c

compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_compiler = pytest.mark.skipif(compiler is None, reason="no C compiler")
FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off"]


def _compiled(controller, folder):
    header, source = export_c(controller, folder)
    library = folder / "mpc.so"
    subprocess.run([compiler, *FLAGS, "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True)
    loaded = ctypes.CDLL(str(library))
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
    reset, command, header = _compiled(controller, tmp_path)
    env = gym.make(
        "ISDSuspension-v0", road=road, observation=controller.observation, preview=controller.preview or None
    )
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
    reset, command, _ = _compiled(controller, tmp_path)
    reset()
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(40, 6)) * [1.0, 0.01, 0.2, 0.01, 0.05, 1.0]
    rows[7, 2], rows[9, 0], rows[12, 5], rows[13, 5], rows[20, 1] = np.nan, np.inf, np.nan, 40.0, -1e300
    own = [controller.act(row) for row in rows]
    assert np.isfinite(own).all()
    np.testing.assert_allclose([command(row) for row in rows], own, atol=1e-7)


def test_what_has_no_c_is_one_line(tmp_path):
    with pytest.raises(InputError, match="no C for 'lqg'"):
        export_c(baselines.make("lqg"), tmp_path)
    with pytest.raises(InputError, match="car with a motor"):
        export_c(baselines.make("mpc-friction", model="quarter-car-passive"), tmp_path)


def test_the_command_writes_it(tmp_path):
    done = run("convert", "mpc-friction", "--c", tmp_path / "c")
    assert done.returncode == 0 and (tmp_path / "c" / "mpc_friction.h").is_file(), done.stderr
    refused = run("convert", "mpc-friction", "--onnx", tmp_path / "x.onnx")
    assert_one_line(refused, "with --c DIR alone")
