"""Errors of `fleet.yaml`: their line, and their description in plain words. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import yaml
from pydantic_core import ErrorDetails

Place = tuple[str | int, ...]

_MUST_BE = {
    "int": "a whole number",
    "float": "a number",
    "finite": "a number",
    "decimal": "a number",
    "bool": "true or false",
    "string": "text; put it in quotes",
    "tuple": "a list: [..., ...]",
    "list": "a list: [..., ...]",
    "model": "keys with values: {key: value}",
    "dict": "keys with values: {key: value}",
}
_LIMITS = {
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "less than {lt:g}",
    "less_than_equal": "at most {le:g}",
    "string_too_short": "at least {min_length} characters long",
    "string_too_long": "at most {max_length} characters long",
}


class Misplaced(ValueError):
    """An error that shows only together with other lines; `place` says where to report it."""

    def __init__(self, message: str, *place: str | int) -> None:
        super().__init__(message)
        self.place = place


def in_words(error: ErrorDetails, pattern_hint: str | None = None) -> str:
    """Describe an error in plain words instead of the library's; `pattern_hint` says how it is written."""
    kind, context = error["type"], error.get("ctx", {})
    if kind == "missing":
        return "is missing" if isinstance(error["loc"][-1], str) else "is one value short"
    if kind == "string_pattern_mismatch":
        return f"must be {pattern_hint or 'written differently'}, not {str(error['input'])!r}"
    if kind == "invalid_key":
        return "a key must be text"
    if kind in _LIMITS:
        return f"must be {_LIMITS[kind].format(**context)}"
    if kind == "too_long":
        return "has too many values"
    must_be = _MUST_BE.get(kind.partition("_")[0])
    return f"must be {must_be}" if must_be else error["msg"].removeprefix("Value error, ")


def place_of(error: ErrorDetails) -> Place:
    """Where it is wrong: of a whole that does not fit together, the line that says so."""
    cause = error.get("ctx", {}).get("error")
    return cause.place if isinstance(cause, Misplaced) else error["loc"]


def written(node: yaml.Node | None, place: Place) -> Place:
    """Where a person wrote what is found at `place`: a printer's key may stand in `defaults`."""
    if len(place) < 3 or place[0] != "printers":
        return place
    own = _find(node, place[:2])
    shared = _find(node, ("defaults",))
    if any(key == place[2] for key, _ in _children(own)):
        return place
    return ("defaults", *place[2:]) if any(key == place[2] for key, _ in _children(shared)) else place


def line_of(node: yaml.Node | None, place: Place) -> int:
    """The line (from 1) of the deepest node on the way to `place`."""
    line = 1
    for step in place:
        for key, child in _children(node):
            if key == step:
                node = child
                line = child.start_mark.line + 1
                break
        else:
            break
    return line


def written_twice(node: yaml.Node | None) -> Place | None:
    """Where a key is written twice in one place: YAML takes the last one without a word."""
    looked_at: set[int] = set()  # an alias leads to a node again, even to one that it stands in

    def look(node: yaml.Node | None, place: Place) -> Place | None:
        if id(node) in looked_at:
            return None
        looked_at.add(id(node))
        seen: set[Any] = set()
        for key, child in _children(node):
            here = (*place, key)
            if key in seen:
                return here
            seen.add(key)
            found = look(child, here)
            if found is not None:
                return found
        return None

    return look(node, ())


def _find(node: yaml.Node | None, place: Place) -> yaml.Node | None:
    for step in place:
        node = next((child for key, child in _children(node) if key == step), None)
    return node


def _children(node: yaml.Node | None) -> Iterator[tuple[Any, yaml.Node]]:
    if isinstance(node, yaml.MappingNode):
        yield from ((key.value, value) for key, value in node.value)
    elif isinstance(node, yaml.SequenceNode):
        yield from enumerate(node.value)
