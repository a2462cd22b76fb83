"""Gluing in the views: the order of parts, its duration, and the beds to clear first."""

import csv
import io
from pathlib import Path

import pytest
from rich.console import Console

from books.make_books import PRINTERS, apply_events, make_end_event, make_job, make_planned_books
from farm.cli.display.job_page import render_job
from farm.config import Fleet
from farm.model import AgentSnapshot, Gluing, JobState, Link, Role
from farm.paths import StateFolder
from farm.scheduling import describe_plates
from farm.state import events as ev
from farm.state.books import put, replace_fields
from farm.views import describe_job, list_history, list_jobs, list_tasks
from farm.views.context import ViewContext
from farm.views.dashboard import HistoryFilter, describe_history, write_csv
from farm.views.jobs import compute_assembly_times
from farm.views.report import list_figures
from farm.web.notes import User
from farm.web.pages.fleet.history import render_history

FLEET = Fleet.model_validate(
    {"printers": [{"name": name, "model": "m", "port": f"/dev/{name}"} for name in PRINTERS]}
)


@pytest.fixture
def books():
    """Make books with three unprinted parts, which are glued in the order 3, 1, 2."""
    books = make_planned_books(plates=3)
    ranks = {"1/p01": 2, "1/p02": 3, "1/p03": 1}
    parts = (replace_fields(books.parts[name], glue_rank=rank) for name, rank in ranks.items())
    return put(books, *parts, replace_fields(books.jobs[1], assembly_s=3600.0))


def make_context(books, now_s=10.0):
    snapshots = {name: AgentSnapshot(printer=name, link=Link.READY) for name in PRINTERS}
    return ViewContext(FLEET, books, snapshots, StateFolder(Path("/state")), now_s)


def print_parts(books):
    for number, name in enumerate(PRINTERS, 1):
        assigned_event = ev.PlateAssigned(at_s=2.0, plate=f"1/{number:02d}", printer=name, print_id=name)
        books, _ = apply_events(books, assigned_event, make_end_event(name, at_s=200.0 + number))
    return books


def print_page(view):
    console = Console(width=140, record=True, file=io.StringIO())
    console.print(render_job(view))
    return console.export_text()


def read_row(view, label):
    [row] = [line.strip() for line in print_page(view).splitlines() if line.strip().startswith(label)]
    return row


def test_parts_are_listed_in_the_order_of_gluing(books):
    view = describe_job(make_context(books), books.jobs[1])
    assert [part.id for part in view.parts] == ["1/p01", "1/p02", "1/p03"]
    assert [part.id for part in view.parts_in_gluing_order] == ["1/p03", "1/p01", "1/p02"]
    rows = [line.split()[:2] for line in print_page(view).splitlines() if line.startswith("1/p")]
    assert rows == [["1/p03", "1"], ["1/p01", "2"], ["1/p02", "3"]]


def test_beds_are_cleared_in_the_order_of_gluing(books):
    [task] = [item for item in list_tasks(make_context(print_parts(books), 300.0)) if item.code == "clear"]
    assert task.printers == ["c", "a", "b"]
    assert task.brief == "c (1/p03) a (1/p01) b (1/p02)"
    assert task.text.startswith(f"clear 3 beds: {task.brief}, then")


def test_time_from_submission_to_assembly_is_forecast_then_measured(books):
    books = print_parts(books)
    view = describe_job(make_context(books, 300.0), books.jobs[1])
    assert (view.assembly_s, view.glued) == (3600.0, False)
    assert view.submitted_to_assembled_s == pytest.approx(203.0 + 3600.0)
    assert ("assembly, expected", "1h00") in list_figures(view)
    assert ("from submission to assembly, expected", "1h03") in list_figures(view)
    assert read_row(view, "assembled").startswith("assembled, expected")
    books, _ = apply_events(books, ev.JobAssembled(at_s=5000.0, job=1, minutes=50.0, by="ann"))
    view = describe_job(make_context(books, 6000.0), books.jobs[1])
    assert (view.assembly_s, view.glued, view.submitted_to_assembled_s) == (3000.0, True, 5000.0)
    assert ("assembly", "50 min") in list_figures(view)
    assert ("from submission to assembly", "1h23") in list_figures(view)
    assert read_row(view, "assembled").startswith("assembled  ")


