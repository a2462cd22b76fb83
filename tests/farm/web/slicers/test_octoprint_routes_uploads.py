"""Uploads of slicers in OctoPrint's dialect: which job they become, and what is refused."""

import pytest

from farm.model import Role
from farms.slicer_farm import UPLOAD_PATH, RefusingWorkers, SlicerFarm
from farms.web_farm import HOST


@pytest.fixture
def make_slicer_farm(tmp_path):
    return lambda **options: SlicerFarm(tmp_path, **options)


def test_version_is_one_that_slicers_accept(make_slicer_farm):
    farm = make_slicer_farm()
    response = farm.ask("GET", "/api/version", farm.add_key(Role.LOOK))
    assert response.status_code == 200
    assert response.json()["api"] == "0.1"
    assert response.json()["text"].startswith("OctoPrint")


def test_plain_upload_is_held_and_upload_with_print_is_submitted(make_slicer_farm):
    farm = make_slicer_farm()
    key = farm.add_key(Role.PRINT)
    held_response, printed_response = farm.upload(key, print="false"), farm.upload(key, print="true")
    assert [response.status_code for response in (held_response, printed_response)] == [201, 201]
    assert [farm.jobs_by_number[n].options.hold for n in (1, 2)] == [True, False]
    assert [response.json()["effectivePrint"] for response in (held_response, printed_response)] == [
        False,
        True,
    ]
    assert farm.jobs_by_number[1].submitted_by == "key print"
    assert farm.jobs_by_number[1].name == "box.gcode"
    assert farm.unfinished_uploads == []


def test_response_is_that_of_octoprint_with_a_location(make_slicer_farm):
    farm = make_slicer_farm()
    response = farm.upload(farm.add_key(Role.PRINT), "größe 1.gcode", print="true")
    assert response.headers["location"] == f"http://{HOST}{UPLOAD_PATH}/1/gr%C3%B6%C3%9Fe%201.gcode"
    assert response.json() == {
        "files": {
            "local": {
                "name": "größe 1.gcode",
                "path": "1/größe 1.gcode",
                "origin": "local",
                "refs": {"resource": response.headers["location"]},
            }
        },
        "done": True,
        "effectiveSelect": False,
        "effectivePrint": True,
    }


def test_farm_with_approval_of_every_job_prints_no_upload_at_once(make_slicer_farm):
    farm = make_slicer_farm(approve=True)
    assert farm.upload(farm.add_key(Role.PRINT), print="true").json()["effectivePrint"] is False


@pytest.mark.parametrize("name", ["a.stl", "a.obj", "a.ply", "a.3mf"])
def test_models_are_accepted_as_well(make_slicer_farm, name):
    farm = make_slicer_farm()
    assert farm.upload(farm.add_key(Role.PRINT), name, print="true").status_code == 201
    assert farm.jobs_by_number[1].name == name


def test_upload_to_the_address_of_a_printer_requests_that_printer(make_slicer_farm):
    farm = make_slicer_farm()
    key = farm.add_key(Role.PRINT)
    response = farm.upload(key, url_path="/to/b" + UPLOAD_PATH, print="true")
    assert farm.jobs_by_number[1].options.only == ("b",)
    assert response.headers["location"] == f"http://{HOST}/to/b{UPLOAD_PATH}/1/box.gcode"
    response_to_unknown = farm.upload(key, url_path="/to/c" + UPLOAD_PATH)
    assert (response_to_unknown.status_code, response_to_unknown.text) == (
        404,
        "there is no printer c; the fleet has a, b",
    )
    assert len(farm.jobs_by_number) == 1


def test_refusal_is_plain_text_with_line_and_reason_in_front(make_slicer_farm):
    farm = make_slicer_farm(workers=RefusingWorkers())
    response = farm.upload(farm.add_key(Role.PRINT), "n" * 200 + ".gcode")
    assert response.status_code == 400
    assert response.headers["content-type"] == "text/plain"
    assert response.text == "line 12: G29 probes the bed, which this printer cannot"
    assert (farm.jobs_by_number, farm.unfinished_uploads) == ({}, [])


