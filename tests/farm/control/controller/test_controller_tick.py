"""Tick of the controller: it schedules if time has changed a decision, and repeats instructions."""

from datetime import UTC, datetime

import pytest

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from farm.control import scheduler
from farm.model import AgentSnapshot, HoldCode, JobOptions, JobState, Link, Reel
from farm.planning import Plan
from farm.state import events as ev
from farm.state.storage import StoreError
from hosts.manual_clock import ManualClock

NIGHT_S = datetime(2026, 11, 20, 23, tzinfo=UTC).timestamp()
MORNING_S = datetime(2026, 11, 21, 6, tzinfo=UTC).timestamp()


@pytest.fixture
def calls(monkeypatch):
    """Record the times at which the scheduler runs."""
    results = []

    def record_call(situation):
        results.append(situation.now_s)
        return assign_plates(situation)

    assign_plates = scheduler.assign_plates
    monkeypatch.setattr(scheduler, "assign_plates", record_call)
    return results


@pytest.fixture
def farm(tmp_path, calls):
    """Make a job of one part that waits for the end of quiet hours, on a farm that started an hour ago."""
    farm = Farm(tmp_path, clock=ManualClock(NIGHT_S), timezone="UTC", quiet=["22:00-06:00"])
    farm.controller.started_s = NIGHT_S - 3600.0
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions(), "ann")
    event = make_plan_event(1, 1)
    farm.controller.on_plan(1, Plan(event.parts, event.plates, event.repairs, 1.0, 500.0))
    calls.clear()
    return farm


def tick(farm, at_s):
    farm.controller.clock.now_s = at_s
    farm.controller.tick()


def test_tick_without_a_change_does_not_schedule(farm, calls):
    for seconds in range(1, 3600):
        tick(farm, NIGHT_S + seconds)
    assert calls == []
    assert [hold.code for hold in farm.controller.scheduler.find_plate_holds().values()] == [
        HoldCode.QUIET_HOURS
    ]


def test_tick_at_the_end_of_quiet_hours_starts_the_plate(farm, calls):
    assert farm.controller.next_change_s == MORNING_S
    tick(farm, MORNING_S - 1.0)
    assert calls == []
    tick(farm, MORNING_S)
    assert calls == [MORNING_S]
    assert farm.controller.books.find_open_print("a") is not None


def test_tick_repeats_an_unconfirmed_start(farm):
    tick(farm, MORNING_S)
    farm.effects.instructions.clear()
    tick(farm, MORNING_S + 1.0)
    assert [type(item) for item in farm.effects.instructions] == [ev.SendStart]


def test_unconfirmed_start_is_repeated_by_the_next_tick_not_by_a_command(farm):
    tick(farm, MORNING_S)
    farm.effects.instructions.clear()
    farm.clear_bed("b")
    assert [type(item) for item in farm.effects.instructions] == [ev.SendCleared]
    tick(farm, MORNING_S + 1.0)
    assert [type(item) for item in farm.effects.instructions] == [ev.SendCleared, ev.SendStart]


def test_telemetry_alone_does_not_schedule(farm, calls):
    farm.report_ready("a", nozzle_c=24.0)
    assert calls == []
    farm.controller.on_snapshot(AgentSnapshot(printer="a", link=Link.ABSENT))
    assert len(calls) == 1


def test_failed_commit_is_repeated_at_the_next_tick(farm, calls, monkeypatch):
    def fail_on_full_disk(*_):
        raise StoreError("the database cannot be written: disk full")

    with monkeypatch.context() as patch:
        patch.setattr(farm.store, "commit", fail_on_full_disk)
        with pytest.raises(StoreError):
            tick(farm, MORNING_S)
    tick(farm, MORNING_S + 1.0)
    assert calls == [MORNING_S, MORNING_S + 1.0]
    assert farm.controller.books.get_job(1).state is JobState.PRINTING
    assert farm.controller.books.find_open_print("a") is not None


def test_plate_of_a_single_lost_printer_is_reassigned(farm, calls):
    tick(farm, MORNING_S)
    lost_print = farm.controller.books.find_open_print("a")
    end_fields = {
        "state": "failed",
        "fault": "port_lost",
        "reason": "gone",
        "filament": "parked",
        "extruded": False,
    }
    farm.controller.handle(
        ev.PrintEnded(
            at_s=MORNING_S, print_id=lost_print.id, started_s=MORNING_S, ended_s=MORNING_S, **end_fields
        )
    )
    assert [hold.code for hold in farm.controller.scheduler.find_plate_holds().values()] == [
        HoldCode.JUST_LOST
    ]
    tick(farm, MORNING_S + 10.0)
    assert farm.controller.books.find_open_print("b") is None
    tick(farm, MORNING_S + 11.0)
    assert farm.controller.books.find_open_print("b") is not None


def test_tick_starts_a_plate_made_possible_by_the_last_start(tmp_path):
    """Start the first plate, planned for the tall printer c, on a, so that c can be the spare."""
    models = ("ultimaker2_plus", "ultimaker2_plus", "ultimaker2_extended_plus")
    farm = Farm(tmp_path, models, ManualClock(NIGHT_S), timezone="UTC", attended=["08:00-10:00"])
    farm.controller.started_s = NIGHT_S - 3600.0
    farm.report_ready("a", "b", "c")
    reel = Reel(material="generic_pla", nozzle_mm=0.4, grams=10.0)
    farm.controller.handle(ev.ReelLoaded(at_s=NIGHT_S, printer="c", reel=reel, by="ann"))
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions(spares=1), "ann")
    event = make_plan_event(1, 2)
    plates = [
        plate.model_copy(update={"printer": printer, "grams": 50.0})
        for plate, printer in zip(event.plates, "ca", strict=True)
    ]
    plan = Plan(event.parts, tuple(plates), event.repairs, 1.0, 500.0)
    farm.controller.on_plan(1, plan)
    tick(farm, NIGHT_S)
    books = farm.controller.books
    assert [books.find_open_print(name) is not None for name in "abc"] == [True, True, False]