def test_gluing_is_in_the_lists_of_jobs_and_prints_once_it_is_reported(books):
    books = print_parts(books)
    context = make_context(books, 300.0)
    assert [row.assembled for row in (*list_jobs(context, None, 9), *list_history(context))] == [None] * 4
    [outcome] = describe_history(context, HistoryFilter()).jobs
    assert (outcome.assembled, outcome.assembly_s, outcome.assembly_expected_s) == (None, None, 3600.0)
    books, _ = apply_events(books, ev.JobAssembled(at_s=5000.0, job=1, minutes=50.0, by="ann"))
    context = make_context(books, 6000.0)
    rows = [
        *list_jobs(context, None, 9),
        *list_history(context),
        *describe_history(context, HistoryFilter()).jobs,
    ]
    assert [(row.assembled, row.assembly_s) for row in rows] == [(context.format_time(5000.0), 3000.0)] * 5
    for line in csv.DictReader(io.StringIO(write_csv(list_history(context)), newline="")):
        assert (line["assembled"], line["assembly_s"]) == (context.format_time(5000.0), "3000")


def test_history_page_has_the_expected_time_of_gluing_until_it_is_reported(books):
    books = print_parts(books)
    user = User("ann", Role.LOOK)
    view = describe_history(make_context(books, 300.0), HistoryFilter())
    assert ">expected 1h00</td></tr>" in render_history(view, FLEET.fleet, user)
    books, _ = apply_events(books, ev.JobAssembled(at_s=5000.0, job=1, minutes=50.0, by="ann"))
    view = describe_history(make_context(books, 6000.0), HistoryFilter())
    assert ">50 min</td></tr>" in render_history(view, FLEET.fleet, user)


def test_reported_times_correct_those_expected_of_a_later_job(books):
    later_job = make_job(2).model_copy(
        update={"assembly_s": 1000.0, "state": JobState.PRINTED, "ended_s": 400.0}
    )
    books = put(print_parts(books), later_job)
    assert describe_job(make_context(books), books.jobs[2]).assembly_s == pytest.approx(1000.0)
    # An hour was expected.
    books, _ = apply_events(books, ev.JobAssembled(at_s=5000.0, job=1, minutes=90.0, by="ann"))
    assert describe_job(make_context(books), books.jobs[2]).assembly_s == pytest.approx(1250.0)


def test_page_of_a_job_names_its_instructions(books):
    view = describe_job(make_context(print_parts(books), 300.0), print_parts(books).jobs[1])
    assert f"instructions for gluing: {view.folder}/instructions.html" in print_page(view)


def test_expected_gluing_time_of_other_jobs_follows_the_reports():
    other_job = make_job().model_copy(update={"assembly_s": 1000.0})
    assert compute_assembly_times(other_job, 50.0, 1.2).end_s == pytest.approx(1250.0)
    failed_job = other_job.model_copy(update={"state": JobState.FAILED})
    assert compute_assembly_times(failed_job, 50.0, 1.2).end_s is None
    glued_job = other_job.model_copy(update={"gluing": Gluing(minutes=10.0, at_s=70.0, by="ann")})
    reported_times = compute_assembly_times(glued_job, 50.0, 9.0)
    assert (reported_times.work_s, reported_times.end_s) == (600, 70)
    assert compute_assembly_times(make_job(), 50.0, 1.0).work_s is None


def test_first_plate_to_be_glued_is_served_first_among_equally_long_ones(books):
    def list_served_plates(*expected_s):
        plates = [
            plate.model_copy(update={"expected_s": plate_s})
            for plate, plate_s in zip(books.plates.values(), expected_s, strict=True)
        ]
        waiting_plates = describe_plates(plates, books)
        return [plate.id for plate in sorted(waiting_plates, key=lambda plate: plate.priority_key)]

    assert list_served_plates(3600.0, 3604.0, 3596.0) == ["1/03", "1/01", "1/02"]
    assert list_served_plates(3600.0, 9000.0, 3596.0) == ["1/02", "1/03", "1/01"]
    # Times that differ by ten seconds or more are ordered longest first.
    assert list_served_plates(3600.0, 3700.0, 3590.0) == ["1/02", "1/01", "1/03"]
