"""The program with closed streams, other encodings, damaged files and full disks."""

import importlib
import os
import resource
import subprocess
import sys
import textwrap

import pytest
from program import read_json, run

from isd_gym import InputError
from isd_gym._commands._streams import ALIKE, PLAINER, prepare_streams
from isd_gym._common import jit
from isd_gym._common.files import whole
from isd_gym._common.jit import _Files

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a shell of POSIX")
SCORE = f"{sys.executable} -m isd_gym score passive --episodes 1 --duration 0.1"
PLAIN = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def shell(command, cwd, limit=None, **variables):
    """Run a command with further variables, and with a limit on the size of a file [bytes]."""

    def limited():
        if limit:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    options = {"cwd": cwd, "env": {**os.environ, **variables}, "preexec_fn": limited}
    return subprocess.run(
        ["bash", "-c", command], capture_output=True, check=False, **options
    )


@pytest.mark.slow
@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_lose_nothing(closed, tmp_path):
    done = shell(f"{SCORE} --json s.json {closed}", tmp_path)
    assert (done.returncode, done.stderr) == (0, b"")
    assert bool(done.stdout) == (closed == "2>&-")
    assert read_json(tmp_path / "s.json")["schema"] == "isd-score/1"


@pytest.mark.slow
@pytest.mark.parametrize(
    "variables", [{"PYTHONIOENCODING": "ascii"}, {"PYTHONIOENCODING": "cp932"}, PLAIN]
)
def test_a_table_is_printed_in_every_encoding(variables, tmp_path):
    done = shell(f"{SCORE} --report page", tmp_path, **variables)
    text = done.stdout.decode(variables.get("PYTHONIOENCODING", "ascii"))
    assert done.returncode == 0 and "m/s2" in text and "?" not in text
    assert (tmp_path / "page" / "index.html").exists()


def test_what_an_encoding_lacks_keeps_its_width():
    prepare_streams()
    for text in ("m/s²", "─━", "".join(ALIKE), "日本", "café"):
        assert len(text.encode("ascii", PLAINER)) == len(text)
    assert "m/s²".encode("ascii", PLAINER) == b"m/s2"
    assert (
        b"\xff.csv".decode("utf-8", "surrogateescape").encode("utf-8", PLAINER)
        == b"\\udcff.csv"
    )


@pytest.mark.slow
def test_a_notebooks_backend_of_matplotlib_does_no_harm(tmp_path):
    backend = "module://matplotlib_inline.backend_of_another_environment"
    done = shell(f"{SCORE} --report page", tmp_path, MPLBACKEND=backend)
    assert done.returncode == 0, done.stderr


def test_without_the_compiler_is_one_line(tmp_path):
    done = shell(SCORE, tmp_path, NUMBA_DISABLE_JIT="1")
    assert done.returncode == 2
    assert (
        done.stderr.decode().count("\n") == 1
        and b"unset NUMBA_DISABLE_JIT" in done.stderr
    )


FUNCTION = """
    import sys, warnings
    from isd_gym._common.jit import compiled

    @compiled()
    def twice(x):
        return 2.0 * x

    print(twice(21.0), *twice._cache_hits.values())
    """


