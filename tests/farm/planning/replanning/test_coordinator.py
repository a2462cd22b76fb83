"""Coordination of replanning, even if the daemon dies in between."""

import pytest

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, PLUS_MODEL, Farm
from farm.errors import FarmError
from farm.model import AgentPrint, AgentSnapshot, FilamentState, HoldCode, JobOptions, Link, PrintState
from farm.planning.plan import Plan
from farm.planning.replanning.replan import ReplannedPlate, make_next_plate_id
from farm.state import events as ev
from farm.state.storage.store import StoreError
from hosts.manual_clock import ManualClock

UM2 = "ultimaker2"
HOUR_S = 3600.0


def make_farm(tmp_path, models, plates=1, **options):
    """Make a farm that prints a job whose plates take ten hours each."""
    # It is 20:00, after the attended hours.
    farm = Farm(tmp_path, models, ManualClock(20 * HOUR_S), attended=["08:00-18:00"])
    farm.names = "abcdefgh"[: len(models)]
    farm.report_ready(*farm.names)
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions(**options))
    event = make_plan_event(1, plates)
    time_fields = {"expected_s": 10 * HOUR_S, "sliced_s": 10 * HOUR_S - 300.0, "family": PLUS_MODEL}
    long_plates = tuple(plate.model_copy(update=time_fields) for plate in event.plates)
    farm.controller.on_plan(1, Plan(event.parts, long_plates, (), 1.0, 1.0))
    if options.get("hold"):
        farm.controller.handle(ev.JobApproved(at_s=1.0, job=1, by="ann"))
    return farm


def fail_plate(farm, printer, plate):
    attempt = farm.controller.books.find_open_print(printer)
    assert attempt.plate == plate
    now_s = farm.controller.clock.now()
    agent_print = AgentPrint(
        print_id=attempt.id, state=PrintState.FAILED, fault="mintemp", reason="no heat", progress_s=5.0,
        print_time_s=90.0, extruded=True, started_s=now_s - 60.0, ended_s=now_s,
    )  # fmt: skip
    idle_fields = {"link": Link.READY, "agent_pid": 9, "filament": FilamentState.PARKED}
    farm.controller.on_snapshot(AgentSnapshot(printer=printer, print=agent_print, **idle_fields))


def make_recut(farm, plate, duration_h, printers):
    """Make the result of a cut: one piece of this duration for each printer."""
    old_plate = farm.controller.books.plates[plate]
    (part,) = (farm.controller.books.parts[name] for name in old_plate.parts)
    parts, plates = [], []
    for letter, printer in zip("abcdefgh", printers, strict=False):
        changes = {"id": f"{part.id}{letter}", "plate": f"{plate}{letter}", "cut_from": part.id}
        parts.append(part.model_copy(update=changes))
        time_fields = {"expected_s": duration_h * HOUR_S, "sliced_s": duration_h * HOUR_S - 300.0}
        changes = {"id": f"{plate}{letter}", "parts": (f"{part.id}{letter}",), "printer": printer}
        plates.append(old_plate.model_copy(update={"prints": (), **changes, **time_fields}))
    return ReplannedPlate(tuple(parts), tuple(plates), "n.png")


def list_started_plates(farm):
    return {attempt.printer: attempt.plate for attempt in farm.controller.books.list_open_prints()}


def test_failed_part_is_cut_for_the_free_printers_and_held(tmp_path):
    farm = make_farm(tmp_path, [PLUS_MODEL] * 4, plates=1)
    fail_plate(farm, "a", "1/01")
    ((plate, printers, is_cut),) = farm.effects.replans
    assert (plate, printers, is_cut) == ("1/01", ["b", "c", "d"], True)
    hold = farm.controller.scheduler.find_plate_holds().get("1/01")
    assert hold.code is HoldCode.BEING_RECUT
    assert "b, c and d" in hold.text
    assert list_started_plates(farm) == {}
    farm.controller.handle()
    assert len(farm.effects.replans) == 1
    farm.controller.on_replan("1/01", make_recut(farm, "1/01", 4.0, printers))
    assert list_started_plates(farm) == {"b": "1/01a", "c": "1/01b", "d": "1/01c"}


