"""Description of the network's routes: complete, and on a page that loads nothing."""

import re

import pytest

from farm.model import Role
from farm.web.access import LIVENESS_PATH, METRICS_PATH, ROLES, SCHEMA_PAGE_PATH, SCHEMA_PATH, find_role
from farms.web_farm import WebFarm, get_network_path

DESCRIPTION_ROUTES = {("GET", SCHEMA_PATH), ("GET", SCHEMA_PAGE_PATH)}


@pytest.fixture
def farm(tmp_path):
    farm = WebFarm(tmp_path)
    yield farm
    farm.store.close()


@pytest.fixture
def document(farm):
    return farm.ask("GET", SCHEMA_PATH, farm.add_key(Role.LOOK)).json()


def list_operations(document):
    return {
        (verb.upper(), path): operation
        for path, operations in document["paths"].items()
        for verb, operation in operations.items()
    }


def list_references(value):
    if isinstance(value, dict):
        return {value.get("$ref")}.union(*map(list_references, value.values())) - {None}
    return set().union(*map(list_references, value)) if isinstance(value, list) else set()


def test_every_served_route_is_described_with_its_role_and_no_other(document):
    operations = list_operations(document)
    described_routes = {
        route for route in ROLES if route[1].startswith(get_network_path("/"))
    } - DESCRIPTION_ROUTES
    assert operations.keys() == described_routes | {("GET", METRICS_PATH), ("GET", LIVENESS_PATH)}
    for (verb, path), operation in operations.items():
        assert (verb, path) == ("GET", LIVENESS_PATH) or operation["x-role"] == find_role(verb, path)
    assert get_network_path("/down") not in document["paths"]
    ids = [operation["operationId"] for operation in operations.values()]
    assert len(set(ids)) == len(ids)


def test_every_response_has_a_schema_and_every_reference_exists(document):
    for route, operation in list_operations(document).items():
        for status, response in operation["responses"].items():
            for kind, content in response["content"].items():
                assert kind != "application/json" or content["schema"], (route, status)
        assert "422" not in operation["responses"], route
    schemas = document["components"]["schemas"]
    assert {f"#/components/schemas/{name}" for name in schemas} == list_references(document)
    assert "DownRequest" not in schemas


def test_refusal_and_a_response_have_the_fields_that_are_described(farm, document):
    schemas = document["components"]["schemas"]
    refusal = farm.ask("GET", get_network_path("/status")).json()
    assert refusal.keys() == set(schemas["Problem"]["required"])
    status = farm.ask("GET", get_network_path("/status"), farm.add_key(Role.LOOK, "two")).json()
    assert set(schemas["Status"]["required"]) <= status.keys() <= schemas["Status"]["properties"].keys()


def test_page_shows_every_operation_and_loads_nothing(farm, document):
    response = farm.ask("GET", SCHEMA_PAGE_PATH, farm.add_key(Role.LOOK, "two"))
    assert response.headers["content-type"].startswith("text/html")
    for verb, path in list_operations(document):
        assert f"<code>{verb} {path}</code>" in response.text
    links = re.findall(r'(?:src|href)="([^"]*)"', response.text)
    assert set(re.findall(r'id="([^"]*)"', response.text)) >= {
        link[1:] for link in links if link.startswith("#")
    }
    assert {link for link in links if not link.startswith("#")} == {SCHEMA_PATH}
    assert "<script" not in response.text
    policy = response.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; style-src 'sha256-")


@pytest.mark.parametrize("path", [SCHEMA_PATH, SCHEMA_PAGE_PATH, METRICS_PATH])
def test_description_and_metrics_need_a_key(farm, path):
    assert farm.ask("GET", path).status_code == 401
    assert farm.ask("GET", path, farm.add_key(Role.LOOK)).status_code == 200
