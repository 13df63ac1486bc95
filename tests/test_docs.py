"""What the documentation says works: its code runs, its commands parse, the site builds, the notebooks run."""

import importlib.util
import logging
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from isd_gym import _commands as cli
from isd_gym.physics import elements

pytestmark = pytest.mark.tools

ROOT = Path(__file__).parent.parent
PAGES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
)
RESULTS = ROOT / "docs" / "results.py"
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
#: pages and notebooks that fit, train or solve for minutes
SLOW = {
    "docs/guides/own-algorithm.md",
    "docs/guides/other-library.md",
    "docs/tutorials/diagnose.md",
    "docs/tutorials/effect.md",
    "notebooks/2-train-and-compare.ipynb",
    "notebooks/3-from-a-csv-to-a-corrected-model.ipynb",
}
#: upper limit of J after the training in a guide; the passive car has 0.87, an untrained policy 0.89
REACHED = {"own-algorithm.md": 0.75, "other-library.md": 0.75}


def blocks(page, language):
    """(line number, text) of the fenced blocks of a language; those after a comment "not run: why" are left out."""
    text = page.read_text(encoding="utf-8")
    pattern = rf"^( *)```{language}[^\n]*\n(.*?)^\1```"
    for match in re.finditer(pattern, text, re.DOTALL | re.MULTILINE):
        before = text[: match.start()]
        if language == "python" and before.rstrip().splitlines()[-1].strip().startswith(
            "<!-- not run: "
        ):
            continue
        line = before.count("\n") + 2
        indent = match[1]
        yield (
            line,
            "\n".join(row.removeprefix(indent) for row in match[2].splitlines()) + "\n",
        )


def cases(paths, wanted=lambda path: True, slow=()):
    def case(path):
        name = path.relative_to(ROOT).as_posix()
        return pytest.param(
            path, id=name, marks=[pytest.mark.slow] if name in slow else []
        )

    return [case(path) for path in paths if wanted(path)]


@pytest.fixture
def types_as_they_were():
    """A page may register an element, and a library's logger writes to the captured stream: both are forgotten afterwards."""
    known = dict(elements.TYPES)
    yield
    for kind in set(elements.TYPES) - set(known):
        del elements.TYPES[kind]
    for name in list(logging.root.manager.loggerDict):
        logging.getLogger(name).handlers.clear()


NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def told(shown, printed):
    """Whether a page shows what was printed: the same words, and numbers that differ by machine alone (half a per cent)."""
    words, own = (NUMBER.sub("#", " ".join(text.split())) for text in (shown, printed))
    numbers = [
        float(n.replace("−", "-")) for n in NUMBER.findall(" ".join(shown.split()))
    ]
    found = [
        float(n.replace("−", "-")) for n in NUMBER.findall(" ".join(printed.split()))
    ]
    place = own.find(words)
    while place >= 0:
        first = own[:place].count("#")
        pairs = zip(numbers, found[first : first + len(numbers)], strict=True)
        if all(abs(a - b) <= max(0.005 * abs(b), 0.101) for a, b in pairs):
            return True
        place = own.find(words, place + 1)
    return False


@pytest.mark.parametrize("page", cases(PAGES, lambda p: any(blocks(p, "python")), SLOW))
def test_the_code_of_a_page_runs(
    page, tmp_path, monkeypatch, types_as_they_were, capsys
):
    """All ```python blocks of a page, in order, in one namespace and an empty folder; they print what its ```text shows."""
    monkeypatch.chdir(tmp_path)
    space = {"__name__": "__page__"}
    for library in (
        "skrl",
        "stable_baselines3",
        "torch",
    ):  # what a page of a guide may need
        codes = "\n".join(code for _, code in blocks(page, "python"))
        if re.search(rf"^(from|import) {library}\b", codes, re.MULTILINE):
            pytest.importorskip(library)
    for line, code in blocks(page, "python"):
        # so that an error names the line of the page
        exec(compile("\n" * (line - 1) + code, str(page), "exec"), space)
    if page.name in REACHED:
        assert space["cost_of"](space["act"]) < REACHED[page.name]
    printed = capsys.readouterr().out
    for line, text in blocks(page, "text"):
        assert told(text, printed), (
            f"{page.name}, line {line}: prints something else now\n{printed[-2000:]}"
        )


def commands(page):
    for language in ("bash", "sh", "shell", "console"):
        for line, text in blocks(page, language):
            joined = text.replace("\\\n", " ")
            for row in joined.splitlines():
                row = row.strip().removeprefix("$ ")
                if row.startswith("isd-gym"):
                    words = shlex.split(row, comments=True)[1:]
                    yield line, words[: words.index(">")] if ">" in words else words


@pytest.mark.parametrize("page", cases(PAGES, lambda p: any(commands(p))))
def test_the_commands_of_a_page_parse(page):
    program = typer.main.get_command(cli.app)
    for line, words in commands(page):
        place = f"{page.name}, line {line}: isd-gym {' '.join(words)}"
        name = words[0] if words else "--help"
        if name == "--help":
            continue
        assert name in program.commands, f"{place}: no such command"
        if "--help" in words:
            continue
        try:
            program.commands[name].make_context(name, words[1:])
        except Exception as error:
            pytest.fail(f"{place}: {error}")


