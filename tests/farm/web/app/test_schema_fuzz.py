"""Requests from the OpenAPI description: responses match it, and none is a server error."""

from contextlib import suppress

import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings
from hypothesis.errors import Unsatisfiable
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from farm.model import Role
from farm.web.access import SCHEMA_PATH
from farms.network_farm import HOST, NetworkFarm

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
]
BODY_FIELDS = {"json", "data", "content", "params"}
EXAMPLE_COUNT = 4  # for each operation


@pytest.fixture
def farm(tmp_path):
    farm = NetworkFarm(tmp_path)
    yield farm
    farm.store.close()


@pytest.mark.parametrize("mode", GenerationMode)
def test_generated_requests_get_responses_that_match_the_description(farm, mode):
    key = farm.add_key(Role.OPERATE).text
    schema = schemathesis.openapi.from_dict(farm.ask("GET", SCHEMA_PATH, key).json())
    operations = [result.ok() for result in schema.get_all_operations()]
    assert len(operations) > 20
    requested_routes = set()
    for operation in operations:
        if operation.path.endswith("/events"):
            continue  # the stream does not end

        @settings(
            max_examples=EXAMPLE_COUNT,
            derandomize=True,
            deadline=None,
            database=None,
            suppress_health_check=list(HealthCheck),
        )
        @given(operation.as_strategy(mode))
        def check_case(case):
            request_fields = case.as_transport_kwargs(f"http://{HOST}")
            headers = {
                name: value.encode("latin-1", "replace") for name, value in request_fields["headers"].items()
            }
            body = {
                name: value
                for name, value in request_fields.items()
                if name in BODY_FIELDS and value is not None
            }
            if isinstance(body.get("data"), bytes | str):
                body["content"] = body.pop("data")
            response = farm.ask(
                request_fields["method"], request_fields["url"], headers={**headers, "x-api-key": key}, **body
            )
            case.validate_response(response, checks=CHECKS)

        with suppress(Unsatisfiable):  # a route without parameters has no invalid request
            check_case()
            requested_routes.add(operation.path)
    assert len(requested_routes) > 15 and farm.shutdowns == []
