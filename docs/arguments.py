"""Fields of dataclasses for the reference: the comment of each field, and its default, as a section that mkdocstrings shows."""

from __future__ import annotations

import re

import griffe


def comments(thing: griffe.Class) -> dict[str, str]:
    """Return the comment beside or above each field of a dataclass."""
    out: dict[str, str] = {}
    above: list[str] = []
    for line in thing.lines:
        if line.strip().startswith("#"):
            above.append(line.strip().lstrip("#: "))
            continue
        match = re.match(r"\s+(\w+)\s*:[^#]*(?:#:?\s*(.+))?$", line)
        text = match and "ClassVar" not in line and (match[2] or " ".join(above))
        if text:
            out.setdefault(match[1], text)
        above = []
    return out


def whole(text: str) -> str:
    """Return a comment as a sentence: with a capital, except for a symbol, and a full stop."""
    is_symbol = re.match(r"\w+[_(]|[a-z]\b(?! )", text)
    return (text if is_symbol else text[:1].upper() + text[1:]).rstrip(".") + "."


def defaults(thing: griffe.Class) -> dict[str, str | None]:
    """Return the public fields of a dataclass with the text of their defaults."""
    out = {}
    for name, field in thing.members.items():
        is_field = (
            field.is_attribute
            and field.annotation is not None
            and not name.startswith("_")
        )
        if (
            is_field
            and "property" not in field.labels
            and f"{name}: ClassVar" not in thing.source
        ):
            out[name] = None if field.value is None else str(field.value)
    return out


def describe_fields(thing: griffe.Class) -> None:
    """Add the section `Attributes:` to the docstring of a dataclass, and the default to each field."""
    assert thing.docstring is not None
    text, beside, fields = thing.docstring.value, comments(thing), defaults(thing)
    if beside and "Attributes:" not in text:
        rows = [
            f"    {name}: {whole(beside[name]) if name in beside else '–'}"
            for name in fields
        ]
        prose, *rest = re.split(
            r"^(?=(?:Raises|References):$)", text, maxsplit=1, flags=re.MULTILINE
        )
        text = "\n\n".join([prose.strip(), "\n".join(["Attributes:", *rows]), *rest])
    for name, default in fields.items():
        if default is not None and len(default) < 40:
            row = rf"(\n    {name}: .*(?:\n {{8,}}\S.*)*)"
            text = re.sub(
                row, lambda m, d=default: f"{m[1]} (default `{d}`)", text, count=1
            )
    thing.docstring.value = text


class Arguments(griffe.Extension):
    """Completes the docstrings of dataclasses once a package is loaded."""

    def on_package(self, *, pkg: griffe.Module, **_: object) -> None:
        self.walk(pkg, set())

    def walk(self, thing: griffe.Object, seen: set[str]) -> None:
        for member in list(thing.members.values()):
            if member.is_alias or member.path in seen:
                continue
            seen.add(member.path)
            if member.is_module or member.is_class:
                self.walk(member, seen)
            is_dataclass = member.is_class and (
                "dataclass" in member.labels
                or any("dataclass" in str(d.value) for d in member.decorators)
            )
            if is_dataclass and member.docstring is not None:
                describe_fields(member)
