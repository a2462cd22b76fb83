"""Reconciliation of the books with reports of agents."""

import pytest

from books.make_books import apply_events, make_fleet_events, make_planned_books
from farm.model import AgentPrint, AgentSnapshot, Bed, FilamentState, JobState, Link, Printer, PrintState
from farm.state import events as ev
from farm.state.books import Books
from farm.state.faults import FarmFault
from farm.state.lifecycles import InvalidTransition
from farm.state.plate_state import PlateState
from farm.state.reconciliation import (
    handle_unknown_print,
    list_pending_instructions,
    reconcile_idle_printer,
    reconcile_print,
)


def test_manual_use_makes_bed_and_filament_unknown():
    snapshot = AgentSnapshot(
        printer="a",
        link=Link.READY,
        bed_clear=True,
        filament=FilamentState.UNKNOWN,
        bed_unknown_reason="its board was reset, but not by the farm",
    )
    books, _ = apply_events(
        make_planned_books(), *reconcile_idle_printer(make_planned_books().printers["a"], snapshot, 5.0)
    )
    printer = books.printers["a"]
    assert (printer.bed, printer.filament) == (Bed.UNKNOWN, FilamentState.UNKNOWN)
    assert "reset" in printer.attention_reason
    assert list(reconcile_idle_printer(printer, snapshot, 6.0)) == []
    # Not even an emulator's report replaces the inspection.
    assert (
        list(reconcile_idle_printer(printer, snapshot.model_copy(update={"bed_unknown_reason": None}), 7.0))
        == []
    )


def test_restarted_agent_knows_the_filament_but_not_the_bed():
    first_snapshot = AgentSnapshot(
        printer="a",
        link=Link.READY,
        filament=FilamentState.UNKNOWN,
        bed_unknown_reason="it was not watched before its agent was started",
    )
    parked_snapshot = first_snapshot.model_copy(update={"filament": FilamentState.PARKED})
    books = make_planned_books()
    for at_s, snapshot in enumerate((first_snapshot, parked_snapshot, parked_snapshot, parked_snapshot)):
        books, _ = apply_events(books, *reconcile_idle_printer(books.printers["a"], snapshot, float(at_s)))
    printer = books.printers["a"]
    assert (printer.bed, printer.filament) == (Bed.UNKNOWN, FilamentState.PARKED)
    assert "not watched" in printer.attention_reason
    assert list(reconcile_idle_printer(printer, parked_snapshot, 9.0)) == []
    cleared_books, _ = apply_events(books, ev.BedCleared(at_s=10.0, printer="a", by="ann"))
    printer = cleared_books.printers["a"]  # no person had to state the position of the filament
    assert (printer.bed, printer.filament) == (Bed.CLEAR, FilamentState.PARKED)


def test_bed_of_an_emulator_is_used_only_if_unknown():
    snapshot = AgentSnapshot(printer="a", link=Link.READY, bed_clear=True, filament=FilamentState.PARKED)
    books, _ = apply_events(Books(), *make_fleet_events(Bed.UNKNOWN))
    books, _ = apply_events(books, *reconcile_idle_printer(books.printers["a"], snapshot, 5.0))
    assert books.printers["a"].bed is Bed.CLEAR
    assert list(reconcile_idle_printer(books.printers["a"], snapshot, 6.0)) == []


def test_real_printer_does_not_report_its_bed():
    snapshot = AgentSnapshot(printer="a", link=Link.READY, filament=FilamentState.PARKED)
    books, _ = apply_events(Books(), *make_fleet_events(Bed.UNKNOWN))
    assert list(reconcile_idle_printer(books.printers["a"], snapshot, 5.0)) == []


def make_report(print_id="x", state=PrintState.PRINTING, link=Link.BUSY, **changes):
    fields = {
        "fault": None,
        "reason": None,
        "progress_s": 5.0,
        "print_time_s": 90.0,
        "extruded": True,
        "started_s": 2.0,
        "ended_s": None,
    }
    agent_print = AgentPrint(print_id=print_id, state=state, **{**fields, **changes})
    return AgentSnapshot(printer="a", link=link, filament=FilamentState.PARKED, print=agent_print)


