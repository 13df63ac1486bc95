"""Public functions, classes and methods have Google-style docstrings: Args, Returns and Raises as the code has them.

In a private module (a part of its path begins with `_`) only the names of the reference are public.

The checks read the sources, so that extras need not be installed. `ruff` checks the form of the sections (rules D).
"""

import ast
import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.tools

ROOT = Path(__file__).parents[1]
PACKAGES = ("isd_gym", "baselines", "agents")
#: the diagnosis, of which only the documented names are checked, and its kinds outside the core
DIAGNOSIS = (
    "isd_gym/diagnosis",
    "isd_gym/contrib/forecast",
    "isd_gym/contrib/no_road",
    "isd_gym/contrib/fmi/identification",
)
#: also the readers of a helper process
INTERNAL = (
    *DIAGNOSIS,
    *(f"isd_gym/contrib/bench_files/{reader}" for reader in ("mat73", "tdms", "uff", "xlsx")),
)
SECTIONS = ("Args", "Attributes", "Returns", "Yields", "Raises", "References")
Function = ast.FunctionDef | ast.AsyncFunctionDef


# ------------------------------------------------------------------------------------------- names in the reference
def documented():
    """Return the names on the API pages and in `isd_gym.__all__`: module -> names, None for all of a module."""
    pages = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "docs/reference").glob("api*.md"))
    found = {}
    for target, members in re.findall(
        r"^::: ([\w.]+)(?:\n +options:\n +members: \[(.*)\])?", pages, re.MULTILINE
    ):
        if not exists(target):
            target, _, members = target.rpartition(".")
        found.setdefault(target, set()).update(members.split(", ") if members else [None])
    homes = re.search(
        r"_HOME = \{(.*?)\n\}", (ROOT / "isd_gym/__init__.py").read_text(encoding="utf-8"), re.DOTALL
    )
    for name, module in re.findall(r'"(\w+)": "([\w.]+)"', homes[1]):
        found.setdefault(f"isd_gym.{module}", set()).add(name)
    return found


def exists(module):
    """Return whether a dotted name is a module."""
    path = ROOT / module.replace(".", "/")
    return path.is_dir() or path.with_suffix(".py").exists()


DOCUMENTED = documented()


def is_documented(path, name):
    """Return whether a name of a module is on an API page or exported, possibly by a package above the module."""
    dotted = path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".").removesuffix(".__init__")
    return any(
        name in names or (None in names and dotted == module)
        for module, names in DOCUMENTED.items()
        if f"{dotted}.".startswith(f"{module}.")
    )


# ------------------------------------------------------------------------------------------- what a docstring tells
def sections(doc):
    """Return the names of the entries of each section of a docstring, and its summary under ''."""
    found, current = {"": [doc.strip().split("\n\n")[0]]}, None
    for line in doc.splitlines():
        if (head := re.fullmatch(r"(\w+):", line)) and head[1] in SECTIONS:
            current = found.setdefault(head[1], [])
        elif line and not line.startswith(" "):
            current = None
        elif current is not None and (entry := re.match(r"    (\*{0,2}\w+):", line)):
            current.append(entry[1].lstrip("*"))
    return found


def arguments(function, is_method):
    """Return the names of the arguments that a caller gives."""
    given = function.args
    named = [*given.posonlyargs, *given.args, *given.kwonlyargs][int(is_method) :]
    names = [a.arg for a in named if not a.arg.startswith("_")]
    return names + [a.arg for a in (given.vararg, given.kwarg) if a is not None and a.arg != "_"]


def decorators(node):
    """Return the last names of the decorators of a function or class."""
    calls = [d.func if isinstance(d, ast.Call) else d for d in node.decorator_list]
    return {d.attr if isinstance(d, ast.Attribute) else d.id for d in calls}


def is_command(function):
    """Return whether a function is a command: its docstring is the help, and its options have texts of their own."""
    notes = [ast.unparse(a.annotation) for a in function.args.args if a.annotation is not None]
    return "command" in decorators(function) or any("Option" in n or "typer." in n for n in notes)


def raised(function):
    """Return the names of the errors that the body raises for bad input."""
    calls = [n.exc for n in ast.walk(function) if isinstance(n, ast.Raise) and isinstance(n.exc, ast.Call)]
    names = {call.func.id for call in calls if isinstance(call.func, ast.Name)}
    return names & {"InputError", "MissingColumn", "ReportError"}


