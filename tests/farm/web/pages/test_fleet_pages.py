"""Pages of the fleet as a browser requests them: timeline, printers, history."""

import dataclasses
import html
import re
from datetime import datetime

import pytest

from books.make_books import apply_events, make_end_event
from books.planned_job import plan_job
from drivers.messages import WireLine
from farm.control import DryRuns
from farm.http import EventStreams
from farm.model import AgentSnapshot, FilamentState, Link, Moment, PrintState, Role, Still
from farm.state import events as ev
from farm.web import make_web_app
from farms.dashboard_farm import add_planned_job, add_print, judge_print
from farms.network_farm import HOST, NetworkFarm


@pytest.fixture
def farm(tmp_path):
    farm = NetworkFarm(
        tmp_path, fleet={"name": "lab", "attended": ["00:00-24:00"], "timezone": "Europe/Berlin"}
    )
    yield farm
    farm.store.close()


@pytest.fixture
def busy_farm(farm):
    """Make a farm with a failed print that has a still, and jobs that wait."""
    now_s = farm.clock.now_s
    books = add_planned_job(farm.controller.books, 1, 2, now_s - 2000.0)
    failure_fields = {
        "state": PrintState.FAILED,
        "fault": "thermal_runaway",
        "reason": "the nozzle got <cold>",
    }
    books = judge_print(
        add_print(books, "1/01", "a", now_s - 1000.0, 500.0, **failure_fields), "a", now_s - 100.0
    )
    for number in (2, 3):
        books = add_planned_job(books, number, 1, now_s - 900.0)
    (attempt,) = books.prints.values()
    still = Still(moment=Moment.FAILURE, at_s=now_s - 501.0, file="0123.png")
    books.prints[attempt.id] = attempt.model_copy(update={"stills": (still,)})
    farm.controller.books = books
    farm.state.files.mkdir(exist_ok=True)
    (farm.state.files / "0123.png").write_bytes(b"\x89PNG")
    return farm


def read_page(farm, path, role=Role.OPERATE, status=200):
    response = farm.browse("GET", path, farm.open_session(role))
    assert (response.status_code, response.headers["content-type"]) == (status, "text/html; charset=utf-8")
    return response.text


@pytest.mark.parametrize("path", ["/timeline", "/history", "/printers/a"])
def test_pages_of_a_farm_without_prints_show_that_nothing_was_printed(farm, path):
    page = read_page(farm, path, Role.LOOK)
    assert any(
        message in page for message in ("Nothing was printed", "No ended print", "It has not printed yet")
    )


def test_printer_page_shows_temperatures_faults_and_prints(busy_farm):
    for _ in range(3):
        busy_farm.clock.now_s += 100.0
        heat = {"nozzle_c": 210.0, "bed_c": 60.0, "nozzle_target_c": 210.0, "bed_target_c": 60.0}
        ready_fields = {"link": Link.READY, "filament": FilamentState.PARKED}
        busy_farm.controller.on_snapshot(AgentSnapshot(printer="a", **ready_fields, **heat))
    page = read_page(busy_farm, "/printers/a")
    assert "hottest 210 °C" in page
    assert "the nozzle got &lt;cold&gt;" in page
    assert 'src="/jobs/1/stills/print-1-failure.png"' in page
    picture = busy_farm.browse("GET", "/jobs/1/stills/print-1-failure.png", busy_farm.open_session())
    assert (picture.headers["content-type"], picture.content) == ("image/png", b"\x89PNG")
    assert 'action="/printers/a/cleared"' not in page  # `a` is printing the next plate


