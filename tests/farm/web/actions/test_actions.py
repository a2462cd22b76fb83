"""Forms of the pages: their effect, their redirect, and the note that follows."""

import json

import pytest

from farm import api
from farm.model import Role
from farm.web.actions.printer_forms import describe_cleared_bed
from farm.web.notes import Note, Notes
from farms.network_farm import HOST, NetworkFarm

PAGE = f"http://{HOST}"


@pytest.fixture
def farm(tmp_path):
    farm = NetworkFarm(tmp_path)
    yield farm
    farm.store.close()


def send_form(farm, session, path, fields=None, page="/"):
    """Send a form from a page; return the address to which it redirects."""
    response = farm.browse("POST", path, session, {"referer": PAGE + page}, data=fields or {})
    assert response.status_code == 303, response.text
    return response.headers["location"]


def test_form_does_the_same_as_the_api_and_its_note_is_shown_once(farm):
    session = farm.open_session()
    assert send_form(farm, session, "/printers/a/cleared", {"why": "", "good": ""}) == "/"
    kind, body = farm.read_last_event()
    assert (kind, json.loads(body)["by"], json.loads(body)["why"]) == ("BedCleared", "ann", None)
    assert '<p class="done">a is clear.</p>' in farm.browse("GET", "/", session).text
    assert "a is clear." not in farm.browse("GET", "/", session).text
    send_form(farm, session, "/printers/a/load", {"grams": "432.5", "material": ""})
    assert "432 g" in farm.browse("GET", "/", session).text


@pytest.mark.parametrize(
    ("path", "fields", "expected_note"),
    [
        ("/printers/a/pause", {}, "a is not printing"),
        ("/printers/<i>/cleared", {}, "&lt;i&gt;"),
        ("/printers/a/load", {"grams": "much"}, "grams: Input should be a valid number"),
        ("/printers/a/load", {"grams": "1", "nonsense": "1"}, "nonsense"),
        ("/printers/a/cleared", {"bad": "true"}, "waits for a verdict"),
        ("/jobs/1/pause", {}, "job 1"),
        ("/jobs/one/pause", {}, "valid integer"),
        ("/jobs/1/approve", {}, "plan: Field required"),
        ("/outage/confirm", {}, "there is no outage"),
    ],
)
def test_refusal_is_a_note_on_the_page_and_changes_nothing(farm, path, fields, expected_note):
    session = farm.open_session()
    event_count = len(farm.store.read_all_events())
    assert send_form(farm, session, path, fields) == "/"
    page = farm.browse("GET", "/", session).text
    assert (
        expected_note in page[page.index('<p class="problem">') : page.index("</p>", page.index("problem"))]
    )
    assert "<i>" not in page
    assert len(farm.store.read_all_events()) == event_count


@pytest.mark.parametrize(
    ("referer", "page"),
    [
        (f"{PAGE}/printers/a?x=1", "/printers/a?x=1"),
        (f"{PAGE}//evil.example/x", "/evil.example/x"),
        ("http://evil.example/x", "/"),
        ("nonsense", "/"),
        (PAGE, "/"),
    ],
)
def test_form_leads_back_to_its_page_and_to_no_other_site(farm, referer, page):
    response = farm.browse("POST", "/printers/a/cleared", farm.open_session(), {"referer": referer}, data={})
    assert response.headers["location"] == page


def test_note_is_shown_only_to_its_own_reader(farm):
    ann, bob = farm.open_session(user="ann"), farm.open_session(Role.LOOK, user="bob")
    send_form(farm, ann, "/printers/a/cleared")
    assert "a is clear" not in farm.browse("GET", "/", bob).text
    assert "a is clear" in farm.browse("GET", "/", ann).text


def test_at_most_a_thousand_notes_are_kept():
    notes = Notes()
    for number in range(1001):
        notes.put(str(number), Note("done"))
    assert read_note(notes, "0") is None
    assert read_note(notes, "1000") == Note("done")
    assert read_note(notes, "1000") is None


def test_note_stays_for_the_next_page_if_a_page_fails():
    notes = Notes()
    notes.put("ann", Note("job 1 is approved"))
    with pytest.raises(ValueError, match="a fault"), notes.show("ann"):
        raise ValueError("a fault")
    assert read_note(notes, "ann") == Note("job 1 is approved")


def read_note(notes, user):
    """Return the note that a page shows to a user."""
    with notes.show(user) as note:
        return note


@pytest.mark.parametrize(
    ("response", "expected_text"),
    [
        (api.ClearedResponse(again="1/p01"), "a is clear; part 1/p01 is printed again."),
        (
            api.ClearedResponse(good="1/p01", printed_on=["b"]),
            "a is clear, and part 1/p01 is good; b is already printing it again.",
        ),
    ],
)
def test_note_on_a_cleared_bed_names_the_part_and_the_printers_that_print_it_again(response, expected_text):
    assert describe_cleared_bed("a", response) == expected_text
