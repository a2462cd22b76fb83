"""Moonraker's dialect: recognised by slicers, and uploads become the same jobs."""

import pytest

from farm.model import Role
from farms.slicer_farm import RefusingWorkers, SlicerFarm
from farms.web_farm import HOST

UPLOAD_PATH = "/server/files/upload"


@pytest.mark.parametrize("prefix", ["", "/to/b"])
def test_server_is_recognised_by_its_version(tmp_path, prefix):
    farm = SlicerFarm(tmp_path)
    key = farm.add_key(Role.LOOK)
    info = farm.ask("GET", f"{prefix}/server/info", key).json()
    assert list(info) == ["result"]
    assert info["result"]["moonraker_version"]
    assert farm.ask("GET", f"{prefix}/printer/info", key).json()["result"]["state"] == "ready"


def test_upload_is_held_and_upload_with_print_is_submitted(tmp_path):
    farm = SlicerFarm(tmp_path)
    key = farm.add_key(Role.PRINT)
    held_answer = farm.upload(key, url_path=UPLOAD_PATH, root="gcodes")
    printed_answer = farm.upload(key, url_path="/to/b" + UPLOAD_PATH, root="gcodes", print="true")
    assert [answer.status_code for answer in (held_answer, printed_answer)] == [201, 201]
    assert held_answer.json()["item"] == {"path": "1/box.gcode", "root": "gcodes"}
    assert [answer.json()["print_queued"] for answer in (held_answer, printed_answer)] == [False, True]
    assert [(job.options.hold, job.options.only) for job in farm.jobs_by_number.values()] == [
        (True, ()),
        (False, ("b",)),
    ]
    assert printed_answer.headers["location"] == f"http://{HOST}/to/b/server/files/gcodes/2/box.gcode"


def test_refusals_are_plain_text(tmp_path):
    farm = SlicerFarm(tmp_path, workers=RefusingWorkers())
    answer = farm.upload(farm.add_key(Role.PRINT), url_path=UPLOAD_PATH)
    assert (answer.status_code, answer.headers["content-type"]) == (400, "text/plain")
    assert answer.text.startswith("line 12:")
    for path in ("/server/info", UPLOAD_PATH, "/printer/info"):
        assert farm.ask("GET", path).headers["content-type"] == "text/plain"