def faults_of_function(function, is_method, is_strict):
    """Return what the docstring of a function lacks."""
    doc = ast.get_docstring(function)
    if doc is None:
        return ["no docstring"]
    found, names = sections(doc), arguments(function, is_method)
    told = found.get("Args", [])
    faults = [f"Args: no {n}" for n in names if n not in told]
    faults += [f"Args: {n} is no argument" for n in told if n not in names]
    if missing := raised(function) - set(found.get("Raises", [])):
        faults.append(f"Raises: no {', '.join(sorted(missing))}")
    returns = "None" if function.returns is None else ast.unparse(function.returns)
    summary = found[""][0]
    is_plain = returns in ("None", "Self") or (returns == "bool" and "whether" in summary)
    if not (
        is_plain or {"Returns", "Yields"} & set(found) or (not is_strict and summary.startswith("Return"))
    ):
        faults.append("no Returns")
    return faults


def fields(cls):
    """Return the annotated fields of a dataclass or named tuple."""
    noted = [n for n in cls.body if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)]
    own = [n.target.id for n in noted if "ClassVar" not in ast.unparse(n.annotation)]
    return [name for name in own if not name.startswith("_")]


def commented(cls, source):
    """Return the fields that a comment beside or above describes."""
    out, above = set(), False
    for line in source.splitlines()[cls.lineno - 1 : cls.end_lineno]:
        field = re.match(r"\s+(\w+)\s*:\s", line)
        if field and ("#" in line or above):
            out.add(field[1])
        above = line.strip().startswith("#")
    return out


def faults_of_class(cls, source):
    """Return what the docstring of a class lacks: Attributes of a dataclass, Args of a constructor."""
    doc = ast.get_docstring(cls)
    if doc is None:
        return ["no docstring"]
    found = sections(doc)
    if "dataclass" in decorators(cls) or "NamedTuple" in {ast.unparse(b) for b in cls.bases}:
        known = {*found.get("Attributes", []), *found.get("Args", []), *commented(cls, source)}
        return [f"Attributes: no {n}" for n in fields(cls) if n not in known]
    made = next((n for n in cls.body if isinstance(n, Function) and n.name == "__init__"), None)
    if made is None:
        return []
    own = sections(ast.get_docstring(made) or "")
    told, names = [*found.get("Args", []), *own.get("Args", [])], arguments(made, True)
    faults = [f"Args: no {n}" for n in names if n not in told]
    return faults + [f"Args: {n} is no argument" for n in told if n not in names]


def faults(path):
    """Return the faults of all public docstrings of a module, each with its place."""
    source = path.read_text(encoding="utf-8")
    inside = path.relative_to(ROOT).with_suffix("").parts
    private = any(part.startswith("_") and part != "__init__" for part in inside)
    out = []

    def visit(nodes, outer, cls, is_strict):
        for node in nodes:
            if isinstance(node, ast.If | ast.Try):
                visit([*node.body, *node.orelse], outer, cls, is_strict)
            if not isinstance(node, Function | ast.ClassDef) or node.name.startswith("_"):
                continue
            if private and cls is None and not is_documented(path, node.name):
                continue
            place = f"{outer}{node.name}"
            strict = is_strict or is_documented(path, node.name)
            if isinstance(node, ast.ClassDef):
                # an element has an equation and a source as attributes; its base class documents its methods
                if "register" not in decorators(node):
                    out.extend(f"{place}: {f}" for f in faults_of_class(node, source))
                visit(node.body, f"{place}.", node, strict)
            elif {"property", "cached_property"} & decorators(node):
                if ast.get_docstring(node) is None:
                    out.append(f"{place}: no docstring")
            elif not is_command(node) and (ast.get_docstring(node) or cls is None or not cls.bases):
                is_method = cls is not None and "staticmethod" not in decorators(node)
                out.extend(f"{place}: {f}" for f in faults_of_function(node, is_method, strict))

    visit(ast.parse(source).body, "", None, False)
    return out


def modules():
    """Return the modules with functions that other modules use, also private modules; parts of the program are left out."""
    paths = [p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))]
    shared = [p for p in paths if not p.name.startswith("_") or p.parent.name not in ("_commands", "fmi")]
    names = [p.relative_to(ROOT).as_posix() for p in shared]
    return [name for name in names if not name.startswith(INTERNAL)]


@pytest.mark.parametrize("module", modules())
def test_public_docstrings_have_the_sections_of_the_code(module):
    assert faults(ROOT / module) == []
