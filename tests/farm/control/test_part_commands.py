"""Commands on prints, parts and printers, through the controller."""

from pathlib import Path

import pytest

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from drivers.clock import Clock
from farm.control.telemetry import MAX_REFUSALS
from farm.errors import NotFoundError, RefusedError
from farm.model import (
    AgentPrint,
    AgentSnapshot,
    Bed,
    FilamentState,
    HoldCode,
    JobOptions,
    JobState,
    Link,
    PrintState,
    Reel,
    Verdict,
)  # fmt: skip
from farm.paths import StateFolder
from farm.planning.plan import Plan
from farm.scheduling.forecast import CLEARING_TIME_S
from farm.state import events as ev
from farm.views import describe_job, list_tasks

STATE = StateFolder(Path("/state"))


@pytest.fixture
def farm(tmp_path):
    """Make a job of three parts on two printers: two are printed, one waits."""
    farm = Farm(tmp_path)
    farm.report_ready("a", "b")
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    event = make_plan_event(1, 3)
    farm.controller.on_plan(1, Plan(event.parts, event.plates, event.repairs, 1.0, 500.0))
    return farm


def end_print(farm, printer, state=PrintState.DONE, **changes):
    attempt = farm.controller.books.find_open_print(printer)
    fields = {"fault": None, "reason": "test", "progress_s": 5.0, "print_time_s": 90.0, "extruded": True}
    fields |= {"started_s": 2.0, "ended_s": 50.0, **changes}
    agent_print = AgentPrint(print_id=attempt.id, state=state, **fields)
    idle_fields = {"link": Link.READY, "agent_pid": 9, "filament": FilamentState.PARKED}
    farm.controller.on_snapshot(AgentSnapshot(printer=printer, print=agent_print, **idle_fields))
    farm.report_ready(printer)
    return attempt


def test_failing_print_is_ended_and_its_part_is_printed_elsewhere(farm):
    farm.printers.fail_print("a", "a blob", "ann")
    with pytest.raises(RefusedError, match="ending"):
        farm.printers.fail_print("a", "a blob", "ann")
    attempt = end_print(farm, "a", PrintState.CANCELLED)
    assert farm.controller.books.prints[attempt.id].fault == "by_a_person"
    with pytest.raises(RefusedError, match="a is not printing"):
        farm.printers.fail_print("a", "a blob", "ann")
    end_print(farm, "b")
    farm.clear_bed("b")
    plates = {
        plate.id: farm.controller.books.find_plate_state(plate).name
        for plate in farm.controller.books.plates.values()
    }
    assert plates == {"1/01": "PRINTING", "1/02": "GOOD", "1/03": "WAITING"}


def test_part_is_found_by_any_form_of_its_name(farm):
    for name in ("1/p03", "p03", "03", "3"):
        with pytest.raises(RefusedError, match="1/p03 is already waiting to be printed"):
            farm.parts.reprint(1, name, "", "ann")
    with pytest.raises(NotFoundError, match="no part p9; its parts are p01 p02 p03"):
        farm.parts.reprint(1, "p9", "", "ann")
    with pytest.raises(RefusedError, match=r"being printed: `farm fail a`"):
        farm.parts.reprint(1, "1", "", "ann")


def test_part_is_cancelled_by_name_or_by_printer(farm):
    assert farm.parts.cancel(1, "p03", "ann") == "1/p03"
    with pytest.raises(RefusedError, match="already cancelled"):
        farm.parts.cancel(1, "p03", "ann")
    assert farm.parts.cancel_on_printer("a", "ann") == "1/p01"
    end_print(farm, "a", PrintState.CANCELLED)
    end_print(farm, "b")
    farm.clear_bed("a")
    with pytest.raises(RefusedError, match="a is not printing"):
        farm.parts.cancel_on_printer("a", "ann")
    with pytest.raises(RefusedError, match="1/p02 is already printed"):
        farm.parts.cancel(1, "p02", "ann")
    assert farm.controller.books.jobs[1].state is JobState.PRINTED
    assert not list(farm.controller.books.list_open_prints())
    assert farm.parts.reprint(1, "p01", "after all", "ann") == "1/p01"
    assert farm.controller.books.find_open_print("a").plate == "1/01"


def test_paused_job_starts_no_plate(farm):
    farm.jobs.set_paused(1, True, "ann")
    with pytest.raises(RefusedError, match="already paused"):
        farm.jobs.set_paused(1, True, "ann")
    end_print(farm, "a")
    farm.clear_bed("a")
    assert farm.controller.books.find_open_print("a") is None
    assert farm.controller.scheduler.find_plate_holds().get("1/03").code is HoldCode.PAUSED
    farm.jobs.set_paused(1, False, "ann")
    assert farm.controller.books.find_open_print("a").plate == "1/03"
    assert farm.parts.set_paused(1, "p03", True, "ann") == "a"
    with pytest.raises(RefusedError, match="is already printed"):
        farm.parts.set_paused(1, "p01", True, "ann")


