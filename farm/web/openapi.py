"""OpenAPI 3.1 description of the routes on the network. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fastapi.openapi.utils import get_openapi
from starlette.routing import BaseRoute

import farm
from farm import api
from farm.api import NETWORK_PREFIX
from farm.model import Role
from farm.web.access import LIVENESS_PATH, METRICS_PATH, find_role, is_public

_REFERENCE_PREFIX = "#/components/schemas/"
_PROBLEM = {"content": {"application/json": {"schema": {"$ref": f"{_REFERENCE_PREFIX}Problem"}}}}
_ERROR_RESPONSES = {
    "4XX": {"description": "The request was refused; the error text says what to do.", **_PROBLEM},
    "500": {"description": "The daemon failed.", **_PROBLEM},
}
_INVALID_STATUS = "422"  # FastAPI's status for an invalid request; this application uses 400
_SECURITY_SCHEMES = {
    "key": {"type": "apiKey", "in": "header", "name": "X-Api-Key"},
    "bearer": {"type": "http", "scheme": "bearer"},
}
_DESCRIPTION = (
    "Interface of the farm for programs on the network. Each request needs a key, from `farm key add NAME`; "
    "an operation's `x-role` is the role that the key must have. Times are ISO 8601 in the fleet's time "
    "zone, and durations are in seconds. Later releases may add fields and routes, but never remove or "
    "redefine any."
)


def describe_routes(routes: list[BaseRoute]) -> dict[str, Any]:
    """Describe the routes for programs that use the farm's own API.

    Parameters
    ----------
    routes
        All routes of the application; their paths begin with the prefix of the API.

    Returns
    -------
    dict
        An OpenAPI document; an operation's `x-role` is the role that it requires.
    """
    document: dict[str, Any] = get_openapi(
        title="farm", version=farm.__version__, description=_DESCRIPTION, routes=routes
    )
    paths: dict[str, Any] = {}
    for path, method, operation in _list_operations(document):
        if not path.startswith(f"{NETWORK_PREFIX}/") and path not in (METRICS_PATH, LIVENESS_PATH):
            continue  # a page, or a route in the API of another print server
        role = find_role(method.upper(), path)
        if role is not None or is_public(method.upper(), path):
            paths.setdefault(path, {})[method] = _complete_operation(operation, method, path, role)
    document["paths"] = paths
    components = document["components"]
    components["schemas"]["Problem"] = api.Problem.model_json_schema()
    components["securitySchemes"] = _SECURITY_SCHEMES
    document["security"] = [{name: []} for name in _SECURITY_SCHEMES]
    components["schemas"] = _select_used_schemas(paths, components["schemas"])
    return document


def _list_operations(document: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            yield path, method, operation


def _complete_operation(
    operation: dict[str, Any], method: str, path: str, role: Role | None
) -> dict[str, Any]:
    """Add an id, the role and the error responses to the description of an operation."""
    responses = {
        status: response for status, response in operation["responses"].items() if status != _INVALID_STATUS
    }
    for response in responses.values():
        json = response.get("content", {}).get("application/json")
        if json is not None and not json.get("schema"):
            json["schema"] = {"type": "null"}
    segments = path.replace("{", "").replace("}", "").strip("/").split("/")
    return {
        **operation,
        "operationId": "_".join([method, *segments]),
        "responses": {**responses, **_ERROR_RESPONSES},
        **({"security": []} if role is None else {"x-role": str(role)}),
    }


def _select_used_schemas(paths: dict[str, Any], schemas: dict[str, Any]) -> dict[str, Any]:
    """Select the schemas that the operations refer to, directly or through others."""
    used_names: set[str] = set()
    pending_names = list(_find_references(paths))
    while pending_names:
        name = pending_names.pop()
        if name not in used_names:
            used_names.add(name)
            pending_names += _find_references(schemas[name])
    return {name: schema for name, schema in schemas.items() if name in used_names}


def _find_references(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        reference = value.get("$ref")
        if isinstance(reference, str) and reference.startswith(_REFERENCE_PREFIX):
            yield reference.removeprefix(_REFERENCE_PREFIX)
        for item in value.values():
            yield from _find_references(item)
    elif isinstance(value, list):
        for item in value:
            yield from _find_references(item)
