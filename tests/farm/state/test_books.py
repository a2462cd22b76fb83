"""Books: invariants after any sequence of events."""

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from books.make_books import (
    PRINTERS,
    apply_events,
    make_end_event,
    make_fleet_events,
    make_job,
    make_plan_event,
    make_planned_books,
)
from farm.errors import ErrorCode, NotFoundError
from farm.model import (
    Bed,
    FilamentState,
    JobState,
    PrintState,
    Verdict,
)
from farm.state import events as ev
from farm.state.books import Books, _list_changes
from farm.state.lifecycles import InvalidTransition
from farm.state.plate_state import MAX_ATTEMPTS, PlateState, list_counted_failures
from farm.state.transitions import apply


def test_job_is_printed_when_its_last_print_ends():
    books, instructions = apply_events(
        make_planned_books(),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        ev.PlateAssigned(at_s=2.0, plate="1/02", printer="b", print_id="y"),
        make_end_event("x", at_s=150.0),
    )
    assert instructions[:2] == [
        ev.SendStart(print_id="x", printer="a"),
        ev.SendStart(print_id="y", printer="b"),
    ]
    assert books.jobs[1].state is JobState.PRINTING
    books, _ = apply_events(books, make_end_event("y", at_s=160.0))
    assert books.jobs[1].state is JobState.PRINTED
    assert books.jobs[1].ended_s == 160.0
    assert {p.bed for n, p in books.printers.items() if n in "ab"} == {Bed.NOT_CLEAR}


def test_no_plate_is_assigned_to_a_printer_that_is_booked_or_not_clear():
    books, _ = apply_events(
        make_planned_books(), ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x")
    )
    with pytest.raises(InvalidTransition, match="printer a is printing"):
        apply(ev.PlateAssigned(at_s=2.0, plate="1/02", printer="a", print_id="y"), books)
    books, _ = apply_events(books, make_end_event("x"))
    with pytest.raises(InvalidTransition, match="printer a is not_clear"):
        apply(ev.PlateAssigned(at_s=2.0, plate="1/02", printer="a", print_id="y"), books)


def test_only_a_person_makes_a_bed_clear():
    books, _ = apply_events(
        make_planned_books(),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        make_end_event("x"),
        ev.BedReported(at_s=201.0, printer="a", bed=Bed.CLEAR, filament=FilamentState.PARKED),
    )
    assert books.printers["a"].bed is Bed.NOT_CLEAR
    books, instructions = apply_events(books, ev.BedCleared(at_s=300.0, printer="a", by="ann"))
    assert books.printers["a"].bed is Bed.CLEAR
    assert instructions == [ev.SendCleared(printer="a", filament=None)]


def test_failed_print_needs_clearing_and_inspection_and_is_retried():
    books, _ = apply_events(
        make_planned_books(plates=1),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        make_end_event("x", PrintState.FAILED, fault="reboot", reason="the board was reset", extruded=False),
    )
    assert books.printers["a"].bed is Bed.NOT_CLEAR
    assert books.printers["a"].attention_reason == "the board was reset"
    assert [p.id for p in books.list_waiting_plates()] == ["1/01"]


def test_plate_that_fails_too_often_fails_its_job():
    books = make_planned_books(plates=1)
    for attempt in range(MAX_ATTEMPTS):
        assert books.jobs[1].state is JobState.PRINTING
        books, _ = apply_events(
            books,
            ev.BedCleared(at_s=3.0, printer="a", by="ann"),
            ev.PlateAssigned(at_s=3.0, plate="1/01", printer="a", print_id=f"x{attempt}"),
            make_end_event(f"x{attempt}", PrintState.FAILED, reason="no heat"),
        )
    assert books.jobs[1].state is JobState.FAILED
    assert books.jobs[1].error is ErrorCode.ATTEMPTS
    assert "no heat" in books.jobs[1].reason


def test_cancelled_job_ends_its_prints_without_retries():
    books, instructions = apply_events(
        make_planned_books(),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        ev.JobCancelled(at_s=50.0, job=1),
    )
    assert instructions[-1] == ev.SendCancel(print_id="x", printer="a", reason="cancelled by a person")
    books, _ = apply_events(books, make_end_event("x", PrintState.CANCELLED, reason="cancelled by a person"))
    assert books.prints["x"].state is PrintState.CANCELLED
    assert books.printers["a"].attention_reason is None
    assert not list(books.list_waiting_plates())