def make_assigned_books():
    return apply_events(
        make_planned_books(), ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x")
    )[0]


def test_reconciliation_yields_events_only_for_changes():
    books = make_assigned_books()
    books, _ = apply_events(books, *reconcile_print(books.prints["x"], make_report(), 3.0))
    assert books.prints["x"].state is PrintState.PRINTING
    assert books.prints["x"].started_s == 2.0
    assert books.printers["a"].bed is Bed.NOT_CLEAR
    assert list(reconcile_print(books.prints["x"], make_report(), 4.0)) == []
    last_report = make_report(state=PrintState.DONE, link=Link.READY, ended_s=90.0)
    books, _ = apply_events(books, *reconcile_print(books.prints["x"], last_report, 100.0))
    assert (books.prints["x"].state, books.prints["x"].ended_s) == (PrintState.DONE, 90.0)


def test_start_is_repeated_and_a_forgotten_print_is_lost():
    books = make_assigned_books()
    assert list(reconcile_print(books.prints["x"], make_idle_snapshot(), 3.0)) == []
    assert list(list_pending_instructions(books.prints["x"], make_idle_snapshot())) == [
        ev.SendStart(print_id="x", printer="a")
    ]
    books, _ = apply_events(books, *reconcile_print(books.prints["x"], make_report(), 3.0))
    assert list(list_pending_instructions(books.prints["x"], make_idle_snapshot())) == []
    books, _ = apply_events(books, *reconcile_print(books.prints["x"], make_idle_snapshot(), 9.0))
    assert books.prints["x"].state is PrintState.FAILED
    assert books.prints["x"].fault == FarmFault.PRINT_LOST


def make_idle_snapshot(link=Link.READY, pid=9, **changes):
    """Make a snapshot of an agent without a print."""
    return AgentSnapshot(printer="a", link=link, agent_pid=pid, **changes)


def test_cancelled_print_ends_when_its_agent_confirms():
    """Wait for the confirmation: the start may be in transit together with an older snapshot."""
    books, _ = apply_events(make_assigned_books(), ev.JobCancelled(at_s=3.0, job=1))
    cancel_instruction = ev.SendCancel(print_id="x", printer="a", reason=books.prints["x"].cancel_reason)
    assert list(reconcile_print(books.prints["x"], make_idle_snapshot(), 4.0)) == []
    assert list(list_pending_instructions(books.prints["x"], make_idle_snapshot())) == [cancel_instruction]
    # No agent would receive the instruction.
    assert list(list_pending_instructions(books.prints["x"], make_idle_snapshot(Link.STARTING))) == []
    assert (
        list(reconcile_print(books.prints["x"], make_idle_snapshot(acknowledged_cancel="another"), 4.0)) == []
    )
    books, _ = apply_events(
        books, *reconcile_print(books.prints["x"], make_idle_snapshot(acknowledged_cancel="x"), 4.0)
    )
    assert books.prints["x"].state is PrintState.CANCELLED
    assert books.printers["a"].bed is Bed.CLEAR


@pytest.mark.parametrize("link", [Link.FAULT, Link.ABSENT])
def test_unstartable_print_is_reassigned_after_its_agent_confirms(link):
    books = make_assigned_books()
    stale_snapshot = make_idle_snapshot(link, reason="unplugged")
    books, instructions = apply_events(books, *reconcile_print(books.prints["x"], stale_snapshot, 3.0))
    assert instructions == [ev.SendCancel(print_id="x", printer="a", reason="unplugged")]
    assert [plate.id for plate in books.list_waiting_plates()] == ["1/02"]
    assert list(reconcile_print(books.prints["x"], stale_snapshot, 4.0)) == []
    # The print started nevertheless and is ended: its plate is free again, without a charged attempt.
    started_books, _ = apply_events(
        books, *reconcile_print(books.prints["x"], make_report(state=PrintState.HEATING, extruded=False), 5.0)
    )
    assert [
        type(item)
        for item in list_pending_instructions(
            started_books.prints["x"], make_report(state=PrintState.HEATING)
        )
    ] == [ev.SendCancel]
    last_report = make_report(state=PrintState.CANCELLED, link=Link.READY, extruded=False, ended_s=9.0)
    started_books, _ = apply_events(
        started_books, *reconcile_print(started_books.prints["x"], last_report, 9.0)
    )
    assert started_books.prints["x"].state is PrintState.CANCELLED
    # Or the print never started.
    books, _ = apply_events(
        books, *reconcile_print(books.prints["x"], make_idle_snapshot(link, acknowledged_cancel="x"), 5.0)
    )
    assert books.prints["x"].state is PrintState.CANCELLED
    assert books.printers["a"].bed is Bed.CLEAR
    for result_books in (books, started_books):
        assert [plate.id for plate in result_books.list_waiting_plates()] == ["1/01", "1/02"]


