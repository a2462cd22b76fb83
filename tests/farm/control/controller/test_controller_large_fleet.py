"""Large fleet: one scheduling run for all reports of an interval, and starts spread over several ticks."""

from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, PLUS_MODEL, Farm
from farm.control import controller, scheduler
from farm.model import AgentPrint, JobOptions, Link, PrintState
from farm.planning import Plan
from farm.scheduling import assign_plates
from farm.state import events as ev
from farm.state.storage import StoreError


@pytest.fixture
def farm(tmp_path, monkeypatch):
    """Make a planned job of two parts on a fleet of two printers, which counts as large."""
    monkeypatch.setattr(controller, "LARGE_FLEET_SIZE", 1)
    monkeypatch.setattr(scheduler, "MAX_STARTS", 1)
    farm = Farm(tmp_path)
    farm.report_ready("a", "b")
    farm.controller.tick()
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions(), "ann")
    farm.report_ready("a", "b", link=Link.STARTING)
    event = make_plan_event(1, 2)
    farm.controller.on_plan(1, Plan(event.parts, event.plates, event.repairs, 1.0, 500.0))
    return farm


def list_started_printers(farm):
    return sorted(attempt.printer for attempt in farm.controller.books.list_open_prints(1))


def test_reports_wait_for_the_tick_and_each_tick_starts_its_share(farm):
    farm.report_ready("a", "b")
    assert list_started_printers(farm) == []
    farm.controller.tick()
    assert len(list_started_printers(farm)) == 1
    farm.controller.tick()
    assert list_started_printers(farm) == ["a", "b"]
    assert sorted(attempt.printer for attempt in farm.controller.books.list_open_prints()) == ["a", "b"]


def test_events_of_a_report_are_recorded_at_once(farm):
    farm.report_ready("a", "b")
    farm.controller.tick()
    farm.controller.tick()
    ended_print = farm.controller.books.find_open_print("a")
    farm.report_ready("a", link=Link.ABSENT, agent_pid=None)
    assert farm.controller.books.prints[ended_print.id].state is PrintState.CANCELLED


def test_command_of_a_person_is_scheduled_at_once(farm):
    farm.report_ready("a", "b")
    farm.clear_bed("a")
    assert len(list_started_printers(farm)) == 1


def test_postponed_start_is_dropped_once_it_is_impossible(farm):
    farm.report_ready("a", "b")
    farm.controller.tick()
    (started_printer,) = list_started_printers(farm)
    (other_printer,) = {"a", "b"} - {started_printer}
    farm.report_ready(other_printer, link=Link.ABSENT, agent_pid=None)
    farm.controller.tick()
    assert list_started_printers(farm) == [started_printer]
    farm.report_ready(other_printer)
    farm.controller.tick()
    assert list_started_printers(farm) == ["a", "b"]


def test_starts_that_cannot_be_written_together_leave_the_books_unchanged(farm, monkeypatch):
    monkeypatch.setattr(scheduler, "MAX_STARTS", 2)
    farm.report_ready("a", "b")
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
    assert list_started_printers(farm) == ["a", "b"]


def plan_jobs(farm, plate_counts):
    """Submit and plan one job for each number of plates; no printer is ready yet."""
    for number, count in enumerate(plate_counts, 1):
        farm.jobs.submit(
            str(number) * 8, "m.stl", INSPECTED_MODEL, JobOptions(printers=count % 3 or None), "ann"
        )
        event = make_plan_event(number, count)
        plan = Plan(event.parts, event.plates, event.repairs, 1.0, 500.0)
        farm.controller.handle(ev.PlanningStarted(at_s=1.0, job=number))
        farm.controller.on_plan(number, plan)


def make_farm(folder, plate_counts, printer_count):
    farm = Farm(Path(folder), models=(PLUS_MODEL,) * printer_count)
    plan_jobs(farm, plate_counts)
    farm.report_ready(*farm.controller.fleet.names)
    return farm


def list_assignments(farm):
    return sorted((attempt.plate, attempt.printer) for attempt in farm.controller.books.list_open_prints())


@pytest.fixture
def large_fleet(monkeypatch):
    monkeypatch.setattr(controller, "LARGE_FLEET_SIZE", 1)


fleets = st.lists(st.integers(1, 4), min_size=1, max_size=4), st.integers(2, 8)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40)
@given(*fleets, st.integers(1, 4))
def test_starts_in_portions_equal_those_of_one_run(large_fleet, plate_counts, printer_count, max_portion):
    """Make the same decisions as one run, although each portion considers only its own jobs."""
    pairs = []
    for max_starts in (max_portion, 100):
        with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
            patch.setattr(scheduler, "MAX_STARTS", max_starts)
            farm = make_farm(folder, plate_counts, printer_count)
            for _ in range(20):
                farm.controller.tick()
            pairs.append(list_assignments(farm))
            farm.store.close()
    assert pairs[0] == pairs[1] and pairs[0]