def test_pieces_that_cannot_be_stored_are_planned_again(tmp_path):
    farm = make_farm(tmp_path, [PLUS_MODEL] * 4, plates=1)
    fail_plate(farm, "a", "1/01")
    farm.store._db.execute("PRAGMA query_only = 1")
    with pytest.raises(StoreError):
        farm.controller.on_replan("1/01", make_recut(farm, "1/01", 4.0, "bcd"))
    farm.store._db.execute("PRAGMA query_only = 0")
    farm.controller.handle()
    assert farm.effects.replans == [("1/01", ["b", "c", "d"], True)] * 2
    farm.controller.on_replan("1/01", make_recut(farm, "1/01", 4.0, "bcd"))
    assert list_started_plates(farm) == {"b": "1/01a", "c": "1/01b", "d": "1/01c"}


def test_part_that_would_end_no_sooner_in_pieces_stays_whole(tmp_path):
    for name, result in {
        "slow": lambda farm: make_recut(farm, "1/01", 9.0, "bcd"),
        "failed": lambda farm: FarmError("too thin"),
    }.items():
        farm = make_farm(tmp_path / name, [PLUS_MODEL] * 4, plates=1)
        fail_plate(farm, "a", "1/01")
        farm.controller.on_replan("1/01", result(farm))
        assert list_started_plates(farm) == {"b": "1/01"}
        fail_plate(farm, "b", "1/01")  # the next failure is examined again: two printers are free now
        assert [is_cut for _, _, is_cut in farm.effects.replans] == [True, True]


def test_later_job_gets_no_reserved_printers(tmp_path):
    farm = make_farm(tmp_path, [PLUS_MODEL] * 5, plates=1)
    fail_plate(farm, "a", "1/01")
    ((_, reserved_printers, _),) = farm.effects.replans
    farm.jobs.submit("s" * 8, "n.stl", INSPECTED_MODEL, JobOptions(material="generic_pla"))
    event = make_plan_event(2, 2)
    farm.controller.on_plan(2, Plan(event.parts, event.plates, (), 1.0, 500.0))
    assert not list_started_plates(farm).keys() & set(reserved_printers)
    farm.controller.on_replan("1/01", FarmError("too thin"))
    # The reserved printers print the plate itself and those of the other job.
    assert len(list_started_plates(farm).keys() & set(reserved_printers)) == 3


def test_replan_result_from_before_a_restart_is_ignored(tmp_path):
    farm = make_farm(tmp_path, [PLUS_MODEL] * 4, plates=1)
    fail_plate(farm, "a", "1/01")
    farm.store.close()
    restarted_farm = Farm(tmp_path, [PLUS_MODEL] * 4, farm.controller.clock, attended=["08:00-18:00"])
    # The restarted farm has not started this task.
    restarted_farm.controller.on_replan("1/01", make_recut(farm, "1/01", 4.0, "bcd"))
    assert restarted_farm.controller.books.jobs[1].plates == ("1/01",)
    restarted_farm.report_ready("b", "c", "d")
    assert list_started_plates(restarted_farm) == {"b": "1/01"}  # `b` was ready first


def test_part_that_is_cancelled_while_it_is_cut_is_not_replaced(tmp_path):
    farm = make_farm(tmp_path, [PLUS_MODEL] * 4, plates=1)
    fail_plate(farm, "a", "1/01")
    farm.parts.cancel(1, "p01", "ann")
    farm.controller.on_replan("1/01", make_recut(farm, "1/01", 4.0, "bcd"))
    assert farm.controller.books.jobs[1].parts == ("1/p01",)
    assert list_started_plates(farm) == {}


def test_approved_plan_is_not_replanned(tmp_path):
    farm = make_farm(tmp_path, [PLUS_MODEL] * 4, plates=1, hold=True)
    fail_plate(farm, "a", "1/01")
    assert farm.effects.replans == []
    assert list_started_plates(farm) == {"b": "1/01"}


