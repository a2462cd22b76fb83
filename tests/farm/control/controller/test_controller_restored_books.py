"""Restored books: prints since the backup are imported from the agents."""

import itertools

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from farm.model import (
    AgentPrint,
    AgentSnapshot,
    FilamentState,
    HoldCode,
    JobOptions,
    JobState,
    Link,
    PrintState,
    Reel,
    Verdict,
)
from farm.paths import StateFolder
from farm.state import events as ev
from farm.state.books import put
from farm.state.reconciliation import import_agent_journal
from farm.state.storage.store import copy_books
from farm.views import list_tasks
from farms.simulated_fleet import FarmSimulation

PLATE_COUNT = 4
PLANNED_S = 1_790_000_000.0


def run_with_restore(
    simulation, folder, minutes_until_copy, minutes_until_restore, unreachable=(), unreachable_minutes=0
):
    """Run a job to its end and yield each minute; copy the books in one minute and restore them later."""
    planned_minute, copy = None, folder / "copy.db"
    for minute in itertools.count():
        assert minute < 300, simulation.controller.books
        if planned_minute is None and simulation.controller.books.plates:
            planned_minute = minute
        if planned_minute is not None and minute == planned_minute + minutes_until_copy:
            copy_books(simulation.path, copy, simulation.clock.now())
        if (
            planned_minute is not None
            and minute == planned_minute + minutes_until_copy + minutes_until_restore
        ):
            simulation.restore(copy)
            simulation.unreachable_agents = frozenset(unreachable)
        if (
            planned_minute is not None
            and minute == planned_minute + minutes_until_copy + minutes_until_restore + unreachable_minutes
        ):
            simulation.unreachable_agents = frozenset()
        yield minute
        job = simulation.controller.books.jobs.get(1)
        if job is not None and job.state is JobState.DONE and simulation.is_restored:
            return
        # A person approves the job without an inspection of the beds.
        if job is not None and job.state is JobState.HELD:
            simulation.controller.handle(ev.JobApproved(at_s=simulation.clock.now(), job=1, by="ann"))
        simulation.step()


def check_books(simulation):
    books = simulation.controller.books
    done_prints = [p for p in books.prints.values() if p.state is PrintState.DONE]
    assert len(done_prints) == len(simulation.completed_prints) == PLATE_COUNT
    assert {verdict for *_, verdict in simulation.completed_prints} == {Verdict.GOOD}
    started_prints = {name: p for name, p in books.prints.items() if p.started_s is not None}
    assert {
        name: (p.printer, p.started_s, p.ended_s) for name, p in started_prints.items()
    } == simulation.prints
    assert not list(books.list_open_prints())
    assert len([p for p in started_prints.values() if p.state is PrintState.FAILED]) == 1


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    minutes_until_copy=st.integers(0, 12),
    minutes_until_restore=st.integers(0, 14),
    unreachable=st.sets(st.sampled_from("ab")),
    unreachable_minutes=st.integers(0, 8),
    files=st.sampled_from([1, 2, PLATE_COUNT]),
)
def test_restored_backup_neither_loses_nor_repeats_a_plate(
    minutes_until_copy, minutes_until_restore, unreachable, unreachable_minutes, files, tmp_path_factory
):
    """Let a person approve the job at once, and let some agents connect later."""
    folder = tmp_path_factory.mktemp("copied")
    simulation = FarmSimulation(folder, PLATE_COUNT, bad_prints=(), files=files)
    for _ in run_with_restore(
        simulation, folder, minutes_until_copy, minutes_until_restore, unreachable, unreachable_minutes
    ):
        pass
    if files == PLATE_COUNT:
        assert sorted(plate for plate, *_ in simulation.completed_prints) == [
            f"1/0{i + 1}" for i in range(PLATE_COUNT)
        ]
    check_books(simulation)


def restore_farm(folder, plates=1, first_print_id=None):
    """Make a farm with restored books: a job is planned, and its first plate may be assigned to `a`."""
    farm = Farm(folder)
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    event = make_plan_event(1, plates)
    farm.controller.handle(ev.PlanningStarted(at_s=PLANNED_S, job=1))
    farm.controller.handle(event.model_copy(update={"at_s": PLANNED_S}))
    if first_print_id is not None:
        farm.controller.handle(ev.BedReported(at_s=PLANNED_S, printer="a", bed="clear", filament="parked"))
        assigned_event = ev.PlateAssigned(at_s=PLANNED_S, plate="1/01", printer="a", print_id=first_print_id)
        farm.controller.handle(assigned_event)
    farm.controller.start(farm.effects, restored_s=PLANNED_S + 1.0)
    return farm


def make_agent_print(print_id="x", started_s=PLANNED_S + 100.0, sha256="0" * 64, **changes):
    fields = {"state": PrintState.DONE, "fault": None, "reason": None, "progress_s": 90.0}
    fields |= {"print_time_s": 90.0, "extruded": True, "ended_s": started_s + 100.0}
    return AgentPrint(print_id=print_id, started_s=started_s, sha256=sha256, **{**fields, **changes})


def approve_job(farm):
    farm.controller.handle(ev.JobApproved(at_s=farm.controller.clock.now(), job=1, by="ann"))
    return farm


