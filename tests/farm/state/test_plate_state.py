"""States of plates and jobs after verdicts, commands and failures."""

import pytest

from books.make_books import apply_events, make_end_event, make_planned_books
from farm.errors import ErrorCode
from farm.model import Bed, JobState, PrintState, Verdict
from farm.state import events as ev
from farm.state.books import Books
from farm.state.plate_state import MAX_ATTEMPTS, PlateState

CANCELLED_FIELDS = {"reason": "because", "state": PrintState.CANCELLED}


def make_assigned_event(plate, printer, print_id):
    return ev.PlateAssigned(at_s=2.0, plate=plate, printer=printer, print_id=print_id)


def make_cleared_event(printer, verdict=Verdict.GOOD):
    return ev.BedCleared(at_s=300.0, printer=printer, by="ann", verdict=verdict, why="stringy")


def make_printed_books(plates=1):
    books = make_planned_books(plates=plates)
    for number, printer in zip(range(1, plates + 1), "abc", strict=False):
        books, _ = apply_events(
            books, make_assigned_event(f"1/{number:02d}", printer, printer), make_end_event(printer)
        )
    return books


def make_failed_books(books, count, printer="a", plate="1/01", first_number=0):
    for number in range(first_number, first_number + count):
        name = f"{printer}{number}"
        books, _ = apply_events(
            books,
            make_cleared_event(printer),
            make_assigned_event(plate, printer, name),
            make_end_event(name, PrintState.FAILED, reason="no heat"),
        )
    return books


def find_plate_state(books, plate="1/01"):
    return books.find_plate_state(books.plates[plate])


def test_job_is_done_when_a_person_has_found_every_part_good():
    books = make_printed_books(2)
    assert (books.jobs[1].state, find_plate_state(books)) == (JobState.PRINTED, PlateState.PRINTED)
    books, _ = apply_events(books, make_cleared_event("a"))
    assert (books.jobs[1].state, find_plate_state(books)) == (JobState.PRINTED, PlateState.GOOD)
    books, _ = apply_events(books, make_cleared_event("b"))
    assert (books.jobs[1].state, books.jobs[1].ended_s) == (JobState.DONE, 200.0)


def test_bad_part_is_printed_again_without_a_charged_attempt():
    books, _ = apply_events(make_printed_books(1), make_cleared_event("a", Verdict.BAD))
    assert (books.jobs[1].state, books.jobs[1].ended_s) == (JobState.PRINTING, None)
    assert [plate.id for plate in books.list_waiting_plates()] == ["1/01"]
    assert (books.prints["a"].verdict, books.prints["a"].verdict_why) == (Verdict.BAD, "stringy")
    books = make_failed_books(books, MAX_ATTEMPTS - 1)
    assert find_plate_state(books) is PlateState.WAITING
    books, _ = apply_events(
        books,
        make_cleared_event("a"),
        make_assigned_event("1/01", "a", "x"),
        make_end_event("x", at_s=900.0),
        make_cleared_event("a"),
    )
    assert (books.jobs[1].state, books.jobs[1].ended_s) == (JobState.DONE, 900.0)


def test_second_clearing_of_a_bed_does_not_change_the_verdict():
    books, _ = apply_events(
        make_printed_books(1), make_cleared_event("a"), make_cleared_event("a", Verdict.BAD)
    )
    assert books.prints["a"].verdict is Verdict.GOOD


@pytest.mark.parametrize("end_state", [PrintState.CANCELLED, PrintState.DONE])
def test_print_failed_by_a_person_is_repeated(end_state):
    requested_event = ev.PrintFailRequested(at_s=50.0, print_id="x", why="a blob", by="ann")
    books, instructions = apply_events(
        make_planned_books(plates=1),
        make_assigned_event("1/01", "a", "x"),
        requested_event,
        make_end_event("x", end_state),
    )
    assert instructions[1] == ev.SendCancel(print_id="x", printer="a", reason="a blob")
    assert find_plate_state(books) is PlateState.WAITING
    assert books.printers["a"].bed is Bed.NOT_CLEAR
    if end_state is PrintState.CANCELLED:
        print_ = books.prints["x"]
        assert (print_.state, print_.fault, print_.reason) == (PrintState.FAILED, "by_a_person", "a blob")
        assert not print_.charged
        assert books.printers["a"].attention_reason == "a blob"


def test_fault_while_a_print_is_ended_by_a_person_is_not_charged():
    requested_event = ev.PrintFailRequested(at_s=50.0, print_id="x", why="a blob", by="ann")
    hot_event = make_end_event("x", PrintState.FAILED, fault="heater_stuck_on", reason="it does not cool")
    books, _ = apply_events(
        make_planned_books(plates=1), make_assigned_event("1/01", "a", "x"), requested_event, hot_event
    )
    assert (books.prints["x"].fault, books.prints["x"].charged) == ("heater_stuck_on", False)
    assert books.printers["a"].attention_reason == "it does not cool"


def test_plate_without_remaining_attempts_does_not_block_others():
    books, _ = apply_events(make_planned_books(plates=2), make_assigned_event("1/02", "b", "y"))
    books = make_failed_books(books, MAX_ATTEMPTS)
    assert find_plate_state(books) is PlateState.OUT_OF_ATTEMPTS
    assert books.jobs[1].state is JobState.PRINTING
    assert books.prints["y"].cancel_reason is None
    books, _ = apply_events(books, make_end_event("y", at_s=500.0))
    assert (books.jobs[1].state, books.jobs[1].error) == (JobState.FAILED, ErrorCode.ATTEMPTS)
    assert "1/p01 failed 3 times, last on a: no heat" in books.jobs[1].reason