def make_replanned_plate(farm, plate, printer, duration_h):
    old_plate = farm.controller.books.plates[plate]
    name = make_next_plate_id(plate)
    time_fields = {"expected_s": duration_h * HOUR_S, "sliced_s": duration_h * HOUR_S - 300.0, "prints": ()}
    new_plate = old_plate.model_copy(update={"id": name, "family": UM2, "printer": printer, **time_fields})
    (part,) = (
        farm.controller.books.parts[item].model_copy(update={"plate": name}) for item in old_plate.parts
    )
    return ReplannedPlate((part,), (new_plate,))


def test_failed_plate_is_resliced_for_another_printer_overnight(tmp_path):
    farm = make_farm(tmp_path, [PLUS_MODEL, UM2], plates=1)
    fail_plate(farm, "a", "1/01")  # its bed is inspected in the morning
    assert farm.effects.replans == [("1/01", ["b"], False)]
    assert farm.controller.scheduler.find_plate_holds().get("1/01") is not None
    farm.controller.on_replan("1/01", make_replanned_plate(farm, "1/01", "b", 11.0))
    assert list_started_plates(farm) == {"b": "1/01-2"}
    assert farm.controller.books.jobs[1].parts == ("1/p01",)
    assert farm.controller.books.plates["1/01"].replaced_by == ("1/01-2",)


def test_backward_clock_step_does_not_delay_the_next_search(tmp_path):
    farm = make_farm(tmp_path, [PLUS_MODEL, PLUS_MODEL, UM2], plates=2)
    fail_plate(farm, "a", "1/01")
    farm.controller.on_replan("1/01", FarmError("too thin"))
    farm.controller.clock.now_s -= HOUR_S
    farm.controller.on_clock_set(-HOUR_S)
    farm.controller.clock.now_s += 60.0
    fail_plate(farm, "b", "1/02")
    assert farm.effects.replans == [("1/01", ["c"], False), ("1/02", ["c"], False)]


def test_useless_reslice_is_not_repeated(tmp_path):
    farm = make_farm(tmp_path, [PLUS_MODEL, UM2], plates=1)
    fail_plate(farm, "a", "1/01")
    farm.controller.on_replan("1/01", make_replanned_plate(farm, "1/01", "b", 30.0))
    farm.controller.clock.now_s += HOUR_S
    farm.controller.handle()
    assert len(farm.effects.replans) == 1
    assert list_started_plates(farm) == {}
    farm.clear_bed("a", FilamentState.PARKED)
    assert list_started_plates(farm) == {"a": "1/01"}


def test_planned_printer_may_take_the_plate_before_the_reslice(tmp_path):
    farm = make_farm(tmp_path, [PLUS_MODEL, UM2], plates=1)
    fail_plate(farm, "a", "1/01")
    farm.clear_bed("a", FilamentState.PARKED)
    assert list_started_plates(farm) == {"a": "1/01"}
    farm.controller.on_replan("1/01", make_replanned_plate(farm, "1/01", "b", 9.0))
    assert farm.controller.books.jobs[1].plates == ("1/01",)
    assert [make_next_plate_id(name) for name in ("3/07", "3/07-2", "3/07a")] == [
        "3/07-2",
        "3/07-3",
        "3/07a-2",
    ]


def test_printer_back_from_maintenance_is_considered_after_a_backward_clock_step(tmp_path):
    farm = make_farm(tmp_path, [PLUS_MODEL, UM2], plates=1)
    farm.printers.begin_maintenance("b", "a new belt", "ann")
    fail_plate(farm, "a", "1/01")
    assert farm.effects.replans == []
    farm.controller.clock.now_s -= HOUR_S
    farm.controller.on_clock_set(-HOUR_S)
    farm.printers.end_maintenance("b", "ann")
    farm.controller.clock.now_s += 11.0
    farm.controller.handle()
    assert farm.effects.replans == [("1/01", ["b"], False)]
