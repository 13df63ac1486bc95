"""Parts of the site that are made from the code: formulas, the help of commands, the schemas.

Formulas become MathML when the site is built, so that a page needs no script from elsewhere. The comment
``<!-- commands -->`` in a page is replaced by the help of every command.
"""

from __future__ import annotations

import html
import json
import re
import tempfile
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File
from typer.testing import CliRunner

FORMULA = re.compile(
    r'<span class="arithmatex">\\\((.+?)\\\)</span>|<div class="arithmatex">\s*\\\[(.+?)\\\]\s*</div>',
    re.DOTALL,
)


#: the package as an installation has it, where mkdocstrings looks for its modules
_PACKAGE = tempfile.TemporaryDirectory(prefix="isd-gym-docs-")


@event_priority(100)  # before mkdocstrings reads its configuration
def on_config(config):
    """Show mkdocstrings the folders `baselines` and `agents` inside of the package."""
    root, package = Path(__file__).resolve().parents[1], Path(_PACKAGE.name) / "isd_gym"
    package.mkdir(exist_ok=True)
    for part in (*(root / "isd_gym").iterdir(), root / "baselines", root / "agents"):
        if not (package / part.name).exists():
            (package / part.name).symlink_to(part)
    config.plugins["mkdocstrings"].config.handlers["python"]["paths"] = [_PACKAGE.name]
    return config


def on_files(files, config):
    """Add the shipped schemas to the files of the site."""
    from isd_gym.records import schemas

    for name in schemas.NAMES:
        text = json.dumps(schemas.load(name), indent=1, ensure_ascii=False) + "\n"
        files.append(File.generated(config, f"schemas/{name}.json", content=text))
    return files


def on_page_markdown(markdown, page, config, files):
    mark = "<!-- commands -->"
    return markdown.replace(mark, commands()) if mark in markdown else markdown


def on_page_content(content, page, config, files):
    def formula(match: re.Match) -> str:
        inline, block = match.groups()
        return convert(
            html.unescape(inline or block), display="inline" if inline else "block"
        )

    return FORMULA.sub(formula, content)


def commands() -> str:
    """`--help` of every command."""
    from isd_gym._commands import app

    names = [c.name or c.callback.__name__ for c in app.registered_commands]
    parts = []
    for name in names:
        done = CliRunner().invoke(
            app, [name, "--help"], env={"COLUMNS": "96", "TERMINAL_WIDTH": "96"}
        )
        text = done.stdout.replace("Usage: root", "Usage: isd-gym").strip()
        parts.append(f"## isd-gym {name}\n\n```text\n{text}\n```\n")
    return "\n".join(parts)
