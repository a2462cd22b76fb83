"""Printers that print only in attended hours, from the evening to the next morning."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from farm.errors import RefusedError
from farm.model import AgentPrint, AgentSnapshot, Bed, HoldCode, JobOptions, Link, PrintState
from farm.paths import StateFolder
from farm.planning.plan import Plan
from farm.state import events as ev
from farm.views import list_tasks
from hosts.manual_clock import ManualClock

STATE = StateFolder(Path("/state"))


def parse_time_s(text):
    return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()


FRIDAY_S, STOP_S = parse_time_s("2026-11-20 17:00"), parse_time_s("2026-11-20 17:45")


@pytest.fixture
def farm(tmp_path):
    """Make a farm with a job of one part; the board of `a` has no reset, and `b` is absent."""
    farm = Farm(tmp_path, timezone="UTC", attended=["mon-fri 08:00-18:00"])
    farm.controller.clock, farm.controller.started_s = ManualClock(FRIDAY_S), FRIDAY_S - 3600.0
    farm.report_ready("a", reset_verified=False)
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions(), "ann")
    event = make_plan_event(1, 1)
    farm.controller.on_plan(1, Plan(event.parts, event.plates, event.repairs, 1.0, 500.0))
    return farm


def report_print(farm, state=PrintState.PRINTING, **changes):
    """Report the print on `a` as its agent does; return its record before the report."""
    attempt = farm.controller.books.find_open_print("a")
    fields = {"fault": None, "reason": None, "progress_s": 5.0, "print_time_s": 90.0, "extruded": True}
    fields |= {"started_s": FRIDAY_S, "ended_s": None, "ends_by_s": STOP_S, **changes}
    agent_print = AgentPrint(print_id=attempt.id, state=state, **fields)
    farm.controller.on_snapshot(
        AgentSnapshot(printer="a", link=Link.BUSY, reset_verified=False, print=agent_print)
    )
    return attempt


def list_deadline_tasks(farm):
    return [item for item in list_tasks(farm.build_view_context(STATE)) if item.code in ("hours", "resume")]


def test_print_gets_its_latest_start_and_end(farm):
    attempt = farm.controller.books.find_open_print("a")
    limits = farm.controller.situations.find_limits(attempt.id)
    needed_s = farm.controller.books.plates[attempt.plate].expected_s * 1.05
    assert limits.latest_start_s == pytest.approx(STOP_S - needed_s)
    assert limits.latest_end_s == STOP_S


def test_changed_hours_are_sent_to_the_agent(farm):
    attempt = report_print(farm)
    instructions = [i for i in farm.effects.instructions if isinstance(i, ev.SendEndBy)]
    assert instructions == []
    report_print(farm, ends_by_s=STOP_S - 3600.0)
    assert farm.effects.instructions[-1] == ev.SendEndBy(print_id=attempt.id, printer="a", ends_by_s=STOP_S)
    report_print(farm, ends_by_s=None)
    assert farm.effects.instructions[-1].ends_by_s == STOP_S
    instruction_count = len(farm.effects.instructions)
    [remaining_section] = (p for p in farm.controller.fleet.printers if p.name == "b")
    fleet = farm.controller.fleet
    # `a` was removed from the fleet.
    farm.controller.fleet = fleet.model_copy(update={"printers": (remaining_section,)})
    report_print(farm, ends_by_s=STOP_S - 3600.0)
    farm.controller.fleet = fleet
    report_print(farm, PrintState.ENDING)
    assert len(farm.effects.instructions) == instruction_count


def test_late_start_is_refused_and_its_plate_waits(farm):
    attempt = farm.controller.books.find_open_print("a")
    farm.controller.clock.now_s = parse_time_s("2026-11-20 19:00")
    farm.controller.on_refusal(attempt.id, "it came too late", is_late=True)
    late_print = farm.controller.books.prints[attempt.id]
    assert (late_print.state, late_print.fault) == (PrintState.CANCELLED, None)
    assert "too late" in late_print.reason
    assert (
        farm.controller.books.get_printer("a").bed is Bed.CLEAR
        and farm.controller.books.get_printer("a").attention_reason is None
    )
    (hold,) = farm.controller.scheduler.find_plate_holds().values()
    assert "from Mon 08:00" in hold.text
    farm.controller.clock.now_s = parse_time_s("2026-11-23 08:00")
    farm.controller.handle()
    assert farm.controller.books.find_open_print("a").plate == late_print.plate


def test_print_that_exceeds_the_hours_is_listed_as_a_task(farm):
    report_print(farm)
    assert list_deadline_tasks(farm) == []
    report_print(farm, progress_s=10.0, print_time_s=90.0)
    farm.controller.clock.now_s = STOP_S - 20.0
    (item,) = list_deadline_tasks(farm)
    assert item.code == "hours" and item.printers == ["a"]
    assert "stopped at Fri 17:45" in item.text and "attended" in item.text
    report_print(farm, PrintState.ENDING)
    assert list_deadline_tasks(farm) == []


def test_paused_print_is_resumed_only_in_attended_hours(farm):
    report_print(farm)
    farm.printers.set_paused("a", True, "ann")
    report_print(farm, PrintState.PAUSED, pause_ends_s=STOP_S + 3600.0)
    assert [item.text for item in list_deadline_tasks(farm)] == [
        "resume a by Fri 17:45, or its print will be ended: `farm resume a`"
    ]
    farm.controller.clock.now_s = parse_time_s("2026-11-20 19:00")
    with pytest.raises(RefusedError, match=r"only in attended hours .*: from Mon 08:00"):
        farm.printers.set_paused("a", False, "ann")
    farm.controller.clock.now_s = STOP_S - 60.0
    farm.printers.set_paused("a", False, "ann")
    assert not farm.controller.books.find_open_print("a").pause_requested


def test_job_is_resumed_only_if_its_printers_may_continue(farm):
    report_print(farm)
    farm.jobs.set_paused(1, True, "ann")
    report_print(farm, PrintState.PAUSED)
    farm.controller.clock.now_s = parse_time_s("2026-11-20 19:00")
    with pytest.raises(RefusedError, match=r"^a prints only in attended hours .*: from Mon 08:00 \(UTC\)$"):
        farm.jobs.set_paused(1, False, "ann")
    assert farm.controller.books.jobs[1].paused
    report_print(
        farm, PrintState.FAILED, fault="hours_ended", reason="the attended hours have ended", ended_s=STOP_S
    )
    farm.jobs.set_paused(1, False, "ann")  # its waiting plates have their own start times
    assert not farm.controller.books.jobs[1].paused


def test_end_of_hours_is_not_charged_to_the_plate_and_needs_an_inspection(farm):
    attempt = report_print(farm)
    end_fields = {"fault": "hours_ended", "reason": "the attended hours have ended", "ended_s": STOP_S}
    report_print(farm, PrintState.FAILED, **end_fields)
    books = farm.controller.books
    assert not books.prints[attempt.id].charged
    assert books.get_printer("a").attention_reason == "the attended hours have ended"
    assert books.get_printer("a").bed is Bed.NOT_CLEAR
    assert [plate.id for plate in books.list_waiting_plates()] == [attempt.plate]


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_clock_step_shifts_hours_but_not_prints(farm, step_s):
    """Keep the age of a print, because its agent reports the start in the time of the corrected clock."""
    attempt = report_print(farm)
    farm.controller.clock.now_s += 600.0
    age_s = farm.controller.clock.now() - farm.controller.books.prints[attempt.id].started_s
    farm.controller.clock.now_s += step_s
    farm.controller.on_clock_set(step_s)
    moved_print = farm.controller.books.prints[attempt.id]
    assert farm.controller.clock.now() - moved_print.started_s == age_s
    assert moved_print.assigned_s == pytest.approx(attempt.assigned_s + step_s)
    assert farm.controller.clock.now() - farm.controller.started_s == pytest.approx(3600.0 + 600.0)
    # The agent still uses the end time from before the clock step.
    report_print(farm, started_s=moved_print.started_s, ends_by_s=STOP_S + step_s)
    if step_s < 0:
        assert farm.effects.instructions[-1] == ev.SendEndBy(
            print_id=attempt.id, printer="a", ends_by_s=STOP_S
        )


def test_hours_and_start_times_follow_a_clock_step(tmp_path):
    """Shift hours and start times when NTP corrects the clock of a host that started without a network."""
    farm = Farm(tmp_path, timezone="UTC", quiet=["mon-sun 22:00-08:00"])
    farm.controller.clock, farm.controller.started_s = (
        ManualClock(parse_time_s("2026-11-20 03:00")),
        parse_time_s("2026-11-20 02:00"),
    )
    farm.report_ready("a")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions(), "ann")
    event = make_plan_event(1, 1)
    farm.controller.on_plan(1, Plan(event.parts, event.plates, event.repairs, 1.0, 500.0))
    farm.jobs.submit("s" * 8, "m.stl", INSPECTED_MODEL, JobOptions(at="12:00"), "ann")
    assert farm.controller.books.find_open_print("a") is None
    farm.controller.clock.now_s += 7 * 3600.0
    farm.controller.on_clock_set(7 * 3600.0)
    assert farm.controller.books.find_open_print("a").plate == "1/01"
    assert farm.controller.books.jobs[2].not_before_s == parse_time_s("2026-11-20 12:00")
    later_event = make_plan_event(2, 1)
    farm.controller.on_plan(2, Plan(later_event.parts, later_event.plates, later_event.repairs, 1.0, 500.0))
    farm.report_ready("b")
    assert farm.controller.scheduler.find_plate_holds()["2/01"].code is HoldCode.START_TIME
    farm.controller.clock.now_s += 2 * 3600.0
    farm.controller.on_clock_set(2 * 3600.0)
    assert farm.controller.books.find_open_print("b").plate == "2/01"
