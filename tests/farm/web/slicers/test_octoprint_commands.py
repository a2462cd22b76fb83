"""Requests of clients after an upload: they read, select, print, pause and cancel."""

import pytest

from farm.model import JobState, Role
from farms.slicer_farm import UPLOAD_PATH, SlicerFarm
from farms.web_farm import HOST

START_COMMAND = {"command": "start"}


@pytest.fixture
def farm(tmp_path):
    return SlicerFarm(tmp_path)


@pytest.fixture
def key(farm):
    return farm.add_key(Role.PRINT)


def select_file(farm, key, path, **fields):
    return farm.ask("POST", f"{UPLOAD_PATH}/{path}", key, json={"command": "select", **fields})


def test_selecting_with_print_releases_a_held_job_before_it_is_planned(farm, key):
    path = farm.upload(key).headers["location"].removeprefix(f"http://{HOST}{UPLOAD_PATH}/")
    assert farm.jobs_by_number[1].options.hold
    assert select_file(farm, key, path, print=True).status_code == 204
    assert not farm.jobs_by_number[1].options.hold
    # The job is already released, so nothing changes.
    assert select_file(farm, key, path, print=True).status_code == 204
    assert [name for _, name, _ in farm.store.read_all_events()].count("JobReleased") == 1


def test_selection_alone_prints_nothing_and_a_start_command_does(farm, key):
    farm.upload(key)
    assert select_file(farm, key, "box.gcode").status_code == 204
    assert farm.jobs_by_number[1].options.hold
    assert farm.ask("GET", "/api/job", key).json()["job"]["file"]["name"] == "box.gcode"
    assert farm.ask("POST", "/api/job", key, json=START_COMMAND).status_code == 204
    assert not farm.jobs_by_number[1].options.hold


def test_only_the_sender_or_an_operator_may_release_a_job(farm, key):
    farm.upload(key)
    refusal = select_file(farm, farm.add_key(Role.PRINT, "other"), "1/box.gcode", print=True)
    assert (refusal.status_code, refusal.headers["content-type"]) == (400, "text/plain")
    assert refusal.text == "only an operator may let job 1 print: `farm approve 1`"
    assert farm.jobs_by_number[1].options.hold
    assert select_file(farm, farm.add_key(Role.OPERATE), "1/box.gcode", print=True).status_code == 204
    assert not farm.jobs_by_number[1].options.hold


def test_sender_may_not_release_a_job_that_needs_approval(tmp_path):
    farm = SlicerFarm(tmp_path, approve=True)
    key = farm.add_key(Role.PRINT)
    farm.upload(key, print="true")
    assert select_file(farm, key, "1/box.gcode", print=True).status_code == 400
    assert farm.jobs_by_number[1].options.hold


def test_ended_job_is_not_released(farm, key):
    farm.upload(key)
    assert select_file(farm, key, "1/box.gcode").status_code == 204
    assert farm.ask("POST", "/api/job", key, json={"command": "cancel"}).status_code == 204
    assert farm.jobs_by_number[1].state is JobState.CANCELLED
    response = farm.ask("POST", "/api/job", key, json=START_COMMAND)
    assert (response.status_code, response.text) == (400, "job 1 has already ended: it is cancelled")


def test_pause_toggles_the_selected_job(farm, key):
    farm.upload(key, print="true")
    select_file(farm, key, "box.gcode")
    states = []
    for action in ({}, {}, {"action": "pause"}, {"action": "resume"}):
        assert farm.ask("POST", "/api/job", key, json={"command": "pause", **action}).status_code == 204
        states.append(farm.jobs_by_number[1].paused)
    assert states == [True, False, True, False]


def test_unsupported_commands_are_refused_in_plain_text(farm, key):
    response_without_file = farm.ask("POST", "/api/job", key, json=START_COMMAND)
    assert (response_without_file.status_code, response_without_file.text[:20]) == (
        400,
        "no file is selected,",
    )
    farm.upload(key)
    select_file(farm, key, "box.gcode")
    for path, body in (
        ("/api/job", {"command": "restart"}),
        ("/api/job", {"command": "pause", "action": "x"}),
        ("/api/job", {}),
        (f"{UPLOAD_PATH}/box.gcode", {"command": "slice"}),
        ("/api/connection", {"command": "disconnect"}),
    ):
        response = farm.ask("POST", path, key, json=body)
        assert (response.status_code, response.headers["content-type"]) == (400, "text/plain"), body
    assert farm.ask("POST", "/api/connection", key, json={"command": "connect"}).status_code == 204


def test_files_are_the_open_jobs_of_the_address(farm, key):
    farm.upload(key, "a.gcode")
    farm.upload(key, "b.stl", url_path="/to/b" + UPLOAD_PATH)
    names = {
        prefix: [file["name"] for file in farm.ask("GET", f"{prefix}/api/files", key).json()["files"]]
        for prefix in ("", "/to/a", "/to/b")
    }
    assert names == {"": ["a.gcode", "b.stl"], "/to/a": ["a.gcode"], "/to/b": ["a.gcode", "b.stl"]}
    file = farm.ask("GET", f"/to/b{UPLOAD_PATH}/2/b.stl", key).json()
    assert (file["type"], file["refs"]["resource"]) == ("model", f"http://{HOST}/to/b{UPLOAD_PATH}/2/b.stl")
    missing_response = farm.ask("GET", f"{UPLOAD_PATH}/c.gcode", key)
    assert (missing_response.status_code, missing_response.headers["content-type"]) == (404, "text/plain")


def test_requests_of_cura_are_answered_at_both_addresses(farm):
    key = farm.add_key(Role.LOOK, "laptop")
    farm.report_ready("b", nozzle_c=24.5, bed_c=23.0)
    for prefix, name in (("", farm.controller.fleet.fleet.name), ("/to/b", "b")):
        responses = {
            path: farm.ask("GET", f"{prefix}/api/{path}", key).json()
            for path in ("version", "server", "settings", "printer", "printerprofiles", "job", "connection")
        }
        assert responses["settings"]["feature"]["sdSupport"] is False
        assert responses["printerprofiles"]["profiles"]["_default"]["name"] == name
        assert responses["job"]["state"] == "Operational"
        heaters = responses["printer"]["temperature"]
        assert heaters == {} if not prefix else heaters["tool0"]["actual"] == 24.5
        user = farm.ask("POST", f"{prefix}/api/login", key, json={"passive": True}).json()
        assert (user["name"], user["admin"]) == ("key laptop", False)
        assert farm.ask("GET", f"{prefix}/api/currentuser", key).json()["name"] == "key laptop"
        response_to_unknown = farm.ask("GET", "/to/nobody/api/printer", key)
        assert (response_to_unknown.status_code, response_to_unknown.headers["content-type"]) == (
            404,
            "text/plain",
        )