def damaged(data, how):
    k = len(data) // 3
    flipped = bytes(b ^ 0x55 * (i == k) for i, b in enumerate(data))
    return {"empty": b"", "half": data[: len(data) // 2], "flipped": flipped}[how]


@pytest.mark.slow
def test_a_damaged_kernel_is_compiled_again(tmp_path):
    """Whatever happened to the files; the result is right, the files are mended, and the next call reads them."""
    (tmp_path / "own.py").write_text(textwrap.dedent(FUNCTION))

    def printed():
        done = shell(
            f"{sys.executable} own.py", tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "kept")
        )
        assert done.returncode == 0, done.stderr.decode()
        return done.stdout.split()

    assert printed() == [b"42.0"] and printed() == [b"42.0", b"1"]
    for how in ("flipped .nbi", "empty .nbi", "half .nbc", "flipped .nbc"):
        for file in (tmp_path / "kept").rglob(f"own.twice*{how.split()[1]}"):
            file.write_bytes(damaged(file.read_bytes(), how.split()[0]))
        assert printed()[0] == b"42.0", how
        assert printed() == [b"42.0", b"1"], how


def test_a_kernel_that_cannot_be_kept_is_used(monkeypatch):
    def full(self, name, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(jit._Files, "_save_data", full)
    twice = jit.compiled()(lambda x: 2.0 * x)
    with pytest.warns(
        RuntimeWarning, match=r"cannot be kept in '.+' \(No space left on device\)"
    ):
        assert twice(21.0) == 42.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("score passive --episodes 1 --duration 0.1 --json s.json", "s.json"),
        ("score passive --episodes 1 --duration 0.1 --report page", "page"),
        ("networks full-car-isd --draw n.svg", "n.svg"),
        ("simulate quarter-car-passive d.csv --out o.csv", "o.csv"),
        ("show passive --seconds 0.1 --out a.mp4", "a.mp4"),
        ("export quarter-car-passive --fmu a.fmu", ""),
    ],
)
def test_a_full_disk_names_the_file(words, named, tmp_path):
    """A limit on the size of a file stands for the full disk: the error of the system names no file either."""
    needed = {"show": ("pygame",), "export": ("pythonfmu",)}
    for module in needed.get(words.split()[0], ()):
        pytest.importorskip(module)
    (tmp_path / "d.csv").write_text(
        "time,road\n" + "".join(f"{k / 1000},0.0\n" for k in range(400))
    )
    before = sorted(tmp_path.iterdir())
    # a kernel that is compiled for the first time is told apart: it cannot be kept either
    program = f"{sys.executable} -m isd_gym {words}"
    done = shell(program, tmp_path, limit=2000, PYTHONWARNINGS="ignore::RuntimeWarning")
    assert done.returncode == 2, done.stderr
    lines = done.stderr.decode().strip().splitlines()
    assert len(lines) == 1 and "cannot " in lines[0] and named in lines[0], done.stderr
    assert sorted(tmp_path.iterdir()) == before


def test_errors_of_files_that_are_read_stay_what_they_are(tmp_path):
    with pytest.raises(FileNotFoundError), whole(tmp_path / "out.txt"):
        (tmp_path / "missing.csv").read_text()
    with (
        pytest.raises(InputError, match=r"out.txt' \(No space"),
        whole(tmp_path / "out.txt"),
    ):
        raise OSError(28, "No space left on device")


def test_a_kernel_of_an_unknown_module_is_compiled_again(tmp_path):
    """A law of a notebook or of generated code has no module in another process: numba compiles after an OSError."""

    class Foreign:
        def __reduce__(self):
            return importlib.import_module, ("<dynamic>",)

    files = _Files(str(tmp_path), "law", "stamp")
    files._save_data("law.1.nbc", Foreign())
    with pytest.raises(OSError, match="dynamic"):
        files._load_data("law.1.nbc")


def test_a_replaced_file_keeps_its_mode(tmp_path):
    to = tmp_path / "score.json"
    to.write_text("{}")
    to.chmod(0o640)
    with whole(to) as part:
        part.write_text("new")
    assert to.read_text() == "new" and to.stat().st_mode & 0o777 == 0o640
    if os.geteuid() == 0:
        os.chown(to, 1234, 1234)
        with whole(to) as part:
            part.write_text("newer")
        assert (to.stat().st_uid, to.stat().st_gid, to.stat().st_mode & 0o777) == (
            1234,
            1234,
            0o640,
        )


def test_settings_of_numba_that_cannot_be_read_are_one_line(tmp_path):
    pytest.importorskip("yaml", reason="numba reads its file of settings with PyYAML")
    (tmp_path / ".numba_config.yaml").write_text(
        '!!python/object/apply:os.system ["touch RUN"]\n'
    )
    done = shell(SCORE, tmp_path)
    assert (
        done.returncode == 2
        and done.stderr.count(b"\n") == 1
        and b".numba_config.yaml" in done.stderr
    )
    assert not (tmp_path / "RUN").exists()


def test_a_foreign_folder_does_not_hide_a_known_policy(tmp_path):
    for name in ("mpc", "ppo"):
        (tmp_path / name).mkdir()
    short = "score --episodes 1 --duration 0.1 mpc ppo"
    assert "no policy.json" in run(short, "./mpc", cwd=tmp_path).stderr
    done = run(short, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