def test_print_without_an_agent_cannot_start():
    books = make_assigned_books()
    books, _ = apply_events(
        books, *reconcile_print(books.prints["x"], make_idle_snapshot(Link.ABSENT, None), 3.0)
    )
    assert books.prints["x"].state is PrintState.CANCELLED


def restore_books(*states):
    """Restore books in which the prints on `a` and `b` have these states."""
    books = make_planned_books()
    for name, state in zip("ab", states, strict=False):
        plate = {"a": "1/01", "b": "1/02"}[name]
        books, _ = apply_events(books, ev.PlateAssigned(at_s=2.0, plate=plate, printer=name, print_id=name))
        if state is not PrintState.ASSIGNED:
            event = ev.PrintProgressed(at_s=3.0, print_id=name, state=state, started_s=2.0, extruded=True)
            books, _ = apply_events(books, event)
    return apply_events(books, ev.BooksRestored(at_s=50.0, copied_s=10.0))[0]


@pytest.mark.parametrize("state", [PrintState.ASSIGNED, PrintState.PRINTING])
def test_restored_books_adopt_the_print_of_an_agent(state):
    books = restore_books(state)
    # The print is not started again.
    assert list(list_pending_instructions(books.prints["a"], make_idle_snapshot())) == []
    snapshot = make_report("a")
    books, instructions = apply_events(books, *reconcile_print(books.prints["a"], snapshot, 51.0))
    assert (instructions, list(list_pending_instructions(books.prints["a"], snapshot))) == ([], [])
    assert (books.prints["a"].state, books.prints["a"].restored) == (PrintState.PRINTING, False)
    assert list(reconcile_print(books.prints["a"], snapshot, 52.0)) == []
    last_report = make_report("a", state=PrintState.DONE, link=Link.READY, ended_s=90.0)
    books, _ = apply_events(books, *reconcile_print(books.prints["a"], last_report, 100.0))
    assert books.find_plate_state(books.plates["1/01"]) is PlateState.PRINTED
    assert books.jobs[1].state is JobState.HELD
    books, _ = apply_events(books, ev.JobApproved(at_s=101.0, job=1, by="ann"))
    assert [plate.id for plate in books.list_waiting_plates()] == ["1/02"]


def test_print_unknown_to_its_agent_is_neither_an_outage_nor_a_charged_attempt():
    books = restore_books(PrintState.PRINTING, PrintState.PRINTING)
    for name in "ab":
        snapshot = make_idle_snapshot().model_copy(update={"printer": name})
        books, _ = apply_events(books, *reconcile_print(books.prints[name], snapshot, 51.0))
    assert books.outage is None
    assert {(p.state, p.charged) for p in books.prints.values()} == {(PrintState.FAILED, False)}
    assert "check what happened to it" in books.printers["a"].attention_reason
    restored_books = restore_books(PrintState.ASSIGNED)
    restored_books, _ = apply_events(
        restored_books, *reconcile_print(restored_books.prints["a"], make_idle_snapshot(), 51.0)
    )
    assert restored_books.prints["a"].state is PrintState.CANCELLED


