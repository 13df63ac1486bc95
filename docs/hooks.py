"""Parts of the site that are made from the code: formulas, the list of elements, the help of commands, the schemas.

Formulas become MathML when the site is built, so that a page needs no script from elsewhere. A line ``{{ elements }}``
or ``{{ commands }}`` in a page is replaced by the package's own list.
"""

from __future__ import annotations

import html
import json
import re

from latex2mathml.converter import convert
from mkdocs.structure.files import File
from typer.testing import CliRunner

FORMULA = re.compile(
    r'<span class="arithmatex">\\\((.+?)\\\)</span>|<div class="arithmatex">\s*\\\[(.+?)\\\]\s*</div>',
    re.DOTALL,
)


def on_files(files, config):
    """Add the shipped schemas to the files of the site."""
    from isd_gym.records import schemas

    for name in schemas.NAMES:
        text = json.dumps(schemas.load(name), indent=1, ensure_ascii=False) + "\n"
        files.append(File.generated(config, f"schemas/{name}.json", content=text))
    return files


def on_page_markdown(markdown, page, config, files):
    for name, make in (("elements", elements), ("commands", commands)):
        if f"{{{{ {name} }}}}" in markdown:
            markdown = markdown.replace(f"{{{{ {name} }}}}", make())
    return markdown


def on_page_content(content, page, config, files):
    def formula(match: re.Match) -> str:
        inline, block = match.groups()
        return convert(html.unescape(inline or block), display="inline" if inline else "block")

    return FORMULA.sub(formula, content)


def elements() -> str:
    """Every element type: law, parameters with units and plausible ranges, what tells it apart, source."""
    from isd_gym.physics.elements import TYPES, parameter_fields

    where = {"between": "between two nodes", "element": "at a motor", "channel": "at a channel"}
    parts = []
    for place, title in where.items():
        parts.append(f"## {title[0].upper()}{title[1:]}\n")
        for kind, cls in TYPES.items():
            if cls.place != place:
                continue
            parts += [f"### `{kind}`\n", f"`{cls.equation}`\n"]
            rows = ["| parameter | unit | usual | default |", "|---|---|---|---|"]
            for f in parameter_fields(cls):
                low, high = f.metadata["range"]
                usual = f"{low:g} to {high:g}" if abs(high) < float("inf") else "any"
                default = f"{f.default:g}" if isinstance(f.default, int | float) else "needed"
                rows.append(f"| `{f.name}` | {f.metadata['unit']} | {usual} | {default} |")
            for key, allowed in cls.choices.items():
                default = cls.__dataclass_fields__[key].default
                rows.append(f"| `{key}` | | {', '.join(allowed)} | {default} |")
            parts += ["\n".join(rows) + "\n", f"Recognised by: {cls.signature}. Source: {cls.source}.\n"]
    return "\n".join(parts)


def commands() -> str:
    """`--help` of every command."""
    from isd_gym._commands import app
    from isd_gym._common.plugins import COMMANDS, plugins

    known = {c.name or c.callback.__name__ for c in app.registered_commands}
    for point in plugins(COMMANDS):
        if point.name not in known:
            app.command(name=point.name)(point.load())
    names = [c.name or c.callback.__name__ for c in app.registered_commands]
    parts = []
    for name in names:
        done = CliRunner().invoke(app, [name, "--help"], env={"COLUMNS": "96", "TERMINAL_WIDTH": "96"})
        text = done.stdout.replace("Usage: root", "Usage: isd-gym").strip()
        parts.append(f"## isd-gym {name}\n\n```text\n{text}\n```\n")
    return "\n".join(parts)