def test_plates_waiting_for_a_bed_are_counted(farm):
    """Include waiting plates while the printers of the job print, and until a bed has been cleared."""
    now_s = farm.controller.clock.now()
    started_fields = {"at_s": now_s, "state": PrintState.PRINTING, "started_s": now_s, "extruded": True}
    for attempt in list(farm.controller.books.list_open_prints()):
        farm.controller.handle(ev.PrintProgressed(print_id=attempt.id, **started_fields))
    view = describe_job(farm.build_view_context(STATE), farm.controller.books.get_job(1))
    assert view.expected_s == pytest.approx(200.0 + CLEARING_TIME_S)
    assert view.current_s == pytest.approx(view.expected_s, abs=120.0)  # forecasts are rounded to minutes
    assert view.utilisation < 1.0
    farm.parts.cancel(1, "p03", "ann")  # a plate that is never printed takes no time
    assert describe_job(farm.build_view_context(STATE), farm.controller.books.get_job(1)).current_s < 110.0


def test_paused_waiting_part_is_not_assigned(farm, tmp_path):
    assert farm.parts.set_paused(1, "p03", True, "ann") == ""
    with pytest.raises(RefusedError, match="already paused"):
        farm.parts.set_paused(1, "3", True, "ann")
    end_print(farm, "a")
    farm.clear_bed("a")
    assert farm.controller.books.find_open_print("a") is None
    hold = farm.controller.scheduler.find_plate_holds().get("1/03")
    assert (hold.code, hold.text) == (HoldCode.PAUSED, "part 1/p03 is paused: `farm resume 1/p03`")
    farm.store.close()
    farm = Farm(tmp_path)  # the pause survives a restart
    farm.report_ready("a")
    assert farm.controller.books.find_open_print("a") is None
    farm.parts.set_paused(1, "p03", False, "ann")
    assert farm.controller.books.find_open_print("a").plate == "1/03"


def test_resumed_job_resumes_its_paused_parts(farm):
    farm.parts.set_paused(1, "p03", True, "ann")
    farm.jobs.set_paused(1, False, "ann")
    assert farm.controller.scheduler.find_plate_holds().get("1/03").code is not HoldCode.PAUSED
    farm.jobs.set_paused(1, True, "ann")
    with pytest.raises(RefusedError, match="job 1 is paused: `farm resume 1`"):
        farm.parts.set_paused(1, "p03", False, "ann")


def test_printer_in_maintenance_finishes_its_print_and_gets_no_other(farm):
    farm.printers.begin_maintenance("a", "a new belt", "ann")
    assert farm.controller.books.find_open_print("a").cancel_reason is None
    end_print(farm, "a")
    farm.clear_bed("a")
    assert farm.controller.books.find_open_print("a") is None
    farm.printers.end_maintenance("a", "ann")
    assert farm.controller.books.find_open_print("a").plate == "1/03"
    with pytest.raises(RefusedError, match="not in maintenance"):
        farm.printers.end_maintenance("a", "ann")


@pytest.mark.parametrize("is_cancelled", [False, True])
def test_bad_part_is_printed_again_unless_its_job_was_cancelled(farm, is_cancelled):
    end_print(farm, "a")
    if is_cancelled:
        farm.jobs.cancel(1, "ann")
    answer = farm.clear_bed("a", verdict=Verdict.BAD, reason="warped")
    assert answer.again == (None if is_cancelled else "1/p01")


def test_bad_verdict_requires_a_printed_part(farm):
    end_print(farm, "a")
    farm.clear_bed("a", verdict=Verdict.BAD, reason="warped")
    assert farm.controller.books.plates["1/01"].prints
    assert farm.controller.books.find_open_print("a").plate in ("1/01", "1/03")
    farm.report_ready("b")
    with pytest.raises(RefusedError, match="its bed cannot be clear"):
        farm.clear_bed("b", verdict=Verdict.BAD)
    assert ev.SendCleared(printer="a", filament=None) in farm.effects.instructions