@pytest.mark.slow
def test_readme_shows_what_the_diagnosis_prints(tmp_path, monkeypatch):
    """README's command on the records of the tutorial: the same words, and the figures of the completed model."""
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / "tutorials" / "diagnose.md"
    made = [code for _, code in blocks(page, "python")][:2]  # records and model
    exec("".join(made), {"__name__": "__page__"})
    (shown,) = (text for _, text in blocks(ROOT / "README.md", "console"))
    command, _, output = shown.partition("\n")
    wide = {"COLUMNS": "80", "TERMINAL_WIDTH": "80"}
    done = CliRunner().invoke(cli.app, shlex.split(command)[2:], env=wide)
    assert done.exit_code == 0, done.output
    words, own = (
        NUMBER.sub("#", " ".join(re.sub("─+", "", text).split()))
        for text in (output, done.output)
    )
    assert words in own, done.output
    # the refit of the old model ends in one of several optima; what is found does not
    for pattern, near in ((r"level (\S+) N", 3.0), (r"% to (\S+) % \(noise", 0.3)):
        here, there = (
            float(re.search(pattern, " ".join(text.split()))[1])
            for text in (output, done.output)
        )
        assert abs(here - there) <= near, pattern


@pytest.mark.parametrize("page", cases(PAGES, lambda p: p.parent.name == "validation"))
def test_evidence_that_a_page_cites_exists(page):
    text = page.read_text(encoding="utf-8")
    tests = {path.name for path in (ROOT / "tests").rglob("test_*.py")}
    assert set(re.findall(r"test_\w+\.py", text)) <= tests
    for name in re.findall(r"(?:benchmarks|examples|docs)/\w+\.(?:py|json|toml)", text):
        assert (ROOT / name).is_file(), name


@pytest.mark.parametrize("page", cases(sorted(ROOT.glob("*.md"))))
def test_links_beside_the_site_lead_somewhere(page):
    """Of the pages that mkdocs does not see: files, and headings in them."""
    text = page.read_text(encoding="utf-8")
    for target in re.findall(
        r"\]\(([^)\s]+)\)", re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    ):
        if re.match(r"\w+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = ROOT / path if path else page
        assert file.is_file(), target
        if anchor:
            heads = re.findall(
                r"^#+ (.+)$", file.read_text(encoding="utf-8"), re.MULTILINE
            )
            assert anchor in {
                re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in heads
            }, target


@pytest.fixture(scope="module")
def results():
    """The script that writes tables of results into pages."""
    spec = importlib.util.spec_from_file_location("results", RESULTS)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


PAGES_OF_RESULTS = [
    p for p in PAGES if "python docs/results.py -->" in p.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("page", cases(PAGES_OF_RESULTS, slow=SLOW))
def test_tables_are_those_of_the_benchmarks_files(page, results):
    name = page.relative_to(ROOT).as_posix()
    assert results.fill(name) == page.read_text(encoding="utf-8"), (
        "run python docs/results.py"
    )


def test_shares_of_the_ceiling_follow_from_card_and_ceiling(results):
    """README's two shares of the gain at the ceiling."""
    text = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    shares = re.search(
        r"`mpc-friction` has (\d+) % of the gain at the ceiling and `ppo` (\d+) %", text
    )
    rows, ceiling = results.card_rows(), results.ceiling("quarter-car-isd").change
    for name, share in zip(("mpc-friction", "ppo"), shares.groups(), strict=True):
        assert round(100 * rows[name]["cost"]["change"] / ceiling) == int(share)


def test_citation_and_recipe_follow_the_package():
    yaml = pytest.importorskip("yaml")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    files = (ROOT / "CITATION.cff", ROOT / "recipe.yaml")
    citation, recipe = (
        yaml.safe_load(file.read_text(encoding="utf-8")) for file in files
    )
    assert citation["version"] == recipe["context"]["version"] == project["version"]
    assert citation["license"] == recipe["about"]["license"] == project["license"]
    needs = {need.replace(" ", "") for need in recipe["requirements"]["run"]}
    # conda splits what needs no Qt from matplotlib
    own = {
        need.replace("matplotlib>", "matplotlib-base>")
        for need in project["dependencies"]
    }
    assert needs - own == {"python>=${{python_min}}"} and own <= needs
    assert recipe["context"]["python_min"] == project["requires-python"].removeprefix(
        ">="
    )


@pytest.mark.parametrize("page", cases(PAGES))
def test_pages_name_no_machine(page):
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"(?<![\w.])/(work|opt|root|home|tmp)/", text)


def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("material")
    words = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "--site-dir",
        tmp_path / "site",
    ]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        words, capture_output=True, text=True, cwd=ROOT, check=False, env=quiet
    )
    assert done.returncode == 0, done.stderr[-3000:]
    home = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
    assert not re.search(
        r'<(script|link|img)[^>]+(src|href)="https?://', home
    )  # fetched from elsewhere
    physics = (tmp_path / "site" / "explanation" / "network" / "index.html").read_text(
        encoding="utf-8"
    )
    assert physics.count("<math") > 20 and "arithmatex" not in physics
    assert (
        "coulomb_friction"
        in (tmp_path / "site" / "reference" / "elements" / "index.html").read_text()
    )
    assert (tmp_path / "site" / "schemas" / "isd-model-1.json").is_file()


@pytest.mark.parametrize("path", cases(NOTEBOOKS, slow=SLOW))
@pytest.mark.filterwarnings(
    "default"
)  # the kernel's own libraries warn about each other
def test_a_notebook_runs(path, tmp_path):
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient")
    notebook = nbformat.read(path, as_version=4)
    shipped = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert not any(
        output["output_type"] == "error" or output.get("name") == "stderr"
        for output in shipped
    )
    place = {"metadata": {"path": str(tmp_path)}}
    client.NotebookClient(
        notebook, timeout=600, kernel_name="python3", resources=place
    ).execute()
