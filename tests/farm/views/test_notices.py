"""Notices to an absent person: one for each event, and one for printers that are lost together."""

from books.make_books import apply_events, make_end_event, make_fleet_events, make_job, make_planned_books
from farm.errors import ErrorCode
from farm.model import PrintState
from farm.state import events as ev
from farm.state.books import Books
from farm.state.outage import OUTAGE_WINDOW_S
from farm.views import list_due_notices

LATER_S = 1000.0


def list_texts(books, now_s=LATER_S, since_s=0.0, known_notices=()):
    return [notice.text for notice in list_due_notices(books, now_s, since_s, known_notices)]


def make_started_books(plates=2):
    names = zip("xyz", "abc", range(1, plates + 1), strict=False)
    assigned_events = (
        ev.PlateAssigned(at_s=2.0, plate=f"1/0{i}", printer=printer, print_id=name)
        for name, printer, i in names
    )
    return apply_events(make_planned_books(plates), *assigned_events)[0]


def test_no_notice_is_sent_without_a_problem():
    assert list_texts(make_started_books()) == []


def test_printed_job_and_empty_queue_are_notified_once():
    books, _ = apply_events(make_started_books(), make_end_event("x"), make_end_event("y", at_s=300.0))
    texts = ["job 1 (bracket.stl) is printed: 2 parts in 5 min", "all jobs have ended"]
    assert list_texts(books) == texts
    assert (
        list_texts(books, known_notices={notice.key for notice in list_due_notices(books, LATER_S, 0.0, ())})
        == []
    )
    assert list_texts(books, since_s=301.0) == []
    assert list_texts(books, now_s=300.0 + OUTAGE_WINDOW_S / 2) == []
    judged_books, _ = apply_events(
        books, *(ev.BedCleared(at_s=400.0, printer=name, by="ann") for name in "ab")
    )
    keys = [
        {notice.key for notice in list_due_notices(shown_books, LATER_S, 0.0, ())}
        for shown_books in (books, judged_books)
    ]
    assert keys[0] == keys[1]  # a verdict causes no notice
    more_books, _ = apply_events(books, ev.JobSubmitted(at_s=400.0, job=make_job(2)))
    assert list_texts(more_books) == texts[:1]


def test_failure_is_notified_but_not_a_cancellation():
    failed_event = make_end_event(
        "x", PrintState.FAILED, fault="heater_timeout", reason="it does not get warm"
    )
    books, _ = apply_events(
        make_started_books(),
        failed_event,
        ev.PrintFailRequested(at_s=5.0, print_id="y", why="it came off", by="ann"),
    )
    books, _ = apply_events(books, make_end_event("y", PrintState.CANCELLED))
    assert list_texts(books) == ["1/p01 failed on a: it does not get warm"]


def test_failed_job_is_notified():
    books, _ = apply_events(
        Books(),
        *make_fleet_events(),
        ev.JobSubmitted(at_s=0.0, job=make_job()),
        ev.PlanningStarted(at_s=0.0, job=1),
        ev.JobFailed(at_s=9.0, job=1, error=ErrorCode.NO_FIT, reason="too large"),
    )
    assert list_texts(books) == ["job 1 (bracket.stl) failed: too large", "all jobs have ended"]


def test_lost_printer_is_notified_with_its_part():
    lost_event = make_end_event("x", PrintState.FAILED, fault="port_lost", reason="its port is gone")
    books, _ = apply_events(make_started_books(), lost_event, ev.PrinterLost(at_s=500.0, printer="c"))
    assert list_texts(books) == [
        "1/p01 failed on a: its port is gone",
        "c is lost: the connection to its board is gone",
    ]


def test_outage_is_notified_once_for_all_printers():
    failure_fields = {"fault": "port_lost", "reason": "its port is gone"}
    books, _ = apply_events(
        make_started_books(3),
        *(
            make_end_event(name, PrintState.FAILED, 200.0 + i, **failure_fields)
            for i, name in enumerate("xyz")
        ),
    )
    assert list_texts(books) == ["a b c were lost at the same time; nothing starts before `farm resume`"]
    books, _ = apply_events(
        books, ev.OutageConfirmed(at_s=400.0, by="ann"), ev.PrinterLost(at_s=600.0, printer="a")
    )
    assert list_texts(books)[1:] == ["a is lost: the connection to its board is gone"]


def test_ended_dry_run_is_not_notified():
    dry_run_job = make_job(2).model_copy(
        update={"options": make_job().options.model_copy(update={"dry_run": True})}
    )
    books, _ = apply_events(
        make_planned_books(), ev.JobSubmitted(at_s=3.0, job=dry_run_job), ev.JobCancelled(at_s=4.0, job=2)
    )
    assert list_texts(books) == []


def test_restored_database_is_notified_once():
    books, _ = apply_events(make_started_books(), ev.BooksRestored(at_s=500.0, copied_s=1.0))
    (text,) = list_texts(books)
    assert text.startswith("the database was damaged and restored")
    assert (
        list_texts(books, known_notices={notice.key for notice in list_due_notices(books, LATER_S, 0.0, ())})
        == []
    )