def test_outage_blocks_starts_until_confirmed(farm):
    with pytest.raises(RefusedError, match="there is no outage"):
        farm.printers.confirm_outage("ann")
    now_s = farm.controller.clock.now()
    end_print(farm, "a", PrintState.FAILED, fault="port_lost", ended_s=now_s)
    farm.clear_bed("a")
    assert farm.controller.scheduler.find_plate_holds().get("1/01").code is HoldCode.JUST_LOST
    assert farm.controller.books.find_open_print("a").plate == "1/03"
    end_print(farm, "a")
    end_print(farm, "b", PrintState.FAILED, fault="agent_died", ended_s=now_s + 1.0)
    for name in "ab":
        farm.clear_bed(name)
    assert {farm.controller.scheduler.find_plate_holds().get(name).code for name in ("1/01", "1/02")} == {
        HoldCode.OUTAGE
    }
    (item,) = list_tasks(farm.build_view_context(STATE))
    assert (item.code, item.printers) == ("outage", ["a", "b"])
    farm.controller.clock = Clock(2.0, now_s - 60.0)  # a minute later
    assert farm.printers.confirm_outage("ann") == "a b"
    assert not list_tasks(farm.build_view_context(STATE))
    assert {farm.controller.books.find_open_print(name).plate for name in "ab"} == {"1/01", "1/02"}


def test_idle_printers_lost_together_are_an_outage(tmp_path):
    farm = Farm(tmp_path)
    farm.report_ready("a", "b")
    for name in "ab":
        farm.controller.on_snapshot(
            AgentSnapshot(printer=name, link=Link.ABSENT, reason="the port is not there")
        )
    assert farm.controller.books.outage.printers == ("a", "b")


def test_plates_of_a_held_job_do_not_wait_for_an_outage(farm):
    farm.jobs.submit("s" * 8, "n.stl", INSPECTED_MODEL, JobOptions(hold=True))
    event = make_plan_event(2, 1)
    farm.controller.on_plan(2, Plan(event.parts, event.plates, event.repairs, 1.0, 500.0))
    for name in "ab":
        end_print(farm, name, PrintState.FAILED, fault="port_lost", ended_s=farm.controller.clock.now())
    assert farm.controller.books.outage is not None
    assert farm.controller.scheduler.find_plate_holds().get("2/01") is None  # no event would remove this hold


def test_refused_start_uses_no_filament(farm):
    reel = Reel(material="generic_pla", grams=500.0, nozzle_mm=0.4)
    farm.controller.handle(ev.ReelLoaded(at_s=1.0, printer="a", reel=reel, by="ann"))
    attempt = farm.controller.books.find_open_print("a")
    for _ in range(MAX_REFUSALS):
        farm.controller.on_refusal(attempt.id, "no")
    assert farm.controller.books.prints[attempt.id].state is PrintState.FAILED
    assert farm.controller.books.printers["a"].reel == reel


@pytest.mark.parametrize(
    "request_print",
    [
        lambda farm: farm.jobs.set_paused(1, False, "ann"),
        lambda farm: farm.parts.set_paused(1, "p01", False, "ann"),
        lambda farm: farm.parts.reprint(1, "p01", "", "ann"),
    ],
    ids=["resume job", "resume part", "reprint"],
)
def test_part_stopped_by_estop_waits_for_a_person(farm, request_print):
    end_print(farm, "a", PrintState.FAILED, fault="estop")
    for _ in range(2):  # other waiting plates continue
        end_print(farm, "b")
        farm.clear_bed("b")
    farm.controller.handle()
    assert farm.controller.books.find_open_print("b") is None
    hold = farm.controller.scheduler.find_plate_holds().get("1/01")
    assert hold.code is HoldCode.STOPPED and "`farm resume 1/p01`" in hold.text
    [task] = [item for item in list_tasks(farm.build_view_context(STATE)) if item.code == "stopped"]
    assert "part 1/p01 stopped by `farm estop`" in task.text and "`farm resume 1/p01`" in task.text
    request_print(farm)
    assert farm.controller.books.find_open_print("b").plate == "1/01"
    assert not [item for item in list_tasks(farm.build_view_context(STATE)) if item.code == "stopped"]


def test_parts_stopped_by_estop_are_listed_as_one_task(farm):
    for printer in "ab":
        end_print(farm, printer, PrintState.FAILED, fault="estop")
    [task] = [item for item in list_tasks(farm.build_view_context(STATE)) if item.code == "stopped"]
    assert task.text.startswith(
        "2 parts of job 1 stopped by `farm estop`: print them again with `farm resume 1`"
    )


@pytest.mark.parametrize("verdict", list(Verdict))
def test_old_page_does_not_clear_the_bed_of_a_later_plate(farm, verdict):
    first_print = end_print(farm, "a")
    farm.clear_bed("a", seen=first_print.id)
    second_print = end_print(farm, "a")
    for seen_print in (first_print.id, "none"):
        with pytest.raises(RefusedError, match="1/p03 was printed on a after this page"):
            farm.clear_bed("a", verdict=verdict, seen=seen_print)
    books = farm.controller.books
    assert books.printers["a"].bed is not Bed.CLEAR
    assert books.prints[second_print.id].verdict is None
    farm.clear_bed("a", verdict=verdict, seen=second_print.id)
    assert farm.controller.books.prints[second_print.id].verdict is verdict
