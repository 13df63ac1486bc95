"""The package is found and light wherever it lies: installed, a source tree on the path, a zip."""

import ast
import inspect
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import program
import pytest

import isd_gym

ROOT = Path(__file__).parents[1]
#: source folder -> where an installation has it
HOMES = {
    "isd_gym": Path("isd_gym"),
    "baselines": Path("isd_gym/baselines"),
    "agents": Path("isd_gym/agents"),
}
MAKE = "import gymnasium; print(gymnasium.make('isd_gym:ISDSuspension-v0').reset(seed=0)[0].shape)"
IMPORT = "import isd_gym, gymnasium; print(len(gymnasium.make_vec('ISDSuspension-v0', 3).reset(seed=0)[0]))"
LATE = "import gymnasium, isd_gym; print(len(gymnasium.make_vec('ISDSuspension-v0', 3).reset(seed=0)[0]))"


def python(code, place):
    """What `code` prints without any installation: no .pth file is read, the package comes from `place` alone."""
    libraries = [
        p
        for p in sys.path
        if p.endswith("-packages") and not list(Path(p).glob("isd_gym-*"))
    ]
    if not libraries:
        libraries = [str(Path(np.__file__).parents[1])]
    path = os.pathsep.join([str(place), *libraries])
    done = subprocess.run(
        [sys.executable, "-S", "-c", code],
        capture_output=True, text=True, check=False, cwd="/", env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.fixture(scope="module", params=["source tree", "zip"])
def place(request, tmp_path_factory):
    """The packages outside any installation: as folders, and as a zip."""
    base = tmp_path_factory.mktemp("found")
    files = {}
    for folder, home in HOMES.items():
        own = (
            f
            for f in (ROOT / folder).rglob("*")
            if f.is_file() and "__pycache__" not in f.parts
        )
        files |= {home / f.relative_to(ROOT / folder): f for f in own}
    if request.param == "zip":
        with zipfile.ZipFile(base / "isd.zip", "w") as archive:
            for path, f in files.items():
                archive.write(f, path)
        return base / "isd.zip"
    for path, f in files.items():
        target = base / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.symlink_to(f)
    return base


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "answer"),
    [(MAKE, "(6,)"), (IMPORT, "3"), (LATE, "3")],
    ids=["make", "import", "late"],
)
def test_found_without_an_installation(place, code, answer):
    assert python(code, place) == answer


#: what Python does at its start, where the folder `start` lies beside the package
START = (
    f"import sys; sys.path.append({str(ROOT / 'start')!r}); "
    + (ROOT / "start/isd_gym.pth").read_text()
)
FOUND = (
    "import gymnasium; print(gymnasium.make('ISDSuspension-v0').reset(seed=0)[0].shape)"
)


def test_found_from_the_start_of_python(place):
    """The start loads one small module, a second run changes nothing, and Gymnasium finds the environments."""
    code = f"exec({START!r}); before = list(sys.meta_path); exec({START!r}); print(sys.meta_path == before)"
    loaded = f"import sys; known = set(sys.modules); exec({START!r}); print(set(sys.modules) - known)"
    assert python(code, place) == "True"
    assert python(loaded, place) == "{'isd_gym_start'}"
    assert python(f"exec({START!r}); {FOUND}", place) == "(6,)"
    module, _, function = (
        (ROOT / "start/isd_gym.start").read_text().strip().partition(":")
    )
    assert (
        f"import {module}; {module}.{function}()" in START
    )  # Python 3.15 does the same


def test_what_python_ran_at_its_start_outlives_the_package(tmp_path):
    (tmp_path / "isd_gym" / "physics").mkdir(
        parents=True
    )  # caches of the compiler may be left
    code = f"exec({START!r}); import gymnasium; print('ISDSuspension-v0' in gymnasium.registry)"
    assert python(code, tmp_path) == "False"


def test_importing_is_light():
    heavy = [
        "numpy",
        "scipy",
        "numba",
        "gymnasium",
        "torch",
        "matplotlib",
        "pandas",
        "osqp",
        "typing",
        "re",
    ]
    code = (
        f"import sys; import isd_gym; print([m for m in {heavy} if m in sys.modules])"
    )
    assert python(code, ROOT) == "[]"


def test_public_names():
    assert {"Network", "simulate", "score", "diagnose"} <= set(isd_gym.__all__)
    for name in isd_gym.__all__:
        assert inspect.getdoc(getattr(isd_gym, name)), name
    assert set(isd_gym.__all__) <= set(dir(isd_gym))
    with pytest.raises(AttributeError, match="no attribute 'suspension'"):
        isd_gym.suspension  # noqa: B018
    tree = ast.parse((ROOT / "isd_gym/__init__.py").read_text())
    (block,) = (n for n in tree.body if isinstance(n, ast.If))
    relative = [n for n in block.body if isinstance(n, ast.ImportFrom) and n.level]
    typed = {a.name: n.module for n in relative for a in n.names}
    assert typed == isd_gym._HOME  # type checkers and Python know the same names


@pytest.mark.parametrize("folder", ["agents", "baselines"])
def test_source_folder_is_no_package_of_its_own(folder):
    code = f"try: import {folder}\nexcept ImportError as error: print(error)"
    assert f"imported as isd_gym.{folder}" in program.python(code, cwd=ROOT).stdout


def test_other_packages_named_agents_and_baselines(tmp_path):
    """Foreign packages `agents` and `baselines` come first on the path. isd_gym imports its own packages, and the foreign ones import too."""
    for name in ("agents", "baselines"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(f"other = {name!r}\n")
    code = (
        "import sys, gymnasium, isd_gym.baselines, isd_gym.agents.policy\n"
        "gymnasium.make('ISDSuspension-v0').reset(seed=0)\n"
        "from isd_gym._commands import main\n"
        "sys.argv = ['isd-gym', 'score', 'passive', 'mpc', 'ppo', '--episodes', '1', '--duration', '1']\n"
        "try: main()\n"
        "except SystemExit as end: assert not end.code, end.code\n"
        "assert not {'agents', 'baselines'} & set(sys.modules)\n"
        "import agents, baselines\n"
        "print(agents.other, baselines.other, isd_gym.agents is agents, isd_gym.baselines is baselines)\n"
    )
    path = os.pathsep.join(
        [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    done = program.python(code, cwd=tmp_path, env={**os.environ, "PYTHONPATH": path})
    assert done.returncode == 0, done.stderr
    assert (
        "mpc" in done.stdout
        and done.stdout.splitlines()[-1] == "agents baselines False False"
    )
