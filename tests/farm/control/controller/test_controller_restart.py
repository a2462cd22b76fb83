"""Restarts after a kill at any commit, and failed writes: no plate is lost or printed twice."""

import itertools

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, PLUS_MODEL, Farm
from farm.control.telemetry import MAX_REFUSALS
from farm.errors import FarmError
from farm.model import JobOptions, JobState, PrintState, Verdict
from farm.paths import StateFolder
from farm.planning.plan import Plan
from farm.state.storage.store import Store, StoreError
from farm.views import list_tasks
from farms.simulated_fleet import FarmSimulation

PLATE_COUNT = 3


def check_books(simulation):
    """Compare the books, in memory and as stored, with the prints that the simulated printers made."""
    good_plates = [plate for plate, _, verdict in simulation.completed_prints if verdict is Verdict.GOOD]
    # No plate is lost, none is printed twice.
    assert sorted(good_plates) == [f"1/0{i}" for i in range(1, PLATE_COUNT + 1)]
    books = simulation.controller.books
    simulation.store.close()
    with Store(simulation.path) as store:
        assert store.load() == books
    started_prints = {name: p for name, p in books.prints.items() if p.started_s is not None}
    assert {
        name: (p.printer, p.started_s, p.ended_s) for name, p in started_prints.items()
    } == simulation.prints
    for printer in "ab":  # one print at a time
        spans_s = sorted((p.started_s, p.ended_s) for p in started_prints.values() if p.printer == printer)
        assert all(end_s <= next_start_s for (_, end_s), (next_start_s, _) in itertools.pairwise(spans_s))
    for plate in books.plates.values():
        spans_s = sorted((p.started_s, p.ended_s) for p in started_prints.values() if p.plate == plate.id)
        assert all(end_s <= next_start_s for (_, end_s), (next_start_s, _) in itertools.pairwise(spans_s))
    failed_prints = [p for p in books.prints.values() if p.state is PrintState.FAILED]
    assert len(failed_prints) == 1
    assert not list(books.list_open_prints())


@pytest.fixture(scope="module")
def commit_count(tmp_path_factory):
    simulation = FarmSimulation(tmp_path_factory.mktemp("undisturbed"), PLATE_COUNT)
    simulation.run()
    count = simulation.commit_count
    check_books(simulation)
    return count


@pytest.mark.parametrize("is_killed_after", [False, True], ids=["before", "after"])
def test_no_state_is_lost_if_killed_at_any_commit(is_killed_after, commit_count, tmp_path):
    assert commit_count > 20
    for number in range(1, commit_count + 1):
        folder = tmp_path / str(number)
        folder.mkdir()
        simulation = FarmSimulation(folder, PLATE_COUNT, kills=[number], is_killed_after=is_killed_after)
        simulation.run()
        assert simulation.restart_count == 1
        check_books(simulation)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kills=st.sets(st.integers(4, 60), min_size=2, max_size=8), is_killed_after=st.booleans())
def test_no_state_is_lost_over_repeated_kills(kills, is_killed_after, tmp_path_factory):
    simulation = FarmSimulation(
        tmp_path_factory.mktemp("again"), PLATE_COUNT, kills=kills, is_killed_after=is_killed_after
    )
    simulation.run()
    check_books(simulation)


@pytest.mark.parametrize(
    ("failing_sql", "repairing_sql", "message"),
    [
        ("PRAGMA max_page_count = 1", "PRAGMA max_page_count = 100000", "full"),
        ("PRAGMA query_only = 1", "PRAGMA query_only = 0", "readonly"),
    ],
    ids=["disk full", "read-only"],
)
@pytest.mark.parametrize("first_failure", range(0, 16, 5))
def test_controller_continues_after_failed_commits(
    first_failure, failing_sql, repairing_sql, message, tmp_path
):
    simulation = FarmSimulation(tmp_path, PLATE_COUNT)
    report_to_daemon, minutes = simulation.report_to_daemon, itertools.count()

    def report_with_broken_store():
        minute = next(minutes)
        if minute == first_failure:
            simulation.store._db.execute(failing_sql)
        elif minute == first_failure + 4:
            simulation.store._db.execute(repairing_sql)
        report_to_daemon()

    simulation.report_to_daemon = report_with_broken_store
    simulation.run()
    check_books(simulation)


def test_full_disk_is_reported_and_starts_nothing(tmp_path):
    simulation = FarmSimulation(tmp_path, PLATE_COUNT)
    simulation.report_to_daemon()
    simulation.store._db.execute("PRAGMA max_page_count = 1")
    with pytest.raises(FarmError, match="full; nothing was started"):
        for number in range(200):
            simulation.jobs.submit(f"request-{number}", "m.stl", INSPECTED_MODEL, JobOptions())
    assert all(agent.print_id is None for agent in simulation.agents.values())


def test_full_disk_of_an_agent_is_not_counted_as_an_attempt(tmp_path):
    """Use a disk that is too full for a plate's file, but not for the books."""
    farm = Farm(tmp_path, (PLUS_MODEL,) * 4)
    farm.report_ready(*"abcd")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    event = make_plan_event(1, 1)
    farm.controller.on_plan(1, Plan(event.parts, event.plates, (), 1.0, 500.0))
    for _ in "abcd":
        (attempt,) = farm.controller.books.list_open_prints()
        for _ in range(MAX_REFUSALS):
            farm.controller.on_refusal(attempt.id, "x.gcode: cannot be written; make room on its disk")
        farm.controller.handle()
    books = farm.controller.books
    assert not list(books.list_open_prints())
    assert books.jobs[1].state is JobState.PRINTING
    assert [plate.id for plate in books.list_waiting_plates()] == ["1/01"]
    assert all("make room on its disk" in printer.attention_reason for printer in books.printers.values())


def test_unrecordable_snapshot_is_shown_and_logged(tmp_path):
    farm, state = Farm(tmp_path), StateFolder(tmp_path)
    farm.report_ready("a", "b")
    farm.store._db.execute("PRAGMA query_only = 1")
    for _ in range(2):
        with pytest.raises(StoreError):
            farm.report_ready(
                "a", nozzle_c=205.0, bed_unknown_reason="its board was reset, but not by the farm"
            )
    farm.report_ready("b")  # an unchanged snapshot does not change the books
    (first_task, *_) = list_tasks(farm.build_view_context(state))
    assert first_task.code == "farm"
    assert "nothing is recorded until there is space" in first_task.text
    assert farm.controller.telemetry.snapshots["a"].nozzle_c == 205.0
    assert farm.controller.books.printers["a"].attention_reason is None
    farm.store._db.execute("PRAGMA query_only = 0")
    farm.report_ready("a", bed_unknown_reason="its board was reset, but not by the farm")
    assert [item.code for item in list_tasks(farm.build_view_context(state))] == ["look"]
