"""The books: laws that hold after any run of events, and the store that keeps them."""

import itertools

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from farm.errors import ErrorCode, NoSuchThing
from farm.model import (
    AgentPrint,
    AgentSnapshot,
    Bed,
    FilamentState,
    JobState,
    Link,
    PrintState,
)
from farm.tracking import events as ev
from farm.tracking.books import ATTEMPTS, Books, apply
from farm.tracking.reconcile import LOST_FAULT, observe, owed, reconcile
from farm.tracking.store import Store, StoreError
from make_books import PRINTERS, ended, fleet, job, plan, printing, run


def test_a_job_is_printed_when_its_last_part_is():
    books, instructions = run(
        printing(),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        ev.PlateAssigned(at_s=2.0, plate="1/02", printer="b", print_id="y"),
        ended("x", at_s=150.0),
    )
    assert instructions[:2] == [
        ev.SendStart(print_id="x", printer="a"),
        ev.SendStart(print_id="y", printer="b"),
    ]
    assert books.jobs[1].state is JobState.PRINTING
    books, _ = run(books, ended("y", at_s=160.0))
    assert books.jobs[1].state is JobState.PRINTED
    assert books.jobs[1].ended_s == 160.0
    assert {p.bed for n, p in books.printers.items() if n in "ab"} == {Bed.NOT_CLEAR}


