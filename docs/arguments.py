"""Tables of arguments for the reference: what a docstring's prose says of each, with type and default of the signature.

The docstrings of this package are prose: "road, speed [m/s]: as the environment takes them." Here they become the sections
that mkdocstrings makes tables of. A clause that only tells arguments moves into the table; a sentence that names one among
other things stays, and is told there again.
"""

from __future__ import annotations

import re

import griffe

NAME = r"`?[A-Za-z_]\w*`?(?:\(\w+(?:, \w+)*\)`?)?(?:\s*(?:\([^()]*\)|\[[^\]]*\]))*"
#: "a, b [unit] and c: text", or "a [unit]." at the beginning of a sentence
CLAUSE = re.compile(
    rf"(?:(?<=^)|(?<=[.;] ))(?P<names>{NAME}(?:, {NAME})*(?:,? and {NAME})?)(?P<end>:(?= )|[.;])"
)
WORD = re.compile(r"`?([A-Za-z_]\w*)`?")
#: a section in Google style; such a docstring stays as it is
SECTION = re.compile(r"^\s*(Args|Attributes|Returns|Raises|Yields):$", re.MULTILINE)
RAISES = re.compile(r"(?:^|(?<=[.;] ))Raises `(\w+)`,? ?(.*?)(?:\.(?= |$)|$)", re.DOTALL)


def split(text: str, known: set[str]) -> tuple[str, dict[str, str]]:
    """A paragraph without the clauses that only tell arguments, and what those tell by name."""
    starts = []
    for match in CLAUSE.finditer(text):
        items = re.findall(NAME, match["names"].replace(" and ", ", "))
        names = {WORD.match(i)[1]: i for i in items if WORD.match(i)}
        bare = match["end"] == ":" or all("[" in i for i in items)
        if names and set(names) <= known and bare:
            starts.append((match, names))
    told, kept, at = {}, [], 0
    for k, (match, names) in enumerate(starts):
        stop = starts[k + 1][0].start() if k + 1 < len(starts) else len(text)
        kept.append(text[at : match.start()])
        body = text[match.end() : stop].strip()
        for name, item in names.items():
            unit = " ".join(re.findall(r"\([^()]*\)|\[[^\]]*\]", item.split(name, 1)[1]))
            told[name] = " ".join(x for x in (unit, body.rstrip(" ;.")) if x)
        at = stop
    kept.append(text[at:])
    return " ".join(x.strip() for x in kept if x.strip()), told


def sentence(summary: str, text: str, name: str) -> str:
    """The sentence that begins with an argument, or names it in code quotes, or below the summary as a word."""
    parts = [p.strip() for p in re.split(r"(?<=[.;])\s+(?=[A-Z`(])", text)]
    for pattern in (rf"^`?{name}\b", rf"`{name}\b[^`]*`", rf"\b{name}\b"):
        for part in parts:
            if re.search(pattern, part) and (part not in summary or "`" in pattern):
                return part.rstrip(".;")
    return ""


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
    return (text if re.match(r"\w+[_(]|[a-z]\b(?! )", text) else text[:1].upper() + text[1:]).rstrip(
        "."
    ) + "."


def once(rows: dict[str, str]) -> dict[str, str]:
    """What tells several arguments stands beside the first of them."""
    first: dict[str, str] = {}
    return {
        n: t if len(t) < 25 or first.setdefault(t, n) == n else f"see `{first[t]}`" for n, t in rows.items()
    }


def told(text: str, names: list[str], more: dict[str, str], title: str = "Args") -> str:
    """A docstring with sections for its arguments (or attributes: `title`) and errors."""
    if SECTION.search(text):
        return text
    known, rows, errors, kept = set(names), dict(more), [], []
    for paragraph in re.split(r"\n\s*\n", text.strip()):
        if re.search(r"^\s*(\||```|- |\d\. )", paragraph, re.MULTILINE):
            kept.append(paragraph)  # a table, a list, code
            continue
        flat = " ".join(paragraph.split())
        for match in RAISES.finditer(flat):
            errors.append((match[1], match[2] or "where it cannot be used"))
        flat = " ".join(RAISES.sub("", flat).split())
        rest, found = split(flat, known)
        rows |= found
        if rest:
            kept.append(rest)
    prose, summary = " ".join(kept), (kept or [""])[0]
    lines = ["\n\n".join(kept)]
    rows = once({n: rows.get(n) or sentence(summary, prose, n) for n in names})
    if any(rows.values()):
        lines += ["", f"{title}:", *(f"    {n}: {t or '–'}" for n, t in rows.items())]
    if errors:
        lines += ["", "Raises:", *(f"    {kind}: {why}" for kind, why in errors)]
    return "\n".join(lines)


class Arguments(griffe.Extension):
    """Rewrites docstrings once a package is loaded."""

    def on_package(self, *, pkg: griffe.Module, **_: object) -> None:
        self.walk(pkg, set())

    def walk(self, thing: griffe.Object, seen: set[str]) -> None:
        for member in list(thing.members.values()):
            if member.is_alias or member.path in seen:
                continue
            seen.add(member.path)
            if member.is_module or member.is_class:
                self.walk(member, seen)
            if member.docstring is None or not (member.is_class or member.is_function):
                continue
            if member.is_class:
                self.fields(member)
                continue
            hidden = (griffe.ParameterKind.var_positional, griffe.ParameterKind.var_keyword)
            names = [
                p.name
                for p in member.parameters
                if p.name not in ("self", "cls") and not p.name.startswith("_") and p.kind not in hidden
            ]
            member.docstring.value = told(member.docstring.value, names, {})

    def fields(self, thing: griffe.Class) -> None:
        """Fields of a dataclass with their defaults, or the arguments of a plain class's constructor."""
        assert thing.docstring is not None
        if "dataclass" in thing.labels or any("dataclass" in str(d.value) for d in thing.decorators):
            beside, names = comments(thing), {}
            for name, field in thing.members.items():
                own = field.is_attribute and field.annotation is not None and not name.startswith("_")
                if own and "property" not in field.labels and f"{name}: ClassVar" not in thing.source:
                    names[name] = None if field.value is None else str(field.value)
            text = thing.docstring.value
            if beside and "Attributes:" not in text:
                rows = {name: whole(beside[name]) if name in beside else "–" for name in names}
                told_rows = "\n".join(f"    {name}: {row}" for name, row in rows.items())
                prose, *rest = re.split(r"^(?=(?:Raises|References):$)", text, maxsplit=1, flags=re.MULTILINE)
                text = "\n\n".join([prose.strip(), f"Attributes:\n{told_rows}", *rest])
            else:
                text = told(text, list(names), {}, "Attributes")
            for name, default in names.items():
                if default is not None and len(default) < 40:
                    text = re.sub(
                        rf"(\n    {name}: .*(?:\n {{8,}}\S.*)*)",
                        lambda m, d=default: f"{m[1]} (default `{d}`)",
                        text,
                        count=1,
                    )
            thing.docstring.value = text
        elif "__init__" in thing.members:
            made = thing.members["__init__"]
            names = [
                p.name for p in made.parameters if p.name != "self" and not p.name.startswith(("_", "*"))
            ]
            thing.docstring.value = told(thing.docstring.value, names, {})