@settings(max_examples=40)
@given(*fleets, st.data())
def test_updated_situation_equals_one_built_after_the_starts(plate_counts, printer_count, data):
    with TemporaryDirectory() as folder:
        farm = Farm(Path(folder), models=(PLUS_MODEL,) * printer_count)
        plan_jobs(farm, plate_counts)
        farm.controller.is_stopping = True  # the reports must not start plates
        farm.report_ready(*farm.controller.fleet.names)
        situations = farm.controller.situations
        old_situation = situations.build(situations.find_held_back_plates())
        assignments = assign_plates(old_situation)
        starts = assignments[: data.draw(st.integers(0, len(assignments)))]
        now_s = old_situation.now_s
        farm.controller.handle(
            *(
                ev.PlateAssigned(at_s=now_s, plate=start.plate, printer=start.printer, print_id=start.plate)
                for start in starts
            )
        )
        updated_situation, new_situation = (
            situations.apply_starts(old_situation, starts),
            situations.build(situations.find_held_back_plates()),
        )
        farm.store.close()
    assert updated_situation.printers == new_situation.printers
    assert [plate.id for plate in updated_situation.waiting_plates] == [
        plate.id for plate in new_situation.waiting_plates
    ]
    assert {printer.name for printer in updated_situation.free_printers} == {
        p.name for p in old_situation.free_printers
    } - {start.printer for start in starts}


CHANGES = {
    "its printer is absent": lambda farm, start: farm.report_ready(
        start.printer, link=Link.ABSENT, agent_pid=None
    ),
    "its bed is unknown": lambda farm, start: farm.report_ready(
        start.printer, bed_unknown_reason="its board was reset"
    ),
    "an alarm": lambda farm, start: farm.report_ready(start.printer, alarm="it gets hotter"),
    "a fault": lambda farm, start: farm.report_ready(
        start.printer, link=Link.FAULT, reason="stopped by estop"
    ),
    "maintenance": lambda farm, start: farm.printers.begin_maintenance(start.printer, "its nozzle", "ann"),
    "its job is paused": lambda farm, start: farm.jobs.set_paused(int(start.plate[0]), True, "ann"),
    "its job is cancelled": lambda farm, start: farm.jobs.cancel(int(start.plate[0]), "ann"),
    "its part is cancelled": lambda farm, start: farm.parts.cancel(
        int(start.plate[0]), start.plate.replace("/", "/p"), "ann"
    ),
    "the farm is shut down": lambda farm, start: setattr(farm.controller, "is_stopping", True),
}


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(*fleets, st.sampled_from(sorted(CHANGES)), st.data())
def test_start_is_dropped_if_a_change_between_two_portions_forbids_it(
    large_fleet, plate_counts, printer_count, change, data
):
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(scheduler, "MAX_STARTS", 1)
        farm = make_farm(folder, plate_counts, printer_count)
        farm.controller.tick()
        later_starts = farm.controller.scheduler._later_starts
        assume(later_starts)
        start = data.draw(st.sampled_from(later_starts))
        # Nothing is scheduled before the next tick.
        patch.setattr(controller.Controller, "_schedule", lambda _: iter(()))
        CHANGES[change](farm, start)
        patch.undo()
        patch.setattr(scheduler, "MAX_STARTS", 1)
        patch.setattr(controller, "LARGE_FLEET_SIZE", 1)
        for _ in range(20):
            farm.controller.tick()
        assert (start.plate, start.printer) not in list_assignments(farm)
        prints = list(farm.controller.books.prints.values())
        assert len({attempt.printer for attempt in prints}) == len({attempt.plate for attempt in prints})
        assert len(prints) == len({attempt.plate for attempt in prints})
        farm.store.close()


def lose_print(farm, printer):
    attempt = farm.controller.books.find_open_print(printer)
    report = AgentPrint(
        print_id=attempt.id, state=PrintState.FAILED, fault="port_lost", reason="no answer", progress_s=5.0,
        print_time_s=90.0, extruded=True, started_s=attempt.assigned_s, ended_s=attempt.assigned_s,
    )  # fmt: skip
    farm.report_ready(printer, link=Link.ABSENT, print=report)


def test_postponed_starts_are_dropped_in_an_outage(large_fleet, monkeypatch, tmp_path):
    monkeypatch.setattr(scheduler, "MAX_STARTS", 2)
    farm = make_farm(tmp_path / "farm", [6], 6)
    farm.controller.tick()
    for _, printer in list_assignments(farm):
        lose_print(farm, printer)
    assert farm.controller.books.outage is not None and farm.controller.scheduler.has_later_starts
    farm.controller.tick()
    assert list_assignments(farm) == [] and not farm.controller.scheduler.has_later_starts
    farm.printers.confirm_outage("ann")
    farm.controller.tick()
    assert [printer for _, printer in list_assignments(farm)] == ["c", "d", "e", "f"]
