"""An HTML page as the tests read it."""

from __future__ import annotations

import html.parser
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


class Page(html.parser.HTMLParser):
    """What a page refers to, and its plain text."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.charts: list[dict] = []
        self.links: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.text = ""
        self.policies: list[str] = []
        self.scripts: list[str] = []
        self.figures: list[str] = []
        self.inside = False  # whether a script is being read
        self.feed(path.read_text(encoding="utf-8"))
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        if tag == "svg" and dict(attrs).get("class") == "chart":
            self.charts.append(dict(attrs))
        self.inside = tag == "script"
        if tag == "figure":
            self.figures.append(dict(attrs)["id"].removeprefix("figure-"))
        if dict(attrs).get("http-equiv") == "Content-Security-Policy":
            self.policies.append(dict(attrs)["content"])
        self.links += [
            v for k, v in attrs if k in ("src", "href") and not v.startswith("data:")
        ]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        self.inside = False

    def handle_data(self, data):
        if self.inside:
            self.scripts.append(data)
        elif not {"figure", "svg"} <= set(
            self.open
        ):  # texts of a chart are no words of the page
            self.text += data
