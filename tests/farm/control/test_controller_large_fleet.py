"""Large fleet: one scheduling run for all reports of an interval, and starts spread over several ticks."""

import pytest

from farm.control import controller, scheduler
from farm.model import JobOptions, Link, PrintState
from farm.planning import Plan
from farm.state.storage import StoreError
from make_books import make_plan_event
from recording_controller import MODEL, Farm


@pytest.fixture
def farm(tmp_path, monkeypatch):
    """Make a planned job of two parts on a fleet of two printers, which counts as large."""
    monkeypatch.setattr(controller, "LARGE_FLEET", 1)
    monkeypatch.setattr(scheduler, "MAX_STARTS", 1)
    farm = Farm(tmp_path)
    farm.ready("a", "b")
    farm.controller.tick()
    farm.jobs.submit("r" * 8, "m.stl", MODEL, JobOptions(), "ann")
    farm.ready("a", "b", link=Link.STARTING)
    event = make_plan_event(1, 2)
    farm.controller.on_plan(1, Plan(event.parts, event.plates, event.repairs, 1.0, 500.0, 100.0, None))
    return farm


def list_starts(farm):
    return sorted(attempt.printer for attempt in farm.controller.books.open_prints(1))


def test_reports_wait_for_the_tick_and_each_tick_starts_its_share(farm):
    farm.ready("a", "b")
    assert list_starts(farm) == []
    farm.controller.tick()
    assert len(list_starts(farm)) == 1
    farm.controller.tick()
    assert list_starts(farm) == ["a", "b"]
    assert sorted(attempt.printer for attempt in farm.controller.books.open_prints()) == ["a", "b"]


def test_events_of_a_report_are_recorded_at_once(farm):
    farm.ready("a", "b")
    farm.controller.tick()
    farm.controller.tick()
    ended_print = farm.controller.books.open_print_on("a")
    farm.ready("a", link=Link.ABSENT, agent_pid=None)
    assert farm.controller.books.prints[ended_print.id].state is PrintState.CANCELLED


def test_a_command_of_a_person_is_scheduled_at_once(farm):
    farm.ready("a", "b")
    farm.clear_bed("a")
    assert len(list_starts(farm)) == 1


def test_a_start_that_was_left_for_later_is_dropped_once_it_is_impossible(farm):
    farm.ready("a", "b")
    farm.controller.tick()
    (started_printer,) = list_starts(farm)
    (other_printer,) = {"a", "b"} - {started_printer}
    farm.ready(other_printer, link=Link.ABSENT, agent_pid=None)
    farm.controller.tick()
    assert list_starts(farm) == [started_printer]
    farm.ready(other_printer)
    farm.controller.tick()
    assert list_starts(farm) == ["a", "b"]


def test_starts_that_cannot_be_written_together_leave_the_books_as_they_were(farm, monkeypatch):
    monkeypatch.setattr(scheduler, "MAX_STARTS", 2)
    farm.ready("a", "b")
    books, commit = farm.controller.books, farm.store.commit

    def fail_at_the_second(event, old_books, new_books):
        commit(event, old_books, new_books)
        if old_books is not books:
            raise StoreError("the disk is full")

    monkeypatch.setattr(farm.store, "commit", fail_at_the_second)
    with pytest.raises(StoreError):
        farm.controller.tick()
    assert farm.controller.books is books and farm.store.load() == books
    monkeypatch.setattr(farm.store, "commit", commit)
    farm.controller.tick()
    assert list_starts(farm) == ["a", "b"]
