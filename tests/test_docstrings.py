"""Everything public says what it is and names each of its arguments: what the reference shows, what `isd_gym` exports."""

import dataclasses
import inspect
import pkgutil
import re
import sys
from pathlib import Path

import pytest

import isd_gym

ROOT = Path(__file__).parents[1]
#: beside what the reference pages show and what `isd_gym` exports
MORE = ("isd_gym.driving", "isd_gym.report", "isd_gym.sb3", "isd_gym.show", "isd_gym.rendering")


def reference():
    """Dotted names of what is public: modules, classes, functions."""
    pages = "\n".join(p.read_text(encoding="utf-8") for p in (ROOT / "docs/reference").glob("*.md"))
    shown = re.findall(r"^::: ([\w.]+)", pages, re.MULTILINE)
    return sorted({*shown, *MORE, *(f"isd_gym.{name}" for name in isd_gym.__all__)})


def arguments(function):
    """Names of the arguments a caller gives."""
    return [
        p.name
        for p in inspect.signature(function).parameters.values()
        if p.name not in ("self", "cls") and not p.name.startswith("_")
        # *args and **options are what others take
        and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
    ]  # fmt: skip


def commented(cls):
    """Fields of a dataclass that say what they are, with their unit, in a comment beside or above them."""
    out, above = set(), False
    for line in inspect.getsource(cls).splitlines():
        field = re.match(r"\s+(\w+)\s*:\s", line)
        if field and ("#" in line or above):
            out.add(field[1])
        above = line.strip().startswith("#")
    return out


def public(thing, name):
    """(name, function whose arguments count, text that must name them, fields with a comment) of what a name holds."""
    if inspect.ismodule(thing):
        listed = getattr(thing, "__all__", None)
        for key, part in vars(thing).items():
            home = getattr(part, "__module__", None) or ""
            own = key in listed if listed is not None else home == thing.__name__ and not key.startswith("_")
            if own and (inspect.isclass(part) or inspect.isfunction(part)):
                yield from public(part, key)
    elif inspect.isclass(thing):
        bases = [inspect.getdoc(base) or "" for base in thing.__mro__[1:-1]]
        doc = inspect.getdoc(thing) or ""
        other = re.search(r"[Aa]rguments as `(\w+)`'s", doc)
        doc += inspect.getdoc(getattr(sys.modules[thing.__module__], other[1])) if other else ""
        yield name, thing, doc, commented(thing) if dataclasses.is_dataclass(thing) else set()
        for key, method in vars(thing).items():
            if isinstance(method, classmethod | staticmethod):
                method = method.__func__
            if not key.startswith("_") and inspect.isfunction(method):
                own = inspect.getdoc(getattr(thing, key)) or ""
                # what a base class asks of those below it, it documents
                own = own or next((d for d in bases if re.search(rf"\b{key}\b", d)), "")
                yield f"{name}.{key}", method, f"{own} {doc}" if own else "", set()
    else:
        yield name, thing, inspect.getdoc(thing) or "", set()


def missing(thing, name):
    """What is not documented: names of functions, and of arguments in brackets."""
    for part, function, doc, known in public(thing, name):
        if not doc:
            yield part
            continue
        try:
            names = arguments(function)
        except ValueError:  # nothing to call
            continue
        # those of a command are told by its --help
        told = {n for n in names if "Option" in str(inspect.signature(function).parameters[n].annotation)}
        yield from (
            f"{part}({a})" for a in names if a not in known | told and not re.search(rf"\b{a}\b", doc)
        )


@pytest.mark.parametrize("name", reference())
def test_every_public_argument_is_documented(name):
    try:
        thing = pkgutil.resolve_name(name)
    except ModuleNotFoundError as error:  # an extra that is not installed
        pytest.skip(f"{error.name} is not installed")
    assert list(missing(thing, name.rpartition(".")[2])) == []
