"""Controller with recorded effects."""

from datetime import datetime
from pathlib import Path

import pytest

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, PLUS_MODEL, Farm
from farm.control import scheduler
from farm.errors import ErrorCode, FarmError, NotFoundError, RefusedError
from farm.model import (
    AgentPrint,
    AgentSnapshot,
    Bed,
    HoldCode,
    JobOptions,
    JobState,
    Link,
    OwnGcode,
    PrintState,
)
from farm.paths import StateFolder
from farm.planning.plan import InspectedSubmission, Plan, TooFewPrinters
from farm.scheduling.assignment import assign_plates
from farm.state import events as ev
from farm.state.books import list_changed_entities
from farm.state.storage.store import StoreError
from farm.views import describe_job, describe_printer, list_tasks
from hosts.manual_clock import ManualClock

STATE = StateFolder(Path("/state"))
START_S = 1_700_000_000.0


@pytest.fixture
def plan():
    event = make_plan_event(1, 2)
    return Plan(event.parts, event.plates, event.repairs, 1000.0, 500.0)


@pytest.fixture
def farm(tmp_path):
    return Farm(tmp_path)


def test_job_waits_for_printers_then_uses_all_idle_and_clear_ones(farm):
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    assert farm.controller.books.jobs[1].hold.code is HoldCode.PRINTER_CONNECTING
    farm.report_ready("a")
    assert farm.effects.plans == []
    farm.report_ready("b")
    assert farm.effects.plans == [(1, ["a", "b"], 1)]
    assert farm.controller.books.jobs[1].state is JobState.PLANNING


def test_plate_is_reassigned_after_its_agent_confirmed_its_cancellation(tmp_path):
    farm = Farm(tmp_path, [PLUS_MODEL] * 3)
    farm.report_ready("a", "b", "c")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    event = make_plan_event(1, 1)
    farm.controller.on_plan(1, Plan(event.parts, event.plates, (), 1.0, 500.0))
    first_print = farm.controller.books.find_open_print("a")
    stale_snapshot = AgentSnapshot(printer="a", link=Link.ABSENT, agent_pid=9, reason="unplugged")
    farm.controller.on_snapshot(stale_snapshot)
    assert farm.effects.instructions[-1] == ev.SendCancel(
        print_id=first_print.id, printer="a", reason="unplugged"
    )
    assert [p.printer for p in farm.controller.books.list_open_prints()] == ["a"]
    farm.controller.on_snapshot(stale_snapshot.model_copy(update={"acknowledged_cancel": first_print.id}))
    assert [p.printer for p in farm.controller.books.list_open_prints()] == ["b"]


def test_unmatched_job_does_not_block_the_next_one(farm):
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions(material="generic_abs"))
    farm.jobs.submit("s" * 8, "n.stl", INSPECTED_MODEL, JobOptions())
    farm.jobs.submit("t" * 8, "o.stl", INSPECTED_MODEL, JobOptions())
    farm.jobs.submit("u" * 8, "p.stl", INSPECTED_MODEL, JobOptions())
    assert farm.effects.plans == [(2, ["a", "b"], 1), (3, ["a", "b"], 1)]
    holds = {job.id: job.hold and job.hold.code for job in farm.controller.books.jobs.values()}
    assert holds == {1: HoldCode.NO_SUCH_PRINTER, 2: None, 3: None, 4: HoldCode.NOT_FIRST}
    farm.jobs.cancel(2, "ann")
    assert [number for number, *_ in farm.effects.plans] == [2, 3, 4]


def test_own_gcode_is_planned_for_one_matching_printer(farm):
    def submit(request_id, nozzle_mm, half_width_mm):
        box = {"min_mm": (-half_width_mm, -half_width_mm, 0.2), "max_mm": (half_width_mm, half_width_mm, 9.0)}
        own_gcode = OwnGcode(nozzle_mm=nozzle_mm, **box)
        return farm.jobs.submit(
            request_id, "x.gcode", InspectedSubmission("x.gcode", (), 1.0, own_gcode), JobOptions()
        )[0]

    farm.report_ready("a")
    farm.report_ready("b", bed_clear=False)
    numbers = [submit("r" * 8, 0.8, 10), submit("s" * 8, 0.4, 111), submit("t" * 8, None, 10)]
    holds = [farm.controller.books.jobs[number].hold for number in numbers]
    assert [hold and hold.code for hold in holds] == [HoldCode.NO_SUCH_PRINTER] * 2 + [None]
    assert farm.effects.plans == [(3, ["a"], 1)]