def test_printer_page_asks_for_a_verdict_only_on_a_part_that_was_printed(farm):
    controller, verdict_requests, now_s = farm.controller, [], farm.clock.now_s
    plan_job(farm)
    for state in (PrintState.FAILED, PrintState.DONE):
        attempt = controller.books.find_open_print("a")
        controller.handle(make_end_event(attempt.id, state, at_s=now_s, started_s=now_s - 60.0))
        page = read_page(farm, "/printers/a")
        assert 'action="/printers/a/cleared"' in page
        verdict_requests.append('name="bad"' in page)
        part = controller.books.plates[attempt.plate].parts[0]
        for text in (f"Clear the bed: part {part}<", f"Part {part} is\n"):
            assert (text in page) == (state is PrintState.DONE)
        assert f"</a>, part {part}" in read_page(farm, "/")
        cleared_event = ev.BedCleared(at_s=now_s, printer="a", by="ann", filament=FilamentState.PARKED)
        controller.handle(cleared_event)
    assert verdict_requests == [False, True]


def test_printer_page_warns_of_heat_before_it_offers_to_clear_the_bed(farm):
    alarm_fields = {"alarm": "the nozzle cannot be switched off", "nozzle_c": 231.0, "bed_c": 60.0}
    cold_fields = {"nozzle_c": 21.0, "bed_c": 20.0, "heaters_off": True}
    for changes, expected_counts in ((alarm_fields, (1, 1, 0)), (cold_fields, (0, 0, 1))):
        fields = {"link": Link.FAULT, "reason": "inspect it", **changes}
        farm.controller.on_snapshot(AgentSnapshot(printer="a", **fields))
        farm.controller.handle(ev.BedBecameUnknown(at_s=farm.clock.now(), printer="a", reason="test"))
        page = read_page(farm, "/printers/a")
        counts = [page.count(text) for text in ("task urgent", "231 °C, not confirmed off", "<details open>")]
        assert tuple(counts) == expected_counts


@pytest.mark.parametrize(
    ("role", "actions"),
    [
        (Role.LOOK, []),
        (Role.PRINT, ["maintenance"]),
        (Role.OPERATE, ["cleared", "load", "maintenance"]),
    ],
)
def test_printer_page_has_the_forms_of_the_role(farm, role, actions):
    page = read_page(farm, "/printers/a", role)
    found_actions = [
        action for action in ("cleared", "load", "maintenance") if f'action="/printers/a/{action}"' in page
    ]
    assert found_actions == actions


def test_history_is_exported_as_filtered(busy_farm):
    page = read_page(busy_farm, "/history?printer=a&days=")
    assert "/history.csv?printer=a" in page
    assert "thermal" not in page  # the reason is shown instead of the fault's name
    export = busy_farm.browse("GET", "/history.csv?printer=a", busy_farm.open_session(Role.LOOK))
    assert export.headers["content-type"] == "text/csv; charset=utf-8"
    assert export.headers["content-disposition"] == 'attachment; filename="lab-prints.csv"'
    assert len(export.text.splitlines()) == 2
    response = busy_farm.browse("GET", "/history.csv?printer=b", busy_farm.open_session(Role.LOOK))
    assert len(response.text.splitlines()) == 1


def test_effect_of_a_move_is_shown_and_an_operator_may_make_it(busy_farm):
    page = read_page(busy_farm, "/timeline?job=3&to=first&at=")
    assert "What if: job 3 first in the queue" in page
    assert "earlier" in page
    assert "later" in page
    assert 'action="/jobs/3/move"' in page
    assert busy_farm.controller.books.jobs[3].moved_rank is None
    assert 'action="/jobs/3/move"' not in read_page(busy_farm, "/timeline?job=3&to=first", Role.PRINT)


def test_effect_of_a_start_time_is_shown_and_an_operator_may_set_it(busy_farm):
    page = read_page(busy_farm, "/timeline?job=3&at=23:50")
    assert "starting no earlier than 23:50" in page
    button = re.search(r'action="/jobs/3/start"><input type="hidden" name="at" value="([^"]+)"', page)
    start = datetime.fromisoformat(html.unescape(button[1]))
    assert (start.hour, start.minute, start.tzinfo is not None) == (23, 50, True)
    assert busy_farm.controller.books.jobs[3].not_before_s is None
    assert 'action="/jobs/3/start"' not in read_page(busy_farm, "/timeline?job=3&at=23:50", Role.PRINT)
    session = busy_farm.open_session()
    busy_farm.browse("POST", "/jobs/3/start", session, data={"at": html.unescape(button[1])})
    assert "Job 3 starts not before" in busy_farm.browse("GET", "/timeline", session).text
    assert busy_farm.controller.books.jobs[3].not_before_s == start.timestamp()


