"""Programs that request a key, and operators who grant or deny it."""

import pytest

from farm.control.access.app_key_requests import (
    MAX_REQUESTS,
    MAX_REQUESTS_PER_ADDRESS,
    REQUEST_LIFETIME_S,
    AppKeyRequests,
)
from farm.errors import NotFoundError, RefusedError
from farms.slicer_farm import SlicerFarm
from farms.web_farm import HOST

REQUEST_PATH = "/plugin/appkeys/request"


@pytest.mark.parametrize("prefix", ["", "/to/b"])
def test_program_gets_granted_key_once(tmp_path, prefix):
    farm = SlicerFarm(tmp_path)
    assert farm.ask("GET", f"{prefix}/plugin/appkeys/probe").status_code == 204
    response = farm.ask("POST", prefix + REQUEST_PATH, json={"app": "Cura <b>5.9</b>"})
    location = response.headers["location"].removeprefix(f"http://{HOST}")
    assert (response.status_code, location) == (201, f"{prefix}{REQUEST_PATH}/{response.json()['app_token']}")
    assert farm.ask("GET", location).status_code == 202
    (request,) = farm.ask_socket("GET", "/keys").json()["requests"]
    assert (request["app"], request["address"]) == ("Cura b 5.9 b", "10.0.0.9")
    grant = farm.ask_socket("POST", f"/keys/requests/{request['code']}/grant", json={"role": "look"})
    assert grant.json() == {"name": f"Cura b 5.9 b {request['code']}"}
    key = farm.ask("GET", location).json()["api_key"]
    assert farm.ask("GET", location).status_code == 404
    headers = {"x-api-key": key}
    assert farm.ask("GET", "/api/version", headers=headers).status_code == 200
    assert farm.ask("POST", "/api/files/local", headers=headers).status_code == 403
    assert key not in str(farm.store.read_all_events())
    assert farm.ask_socket("GET", "/keys").json()["requests"] == []


def test_any_path_of_a_request_has_a_location(tmp_path):
    response = SlicerFarm(tmp_path).ask("POST", "/to/%E2%82%AC" + REQUEST_PATH, json={"app": "Cura"})
    assert response.status_code == 201
    assert response.headers["location"].startswith(f"http://{HOST}/to/%E2%82%AC{REQUEST_PATH}/")


def test_denied_program_gets_no_key(tmp_path):
    farm = SlicerFarm(tmp_path)
    location = farm.ask("POST", REQUEST_PATH, json={"app": "Cura"}).headers["location"]
    (request,) = farm.ask_socket("GET", "/keys").json()["requests"]
    assert farm.ask_socket("POST", f"/keys/requests/{request['code']}/deny").status_code == 200
    assert farm.ask_socket("POST", f"/keys/requests/{request['code']}/grant", json={}).status_code == 404
    response = farm.ask("GET", location)
    assert (response.status_code, response.headers["content-type"]) == (404, "text/plain")
    assert not farm.controller.books.keys


def test_visitor_does_not_learn_the_names_of_printers(tmp_path):
    farm = SlicerFarm(tmp_path)
    assert farm.ask("POST", "/to/nobody" + REQUEST_PATH, json={"app": "x"}).status_code == 201
    assert farm.ask("POST", REQUEST_PATH, json={"app": ""}).headers["content-type"] == "text/plain"
    assert farm.ask("GET", f"{REQUEST_PATH}/guessed").status_code == 404


def test_open_requests_are_limited_for_an_address_and_in_total():
    requests = AppKeyRequests()
    for _ in range(MAX_REQUESTS_PER_ADDRESS):
        requests.add("Cura", "1.2.3.4", 0.0)
    with pytest.raises(RefusedError, match="too many programs"):
        requests.add("Cura", "1.2.3.4", 0.0)
    for number in range(MAX_REQUESTS - MAX_REQUESTS_PER_ADDRESS):
        requests.add("Cura", f"1.2.3.{number}", 0.0)
    with pytest.raises(RefusedError, match="too many programs"):
        requests.add("Cura", "9.9.9.9", REQUEST_LIFETIME_S - 1.0)
    requests.add("Cura", "9.9.9.9", REQUEST_LIFETIME_S)


def test_request_and_granted_key_are_forgotten_after_their_time():
    requests = AppKeyRequests()
    token = requests.add("\x1b[31m\n", "1.2.3.4", 0.0)
    (request,) = requests.list_open_requests(1.0)
    assert request.app == "31m"
    request.key = "secret"
    with pytest.raises(NotFoundError):
        requests.take_key(token, REQUEST_LIFETIME_S)
    with pytest.raises(NotFoundError):
        requests.find_open_request(request.code, 1.0)
