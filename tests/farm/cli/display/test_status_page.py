"""Status page: tasks, last night, jobs, printers."""

import io
import math

import pytest

from books.example_night import PRINTERS, make_night_books, make_status, make_view_context, summarise_status
from books.make_books import apply_events, make_job, make_plan_event
from farm import api
from farm.cli.display.console import open_console
from farm.cli.display.printers_table import compute_urgency_s
from farm.cli.display.status_page import format_night, render_status, shorten_names
from farm.model import Bed, Hold, HoldCode, JobOptions, Verdict
from farm.state import events as ev
from farm.state.books import Books
from farm.views import list_history, select_shown_jobs


def render_page(view, width=120):
    screen = open_console()
    screen.width, screen.file, screen.record = width, io.StringIO(), True
    screen.print(render_status(summarise_status(view), width))
    return [line.rstrip() for line in screen.export_text().splitlines()]


def test_page_begins_with_the_tasks():
    lines = render_page(make_status(make_night_books()))
    assert lines[1] == "DO NOW   clear 3 beds: um2-01..03     inspect: um2-04: it does not get warm (00:00)"
    assert lines[2].startswith("NIGHT    3 of 5 plates printed, 1 failed, 1 still printing; 9 g + 1 g wasted")
    assert lines[3].startswith("JOB 1    bracket.stl: printed 3/5, good 0/3; expected 100 s, now ")
    table = [line.split() for line in lines if line.startswith("um2-")]
    assert table[0][:8] == ["um2-01", "remove", "1/p01", "at", "00:01", "+2", "%", "1.00"]
    assert [row[1] for row in table] == ["remove"] * 3 + ["inspect", "printing"]


def test_row_of_a_free_printer_shows_its_reservation():
    view = make_status(make_night_books())
    reserved_printer = view.printers[1].model_copy(update={"hold": None, "kept_for": "6/03"})
    printers = [*view.printers[:1], reserved_printer, *view.printers[2:]]
    lines = render_page(view.model_copy(update={"printers": printers}), width=160)
    assert next(line for line in lines if line.endswith("kept for 6/03")).startswith("um2-02")


def test_reserved_printer_is_not_as_urgent_as_one_that_needs_a_person():
    held_printer = make_status(make_night_books()).printers[1]
    reserved_printer = held_printer.model_copy(update={"hold": None, "kept_for": "6/03"})
    assert compute_urgency_s(held_printer) == -1.0
    assert compute_urgency_s(reserved_printer) == math.inf


def test_manually_used_printer_needs_an_inspection_with_its_time():
    bed_event = ev.BedBecameUnknown(at_s=6.5 * 3600.0, printer="um2-03", reason="used at its LCD")
    books, _ = apply_events(make_night_books(), bed_event)
    lines = render_page(make_status(books))
    assert lines[1].startswith(
        "DO NOW   clear 2 beds: um2-01..02     inspect: um2-03: used at its LCD (06:30), um2-04:"
    )


def test_text_of_users_is_not_interpreted():
    maintenance_event = ev.MaintenanceStarted(at_s=1.0, printer="um2-03", why="[/b] new [belt]", by="ann")
    books, _ = apply_events(make_night_books(), maintenance_event)
    assert any(
        line.endswith("maintenance --done ([/b] new [belt])") for line in render_page(make_status(books), 200)
    )


def test_unstarted_job_shows_only_known_figures():
    events = (ev.JobSubmitted(at_s=0.0, job=make_job()), ev.PlanningStarted(at_s=0.0, job=1))
    printers = (ev.PrinterAdded(at_s=0.0, printer=name, bed=Bed.CLEAR) for name in PRINTERS)
    held_plan = make_plan_event(1, 1).model_copy(update={"held": True, "plan": "abc"})
    books, _ = apply_events(Books(), *printers, *events, held_plan)
    lines = render_page(make_status(books), width=200)
    assert lines[1] == "DO NOW   approve: job 1 (1 part, 3 g)"
    assert lines[2].startswith("JOB 1    bracket.stl: held, printed 0/1; expected 100 s; held until")
    assert lines[2].endswith("held until `farm approve 1`")
    books, _ = apply_events(books, ev.JobCancelled(at_s=1.0, job=1))
    assert (
        render_page(make_status(books))[-1] == "JOB 1    bracket.stl: cancelled, printed 0/1; expected 100 s"
    )