def test_folder_of_an_upload_is_shown_and_not_interpreted(make_slicer_farm):
    farm = make_slicer_farm()
    fields = {"path": "/../etc/", "print": "true"}
    response = farm.ask(
        "POST", UPLOAD_PATH, farm.add_key(Role.PRINT), files={"file": ("a.gcode", b"G28")}, data=fields
    )
    assert response.status_code == 201
    assert farm.jobs_by_number[1].options.note == "../etc"


FORM_HEADERS = {"content-type": "multipart/form-data; boundary=b"}
FORM = (
    b'--b\r\nContent-Disposition: form-data; name="file"; filename="../../a.gcode"\r\n\r\nG28\r\n'
    b'--b\r\nContent-Disposition: form-data; name="print"\r\n\r\ntrue\r\n--b--\r\n'
)


def make_headers(size):
    return {**FORM_HEADERS, "content-length": str(size)}


def test_upload_cut_at_any_byte_leaves_no_job_and_no_file(make_slicer_farm):
    farm = make_slicer_farm()
    key = farm.add_key(Role.PRINT)
    event_count = len(farm.store.read_all_events())
    for end in range(len(FORM)):
        response = farm.send(UPLOAD_PATH, key, [FORM[:end], None], make_headers(len(FORM)))
        assert response.status == 400, response
    assert (farm.jobs_by_number, farm.unfinished_uploads, len(farm.store.read_all_events())) == (
        {},
        [],
        event_count,
    )
    assert farm.send(UPLOAD_PATH, key, [FORM], make_headers(len(FORM))).status == 201
    assert farm.jobs_by_number[1].name == "a.gcode"


def test_refused_upload_is_read_to_its_end_so_that_the_client_sees_the_response(make_slicer_farm):
    farm = make_slicer_farm()
    chunks = [b"--x", *[b"x"] * 5]
    assert farm.send(UPLOAD_PATH, farm.add_key(Role.PRINT), chunks, make_headers(8)).unread == 0
    large_response = farm.send(
        UPLOAD_PATH, farm.add_key(Role.PRINT, "b"), [b"--x"] * 5, make_headers(3 * 10**9)
    )
    assert (large_response.status, large_response.unread) == (400, 5)
    assert "fleet.uploads.model_gb" in large_response.text
    waiting_headers = {**make_headers(8), "expect": "100-continue"}
    assert (
        farm.send(
            UPLOAD_PATH,
            farm.add_key(Role.PRINT, "c"),
            chunks,
            {**waiting_headers, "content-type": "text/plain"},
        ).unread
        == 6
    )


def test_length_of_an_upload_must_be_announced(make_slicer_farm):
    response = send_form(make_slicer_farm(), {**FORM_HEADERS})
    assert (response.status, response.text[:31]) == (411, "the request has no Content-Leng")


def send_form(farm, headers):
    return farm.send(UPLOAD_PATH, farm.add_key(Role.PRINT), [FORM], headers)


@pytest.mark.parametrize("headers", [{}, {"transfer-encoding": "chunked"}])
def test_upload_longer_than_announced_leaves_no_job_and_no_file(make_slicer_farm, headers):
    """Include chunked encoding, with which h11 reads more than the announced length."""
    farm = make_slicer_farm()
    farm.send(UPLOAD_PATH, farm.add_key(Role.PRINT), [FORM, FORM], {**make_headers(10), **headers})
    assert not farm.jobs_by_number and not list(farm.services.state.work.iterdir())


def test_empty_file_is_refused(make_slicer_farm):
    farm = make_slicer_farm()
    response = farm.upload(farm.add_key(Role.PRINT), content=b"")
    assert (response.status_code, response.text) == (400, "the file is empty")


def test_refusals_of_the_guard_are_plain_text_too(make_slicer_farm):
    farm = make_slicer_farm()
    for path in ("/api/version", "/to/a/api/version", "/api/nothing"):
        response = farm.ask("GET", path)
        assert (response.status_code, response.headers["content-type"]) == (401, "text/plain"), path
        assert response.text.startswith("this needs a key")
    assert farm.ask("GET", "/api/v1/status").headers["content-type"] == "application/json"