def test_print_ended_in_the_books_is_cancelled_at_its_agent():
    books = make_assigned_books()
    books, _ = apply_events(
        books, *reconcile_print(books.prints["x"], make_idle_snapshot(Link.ABSENT, None), 3.0)
    )
    heating_report = make_report(state=PrintState.HEATING, extruded=False)
    instructions = list(handle_unknown_print(books.printers["a"], books.prints["x"], heating_report, 4.0))
    assert [type(item) for item in instructions] == [ev.SendCancel]
    for snapshot in (make_report(), make_report(state=PrintState.CANCELLED, link=Link.READY, ended_s=9.0)):
        unknown_bed_event, _ = handle_unknown_print(books.printers["a"], books.prints["x"], snapshot, 4.0)
        # The bed is no longer clear.
        assert apply_events(books, unknown_bed_event)[0].printers["a"].bed is Bed.UNKNOWN


def test_unknown_print_continues_and_makes_the_bed_unknown():
    books, _ = apply_events(Books(), *make_fleet_events())
    instructions = list(handle_unknown_print(books.printers["a"], None, make_report("stranger"), 4.0))
    assert [type(item) for item in instructions] == [ev.BedBecameUnknown]
    books, _ = apply_events(books, *instructions)
    assert books.printers["a"].bed is Bed.UNKNOWN
    last_report = make_report("stranger", state=PrintState.DONE, ended_s=9.0)
    assert list(handle_unknown_print(books.printers["a"], None, last_report, 9.0)) == [
        ev.SendForget(print_id="stranger", printer="a")
    ]


@pytest.mark.parametrize(
    ("wanted", "state", "repeated_value"),
    [
        (True, PrintState.HEATING, None),  # the agent reports the pause once it prints
        (True, PrintState.PRINTING, True),
        (True, PrintState.PAUSED, None),
        (False, PrintState.PAUSED, False),
        (False, PrintState.PRINTING, None),
        (True, PrintState.ENDING, None),
    ],
)
def test_unconfirmed_pause_is_repeated(wanted, state, repeated_value):
    books, instructions = apply_events(
        make_assigned_books(), ev.PauseRequested(at_s=3.0, print_id="x", wanted=wanted)
    )
    assert instructions == [ev.SendPause(print_id="x", printer="a", pause=wanted)]
    repeated_instructions = list(list_pending_instructions(books.prints["x"], make_report(state=state)))
    assert repeated_instructions == (
        [] if repeated_value is None else [ev.SendPause(print_id="x", printer="a", pause=repeated_value)]
    )


def test_cancelled_print_is_not_paused():
    books, _ = apply_events(make_assigned_books(), ev.JobCancelled(at_s=3.0, job=1))
    with pytest.raises(InvalidTransition, match="print x is assigned and being stopped"):
        apply_events(books, ev.PauseRequested(at_s=3.0, print_id="x", wanted=True))
    books, instructions = apply_events(
        make_assigned_books(),
        ev.PlateCancelled(at_s=3.0, plate="1/01", by="ann"),
        ev.JobPaused(at_s=4.0, job=1, wanted=True),
    )
    assert books.prints["x"].pause_requested is False
    assert not any(isinstance(item, ev.SendPause) for item in instructions)


@pytest.mark.parametrize("known_field", ["bed", "filament"])
def test_emulator_provides_the_unknown_bed_or_filament(known_field):
    snapshot = AgentSnapshot(printer="a", link=Link.READY, bed_clear=True, filament=FilamentState.PARKED)
    fields = {"bed": Bed.UNKNOWN, "filament": FilamentState.UNKNOWN}
    fields[known_field] = Bed.NOT_CLEAR if known_field == "bed" else FilamentState.AT_NOZZLE
    printer = Printer(name="a", **fields)
    (event,) = reconcile_idle_printer(printer, snapshot, 5.0)
    books, _ = apply_events(Books.from_entities([printer]), event)
    printer = books.printers["a"]
    bed = Bed.NOT_CLEAR if known_field == "bed" else Bed.CLEAR
    filament = FilamentState.AT_NOZZLE if known_field == "filament" else FilamentState.PARKED
    assert (printer.bed, printer.filament) == (bed, filament)