def test_bad_part_of_a_cancelled_job_is_not_printed_when_another_part_is_reprinted():
    books, _ = apply_events(
        make_planned_books(),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        make_end_event("x"),
        ev.JobCancelled(at_s=300.0, job=1),
        ev.BedCleared(at_s=301.0, printer="a", by="ann", verdict=Verdict.BAD),
        ev.ReprintRequested(at_s=302.0, plate="1/02", why="", by="ann"),
    )
    assert books.jobs[1].state is JobState.PRINTING
    assert [plate.id for plate in books.list_waiting_plates()] == ["1/02"]


def test_unknown_job_or_printer_is_named():
    with pytest.raises(NotFoundError, match="no job 7"):
        Books().get_job(7)
    with pytest.raises(NotFoundError, match="no printer z"):
        Books().get_printer("z")


class RandomEvents(RuleBasedStateMachine):
    """Events in any order that the controller could produce, applied to the books."""

    def __init__(self):
        super().__init__()
        self.books, _ = apply_events(Books(), *make_fleet_events())
        self.ids = itertools.count()
        self.now_s = 10.0

    def apply_event(self, event):
        self.now_s += 1.0
        self.books, _ = apply_events(self.books, event)

    @rule(plate_count=st.integers(1, 3))
    def submit_and_plan_job(self, plate_count):
        number = len(self.books.jobs) + 1
        self.apply_event(ev.JobSubmitted(at_s=self.now_s, job=make_job(number)))
        self.apply_event(ev.PlanningStarted(at_s=self.now_s, job=number))
        self.apply_event(make_plan_event(number, plate_count, self.now_s))

    @rule(data=st.data())
    def assign_plate(self, data):
        plates = [p.id for p in self.books.list_waiting_plates()]
        free_printers = [
            n
            for n, p in self.books.printers.items()
            if p.bed is Bed.CLEAR and not self.books.find_open_print(n)
        ]
        if plates and free_printers:
            plate, printer = data.draw(st.sampled_from(plates)), data.draw(st.sampled_from(free_printers))
            self.apply_event(
                ev.PlateAssigned(at_s=self.now_s, plate=plate, printer=printer, print_id=str(next(self.ids)))
            )

    @precondition(lambda self: any(True for _ in self.books.list_open_prints()))
    @rule(
        data=st.data(),
        state=st.sampled_from([PrintState.DONE, PrintState.FAILED, PrintState.CANCELLED]),
        fault=st.sampled_from(["maxtemp", "port_lost"]),
    )
    def end_print(self, data, state, fault):
        name = data.draw(st.sampled_from([p.id for p in self.books.list_open_prints()]))
        self.apply_event(make_end_event(name, state, self.now_s, reason="because", fault=fault))

    @precondition(lambda self: any(p.state.ended for p in self.books.prints.values()))
    @rule(data=st.data(), state=st.sampled_from(PrintState))
    def reject_late_events(self, data, state):
        name = data.draw(st.sampled_from([p.id for p in self.books.prints.values() if p.state.ended]))
        progress = ev.PrintProgressed(
            at_s=self.now_s, print_id=name, state=state, started_s=None, extruded=True
        )
        for late_event in (make_end_event(name, state, self.now_s), progress):
            with pytest.raises(InvalidTransition):
                apply(late_event, self.books)

    @rule(printer=st.sampled_from(PRINTERS), verdict=st.sampled_from(Verdict))
    def clear_bed(self, printer, verdict):
        if self.books.find_open_print(printer) is None:
            self.apply_event(ev.BedCleared(at_s=self.now_s, printer=printer, by="ann", verdict=verdict))

    @precondition(lambda self: any(p.cancel_reason is None for p in self.books.list_open_prints()))
    @rule(data=st.data())
    def fail_print(self, data):
        name = data.draw(
            st.sampled_from([p.id for p in self.books.list_open_prints() if p.cancel_reason is None])
        )
        self.apply_event(ev.PrintFailRequested(at_s=self.now_s, print_id=name, why="a blob", by="ann"))

    @precondition(lambda self: self.books.plates)
    @rule(data=st.data(), is_reprint=st.booleans())
    def cancel_or_reprint(self, data, is_reprint):
        plate = self.books.plates[data.draw(st.sampled_from(sorted(self.books.plates)))]
        state = self.books.find_plate_state(plate)
        if is_reprint and state not in (PlateState.WAITING, PlateState.PRINTING):
            self.apply_event(ev.ReprintRequested(at_s=self.now_s, plate=plate.id, why="more", by="ann"))
        elif not is_reprint and state is not PlateState.CANCELLED:
            self.apply_event(ev.PlateCancelled(at_s=self.now_s, plate=plate.id, by="ann"))

    @rule(printer=st.sampled_from(PRINTERS))
    def lose_printer(self, printer):
        if self.books.find_open_print(printer) is None:
            self.apply_event(ev.PrinterLost(at_s=self.now_s, printer=printer))

    @precondition(lambda self: any(not job.state.ended for job in self.books.jobs.values()))
    @rule(data=st.data())
    def cancel_job(self, data):
        open_jobs = sorted(number for number, item in self.books.jobs.items() if not item.state.ended)
        self.apply_event(ev.JobCancelled(at_s=self.now_s, job=data.draw(st.sampled_from(open_jobs))))

    @invariant()
    def check_no_printer_is_booked_twice(self):
        booked_printers = [p.printer for p in self.books.list_open_prints()]
        assert len(booked_printers) == len(set(booked_printers))

    @invariant()
    def check_no_plate_is_printed_twice(self):
        for plate in self.books.plates.values():
            states = [p.state for p in self.books.list_prints(plate)]
            done_prints = [p for p in self.books.list_prints(plate) if p.state is PrintState.DONE]
            assert sum(p.verdict is not Verdict.BAD for p in done_prints) <= 1
            assert sum(not s.ended for s in states) <= 1

    @invariant()
    def check_attempts_are_limited(self):
        for plate in self.books.plates.values():
            prints = list(self.books.list_prints(plate))
            assert len(list_counted_failures(plate, prints)) <= MAX_ATTEMPTS
            if len(list_counted_failures(plate, prints)) == MAX_ATTEMPTS and prints[-1].state.ended:
                assert plate not in list(self.books.list_waiting_plates())

    @invariant()
    def check_cancelled_plates_have_no_attempts(self):
        assert not any(plate.cancelled for plate in self.books.list_waiting_plates())
        for attempt in self.books.list_open_prints():
            if self.books.plates[attempt.plate].cancelled:
                assert attempt.cancel_reason is not None

    @invariant()
    def check_no_plate_is_lost(self):
        for item in self.books.jobs.values():
            states = {self.books.find_plate_state(plate) for plate in self.books.list_plates(item)}
            has_open_plate = bool(states & {PlateState.WAITING, PlateState.PRINTING})
            match item.state:
                case JobState.PRINTING:
                    assert has_open_plate
                case JobState.PRINTED:
                    assert not has_open_plate and PlateState.PRINTED in states
                case JobState.DONE:
                    assert PlateState.GOOD in states and states <= {PlateState.GOOD, PlateState.CANCELLED}
                case JobState.FAILED:
                    assert not has_open_plate and PlateState.OUT_OF_ATTEMPTS in states
                case JobState.CANCELLED:
                    assert not has_open_plate

    @invariant()
    def check_at_most_one_outage_is_open(self):
        assert sum(outage.confirmed_s is None for outage in self.books.outages.values()) <= 1

    @invariant()
    def check_extrusion_makes_bed_unclear(self):
        for name, printer in self.books.printers.items():
            if self.books.find_open_print(name) and any(
                p.extruded for p in self.books.list_open_prints() if p.printer == name
            ):
                assert printer.bed is not Bed.CLEAR


RandomEvents.TestCase.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)
TestRandomEvents = RandomEvents.TestCase


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 2)), max_size=12), st.booleans())
def test_changes_are_found_in_any_order(changes, is_shuffled):
    old_items = {number: object() for number in range(3)}
    new_items = dict(old_items)
    for number, change in changes:
        if change == 2:
            new_items.pop(number, None)
        else:
            new_items[number] = object()
    if is_shuffled:
        new_items = dict(reversed(new_items.items()))
    expected_numbers = {number for number, entity in new_items.items() if old_items.get(number) is not entity}
    changed_ids = {id(entity) for entity in _list_changes(old_items, new_items)}
    assert changed_ids == {id(new_items[number]) for number in expected_numbers}
