"""Page that lists the routes on the network. It loads no file and runs no script. Pure."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from farm.web.pages.rendering import load_template
from farm.web.pages.sentences import format_commands

Text = tuple[tuple[str, str], ...]
"""Pieces of a text: pairs of plain text and the name of an object to link to, one of which is empty."""

_STYLE = (
    ":root{color-scheme:light dark;--text:#222;--back:#fff;--line:#ccc;--link:#174ea6}"
    "@media(prefers-color-scheme:dark){:root{--text:#e8eaed;--back:#15171a;--line:#3a3f46;--link:#8ab4f8}}"
    "body{font:1rem/1.5 sans-serif;max-width:60rem;margin:auto;padding:1rem}"
    "body{color:var(--text);background:var(--back)}"
    "a{color:var(--link)}"
    "*{overflow-wrap:anywhere}"
    "h2{font-size:1.1rem;border-top:1px solid var(--line);padding-top:.8rem}code{font-family:monospace}"
    "th{overflow-wrap:normal}"
    "td,th{text-align:left;vertical-align:top;padding:.1rem 1rem .1rem 0}dd{margin-left:1.5rem}"
)
_STYLE_HASH = base64.b64encode(hashlib.sha256(_STYLE.encode()).digest()).decode()
POLICY = f"default-src 'none'; style-src 'sha256-{_STYLE_HASH}'; frame-ancestors 'none'; base-uri 'none'"
"""Content security policy of the page: it allows only the page's own style."""


_LIMIT_WORDS = {"minimum": "from", "exclusiveMinimum": "above", "maximum": "to"}


@dataclass(frozen=True, slots=True)
class _Parameter:
    name: str
    location: str
    is_required: bool
    value: Text


@dataclass(frozen=True, slots=True)
class _Operation:
    id: str
    method: str
    path: str
    text: Markup
    role: str | None
    parameters: Sequence[_Parameter]
    bodies: Sequence[tuple[str, Text]]
    responses: Sequence[tuple[str, Text]]


def render_api_page(document: Mapping[str, Any], document_url: str) -> str:
    """Render the page from the OpenAPI description of the routes.

    Parameters
    ----------
    document
        The OpenAPI description.
    document_url
        URL of the description, for a link.
    """
    info = document["info"]
    return load_template("api.html").render(
        title=info["title"],
        version=info["version"],
        description=format_commands(info["description"]),
        document=document_url,
        style=_STYLE,
        operations=list(_list_operations(document)),
        objects=list(_list_objects(document)),
    )


def _list_operations(document: Mapping[str, Any]) -> Iterator[_Operation]:
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            yield _Operation(
                id=operation["operationId"],
                method=method.upper(),
                path=path,
                text=format_commands(operation.get("description") or f"{operation['summary']}."),
                role=operation.get("x-role"),
                parameters=[
                    _Parameter(p["name"], p["in"], p.get("required", False), describe_schema(p["schema"]))
                    for p in operation.get("parameters", ())
                ],
                bodies=_list_contents(operation.get("requestBody", {})),
                responses=_list_contents(operation["responses"]["200"]),
            )


def _list_contents(body: Mapping[str, Any]) -> list[tuple[str, Text]]:
    contents = body.get("content", {})
    return [
        (media_type, describe_schema(content.get("schema", {}))) for media_type, content in contents.items()
    ]


def _list_objects(document: Mapping[str, Any]) -> Iterator[tuple[str, list[tuple[str, Text, bool]]]]:
    for name, schema in sorted(document["components"]["schemas"].items()):
        if "enum" in schema:
            yield name, [(str(value), (), False) for value in schema["enum"]]
        else:
            required_fields = schema.get("required", ())
            fields = schema.get("properties", {}).items()
            yield name, [(field, describe_schema(value), field in required_fields) for field, value in fields]


def describe_schema(schema: Mapping[str, Any]) -> Text:
    """Describe in a few words the values that a JSON schema allows."""
    if "$ref" in schema:
        return (("", str(schema["$ref"]).rpartition("/")[2]),)
    if "anyOf" in schema:
        choices: list[tuple[str, str]] = []
        for choice in schema["anyOf"]:
            choices += [(" or ", "")] if choices else []
            choices += describe_schema(choice)
        return tuple(choices)
    kind = schema.get("type")
    if kind == "array":
        return (("list of ", ""), *describe_schema(schema.get("items", {})))
    if kind == "object" and isinstance(schema.get("additionalProperties"), dict):
        return (("object of ", ""), *describe_schema(schema["additionalProperties"]))
    if "const" in schema:
        return ((str(schema["const"]), ""),)
    limits = [f"{word} {schema[name]}" for name, word in _LIMIT_WORDS.items() if name in schema]
    return ((" ".join([str(kind or "anything"), *limits]), ""),)
