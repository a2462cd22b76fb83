"""Page that submits a model: its fields, and the submitted job."""

import importlib.util
import re
from types import SimpleNamespace

import pytest

from books.recording_controller import make_fleet
from clusters.same_process import AcceptingWorkers
from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions, Role
from farm.web.notes import User
from farm.web.pages.submit.options import DEFAULTS, read_job_options
from farm.web.pages.submit.submit_page import SUBMIT_PATH, list_choices, render_submit_page
from farms.network_farm import NetworkFarm

FARM = SimpleNamespace(name="farm", timezone="UTC")
REQUEST_ID = "0123456789abcdef" * 2


def test_empty_form_asks_for_a_plan_with_the_defaults_of_the_command():
    assert read_job_options(DEFAULTS) == JobOptions(dry_run=True, hold=True)
    assert read_job_options({"next": "print"}) == JobOptions()
    assert read_job_options({"next": "hold"}) == JobOptions(hold=True)


@pytest.mark.parametrize(
    ("fields", "options"),
    [
        ({"goal": "count", "printers": "3"}, {"printers": 3}),
        ({"goal": "auto", "printers": "3"}, {}),
        ({"goal": "deadline", "done_by": "2026-11-25T07:00"}, {"done_by": "2026-11-25T07:00"}),
        (
            {"goal": "glued", "assembled_by": "2026-11-25T07:00"},
            {"assembled_by": "2026-11-25T07:00"},
        ),
        ({"pin_mm": "2.85", "marks": "true"}, {"pin_mm": 2.85, "marks": True}),
        ({"start": "overnight", "at": "2026-11-25T07:00"}, {"overnight": True}),
        ({"start": "at", "at": "2026-11-25T07:00"}, {"at": "2026-11-25T07:00"}),
        ({"scale": "25.4"}, {"scale": 25.4}),
        ({"scale": "25.4", "longest_side_mm": "300"}, {"longest_side_mm": 300.0}),
        (
            {"material": "PLA", "colour": "red", "quality": "fast"},
            {"material": "PLA", "colour": "red", "quality": "fast"},
        ),
        ({"copies": "7", "spares": "1", "priority": "-2"}, {"copies": 7, "spares": 1, "priority": -2}),
        ({"name": "vase ", "note": " for eve"}, {"name": "vase", "note": "for eve"}),
    ],
)
def test_fields_become_options(fields, options):
    assert read_job_options({**DEFAULTS, **fields, "next": "print"}) == JobOptions(**options)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"goal": "count"}, "give the number of printers"),
        ({"goal": "count", "printers": "0"}, "printers"),
        ({"goal": "deadline"}, "give the time by which the job is printed"),
        ({"goal": "glued"}, "give the time by which the job is glued"),
        ({"start": "at"}, "give the time at which the job starts"),
        ({"goal": "x"}, "send the form again"),
        ({"next": "x"}, "send the form again"),
        ({"copies": "many"}, "copies"),
        ({"scale": "nan"}, "scale"),
    ],
)
def test_wrong_field_is_named(fields, text):
    with pytest.raises(FarmError, match=text) as error:
        read_job_options({**DEFAULTS, **fields})
    assert error.value.code is ErrorCode.SETTINGS


def test_page_offers_the_printers_and_beds_of_the_fleet():
    page = render_submit_page(list_choices(make_fleet()), REQUEST_ID, FARM, User("ann", Role.PRINT))
    assert f'action="/submit?request={REQUEST_ID}"' in page
    assert "This many, out of 2 printers" in page
    assert "Ultimaker 2+" in page
    assert "&#34;" in page  # quotes in the attribute that describes the beds


def test_every_field_has_a_label():
    page = render_submit_page(list_choices(make_fleet()), REQUEST_ID, FARM, User("ann", Role.PRINT))
    form = page[page.index('<form id="submit"') :]
    labels = re.findall(r"<label[^>]*>(.*?)</label>", form, re.DOTALL)
    field_names = set(re.findall(r'<(?:input|select)[^>]* name="(\w+)"', form))
    assert field_names == {*DEFAULTS, "file"}
    assert all(any(f'name="{name}"' in label for label in labels) for name in field_names)


