"""Routes of a job's page and of the forms about its plan."""

import io
import re
import zipfile

import pytest

from books.planned_job import plan_job, submit_model
from farm.model import JobState, Role
from farm.state.books import put
from farms.network_farm import NetworkFarm

DRY_RUN_OPTIONS = {"dry_run": True, "hold": True}


@pytest.fixture
def farm(tmp_path):
    farm = NetworkFarm(tmp_path)
    yield farm
    farm.store.close()


@pytest.fixture
def ann(farm):
    return farm.open_session(Role.PRINT, "ann")


def get_job_state(farm, number):
    return farm.controller.books.get_job(number).state


def test_page_shows_a_plan_and_keeps_its_dry_run(farm, ann):
    number = plan_job(farm, **DRY_RUN_OPTIONS)
    page = farm.browse("GET", f"/jobs/{number}", ann)
    assert page.status_code == 200
    assert "Planned: 2 parts" in page.text
    assert re.search(r'<option value="2"[^>]* data-time="[^>]*>2 printers: about 5 s', page.text)
    assert farm.dry_runs._expiry_times_s.keys() == {number}


def test_dry_run_is_printed_only_with_the_plan_that_was_shown(farm, ann):
    number = plan_job(farm, **DRY_RUN_OPTIONS)
    old_plan_response = farm.browse("POST", f"/jobs/{number}/release", ann, data={"plan": "old"})
    assert (old_plan_response.status_code, get_job_state(farm, number)) == (303, JobState.HELD)
    assert "has changed: review it again" in farm.browse("GET", f"/jobs/{number}", ann).text
    plan_data = {"plan": farm.controller.books.get_job(number).plan}
    response = farm.browse("POST", f"/jobs/{number}/release", ann, data=plan_data)
    assert (response.status_code, get_job_state(farm, number)) == (303, JobState.PRINTING)
    assert not farm.controller.books.get_job(number).options.dry_run


def test_dry_run_is_kept_for_approval(farm, ann):
    number = plan_job(farm, **DRY_RUN_OPTIONS)
    farm.browse("POST", f"/jobs/{number}/keep", ann)
    options = farm.controller.books.get_job(number).options
    assert (get_job_state(farm, number), options.dry_run, options.hold) == (JobState.HELD, False, True)


def test_another_number_of_printers_is_planned_from_the_same_model_and_keeps_the_curve(farm, ann):
    number = plan_job(farm, **DRY_RUN_OPTIONS, copies=2)
    response = farm.browse(
        "POST", f"/jobs/{number}/replan", ann, data={"printers": "2", "curve": str(number)}
    )
    assert response.headers["location"] == f"/jobs/{number + 1}?curve={number}"
    assert get_job_state(farm, number) is JobState.CANCELLED
    new_job = farm.controller.books.get_job(number + 1)
    assert (new_job.model_file, new_job.options.printers, new_job.options.copies) == ("m.npz", 2, 2)
    assert new_job.options.dry_run
    refusal = farm.browse("POST", f"/jobs/{number + 1}/replan", ann, data={"printers": "0"})
    assert refusal.status_code == 303
    assert number + 2 not in farm.controller.books.jobs


def test_only_the_submitter_or_an_operator_may_print_a_job(farm, ann):
    number = plan_job(farm, user="bob", **DRY_RUN_OPTIONS)
    farm.browse("POST", f"/jobs/{number}/release", ann)
    assert get_job_state(farm, number) is JobState.HELD
    assert "only an operator may let job 1 print" in farm.browse("GET", "/", ann).text


def test_report_that_could_not_be_read_is_read_again(farm, ann):
    number = plan_job(farm, **DRY_RUN_OPTIONS)
    report = farm.state.files / "d.json"
    renamed_report = report.rename(report.with_name("away.json"))
    assert "2 printers: about 5 s" not in farm.browse("GET", f"/jobs/{number}", ann).text
    renamed_report.rename(report)
    assert "2 printers: about 5 s" in farm.browse("GET", f"/jobs/{number}", ann).text


def test_documents_run_no_script(farm, ann):
    number = plan_job(farm)
    for name in ("instructions", "report"):
        response = farm.browse("GET", f"/jobs/{number}/{name}", ann)
        assert response.status_code == 200
        assert response.headers["content-type"].startswith("text/html")
        assert response.headers["content-security-policy"].startswith("sandbox; default-src 'none'")
    assert "Job 1: m.stl" in response.text
    page = farm.browse("GET", f"/jobs/{number}", ann).text
    picture = re.search(r'<img src="([^"]+)"', page)[1]
    assert farm.browse("GET", picture, ann).headers["content-type"] == "image/png"


@pytest.mark.parametrize(
    ("path", "status"),
    [("/jobs/9", 404), ("/jobs/x", 400), ("/jobs/9/instructions", 404), ("/jobs/9/report", 404)],
)
def test_error_for_an_unknown_job_is_a_page(farm, ann, path, status):
    response = farm.browse("GET", path, ann)
    assert response.status_code == status
    assert response.headers["content-type"].startswith("text/html")


def test_job_without_a_plan_or_files_has_a_page(farm, ann):
    submit_model(farm)
    page = farm.browse("GET", "/jobs/1", ann)
    assert page.status_code == 200
    assert 'http-equiv="refresh"' in page.text


@pytest.mark.parametrize("number", ["x", "9", "-1", "1.5"])
def test_stream_of_an_unknown_job_is_refused(farm, ann, number):
    assert farm.browse("GET", f"/live?page=/jobs/{number}", ann).status_code == 404


def test_parts_are_downloaded_as_one_archive(farm, ann):
    number = plan_job(farm)
    (farm.state.files / "p.stl").write_bytes(b"solid" * 9)
    response = farm.browse("GET", f"/jobs/{number}/parts.zip", ann)
    assert response.headers["content-disposition"] == f'attachment; filename="job-{number}-parts.zip"'
    with zipfile.ZipFile(io.BytesIO(response.content)) as archive:
        assert archive.testzip() is None
        assert {name: archive.read(name) for name in archive.namelist()} == {
            "p01.stl": b"solid" * 9,
            "p02.stl": b"solid" * 9,
        }


def test_archive_without_a_file_is_an_error(farm, ann):
    number = plan_job(farm)
    response = farm.browse("GET", f"/jobs/{number}/parts.zip", ann)
    assert (response.status_code, "has no file" in response.text) == (404, True)
    assert farm.browse("GET", "/jobs/9/parts.zip", ann).status_code == 404


def test_time_of_gluing_is_reported_once_the_parts_are_printed(farm, ann):
    number = plan_job(farm)
    path, form = f"/jobs/{number}", f'action="/jobs/{number}/assembled"'
    farm.browse("POST", f"{path}/assembled", ann, data={"minutes": "42"})
    early_page = farm.browse("GET", path, ann).text
    assert "report its assembly once all parts are printed" in early_page and form not in early_page
    job = farm.controller.books.get_job(number)
    farm.controller.books = put(farm.controller.books, job.model_copy(update={"state": JobState.DONE}))
    assert form in farm.browse("GET", path, ann).text
    farm.browse("POST", f"{path}/assembled", ann, data={"minutes": "42"})
    assert f"Job {number} was assembled in 42 minutes." in farm.browse("GET", path, ann).text
    assert farm.controller.books.get_job(number).gluing.minutes == 42.0