def test_night_with_only_cancelled_prints_is_described():
    view = api.NightView.model_construct(
        plates=0, printed=0, failed=0, printing=0, waiting=0, grams=0.0, wasted_grams=26.0
    )
    assert format_night(view) == "nothing printed; 0 g + 26 g wasted"


def test_printer_in_maintenance_shows_its_reason():
    books, _ = apply_events(
        make_night_books(), ev.MaintenanceStarted(at_s=300.0, printer="um2-01", why="belt", by="ann")
    )
    (row,) = (line for line in render_page(make_status(books)) if line.startswith("um2-01"))
    assert row.endswith("maintenance --done (belt)")


@pytest.mark.parametrize(("link", "text"), [("absent", "connect"), ("starting", "wait (connecting)")])
def test_absent_printer_is_a_task_but_a_connecting_one_is_not(link, text):
    hold = Hold(code=HoldCode.PRINTER_ABSENT, text="")
    printer_view = (
        make_status(make_night_books()).printers[0].model_copy(update={"state": link, "hold": hold})
    )
    view = make_status(make_night_books()).model_copy(update={"printers": [printer_view]})
    assert render_page(view)[-1].endswith(text)


def test_verdict_on_a_part_is_shown():
    verdicts = zip(PRINTERS[:3], (Verdict.GOOD, Verdict.BAD, Verdict.GOOD), strict=True)
    books, _ = apply_events(
        make_night_books(),
        *(ev.BedCleared(at_s=300.0, printer=n, by="ann", verdict=v, why="warped") for n, v in verdicts),
    )
    view, context = make_status(books), make_view_context(books)
    assert (view.jobs[0].printed, view.jobs[0].good) == (2, 2)
    assert (view.night.printed, view.night.plates, view.night.waiting) == (2, 5, 1)
    assert view.jobs[0].wasted_grams == pytest.approx(3.0 + 3.0 * 35 / 90)
    rows = list_history(context, job=1)
    assert [(row.printer, row.wasted) for row in rows] == [
        ("um2-04", True),
        *(("um2-01", False), ("um2-02", True), ("um2-03", False)),
    ]
    assert [row.part for row in list_history(context, printer="um2-02")] == ["1/p02"]
    assert list_history(context, max_count=1) == rows[-1:]


def test_tasks_share_a_line_only_if_they_fit():
    narrow_lines = render_page(make_status(make_night_books()), width=60)
    assert narrow_lines[1:3] == [
        "DO NOW   clear 3 beds: um2-01..03",
        "         inspect: um2-04: it does not get warm (00:00)",
    ]
    books, _ = apply_events(
        Books(), *(ev.PrinterAdded(at_s=0.0, printer=name, bed=Bed.CLEAR) for name in PRINTERS)
    )
    assert render_page(make_status(books))[1] == "DO NOW   nothing"


@pytest.mark.parametrize(
    ("printers", "text"),
    [
        (["um2-02", "um2-01", "um2-03", "um2x-01"], "um2-01..03 um2x-01"),
        (["a9", "a10", "a12", "b"], "a9..10 a12 b"),
        (["42/01", "42/03"], "42/01 42/03"),
        ([], ""),
    ],
)
def test_consecutive_names_are_shown_as_ranges(printers, text):
    assert shorten_names(printers) == text


def test_finished_jobs_leave_the_page_once_judged():
    books, _ = apply_events(Books(), *(ev.JobSubmitted(at_s=0.0, job=make_job(i)) for i in range(1, 31)))
    books, _ = apply_events(books, *(ev.JobCancelled(at_s=1.0, job=i) for i in range(2, 31)))
    assert [item.id for item in select_shown_jobs(books)] == [1, *range(21, 31)]


def test_dry_run_is_on_the_page_only_while_planned():
    dry_run_job = make_job(2).model_copy(update={"options": JobOptions(dry_run=True, hold=True)})
    books, _ = apply_events(
        Books(), *(ev.JobSubmitted(at_s=0.0, job=item) for item in (make_job(1), dry_run_job))
    )
    assert [item.id for item in select_shown_jobs(books)] == [1, 2]
    books, _ = apply_events(books, *(ev.JobCancelled(at_s=1.0, job=i) for i in (1, 2)))
    assert [item.id for item in select_shown_jobs(books)] == [1]


def test_stuck_heater_is_the_first_task():
    view = make_status(make_night_books())
    alarm = api.Todo(code="alarm", printers=["um2-05"], text="go to um2-05 now: it burns")
    lines = render_page(view.model_copy(update={"todo": [alarm, *view.todo]}))
    assert lines[1].startswith("DO NOW   go to um2-05 now: it burns")