@pytest.mark.parametrize(
    ("query", "text"),
    [
        ("job=1&to=first", "already first"),
        ("job=9&to=first", "no job 9"),
        ("job=3", "choose another place"),
        ("to=first", "choose a job"),
        ("job=3&at=yesterday", "is not a time"),
    ],
)
def test_impossible_change_is_explained_above_the_plan(busy_farm, query, text):
    page = read_page(busy_farm, f"/timeline?{query}")
    assert "Change not possible:" in page
    assert text in page
    assert "2/p01" in page


@pytest.mark.parametrize("query", ["at=23:50", "to=last"])
def test_change_to_a_job_whose_plates_have_started_would_move_nothing(busy_farm, query):
    books = busy_farm.controller.books
    started_event = ev.PlateAssigned(
        at_s=busy_farm.clock.now_s, plate="2/01", printer="a", print_id="running"
    )
    busy_farm.controller.books = apply_events(books, started_event)[0]
    page = read_page(busy_farm, f"/timeline?job=2&{query}")
    assert "job 2 has no plate to move: all of its plates have started" in page
    assert '<option value="2"' not in page
    assert '<option value="3"' in page


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/printers/z", 404),
        ("/history?job=9", 404),
        ("/history?days=0", 400),
        ("/timeline?hours=1e9", 400),
        ("/jobs/1/stills/print-9-end.png", 404),
        ("/jobs/1/stills/..%2ffarm.db", 404),
    ],
)
def test_errors_are_pages_without_a_traceback(busy_farm, path, status):
    assert "Traceback" not in read_page(busy_farm, path, status=status)


def test_operator_reads_the_last_lines_on_the_wire(farm):
    async def read_lines(name):
        return [
            WireLine(at_s=farm.clock.now_s, sent=True, text="M105 <b>"),
            WireLine(at_s=0.0, sent=False, text="ok"),
        ]

    services = dataclasses.replace(farm.services, read_lines=read_lines)
    farm.web = make_web_app(services, DryRuns(farm.controller), {HOST})
    page = read_page(farm, "/printers/a/wire")
    assert "23:13:20.000 &gt; M105 &lt;b&gt;" in page  # the time in Berlin
    assert "&lt; ok" in page
    for role in (Role.LOOK, Role.PRINT):
        assert "needs a key with the role operate" in read_page(farm, "/printers/a/wire", role, status=403)
        assert "/printers/a/wire" not in read_page(farm, "/printers/a", role)


def test_page_of_the_wire_explains_why_it_cannot_be_read(farm):
    assert "a has no agent" in read_page(farm, "/printers/a/wire")
    assert "no printer z" in read_page(farm, "/printers/z/wire", status=404)


def test_upkeep_of_a_printer_is_shown_from_the_event_log(farm):
    services = dataclasses.replace(farm.services, streams=EventStreams(farm.store))
    farm.web = make_web_app(services, DryRuns(farm.controller), {HOST})
    session = farm.open_session()
    for path, data in (
        ("maintenance", {"why": "a new <nozzle>"}),
        ("maintained", {}),
        ("load", {"grams": "750"}),
    ):
        farm.browse("POST", f"/printers/a/{path}", session, data=data)
    page = read_page(farm, "/printers/a")
    texts = ["reel loaded", "back in use", "taken out of use", "a new &lt;nozzle&gt;"]
    positions = [page.index(event_text) for event_text in texts]
    assert positions == sorted(positions)
    assert "<td>ann</td>" in page
