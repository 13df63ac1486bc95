"""Text from files on a page in Markdown."""

from __future__ import annotations

import re

from .errors import NAME_LIMIT, plain

#: characters with a meaning in Markdown, HTML or a table
_MARKUP = frozenset("&<>|`*[]\\~#$!")


def markdown(text: str, limit: int = NAME_LIMIT, *, code: bool = False) -> str:
    """Return a text from a file for a page in Markdown, where it appears as it is written."""
    text = plain(text, limit)
    words = re.sub(
        r"(?<![^\W_])_|_(?![^\W_])",
        "&#95;",
        "".join(f"&#{ord(c)};" if c in _MARKUP else c for c in text),
    )
    return f"`{text}`" if code and words == text else words
