"""Outages: several printers lost at once, without a charged attempt."""

import itertools
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.make_books import apply_events, make_end_event, make_planned_books
from farm.model import JobState, Printer, PrintState
from farm.state import events as ev
from farm.state.outage import OUTAGE_WINDOW_S, compute_outage_window_s, find_printers_lost_together
from farm.state.plate_state import MAX_ATTEMPTS, PlateState


def make_assigned_events(*pairs):
    return [
        ev.PlateAssigned(at_s=2.0, plate=plate, printer=printer, print_id=printer) for plate, printer in pairs
    ]


def make_loss_event(printer, at_s, fault="port_lost"):
    return make_end_event(printer, PrintState.FAILED, at_s, fault=fault, reason="the port is not there")


TWO_PLATES = (("1/01", "a"), ("1/02", "b"))


def test_losses_within_the_window_are_one_outage_without_charged_attempts():
    books, _ = apply_events(
        make_planned_books(), *make_assigned_events(*TWO_PLATES), make_loss_event("a", 100.0)
    )
    assert (books.outage, books.prints["a"].charged) == (None, True)
    books, _ = apply_events(books, make_loss_event("b", 100.0 + OUTAGE_WINDOW_S, fault="agent_died"))
    assert books.outage.printers == ("a", "b")
    assert [books.prints[name].charged for name in "ab"] == [False, False]
    assert {books.find_plate_state(plate) for plate in books.plates.values()} == {PlateState.WAITING}
    books, _ = apply_events(books, ev.PrinterLost(at_s=112.0, printer="c"))
    assert [outage.printers for outage in books.outages.values()] == [("a", "b", "c")]
    books, _ = apply_events(books, ev.OutageConfirmed(at_s=500.0, by="ann"))
    assert books.outage is None


def test_outage_window_covers_reporting_delays_on_a_fast_clock():
    assert [compute_outage_window_s(scale) for scale in (1.0, 5.0, 300.0)] == [
        OUTAGE_WINDOW_S,
        OUTAGE_WINDOW_S,
        300.0,
    ]
    second_loss = make_loss_event("b", 250.0)  # 0.5 s of wall time after the first loss
    books_with_real_printers, _ = apply_events(
        make_planned_books(), *make_assigned_events(*TWO_PLATES), make_loss_event("a", 100.0), second_loss
    )
    assert books_with_real_printers.outage is None
    fast_books = replace(make_planned_books(), outage_window_s=compute_outage_window_s(300.0))
    fast_books, _ = apply_events(
        fast_books, *make_assigned_events(*TWO_PLATES), make_loss_event("a", 100.0), second_loss
    )
    assert fast_books.outage.printers == ("a", "b")


@pytest.mark.parametrize(
    "second_failure", [make_loss_event("b", 111.0), make_loss_event("b", 101.0, fault="maxtemp")]
)
def test_failures_that_are_no_outage_count_as_attempts(second_failure):
    books, _ = apply_events(
        make_planned_books(), *make_assigned_events(*TWO_PLATES), make_loss_event("a", 100.0), second_failure
    )
    assert books.outage is None
    assert [books.prints[name].charged for name in "ab"] == [True, True]


def test_job_continues_after_failures_caused_by_an_outage():
    books = make_planned_books(plates=1)
    for attempt in range(MAX_ATTEMPTS - 1):
        name = f"x{attempt}"
        books, _ = apply_events(
            books,
            ev.BedCleared(at_s=3.0, printer="a", by="ann"),
            ev.PlateAssigned(at_s=3.0, plate="1/01", printer="a", print_id=name),
            make_end_event(name, PrintState.FAILED, 10.0 + attempt, fault="maxtemp"),
        )
    books, _ = apply_events(
        books,
        ev.BedCleared(at_s=3.0, printer="a", by="ann"),
        *make_assigned_events(("1/01", "a")),
        make_loss_event("a", 100.0),
    )
    assert books.jobs[1].state is JobState.FAILED
    books, _ = apply_events(books, ev.PrinterLost(at_s=105.0, printer="b"))
    assert books.jobs[1].state is JobState.PRINTING


@given(st.lists(st.floats(0, 100), min_size=1, max_size=8))
def test_group_of_lost_printers_is_the_same_for_each_of_them(times_s):
    printers = [Printer(name=f"p{i}", disconnected_at_s=at_s) for i, at_s in enumerate(times_s)]
    groups = {printer.name: find_printers_lost_together(printer.name, printers) for printer in printers}
    for name, group in groups.items():
        assert name in group
        assert all(groups[other_name] == group for other_name in group)
    sorted_times_s = sorted(times_s)
    wide_gap_count = sum(
        next_s - previous_s > OUTAGE_WINDOW_S for previous_s, next_s in itertools.pairwise(sorted_times_s)
    )
    assert len(set(groups.values())) == wide_gap_count + 1


def test_failure_before_an_outage_stays_charged():
    """Charge the failure before the outage, but not those that the outage causes."""
    earlier_events = (
        *make_assigned_events(("1/01", "a")),
        make_end_event("a", PrintState.FAILED, 50.0, fault="maxtemp"),
        ev.BedCleared(at_s=60.0, printer="a", by="ann"),
        ev.PlateAssigned(at_s=61.0, plate="1/01", printer="a", print_id="again"),
        *make_assigned_events(("1/02", "b")),
    )
    books, _ = apply_events(
        make_planned_books(), *earlier_events, make_loss_event("again", 100.0), make_loss_event("b", 101.0)
    )
    assert books.outage.printers == ("a", "b")
    assert {name: attempt.charged for name, attempt in books.prints.items()} == {
        "a": True,
        "again": False,
        "b": False,
    }
