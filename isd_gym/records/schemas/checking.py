"""Checks of plain data against the shipped schemas, with one-line errors that name the place.

The keywords are those of the shipped schemas, a subset of JSON Schema (draft 2020-12).
"""

from __future__ import annotations

import functools
import re
from typing import TYPE_CHECKING, Any

from ...common.errors import InputError, plain, shown

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: names of the JSON types, with a test and a description for messages
_TYPES: dict[str, tuple[Callable[[Any], bool], str]] = {
    "object": (lambda x: isinstance(x, dict), "an object"),
    "array": (lambda x: isinstance(x, list), "a list"),
    "string": (lambda x: isinstance(x, str), "a text"),
    "number": (lambda x: isinstance(x, int | float) and not isinstance(x, bool), "a number"),
    "integer": (
        lambda x: isinstance(x, int | float) and not isinstance(x, bool) and x == x // 1,
        "a whole number",
    ),
    "boolean": (lambda x: isinstance(x, bool), "true or false"),
    "null": (lambda x: x is None, "null"),
}
#: keywords that state nothing about the data
_NOTES = {"$schema", "$id", "$defs", "title", "description", "default"}
#: keywords that another keyword reads
_READ = {"then"}


def check(data: Any, name: str, where: str) -> None:
    """Check that plain data have the structure of a format.

    Args:
        data: Content of a JSON file.
        name: Name of the format, such as 'isd-score/1'.
        where: Source of the data; start of the error message.

    Raises:
        InputError: The data have another structure; the message names the place.
    """
    schema = _loaded(name)
    problem = next(problems(data, schema, schema), None)
    if problem is not None:
        raise InputError(f"{where}: {problem}")


@functools.cache
def _loaded(name: str) -> dict[str, Any]:
    from . import load

    return load(name)


def problems(data: Any, schema: Any, root: dict[str, Any], place: str = "") -> Iterator[str]:
    """Yield the differences between plain data and a schema.

    Args:
        data: Plain data.
        schema: Schema of the data.
        root: Schema with the definitions to which `schema` refers.
        place: Place of the data in the file, such as 'policies[0].cost'.

    Yields:
        A line that begins with the place.

    Raises:
        NotImplementedError: The schema has a keyword that is not handled.
    """
    if isinstance(schema, bool):
        if not schema:
            yield f"{place or 'it'} is not allowed"
        return
    for keyword, value in schema.items():
        if keyword in _NOTES or keyword in _READ:
            continue
        try:
            rule = _RULES[keyword]
        except KeyError:
            raise NotImplementedError(f"schema keyword '{keyword}'") from None
        yield from rule(data, value, schema, root, place)


def _fits(data: Any, schema: Any, root: dict[str, Any]) -> bool:
    return next(problems(data, schema, root), None) is None


def _same(a: Any, b: Any) -> bool:
    """Return whether two JSON values are equal; true is not 1."""
    return a == b and isinstance(a, bool) == isinstance(b, bool)


def _at(place: str, key: str | int) -> str:
    if isinstance(key, int):
        return f"{place}[{key}]"
    return f"{place}.{plain(key, 40)}" if place else plain(key, 40)


def _refer(data: Any, value: str, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
    yield from problems(data, root["$defs"][value.removeprefix("#/$defs/")], root, place)


def _type(data: Any, value: Any, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
    names = [value] if isinstance(value, str) else value
    if not any(_TYPES[n][0](data) for n in names):
        yield f"{place or 'it'} must be {' or '.join(_TYPES[n][1] for n in names)}, not {shown(data)}"


def _choice(data: Any, value: Any, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
    if not any(_same(data, x) for x in value):
        yield f"{place or 'it'} must be {' or '.join(shown(x) for x in value)}, not {shown(data)}"


def _const(data: Any, value: Any, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
    yield from _choice(data, [value], schema, root, place)


def _bound(words: str, holds: Callable[[Any, Any], bool]) -> Callable[..., Iterator[str]]:
    def rule(data: Any, value: Any, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
        if _TYPES["number"][0](data) and not holds(data, value):
            yield f"{place or 'it'} must be {words} {value:g}, not {shown(data)}"

    return rule


def _length(
    kind: type[list[Any]] | type[dict[Any, Any]] | type[str], words: str, holds: Callable[[int, int], bool]
) -> Callable[..., Iterator[str]]:
    def rule(data: Any, value: int, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
        if isinstance(data, kind) and not holds(len(data), value):
            yield f"{place or 'it'} must have {words} {value} entries, not {len(data)}"

    return rule


def _required(data: Any, value: list[str], schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
    for key in value if isinstance(data, dict) else ():
        if key not in data:
            yield f"{place or 'it'} has no {shown(key)}"


def _depend(
    data: Any, value: dict[str, list[str]], schema: Any, root: dict[str, Any], place: str
) -> Iterator[str]:
    for key, others in value.items():
        if isinstance(data, dict) and key in data:
            yield from _required(data, others, schema, root, place)


def _properties(data: Any, value: Any, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
    for key, part in value.items():
        if isinstance(data, dict) and key in data:
            yield from problems(data[key], part, root, _at(place, key))


def _patterns(data: Any, value: Any, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
    for pattern, part in value.items():
        for key in data if isinstance(data, dict) else ():
            if re.search(pattern, key):
                yield from problems(data[key], part, root, _at(place, key))


def _others(data: Any, value: Any, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
    own, patterns = schema.get("properties", {}), schema.get("patternProperties", {})
    for key in data if isinstance(data, dict) else ():
        if key not in own and not any(re.search(p, key) for p in patterns):
            yield from problems(data[key], value, root, _at(place, key))


def _items(data: Any, value: Any, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
    for i, x in enumerate(data if isinstance(data, list) else ()):
        yield from problems(x, value, root, _at(place, i))


def _all(data: Any, value: Any, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
    for part in value:
        yield from problems(data, part, root, place)


def _one(data: Any, value: Any, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
    count = sum(_fits(data, part, root) for part in value)
    if count != 1:
        yield f"{place or 'it'} must have exactly one of its forms, not {count}"


def _if(data: Any, value: Any, schema: Any, root: dict[str, Any], place: str) -> Iterator[str]:
    if _fits(data, value, root):
        yield from problems(data, schema.get("then", True), root, place)


_RULES: dict[str, Callable[..., Iterator[str]]] = {
    "$ref": _refer,
    "type": _type,
    "enum": _choice,
    "const": _const,
    "minimum": _bound("at least", lambda x, least: x >= least),
    "maximum": _bound("at most", lambda x, most: x <= most),
    "exclusiveMinimum": _bound("above", lambda x, least: x > least),
    "minItems": _length(list, "at least", lambda n, least: n >= least),
    "maxItems": _length(list, "at most", lambda n, most: n <= most),
    "minProperties": _length(dict, "at least", lambda n, least: n >= least),
    "minLength": _length(str, "at least", lambda n, least: n >= least),
    "required": _required,
    "dependentRequired": _depend,
    "properties": _properties,
    "patternProperties": _patterns,
    "additionalProperties": _others,
    "items": _items,
    "allOf": _all,
    "oneOf": _one,
    "if": _if,
}
