"""Views of jobs and printers: prices, times, progress and warnings."""

import dataclasses
import io
from pathlib import Path

import pytest
from rich.console import Console

from books.make_books import (
    apply_events,
    make_end_event,
    make_fleet_events,
    make_job,
    make_plan_event,
    make_planned_books,
)
from farm.cli.display.job_page import render_job
from farm.config import Fleet
from farm.model import AgentPrint, AgentSnapshot, Link, PlanProgress, PlanStep, PrintState, Verdict
from farm.paths import StateFolder
from farm.state import events as ev
from farm.state.books import Books
from farm.views import ViewContext, describe_job, describe_printer

FLEET = Fleet.model_validate(
    {
        "fleet": {"currency": "EUR"},
        "printers": [{"name": name, "model": "m", "port": f"/dev/{name}"} for name in "abc"],
    }
)


def make_priced_books(*prices):
    """Make books with a planned job whose plates have these prices."""
    books = make_planned_books(plates=len(prices))
    plates = {
        name: plate.model_copy(update={"price": price})
        for (name, plate), price in zip(books.plates.items(), prices, strict=True)
    }
    return dataclasses.replace(books, plates=plates)


def make_view(books):
    return describe_job(
        ViewContext(FLEET, books, {}, StateFolder(Path("/state")), now_s=10.0), books.get_job(1)
    )


def test_price_of_a_job_is_the_sum_of_its_plates():
    job_view = make_view(make_priced_books(1.25, 0.5))
    assert [plate.price for plate in job_view.plates] == [1.25, 0.5]
    assert (job_view.price, job_view.currency) == (pytest.approx(1.75), "EUR")
    assert (job_view.grams, job_view.filament_mm) == (pytest.approx(6.0), pytest.approx(800.0))


def test_starved_time_does_not_exceed_the_printing_time():
    """Use a part that was printed twice, so that its starved times are added."""
    books = make_planned_books(plates=1)
    assert make_view(books).starved_share is None
    for name, started_s in (("p", 2.0), ("q", 202.0)):
        assigned_event = ev.PlateAssigned(at_s=started_s, plate="1/01", printer="a", print_id=name)
        done_event = make_end_event(name, at_s=started_s + 100.0, started_s=started_s, starved_s=80.0)
        cleared_event = ev.BedCleared(at_s=started_s + 150.0, printer="a", by="ann", filament=None)
        repeated_event = ev.ReprintRequested(at_s=started_s + 160.0, plate="1/01", why="", by="ann")
        books, _ = apply_events(books, assigned_event, done_event, cleared_event, repeated_event)
    assert make_view(books).starved_share == pytest.approx(0.8)


def test_job_has_no_price_if_one_reel_has_none():
    assert make_view(make_priced_books(1.25, None)).price is None


def test_warnings_of_plates_are_shown_with_the_job():
    books = make_planned_books(plates=1)
    name, plate = next(iter(books.plates.items()))
    warning = "walls too thin to print: 90 mm2 at X4 Y0, Z 6.1..13.5 mm"
    job_view = make_view(
        dataclasses.replace(books, plates={name: plate.model_copy(update={"warnings": (warning,)})})
    )
    assert job_view.plates[0].warnings == [warning]
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(render_job(job_view))
    assert f"1/p01: {warning}" in console.export_text()


def test_failed_job_has_no_speedup():
    books, _ = apply_events(
        make_planned_books(), ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x")
    )
    old_view = make_view(books)
    assert old_view.speedup and old_view.utilisation
    cancelled_books, _ = apply_events(books, ev.JobCancelled(at_s=5.0, job=1))
    job_view = make_view(cancelled_books)
    assert (job_view.speedup, job_view.utilisation) == (None, None)
    assert job_view.expected_s == old_view.expected_s


def make_context(books, now_s, progress=None, **snapshots):
    return ViewContext(FLEET, books, snapshots, StateFolder(Path("/state")), now_s, progress=progress or {})


def test_progress_of_a_plan_is_shown():
    progress = PlanProgress(step=PlanStep.SLICING, done=3, of=8)
    queued_books, _ = apply_events(Books(), *make_fleet_events(), ev.JobSubmitted(at_s=0.0, job=make_job()))
    planning_books, _ = apply_events(queued_books, ev.PlanningStarted(at_s=0.0, job=1))
    planned_books, _ = apply_events(planning_books, make_plan_event())
    cancelled_books, _ = apply_events(planned_books, ev.JobCancelled(at_s=1.0, job=1))
    states = (queued_books, planning_books, planned_books, cancelled_books)
    shown_progress = [describe_job(make_context(b, 1.0, {1: progress}), b.jobs[1]).progress for b in states]
    # A planned job may be planned again before it starts.
    assert shown_progress == [
        None,
        progress,
        progress,
        None,
    ]


@pytest.mark.parametrize(("progress_s", "remaining_s"), [(0.0, 10.0 + 90.0 * 1.2 - 5.0), (30.0, 60.0 * 1.2)])
def test_remaining_time_uses_the_factor_of_the_printer(progress_s, remaining_s):
    books, _ = apply_events(
        make_planned_books(), ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x")
    )
    started_event = ev.PrintProgressed(
        at_s=2.0, print_id="x", state=PrintState.PRINTING, started_s=2.0, extruded=True
    )
    books, _ = apply_events(books, started_event)
    books.printers["a"] = books.printers["a"].model_copy(update={"time_factor": 1.2})
    agent_print = AgentPrint(
        print_id="x",
        state=PrintState.PRINTING,
        fault=None,
        reason=None,
        progress_s=progress_s,
        print_time_s=90.0,
        extruded=True,
        started_s=2.0,
        ended_s=None,
        layer=3,
        z_mm=0.67,
        feature="FILL",
    )
    view = describe_printer(
        make_context(books, 7.0, a=AgentSnapshot(printer="a", link=Link.BUSY, print=agent_print)),
        FLEET.find_printer("a"),
        None,
    )
    assert view.time_factor == 1.2
    assert view.print.remaining_s == pytest.approx(remaining_s)
    assert (view.print.layer, view.print.layers) == (3, 10)
    assert (view.print.z_mm, view.print.feature) == (0.67, "FILL")


def test_print_that_is_resumed_is_not_shown_as_paused():
    """Show the resumed state while the nozzle heats for minutes before the print continues."""
    books, _ = apply_events(
        make_planned_books(), ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x")
    )
    for wants_pause, state, shown_state in (
        (True, PrintState.PRINTING, "printing"),
        (True, PrintState.PAUSED, "paused"),
        (False, PrintState.PAUSED, "heating"),
        (False, PrintState.PRINTING, "printing"),
    ):
        progress_event = ev.PrintProgressed(at_s=3.0, print_id="x", state=state, started_s=2.0, extruded=True)
        books, _ = apply_events(
            books, ev.PauseRequested(at_s=3.0, print_id="x", wanted=wants_pause), progress_event
        )
        printer = describe_printer(make_context(books, 7.0), FLEET.find_printer("a"), None)
        (part,) = [part for part in make_view(books).parts if part.prints]
        assert (printer.state, printer.print.state, part.prints[0].state) == (
            shown_state,
            shown_state,
            shown_state,
        )


def test_bad_part_adds_the_time_of_its_reprint():
    started_event = ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x")
    bad_event = ev.BedCleared(at_s=300.0, printer="a", by="ann", verdict=Verdict.BAD, why="warped")
    books, _ = apply_events(make_planned_books(1), started_event, make_end_event("x", at_s=102.0), bad_event)
    job_view = make_view(books)
    assert job_view.current_s == pytest.approx(job_view.elapsed_s + job_view.expected_s)