def test_print_after_the_backup_is_imported_and_judged_at_the_bed(tmp_path):
    farm = restore_farm(tmp_path, 3)
    items = {item.code: item.text for item in list_tasks(farm.build_view_context(StateFolder(tmp_path)))}
    assert items["restored"].startswith(
        "the database was restored from a backup: check which parts of job 1 were printed"
    )
    assert "`farm approve 1`" in items["approve"]
    farm.report("a", make_agent_print("x"), make_agent_print("y", PLANNED_S + 300.0))
    farm.report("b", make_agent_print("z", state=PrintState.PRINTING, ended_s=None))
    approve_job(farm)
    books = farm.controller.books
    assert {name: p.state for name, p in books.prints.items()} == {
        "x": PrintState.DONE,
        "y": PrintState.DONE,
        "z": PrintState.PRINTING,
    }
    assert len({p.plate for p in books.prints.values()}) == 3
    farm.clear_bed("a", FilamentState.PARKED)
    assert {farm.controller.books.prints[name].verdict for name in "xy"} == {Verdict.GOOD}
    farm.report("b", make_agent_print("z"))
    assert farm.controller.books.jobs[1].state is JobState.PRINTED


def test_open_print_of_a_backup_waits_for_its_agent(tmp_path):
    farm = restore_farm(tmp_path, first_print_id="p")
    farm.controller.on_snapshot(
        AgentSnapshot(printer="a", link=Link.ABSENT, reason="its agent does not start")
    )
    assert not farm.controller.books.prints["p"].state.ended
    farm.report("a", make_agent_print("p"))
    farm.report("b")
    assert approve_job(farm).controller.books.jobs[1].state is JobState.PRINTED
    # A print that a person has cancelled is not awaited.
    farm = restore_farm(tmp_path / "other", first_print_id="p")
    farm.jobs.cancel(1, "ann")
    farm.controller.on_snapshot(
        AgentSnapshot(printer="a", link=Link.ABSENT, reason="its agent does not start")
    )
    assert farm.controller.books.prints["p"].state.ended


@pytest.mark.parametrize(
    "unknown_print",
    [
        make_agent_print(sha256="1" * 64),
        make_agent_print(sha256=None),  # an older agent started it
        make_agent_print(started_s=PLANNED_S - 100.0),
        make_agent_print(state=PrintState.PRINTING, ended_s=None, sha256="1" * 64),
    ],
    ids=["another file", "no file", "before it was planned", "still printing"],
)
def test_print_without_a_plate_needs_a_person(unknown_print, tmp_path):
    farm = restore_farm(tmp_path)
    farm.report("b")
    farm.report("a", unknown_print)
    approve_job(farm)
    state = StateFolder(tmp_path)
    (task,) = (item for item in list_tasks(farm.build_view_context(state)) if item.code == "look")
    assert task.printers == ["a"]
    assert "after the backup of the database it made a print that matches no waiting plate" in task.text
    farm.controller.on_snapshot(AgentSnapshot(printer="a", link=Link.READY, print=unknown_print))
    assert task in list_tasks(farm.build_view_context(state))
    assert not farm.controller.books.prints
    farm.clear_bed("b", FilamentState.PARKED)
    assert [p.printer for p in farm.controller.books.prints.values()] == ["b"]


def test_restored_job_waits_for_every_printer_in_use(tmp_path):
    farm = approve_job(restore_farm(tmp_path))
    farm.report("a")
    farm.clear_bed("a", FilamentState.PARKED)
    (hold,) = farm.controller.scheduler.find_plate_holds().values()
    assert hold.code is HoldCode.PRINTER_UNREPORTED
    assert "b may have printed it" in hold.text
    farm.printers.begin_maintenance("b", "it burnt down", "ann")
    assert [p.printer for p in farm.controller.books.prints.values()] == ["a"]


def test_interrupted_import_of_a_journal_is_repeated(tmp_path):
    farm, prints = (
        restore_farm(tmp_path / "whole", 2),
        [make_agent_print("x"), make_agent_print("y", PLANNED_S + 300.0)],
    )
    ready_snapshot = AgentSnapshot(printer="a", link=Link.READY, agent_pid=9, filament=FilamentState.PARKED)
    events = list(import_agent_journal(farm.controller.books, ready_snapshot, prints, PLANNED_S + 1e3))
    farm.controller.handle(*events)
    for count in range(len(events)):
        other_farm = restore_farm(tmp_path / str(count), 2)
        other_farm.controller.handle(*events[:count])
        since_s = other_farm.controller.find_unreported_since_s("a")
        assert since_s == PLANNED_S + 1.0
        other_farm.controller.handle(
            *import_agent_journal(other_farm.controller.books, ready_snapshot, prints, PLANNED_S + 1e3)
        )
        assert other_farm.controller.books.prints == farm.controller.books.prints
        assert other_farm.controller.find_unreported_since_s("a") is None


def test_inconsistent_restored_books_are_logged(tmp_path, caplog):
    farm = Farm(tmp_path / "farm")
    changed_printer = farm.controller.books.get_printer("a").model_copy(
        update={"reel": Reel(material="generic_pla", grams=-1.0, nozzle_mm=0.4)}
    )
    farm.controller.books = put(farm.controller.books, changed_printer)
    farm.controller.start(farm.effects, restored_s=1.0)
    assert "printer a: its reel has -1 g" in caplog.text