def test_repeated_request_returns_the_same_job(farm):
    assert farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions()) == (1, False)
    assert farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions()) == (1, True)
    assert farm.jobs.submit("s" * 8, "m.stl", INSPECTED_MODEL, JobOptions()) == (2, False)


def test_model_with_more_parts_than_printers_is_planned_in_rounds(farm):
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    farm.controller.on_plan(1, TooFewPrinters("needs 5", 5))
    assert farm.effects.plans[-1] == (1, ["a", "b"], 3)


def test_failed_plan_fails_its_job_and_the_next_one_starts(farm):
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    for request in "st":
        farm.jobs.submit(request * 8, "n.stl", INSPECTED_MODEL, JobOptions())
    assert farm.controller.books.jobs[3].hold.code is HoldCode.NOT_FIRST
    farm.controller.on_plan(1, FarmError("parts overlap", ErrorCode.GEOMETRY))
    job = farm.controller.books.jobs[1]
    assert (job.state, job.error) == (JobState.FAILED, ErrorCode.GEOMETRY)
    assert farm.effects.plans[-1][0] == 3
    assert describe_job(farm.build_view_context(STATE), job).exit_code == 5


def test_plan_of_a_cancelled_job_is_discarded(farm, plan):
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    farm.jobs.cancel(1, "ann")
    assert ev.StopPlanning(job=1) in farm.effects.instructions
    farm.controller.on_plan(1, plan)
    assert not farm.controller.books.plates
    with pytest.raises(RefusedError, match="already ended"):
        farm.jobs.cancel(1, "ann")


def test_instruction_is_sent_once_and_repeated_by_a_new_daemon(farm, plan, tmp_path):
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    farm.controller.on_plan(1, plan)
    starts = [i for i in farm.effects.instructions if isinstance(i, ev.SendStart)]
    assert [s.printer for s in starts] == ["a", "b"]
    farm.store.close()
    restarted_farm = Farm(tmp_path)
    assert restarted_farm.controller.books == farm.controller.books
    restarted_farm.report_ready("a")
    assert [i for i in restarted_farm.effects.instructions if isinstance(i, ev.SendStart)] == [starts[0]]


def test_unattended_start_is_not_repeated_at_night(farm, plan, tmp_path):
    """Drop the start for a disconnected agent, because it would heat while no person is present."""
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    farm.controller.on_plan(1, plan)
    assert any(isinstance(i, ev.SendStart) for i in farm.effects.instructions)
    quiet_farm = Farm(tmp_path, quiet="00:00-24:00")
    quiet_farm.report_ready("a", "b")
    assert not [i for i in quiet_farm.effects.instructions if isinstance(i, ev.SendStart)]
    attended_farm = Farm(tmp_path)
    attended_farm.report_ready("a", "b")
    assert [i for i in attended_farm.effects.instructions if isinstance(i, ev.SendStart)]


def test_planning_is_repeated_after_the_daemon_died(farm, tmp_path):
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    farm.store.close()
    restarted_farm = Farm(tmp_path)
    restarted_farm.report_ready("a", "b")
    assert restarted_farm.effects.plans == [(1, ["a", "b"], 1)]


def test_job_is_planned_while_every_bed_is_full(farm, plan):
    farm.report_ready("a", "b", bed_clear=False)
    assert {p.bed for p in farm.controller.books.printers.values()} == {Bed.NOT_CLEAR}
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    assert farm.effects.plans == [(1, ["a", "b"], 1)]
    farm.controller.on_plan(1, plan)
    view = describe_job(farm.build_view_context(STATE), farm.controller.books.jobs[1])
    assert view.waits_for_person
    assert {plate.hold.code for plate in view.plates} == {HoldCode.BED_NOT_CLEAR}
    assert view.grams and view.expected_s and view.eta  # these are known before a bed is clear
    assert list_tasks(farm.build_view_context(STATE))[0].printers == ["a", "b"]
    farm.clear_bed("a")
    assert [attempt.plate for attempt in farm.controller.books.list_open_prints()] == ["1/01"]


def test_second_job_is_planned_and_forecast_while_the_first_prints(farm, plan):
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    farm.jobs.submit("s" * 8, "n.stl", INSPECTED_MODEL, JobOptions())
    assert farm.effects.plans == [(1, ["a", "b"], 1), (2, ["a", "b"], 1)]
    farm.controller.on_plan(1, plan)
    event = make_plan_event(2, 2)
    farm.controller.on_plan(2, Plan(event.parts, event.plates, (), 1.0, 500.0))
    first_view, second_view = (
        describe_job(farm.build_view_context(STATE), farm.controller.books.jobs[n]) for n in (1, 2)
    )
    assert (first_view.eta or "") < (second_view.eta or "")
    assert second_view.grams and len(second_view.parts) == 2
    assert farm.controller.books.jobs[2].planned_for == ("a", "b")