@pytest.mark.parametrize(
    ("plate_count", "end"), [(1, "no heat"), (2, "(and 1 more plate)"), (3, "(and 2 more plates)")]
)
def test_reason_of_a_failed_job_counts_its_failed_plates(plate_count, end):
    books = make_planned_books(plates=plate_count)
    for index in range(1, plate_count + 1):
        for attempt in range(MAX_ATTEMPTS):
            print_id = f"{index}.{attempt}"
            cleared_event = ev.BedCleared(at_s=9.0, printer="a", by="ann")
            end_event = make_end_event(print_id, PrintState.FAILED, reason="no heat")
            books, _ = apply_events(
                books, cleared_event, make_assigned_event(f"1/{index:02d}", "a", print_id), end_event
            )
    assert books.jobs[1].reason.endswith(end)


def test_failed_cancelled_and_good_parts_can_be_reprinted():
    repeated_event = ev.ReprintRequested(at_s=400.0, plate="1/01", why="it broke", by="ann")
    for books in (
        make_failed_books(make_planned_books(plates=1), MAX_ATTEMPTS),
        apply_events(make_planned_books(plates=1), ev.JobCancelled(at_s=5.0, job=1))[0],
        apply_events(make_printed_books(1), make_cleared_event("a"))[0],
        make_printed_books(1),
    ):
        assert books.jobs[1].state.ended
        books, _ = apply_events(books, repeated_event)
        job = books.jobs[1]
        assert (job.state, job.error, job.reason, job.ended_s) == (JobState.PRINTING, None, None, None)
        assert find_plate_state(books) is PlateState.WAITING
        assert (
            find_plate_state(make_failed_books(books, MAX_ATTEMPTS - 1, first_number=10))
            is PlateState.WAITING
        )
        assert (
            find_plate_state(make_failed_books(books, MAX_ATTEMPTS, first_number=10))
            is PlateState.OUT_OF_ATTEMPTS
        )


def test_cancelled_part_is_not_repeated_while_others_continue():
    cancelled_event = ev.PlateCancelled(at_s=5.0, plate="1/01", by="ann")
    books, instructions = apply_events(
        make_planned_books(plates=2),
        make_assigned_event("1/01", "a", "x"),
        make_assigned_event("1/02", "b", "y"),
        cancelled_event,
    )
    assert [t for t in instructions if isinstance(t, ev.SendCancel)] == [
        ev.SendCancel(print_id="x", printer="a", reason="cancelled by ann")
    ]
    books, _ = apply_events(
        books, make_end_event("x", PrintState.FAILED, reason="no heat"), make_cleared_event("a")
    )
    assert not list(books.list_waiting_plates())
    books, _ = apply_events(books, make_end_event("y"), make_cleared_event("b"))
    assert books.jobs[1].state is JobState.DONE
    cancelled_books, _ = apply_events(
        make_planned_books(plates=2), cancelled_event, ev.PlateCancelled(at_s=6.0, plate="1/02", by="ann")
    )
    assert cancelled_books.jobs[1].state is JobState.CANCELLED


def test_paused_job_pauses_all_its_prints():
    books, instructions = apply_events(
        make_planned_books(plates=2),
        make_assigned_event("1/01", "a", "x"),
        ev.JobPaused(at_s=9.0, job=1, wanted=True),
    )
    assert books.jobs[1].paused
    assert instructions[-1] == ev.SendPause(print_id="x", printer="a", pause=True)
    books, instructions = apply_events(books, ev.JobPaused(at_s=9.0, job=1, wanted=False))
    assert (books.jobs[1].paused, instructions) == (
        False,
        [ev.SendPause(print_id="x", printer="a", pause=False)],
    )


def test_maintenance_lasts_until_ended_by_a_person():
    books, _ = apply_events(
        Books(),
        ev.PrinterAdded(at_s=0.0, printer="a", bed=Bed.CLEAR),
        ev.MaintenanceStarted(at_s=1.0, printer="a", why="a new nozzle", by="ann"),
    )
    assert books.printers["a"].maintenance == "a new nozzle"
    books, _ = apply_events(books, ev.MaintenanceEnded(at_s=2.0, printer="a", by="ann"))
    assert books.printers["a"].maintenance is None


def test_unconfirmed_print_cancelled_elsewhere_has_failed():
    """Cancel a print before its agent reports the start; a person then has to check the bed."""
    assigned_event = ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x")
    books, _ = apply_events(
        make_planned_books(1),
        assigned_event,
        make_end_event("x", PrintState.CANCELLED, 50.0, started_s=10.0),
    )
    assert books.prints["x"].state is PrintState.FAILED
    assert (books.get_printer("a").attention_reason is None, books.get_printer("a").bed) == (
        False,
        Bed.NOT_CLEAR,
    )
    unstarted_books, _ = apply_events(
        make_planned_books(1),
        assigned_event,
        make_end_event("x", PrintState.CANCELLED, 50.0, False, started_s=None),
    )
    assert unstarted_books.prints["x"].state is PrintState.CANCELLED
    assert (unstarted_books.get_printer("a").attention_reason, unstarted_books.get_printer("a").bed) == (
        None,
        Bed.CLEAR,
    )