@pytest.fixture
def farm(tmp_path):
    farm = NetworkFarm(tmp_path)
    yield farm
    farm.store.close()


def send_form(farm, session, request=REQUEST_ID, name="vase.stl", content=b"x" * 1000, **fields):
    path = f"{SUBMIT_PATH}?request={request}"
    return farm.browse("POST", path, session, files={"file": (name, content)}, data={**DEFAULTS, **fields})


def test_model_is_submitted_once_and_leads_to_its_job(farm):
    ann = farm.open_session(Role.PRINT, "ann")
    for _ in range(2):  # the button is pressed twice
        answer = send_form(farm, ann, next="plan", copies="2")
        assert (answer.status_code, answer.headers["location"]) == (303, "/jobs/1")
    job = farm.controller.books.get_job(1)
    assert (job.name, job.submitted_by, job.request_id) == ("vase.stl", "ann", REQUEST_ID)
    assert job.options == JobOptions(dry_run=True, hold=True, copies=2)
    assert list(farm.controller.books.jobs) == [1]
    assert farm.browse("GET", "/jobs/1", ann).status_code == 200


def test_refusal_is_shown_on_the_form_which_keeps_its_values(farm, monkeypatch):
    async def refuse_model(self, work, path, name, *args, limit=None):
        raise FarmError(f"{name}: it is open at <7> edges", ErrorCode.MODEL)

    monkeypatch.setattr(AcceptingWorkers, "run", refuse_model)
    ann = farm.open_session(Role.PRINT, "ann")
    answer = send_form(farm, ann, note="for <eve>", goal="deadline", done_by="2023-12-01T07:00")
    assert answer.status_code == 400
    assert "it is open at &lt;7&gt; edges" in answer.text
    assert 'value="for &lt;eve&gt;"' in answer.text
    assert 'value="deadline" checked' in answer.text
    assert REQUEST_ID not in answer.text  # another attempt is another submission
    assert not farm.controller.books.jobs
    assert not list(farm.state.work.iterdir())


@pytest.mark.parametrize(
    ("fields", "text"),
    [({"goal": "count"}, "give the number of printers"), ({"start": "at", "at": "1999-01-01T00:00"}, "1999")],
)
def test_wrong_option_submits_nothing(farm, fields, text):
    answer = send_form(farm, farm.open_session(Role.PRINT, "ann"), **fields)
    assert answer.status_code == 400
    assert text in answer.text
    assert not farm.controller.books.jobs


def test_form_without_a_file_is_refused_with_a_message(farm):
    answer = send_form(farm, farm.open_session(Role.PRINT, "ann"), name="", content=b"")
    assert answer.status_code == 400
    assert "Not done:" in answer.text


def test_reader_who_may_not_print_has_no_form_and_no_link(farm):
    eve = farm.open_session(Role.LOOK, "eve")
    assert farm.browse("GET", SUBMIT_PATH, eve).status_code == 403
    assert 'href="/submit"' not in farm.browse("GET", "/", eve).text
    assert 'href="/submit"' in farm.browse("GET", "/", farm.open_session(Role.PRINT)).text


def test_request_for_more_printers_than_there_are_gets_a_note(farm):
    ann = farm.open_session(Role.PRINT, "ann")
    send_form(farm, ann, goal="count", printers="5")
    assert "the fleet has 1 printer" in farm.browse("GET", "/jobs/1", ann).text


@pytest.mark.parametrize("can_read_step", [True, False])
def test_step_files_are_offered_if_they_can_be_read(monkeypatch, can_read_step):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: object() if can_read_step else None)
    page = render_submit_page(list_choices(make_fleet()), REQUEST_ID, FARM, User("ann", Role.PRINT))
    suffixes = re.search(r'accept="([^"]*)"', page)[1].split(",")
    assert (".step" in suffixes, "STEP" in page) == (can_read_step, can_read_step)
    assert {".stl", ".gcode"} <= set(suffixes)
