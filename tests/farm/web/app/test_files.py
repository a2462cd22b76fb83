"""Files of a job over the network: those of the job, by name, and no others."""

import hashlib

import pytest

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL
from farm.model import JobOptions, Role
from farm.planning.plan import Plan
from farms.web_farm import WebFarm, get_network_path

FILES_PATH = get_network_path("/jobs/1/files")


@pytest.fixture
def farm(tmp_path):
    farm = WebFarm(tmp_path)
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions(), "ann")
    content = b"solid part"
    file_name = f"{hashlib.sha256(content).hexdigest()}.stl"
    (farm.state.files / file_name).write_bytes(content)
    (farm.state.files / "secret.txt").write_text("secret")
    event = make_plan_event(1, 2)
    parts = (event.parts[0].model_copy(update={"file": file_name}), *event.parts[1:])
    farm.controller.on_plan(1, Plan(parts, event.plates, event.repairs, 1.0, 500.0))
    yield farm
    farm.store.close()


def test_existing_files_are_listed_and_sent_with_their_hash(farm):
    key = farm.add_key(Role.LOOK)
    (file_view,) = farm.ask("GET", FILES_PATH, key).json()["files"]
    assert file_view["name"] == "p01.stl"
    response = farm.ask("GET", f"{FILES_PATH}/p01.stl", key)
    assert response.status_code == 200
    assert hashlib.sha256(response.content).hexdigest() == file_view["sha256"]
    assert len(response.content) == file_view["size"]
    assert response.headers["content-disposition"].startswith("attachment")
    partial_response = farm.ask("GET", f"{FILES_PATH}/p01.stl", key, headers={"range": "bytes=6-"})
    assert (partial_response.status_code, partial_response.content) == (206, b"part")
    assert farm.ask_socket("GET", "/jobs/1/files").json()["files"] == [file_view]


@pytest.mark.parametrize(
    "name",
    [
        *("secret.txt", "..%2fsecret.txt", "%2e%2e%2f%2e%2e%2ffarm.db", "p02.stl"),
        *("", "%00", "p01.stl%00", "%2fetc%2fpasswd", "....//secret.txt", "p01.STL"),
    ],
)
def test_other_file_names_are_not_found(farm, name):
    response = farm.ask("GET", f"{FILES_PATH}/{name}", farm.add_key(Role.LOOK))
    assert response.status_code == 404


def test_files_of_an_unknown_job_are_not_found(farm):
    assert farm.ask("GET", get_network_path("/jobs/7/files"), farm.add_key(Role.LOOK)).status_code == 404
