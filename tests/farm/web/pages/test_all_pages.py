"""Every page with every state, hold and fault, and with hostile names: rendered without a browser."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jinja2 import PackageLoader

from drivers.errors import Fault
from drivers.messages import WireLine
from farm.api import NETWORK_PREFIX
from farm.control import DryRuns
from farm.model import (
    AgentSnapshot,
    Bed,
    FilamentState,
    Hold,
    HoldCode,
    JobState,
    KeyKind,
    Link,
    Outage,
    Print,
    PrintState,
    Role,
    Verdict,
)
from farm.state.books import put
from farm.state.faults import FarmFault
from farm.views import report
from farm.web import make_web_app
from farm.web.access import METRICS_PATH, ROLES, SCHEMA_PAGE_PATH, SCHEMA_PATH
from farm.web.notes import Note, User
from farm.web.pages import rendering, static_files
from farm.web.pages.fleet.printer import render_wire
from farm.web.pages.rendering import render_login, render_message
from farm.web.pages.submit.options import DEFAULTS
from farm.web.pages.submit.submit_page import list_choices, render_submit_page
from farm.web.slicers import SLICER_ROLES
from farms.dashboard_farm import add_planned_job
from farms.network_farm import NetworkFarm

LINKS, OPEN_STATES = list(Link), [state for state in PrintState if not state.ended]
FAULTS = [*Fault, *FarmFault]
PRINTERS = [f"p{number:02d}" for number in range(len(LINKS) + len(OPEN_STATES) + 4)]
JOBS = range(1, 2 + len(JobState))
NOW_S = 1.7e9
PAGE_PATHS = sorted(
    path
    for method, path in ROLES.keys() - SLICER_ROLES.keys()
    if method == "GET"
    and not path.startswith((NETWORK_PREFIX, METRICS_PATH, SCHEMA_PATH, SCHEMA_PAGE_PATH, "/live"))
)
FILE_PAGES = ("/jobs/{number}/instructions", "/jobs/{number}/parts.zip")
"""Pages that are files of a job, which the jobs here do not have."""


class Structure(HTMLParser):
    """Elements of a page with the names of their attributes, its comments, and its text."""

    def __init__(self, page):
        super().__init__()
        self.elements, self.texts, self.values = [], [], []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attributes):
        if tag != "code" or attributes:  # text between backticks is always shown as a command
            self.elements.append((tag, *(name for name, _ in attributes)))
        self.values += [value or "" for _, value in attributes]

    def handle_data(self, data):
        self.texts.append(data)

    def handle_comment(self, data):
        self.elements.append(("comment", data))


def make_farm(folder):
    return NetworkFarm(folder, fleet={"name": "lab", "attended": ["08:00-18:00"]}, printers=PRINTERS)


def read_pages(farm, printers=PRINTERS, jobs=JOBS, role=Role.OPERATE):
    """Return all pages that the role may read, and check that the others are refused."""
    pages = {}
    for path in PAGE_PATHS:
        fields = {"{name}": printers, "{number}": jobs}
        field = next((name for name in fields if name in path), "")
        for value in fields.get(field, [""]):
            address = path.replace(field, str(value)) if field else path
            if "{" in address:
                continue
            response = farm.browse("GET", address, farm.session)
            expected_status = 404 if path in FILE_PAGES else 200
            expected_status = expected_status if role.allows(ROLES["GET", path]) else 403
            assert response.status_code == expected_status, (address, response.text[-300:])
            if response.headers["content-type"].startswith("text/html"):
                pages[address] = response.text
    return pages


def make_attempt(number, printer, state, **changes):
    """Make a print of the first plate of job 1."""
    ended_s = NOW_S - 60.0 if state.ended else None
    return Print(
        id=f"print {number}", plate="1/01", job=1, printer=printer, number=number, state=state,
        assigned_s=NOW_S - 4000.0, started_s=NOW_S - 3900.0, ended_s=ended_s, **changes,
    )  # fmt: skip


def fill_farm(farm, text="reason", name="bracket"):
    """Put every state, hold and fault into the books and the telemetry of a farm, with this text and name."""
    farm.controller.books = farm.initial_books
    books = add_planned_job(
        farm.initial_books, 1, len(HoldCode), NOW_S - 5000.0, name=name, submitted_by=text
    )
    for number in range(2, 2 + len(JobState)):
        books = add_planned_job(books, number, 1, NOW_S - 5000.0, name=name)
    for number, state in enumerate(JobState, 2):
        options = books.jobs[number].options.model_copy(update={"note": text, "colour": text})
        texts = {"reason": text, "repairs": (text,), "hold": Hold(code=HoldCode.START_TIME, text=text)}
        job_fields = {"state": state, "options": options, "paused": state is JobState.PRINTING, **texts}
        books = put(books, books.jobs[number].model_copy(update={**job_fields, "ended_s": NOW_S - 10.0}))
    open_prints = [
        make_attempt(number, printer, state, pause_requested=state is PrintState.PAUSED)
        for number, (printer, state) in enumerate(zip(PRINTERS[len(LINKS) :], OPEN_STATES, strict=False))
    ]
    ended_prints = [
        make_attempt(100 + number, PRINTERS[0], PrintState.FAILED, fault=fault, reason=text, fail_reason=text)
        for number, fault in enumerate(FAULTS)
    ]
    ended_prints += [
        make_attempt(200 + number, PRINTERS[1], state, verdict=verdict, verdict_why=text)
        for number, state in enumerate(state for state in PrintState if state.ended)
        for verdict in (None, *Verdict)
    ]
    plate = books.plates["1/01"].model_copy(
        update={
            "prints": tuple(shown_print.id for shown_print in (*ended_prints, *open_prints)),
            "warnings": (text,),
        }
    )
    books = put(books, *ended_prints, *open_prints, plate, Outage(id=1, at_s=NOW_S, printers=(PRINTERS[0],)))
    beds = [*Bed, Bed.CLEAR]
    for number, (printer, bed) in enumerate(zip(PRINTERS[-len(beds) :], beds, strict=True)):
        changes = {"bed": bed, "filament": list(FilamentState)[number % 3], "attention_reason": text}
        changes |= {"maintenance": text} if bed is Bed.CLEAR else {}
        books = put(books, books.printers[printer].model_copy(update=changes))
    farm.controller.books = books
    for number, printer in enumerate(PRINTERS):
        link = LINKS[number] if number < len(LINKS) else Link.BUSY
        heat = {"nozzle_c": 210.0, "bed_c": 60.0, "nozzle_target_c": 200.0}
        alarm = text if number == 3 else None
        snapshot = AgentSnapshot(printer=printer, link=link, reason=text, alarm=alarm, **heat)
        farm.controller.telemetry.store(snapshot, NOW_S)
    holds = dict(zip(books.jobs[1].plates, (Hold(code=code, text=text) for code in HoldCode), strict=True))
    farm.controller.scheduler.find_plate_holds = lambda: holds


@pytest.fixture(scope="module")
def farm(tmp_path_factory):
    farm = make_farm(tmp_path_factory.mktemp("farm"))
    farm.initial_books = farm.controller.books
    farm.session = farm.open_session()
    session = next(key for key in farm.controller.books.keys.values() if key.kind is KeyKind.SESSION)
    farm.initial_books = put(farm.initial_books, session)
    yield farm
    farm.store.close()


def test_pages_show_every_state_and_the_last_faults(farm):
    fill_farm(farm)
    pages = read_pages(farm)
    assert {f"/printers/{name}" for name in PRINTERS} <= pages.keys()
    fault_page = pages[f"/printers/{PRINTERS[0]}"]
    # The page shows the last ten faults.
    assert sum(fault.replace("_", " ") in fault_page for fault in FAULTS) >= 10
    for state in ("heating", "printing", "paused"):
        assert any(f'class="state {state}"' in pages[f"/printers/{name}"] for name in PRINTERS), state
    home = " ".join(Structure(pages["/"]).texts)
    assert [state for state in JobState if state not in home] == []


@pytest.mark.parametrize("role", [Role.LOOK, Role.PRINT])
def test_pages_are_complete_for_other_roles(farm, role):
    fill_farm(farm)
    session_key = next(key for key in farm.controller.books.keys.values() if key.kind is KeyKind.SESSION)
    farm.controller.books = put(farm.controller.books, session_key.model_copy(update={"role": role}))
    assert read_pages(farm, SOME_PRINTERS, [1], role)


def test_pages_read_no_file_once_the_farm_runs(farm, monkeypatch):
    """Check that pages are in memory, because an upgrade replaces files under a running daemon."""
    for load in (rendering.load_templates, report.load_templates, static_files.load_static_files):
        load.cache_clear()
    make_web_app(farm.services, DryRuns(farm.controller), ())
    monkeypatch.setattr(PackageLoader, "get_source", None)
    monkeypatch.setattr(static_files, "files", None)
    fill_farm(farm)
    pages = read_pages(farm, SOME_PRINTERS, [1])
    assert {"/jobs/1/report", f"/printers/{SOME_PRINTERS[0]}"} <= pages.keys()
    assert farm.browse("GET", "/static/farm.css", farm.session).status_code == 200


SOME_PRINTERS = [PRINTERS[0], PRINTERS[1], PRINTERS[3], PRINTERS[-1]]
"""Printers with faults, with bad parts, with an alarm, and in maintenance."""
hostile_texts = st.text(
    st.sampled_from("<>\"'&`={}%/\\;:()-!x \u202e\u00e9"), min_size=1, max_size=30
) | st.sampled_from(
    [
        "<script>alert(1)</script>",
        '"><img src=x onerror=alert(1)>',
        "' onmouseover='alert(1)",
        "</title></svg><style>*{display:none}</style>",
        "{{ 7 * 7 }}{% raw %}",
        "javascript:alert(1)",
        "<!-- -->",
        "&lt;b&gt;",
        "</script><!--",
    ]
)


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(hostile_texts, hostile_texts)
def test_hostile_text_changes_no_element_of_any_page(farm, text, name):
    fill_farm(farm)
    benign_pages = {path: Structure(page) for path, page in read_pages(farm, SOME_PRINTERS, [1, 4]).items()}
    fill_farm(farm, f"x{text}x", f"x{name}x")
    for path, page in read_pages(farm, SOME_PRINTERS, [1, 4]).items():
        structure = Structure(page)
        assert structure.elements == benign_pages[path].elements, path
        assert not any(value.strip().lower().startswith("javascript:") for value in structure.values)


def render_other_pages(farm, text, name):
    """Render pages that no address shows by itself: log-in, messages, refused forms, what-if changes."""
    fleet = SimpleNamespace(name=name, timezone="UTC")
    user, note = User(text, Role.OPERATE), Note(text, is_problem=True)
    choices = list_choices(farm.controller.fleet)
    choices = replace(choices, materials=[text], colours=[name], build_volumes_mm=[(text, 1.0, 2.0, 3.0)])
    fields = dict.fromkeys(DEFAULTS, text)
    lines = [WireLine(at_s=0.0, sent=True, text=text)]
    responses = [
        farm.browse("GET", path, farm.session, params=query)
        for path, query in (
            ("/timeline", {"job": "1", "at": text[:40]}),
            ("/timeline", {"job": "1", "to": "last"}),
            ("/history", {"printer": name}),
        )
    ]
    return [
        render_login(name, text, Role.LOOK),
        render_message(name, text, has_login_hint=True),
        render_wire(name, lines, fleet, user),
        render_wire(name, [], fleet, user, problem=text),
        render_submit_page(choices, text, fleet, user, note, fields),
        *(response.text for response in responses),
    ]


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(hostile_texts, hostile_texts)
def test_hostile_text_changes_no_element_of_answers_to_forms(farm, text, name):
    fill_farm(farm)
    known_elements = {
        element for page in render_other_pages(farm, "x", "y") for element in Structure(page).elements
    }
    for page in render_other_pages(farm, f"x{text}x", f"x{name}x"):
        assert set(Structure(page).elements) <= known_elements


def test_templates_have_no_conflict_markers():
    folders = [Path(rendering.__file__).parent / folder for folder in ("templates", "static", "browser")]
    texts = {path.name: path.read_text() for folder in folders for path in folder.iterdir() if path.is_file()}
    assert "printer.html" in texts
    assert [name for name, text in texts.items() if re.search(r"^(<{7}|={7}|>{7})", text, re.MULTILINE)] == []