def test_printer_with_a_fault_is_not_used_and_shows_its_reason(farm):
    farm.report_ready("a", link=Link.FAULT, reason="it does not get warm")
    view = describe_printer(farm.build_view_context(STATE), farm.controller.fleet.find_printer("a"), None)
    assert (view.state, view.look) == ("fault", "it does not get warm")
    farm.report_ready("b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    assert farm.effects.plans == [(1, ["b"], 1)]


def test_paused_print_is_a_task_with_its_time_limit(farm, plan):
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    with pytest.raises(RefusedError, match="a is not printing"):
        farm.printers.set_paused("a", True, "ann")
    farm.controller.on_plan(1, plan)
    attempt = farm.controller.books.find_open_print("a")
    with pytest.raises(RefusedError, match="a is not paused"):
        farm.printers.set_paused("a", False, "ann")
    pause_instruction = ev.SendPause(print_id=attempt.id, printer="a", pause=True)

    def find_last_pause():
        pauses = [
            instruction for instruction in farm.effects.instructions if isinstance(instruction, ev.SendPause)
        ]
        return pauses[-1]

    farm.printers.set_paused("a", True, "ann")
    assert find_last_pause() == pause_instruction

    def report_state(state, **changes):
        fields = {"fault": None, "reason": None, "progress_s": 5.0, "print_time_s": 90.0, "extruded": True}
        fields |= {"started_s": 2.0, "ended_s": None, **changes}
        agent_print = AgentPrint(print_id=attempt.id, state=state, **fields)
        farm.controller.on_snapshot(AgentSnapshot(printer="a", link=Link.BUSY, print=agent_print))
        context = farm.build_view_context(STATE)
        view = describe_printer(context, farm.controller.fleet.find_printer("a"), None)
        return view, [item for item in list_tasks(context) if item.code == "resume"]

    report_state(PrintState.PRINTING)  # the pause arrived while the printer was heating
    assert find_last_pause() == pause_instruction
    assert report_state(PrintState.PAUSED)[1] == []  # the printer is still parking its nozzle
    view, (item,) = report_state(PrintState.PAUSED, pause_ends_s=7200.0)
    assert (view.state, view.print.pause_ends) == ("paused", "1970-01-01T02:00:00+00:00")
    assert item.text == "resume a by 01 Jan 1970 02:00, or its print will be ended: `farm resume a`"
    assert [time.text for time in item.times] == ["01 Jan 1970 02:00"]
    farm.printers.set_paused("a", False, "ann")
    assert find_last_pause() == pause_instruction.model_copy(update={"pause": False})
    view, tasks = report_state(PrintState.PRINTING)
    assert (view.state, view.print.pause_ends, tasks) == ("printing", None, [])
    farm.jobs.cancel(1, "ann")
    with pytest.raises(RefusedError, match="ending"):
        farm.printers.set_paused("a", True, "ann")


def test_temperatures_and_progress_do_not_run_the_scheduler(farm, plan, monkeypatch):
    """Show telemetry at once, at a cost independent of the number of waiting plates."""
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    farm.controller.on_plan(1, plan)
    attempt = farm.controller.books.find_open_print("a")
    runs = []

    def count_call(situation):
        runs.append(1)
        return assign_plates(situation)

    monkeypatch.setattr(scheduler, "assign_plates", count_call)

    def report_progress(step, link=Link.BUSY, state=PrintState.PRINTING):
        agent_print = AgentPrint(
            print_id=attempt.id, state=state, fault=None, reason=None, progress_s=1.0 * step,
            print_time_s=90.0, extruded=True, started_s=2.0, ended_s=None, layer=step, layers=90,
        )  # fmt: skip
        heat = {"nozzle_c": 20.0 + step, "bed_c": 20.0 + step, "nozzle_target_c": 210.0}
        farm.controller.on_snapshot(AgentSnapshot(printer="a", link=link, print=agent_print, **heat))

    report_progress(0)
    assert len(runs) == 1  # the start of printing is in the books
    for step in range(1, 50):
        report_progress(step)
        idle_snapshot = AgentSnapshot(printer="b", link=Link.READY, nozzle_c=20.0 + step, agent_pid=9)
        farm.controller.on_snapshot(idle_snapshot)
    assert len(runs) == 1
    assert farm.controller.telemetry.snapshots["a"].nozzle_c == 69.0
    assert farm.controller.telemetry.snapshots["b"].nozzle_c == 69.0
    report_progress(50, state=PrintState.PAUSED)
    report_progress(51, link=Link.ABSENT, state=PrintState.PAUSED)
    assert len(runs) == 3


def test_hold_shows_the_end_computed_from_progress_without_a_commit(farm):
    clock = farm.controller.clock = ManualClock(START_S)
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    event = make_plan_event(1, 3)
    farm.controller.on_plan(1, Plan(event.parts, event.plates, (), 1.0, 500.0))

    def find_hold():
        job = describe_job(farm.build_view_context(STATE), farm.controller.books.jobs[1])
        (hold,) = (plate.hold for plate in job.plates if plate.hold is not None)
        return hold

    farm.controller.handle()
    first_hold = find_hold()
    assert "a and b are printing until" in first_hold.text
    for name, progress_s in (("a", 1.0), ("b", 80.0)):
        attempt = farm.controller.books.find_open_print(name)
        agent_print = AgentPrint(
            print_id=attempt.id, state=PrintState.PRINTING, fault=None, reason=None, progress_s=progress_s,
            print_time_s=90.0, extruded=True, started_s=clock.now_s - 3600.0, ended_s=None,
        )  # fmt: skip
        farm.controller.on_snapshot(AgentSnapshot(printer=name, link=Link.BUSY, print=agent_print))
    clock.now_s += 3600.0
    second_hold, context = find_hold(), farm.build_view_context(STATE)
    assert second_hold.text != first_hold.text
    views = [describe_printer(context, section, None) for section in context.fleet.printers]
    end_s = clock.now_s + min(view.print.remaining_s for view in views)
    assert datetime.fromisoformat(second_hold.times[0].at).timestamp() == end_s == clock.now_s + 10.0
    kinds = [kind for _, kind, _ in farm.store.read_all_events()]
    assert kinds[-5:] == ["JobPlanned", *["PlateAssigned"] * 2, *["PrintProgressed"] * 2]


def test_start_writes_few_bytes_while_many_plates_wait(farm, monkeypatch):
    sizes = {}

    def record_size(event, old_books, new_books, commit=farm.store.commit):
        commit(event, old_books, new_books)
        texts = [entity.model_dump_json() for entity in (event, *list_changed_entities(old_books, new_books))]
        sizes.setdefault(type(event).__name__, []).append(sum(map(len, texts)))

    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    event = make_plan_event(1, 100)
    monkeypatch.setattr(farm.store, "commit", record_size)
    farm.controller.on_plan(1, Plan(event.parts, event.plates, (), 1.0, 500.0))
    assert sizes.pop("JobPlanned")
    assert sizes.keys() == {"PlateAssigned"} and max(sizes["PlateAssigned"]) < 4096


def test_report_that_was_not_stored_is_handled_when_repeated(farm):
    farm.report_ready("a", "b")
    snapshot = AgentSnapshot(printer="a", link=Link.READY, agent_pid=9, alarm="it gets hotter", nozzle_c=90.0)
    farm.store._db.execute("PRAGMA query_only = 1")
    for _ in range(2):
        with pytest.raises(StoreError):
            farm.controller.on_snapshot(snapshot)
    farm.report_ready("b")  # this snapshot does not change the books
    context = farm.build_view_context(STATE)
    assert "nothing is recorded until there is space" in context.warnings[0]
    assert context.snapshots["a"].nozzle_c == 90.0
    farm.store._db.execute("PRAGMA query_only = 0")
    farm.controller.on_snapshot(snapshot)
    assert farm.controller.books.printers["a"].alarm == "it gets hotter"
    assert farm.build_view_context(STATE).warnings == ()


def test_effects_before_an_error_are_performed(farm, plan):
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    farm.controller.on_plan(1, plan)
    attempt = farm.controller.books.find_open_print("a")
    pause = ev.PauseRequested(at_s=1.0, print_id=attempt.id, wanted=True)
    with pytest.raises(NotFoundError):
        farm.controller.handle(pause, ev.JobCancelled(at_s=1.0, job=9))
    assert farm.controller.books.find_open_print("a").pause_requested
    assert farm.effects.instructions[-1] == ev.SendPause(print_id=attempt.id, printer="a", pause=True)


def test_stuck_heater_is_recorded_for_idle_and_printing_printers(farm):
    farm.report_ready("a", "b")
    for link in (Link.BUSY, Link.FAULT):
        alarm = f"the nozzle is off, and gets hotter ({link})"
        farm.controller.on_snapshot(AgentSnapshot(printer="a", link=link, agent_pid=7, alarm=alarm))
        assert (
            farm.controller.books.printers["a"].attention_reason,
            farm.controller.books.printers["a"].alarm,
        ) == (
            alarm,
            alarm,
        )