def test_no_plate_goes_to_a_printer_that_is_booked_or_not_clear():
    books, _ = run(printing(), ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"))
    with pytest.raises(ValueError, match="booked"):
        apply(ev.PlateAssigned(at_s=2.0, plate="1/02", printer="a", print_id="y"), books)
    books, _ = run(books, ended("x"))
    with pytest.raises(ValueError, match="not known to be clear"):
        apply(ev.PlateAssigned(at_s=2.0, plate="1/02", printer="a", print_id="y"), books)


def test_only_a_person_makes_a_bed_clear():
    books, _ = run(
        printing(),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        ended("x"),
        ev.PrinterSeen(at_s=201.0, printer="a", bed=Bed.CLEAR, filament=FilamentState.PARKED),
    )
    assert books.printers["a"].bed is Bed.NOT_CLEAR
    books, instructions = run(books, ev.BedCleared(at_s=300.0, printer="a", by="ann"))
    assert books.printers["a"].bed is Bed.CLEAR
    assert instructions == [ev.SendCleared(printer="a", filament=None)]


def test_a_failed_print_soils_the_bed_wants_a_look_and_is_tried_again():
    books, _ = run(
        printing(plates=1),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        ended("x", PrintState.FAILED, fault="reboot", reason="the board was reset", extruded=False),
    )
    assert books.printers["a"].bed is Bed.NOT_CLEAR
    assert books.printers["a"].look == "the board was reset"
    assert [p.id for p in books.waiting_plates()] == ["1/01"]


def test_a_plate_that_fails_too_often_fails_its_job():
    books = printing(plates=1)
    for attempt in range(ATTEMPTS):
        assert books.jobs[1].state is JobState.PRINTING
        books, _ = run(
            books,
            ev.BedCleared(at_s=3.0, printer="a", by="ann"),
            ev.PlateAssigned(at_s=3.0, plate="1/01", printer="a", print_id=f"x{attempt}"),
            ended(f"x{attempt}", PrintState.FAILED, reason="no heat"),
        )
    assert books.jobs[1].state is JobState.FAILED
    assert books.jobs[1].error is ErrorCode.ATTEMPTS
    assert "no heat" in books.jobs[1].reason


def test_cancelling_a_job_ends_its_prints_and_nothing_is_tried_again():
    books, instructions = run(
        printing(),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        ev.JobCancelled(at_s=50.0, job=1),
    )
    assert instructions[-1] == ev.SendCancel(print_id="x", printer="a", reason="cancelled by a person")
    books, _ = run(books, ended("x", PrintState.CANCELLED, reason="cancelled by a person"))
    assert books.prints["x"].state is PrintState.CANCELLED
    assert books.printers["a"].look is None
    assert not list(books.waiting_plates())


def test_a_board_reset_makes_bed_and_filament_unknown():
    before = AgentSnapshot(printer="a", link=Link.READY, agent_pid=7, board_resets=0)
    after = before.model_copy(update={"board_resets": 1})
    books, _ = run(printing(), *observe(printing().printers["a"], before, after, 5.0))
    assert books.printers["a"].bed is Bed.UNKNOWN
    assert books.printers["a"].filament is FilamentState.UNKNOWN


def test_an_emulator_is_asked_only_where_the_books_do_not_know():
    said = AgentSnapshot(printer="a", link=Link.READY, bed_clear=True, filament=FilamentState.PARKED)
    books, _ = run(Books(), *fleet(Bed.UNKNOWN))
    books, _ = run(books, *observe(books.printers["a"], None, said, 5.0))
    assert books.printers["a"].bed is Bed.CLEAR
    assert list(observe(books.printers["a"], said, said, 6.0)) == []


def word(print_id="x", state=PrintState.PRINTING, link=Link.BUSY, **changes):
    facts = {
        "fault": None,
        "reason": None,
        "progress_s": 5.0,
        "print_time_s": 90.0,
        "extruded": True,
        "started_s": 2.0,
        "ended_s": None,
    }
    said = AgentPrint(print_id=print_id, state=state, **{**facts, **changes})
    return AgentSnapshot(printer="a", link=link, filament=FilamentState.PARKED, print=said)


def assigned():
    return run(printing(), ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"))[0]


def test_reconciling_follows_an_agent_and_is_quiet_when_nothing_is_new():
    books = assigned()
    books, _ = run(books, *reconcile(books.prints["x"], word(), 3.0))
    assert books.prints["x"].state is PrintState.PRINTING
    assert books.prints["x"].started_s == 2.0
    assert books.printers["a"].bed is Bed.NOT_CLEAR
    assert list(reconcile(books.prints["x"], word(), 4.0)) == []
    last = word(state=PrintState.DONE, link=Link.READY, ended_s=90.0)
    books, _ = run(books, *reconcile(books.prints["x"], last, 100.0))
    assert (books.prints["x"].state, books.prints["x"].ended_s) == (PrintState.DONE, 90.0)


def test_an_agent_that_was_not_told_is_told_again_and_one_that_forgot_has_lost_the_print():
    books = assigned()
    empty = AgentSnapshot(printer="a", link=Link.READY)
    assert list(reconcile(books.prints["x"], empty, 3.0)) == []
    assert list(owed(books.prints["x"], empty)) == [ev.SendStart(print_id="x", printer="a")]
    books, _ = run(books, *reconcile(books.prints["x"], word(), 3.0))
    assert list(owed(books.prints["x"], empty)) == []
    books, _ = run(books, *reconcile(books.prints["x"], empty, 9.0))
    assert books.prints["x"].state is PrintState.FAILED
    assert books.prints["x"].fault == LOST_FAULT


def test_a_print_that_was_cancelled_before_its_agent_heard_of_it_never_starts():
    books, _ = run(assigned(), ev.JobCancelled(at_s=3.0, job=1))
    empty = AgentSnapshot(printer="a", link=Link.READY)
    assert list(owed(books.prints["x"], empty)) == []
    books, _ = run(books, *reconcile(books.prints["x"], empty, 4.0))
    assert books.prints["x"].state is PrintState.CANCELLED
    assert books.printers["a"].bed is Bed.CLEAR


def test_what_is_not_known_is_named():
    with pytest.raises(NoSuchThing, match="no job 7"):
        Books().job(7)
    with pytest.raises(NoSuchThing, match="no printer z"):
        Books().printer("z")


class AnyNight(RuleBasedStateMachine):
    """Events in any order that the core could produce, with the store following along."""

    def __init__(self):
        super().__init__()
        self.books, _ = run(Books(), *fleet())
        self.ids = itertools.count()
        self.now = 10.0

    def happen(self, event):
        self.now += 1.0
        self.books, _ = apply(event, self.books)

    @rule(plates=st.integers(1, 3))
    def submit_and_plan(self, plates):
        number = len(self.books.jobs) + 1
        self.happen(ev.JobSubmitted(at_s=self.now, job=job(number)))
        self.happen(ev.PlanningStarted(at_s=self.now, job=number))
        self.happen(plan(number, plates, self.now))

    @rule(data=st.data())
    def assign(self, data):
        plates = [p.id for p in self.books.waiting_plates()]
        free = [
            n
            for n, p in self.books.printers.items()
            if p.bed is Bed.CLEAR and not self.books.open_print_on(n)
        ]
        if plates and free:
            plate, printer = data.draw(st.sampled_from(plates)), data.draw(st.sampled_from(free))
            self.happen(
                ev.PlateAssigned(at_s=self.now, plate=plate, printer=printer, print_id=str(next(self.ids)))
            )

    @precondition(lambda self: any(True for _ in self.books.open_prints()))
    @rule(data=st.data(), state=st.sampled_from([PrintState.DONE, PrintState.FAILED, PrintState.CANCELLED]))
    def end(self, data, state):
        name = data.draw(st.sampled_from([p.id for p in self.books.open_prints()]))
        self.happen(ended(name, state, self.now, reason="because"))

    @rule(printer=st.sampled_from(PRINTERS))
    def clear(self, printer):
        if self.books.open_print_on(printer) is None:
            self.happen(ev.BedCleared(at_s=self.now, printer=printer, by="ann"))

    @precondition(lambda self: self.books.jobs)
    @rule(data=st.data())
    def cancel(self, data):
        self.happen(ev.JobCancelled(at_s=self.now, job=data.draw(st.sampled_from(sorted(self.books.jobs)))))

    @invariant()
    def no_printer_is_booked_twice(self):
        booked = [p.printer for p in self.books.open_prints()]
        assert len(booked) == len(set(booked))

    @invariant()
    def no_plate_is_printed_twice(self):
        for plate in self.books.plates.values():
            states = [p.state for p in self.books.prints_of(plate)]
            assert states.count(PrintState.DONE) <= 1
            assert sum(not s.ended for s in states) <= 1

    @invariant()
    def a_job_is_printed_if_and_only_if_all_its_plates_are(self):
        for one in self.books.jobs.values():
            done = [
                any(p.state is PrintState.DONE for p in self.books.prints_of(q))
                for q in self.books.plates_of(one)
            ]
            if one.state is JobState.PRINTED:
                assert all(done)
            if one.state is JobState.PRINTING:
                assert not all(done)

    @invariant()
    def a_bed_after_an_extrusion_is_not_clear_until_a_person_says_so(self):
        for name, printer in self.books.printers.items():
            if self.books.open_print_on(name) and any(
                p.extruded for p in self.books.open_prints() if p.printer == name
            ):
                assert printer.bed is not Bed.CLEAR


AnyNight.TestCase.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)
TestAnyNight = AnyNight.TestCase


def test_the_store_gives_back_what_was_committed(tmp_path):
    books = Books()
    with Store(tmp_path / "farm.db") as store:
        for event in (
            *fleet(),
            ev.JobSubmitted(at_s=0.0, job=job()),
            ev.PlanningStarted(at_s=0.0, job=1),
            plan(),
        ):
            after, _ = apply(event, books)
            store.commit(event, books, after)
            books = after
    with Store(tmp_path / "farm.db") as store:
        assert store.load() == books
        assert [kind for _, kind, _ in store.events()][-1] == "JobPlanned"


def test_an_event_that_cannot_be_written_leaves_nothing(tmp_path):
    store = Store(tmp_path / "farm.db")
    before = Books()
    after, _ = apply(fleet()[0], before)
    store.close()
    with pytest.raises(StoreError, match="cannot be written"):
        store.commit(fleet()[0], before, after)
    with Store(tmp_path / "farm.db") as again:
        assert again.load() == before


def test_books_that_are_no_database_are_named(tmp_path):
    (tmp_path / "farm.db").write_text("these are not the books that you are looking for" * 50)
    with pytest.raises(StoreError, match="cannot be opened"):
        Store(tmp_path / "farm.db")
