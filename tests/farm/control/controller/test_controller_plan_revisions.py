"""Revisions of plans before their job starts, through the controller."""

from types import SimpleNamespace

import pytest

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, PLUS_MODEL, Farm
from farm.control.controller import Controller
from farm.errors import FarmError
from farm.model import HoldCode, JobOptions, JobState, Link, PlanProgress, PlanStep
from farm.planning.plan import Plan
from farm.planning.replanning import revisions
from farm.state import PlateState, validate_books
from farm.state import events as ev
from farm.state.lifecycles import InvalidTransition

HOUR_S = 3600.0


def make_plan(number, durations_h, printers):
    """Make a plan with one plate for each of these printing times."""
    event = make_plan_event(number, len(durations_h))
    plates = tuple(
        plate.model_copy(
            update={
                "sliced_s": duration_h * HOUR_S,
                "expected_s": duration_h * HOUR_S + 300.0,
                "printer": printers[index % len(printers)],
                "family": PLUS_MODEL,
            }
        )
        for index, (plate, duration_h) in enumerate(zip(event.plates, durations_h, strict=True))
    )
    return Plan(event.parts, plates, (), 1.0, 500.0)


@pytest.fixture
def farm(tmp_path):
    """Make a farm of eight printers, whose only job is planned for the two that are connected."""
    farm = Farm(tmp_path, [PLUS_MODEL] * 8)
    farm.report_ready(*"ab", bed_clear=False)
    farm.report_ready(*"cdefgh", link=Link.ABSENT, reason="unplugged")
    submit_planned_job(farm)
    return farm


def submit_planned_job(farm, **options):
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions(**options))
    assert farm.effects.plans == [(1, ["a", "b"], 1)]
    farm.controller.on_plan(1, make_plan(1, [8.0, 8.0], "ab"))
    assert farm.controller.books.jobs[1].planned_for == ("a", "b")


def list_open_prints(farm):
    return {attempt.printer: attempt.plate for attempt in farm.controller.books.list_open_prints()}


def clear_other_beds_at_once(farm):
    """Clear the beds of all but the first two printers in one step."""
    controller: Controller = farm.controller
    at_s = controller.clock.now()
    controller.is_stopping = True
    farm.report_ready(*"cdefgh")
    controller.handle(*(ev.BedCleared(at_s=at_s, printer=name, by="ann") for name in "cdefgh"))
    controller.is_stopping = False
    controller.handle()


def test_job_is_planned_again_for_more_printers_and_starts_only_then(farm):
    clear_other_beds_at_once(farm)
    assert farm.effects.plans[1:] == [(1, list("abcdefgh"), 1)]
    assert list_open_prints(farm) == {}
    assert {hold.code for hold in farm.controller.scheduler.find_plate_holds().values()} == {
        HoldCode.BEING_REPLANNED
    }
    assert farm.controller.books.jobs[1].state is JobState.PRINTING  # the job keeps its old plan meanwhile
    farm.controller.on_plan(1, make_plan(1, [3.0] * 6, "cdefgh"))
    job = farm.controller.books.jobs[1]
    assert (len(job.plates), job.revisions) == (6, 1)
    assert set(list_open_prints(farm)) == set("cdefgh")
    # The job is not planned a third time.
    assert [plan for plan in farm.effects.plans if plan[0] == 1][2:] == []
    assert validate_books(farm.controller.books) == []


def test_plan_stays_if_the_new_one_fails(farm):
    clear_other_beds_at_once(farm)
    farm.controller.on_plan(1, FarmError("the engine died"))
    assert farm.controller.books.jobs[1].plates == ("1/01", "1/02")
    assert len(list_open_prints(farm)) == 2
    assert len(farm.effects.plans) == 2


@pytest.mark.parametrize("reason", ["it takes too long", "the disk is full"])
def test_job_does_not_wait_long_for_its_new_plan(farm, reason):
    clear_other_beds_at_once(farm)
    if reason == "the disk is full":
        farm.controller.planning.on_progress(1, PlanProgress(step=PlanStep.NO_ROOM))
        farm.controller.handle()
    else:
        for _ in range(2):  # first the start-up ends, then the delay
            next_change_s = farm.controller.next_change_s
            farm.controller.clock = SimpleNamespace(
                now=lambda next_change_s=next_change_s: next_change_s, scale=1.0
            )
            farm.controller.tick()
    assert len(list_open_prints(farm)) == 2
    farm.controller.on_plan(1, make_plan(1, [3.0] * 6, "cdefgh"))
    assert farm.controller.books.jobs[1].plates == ("1/01", "1/02")


def test_new_plan_that_ends_later_is_not_used(farm):
    clear_other_beds_at_once(farm)
    farm.controller.on_plan(1, make_plan(1, [9.0] * 6, "cdefgh"))
    assert farm.controller.books.jobs[1].revisions == 0
    assert set(list_open_prints(farm).values()) == {"1/01", "1/02"}


def test_revised_plan_may_have_fewer_plates(farm):
    farm.controller.handle(
        ev.PlanRevised(**dict(make_revised_fields(farm, [1.0] * 3, "abc"), job=1)),
    )
    farm.controller.handle(ev.PlanRevised(**dict(make_revised_fields(farm, [9.0], "a"), job=1)))
    books = farm.controller.books
    assert books.jobs[1].plates == ("1/01",)
    assert books.find_plate_state(books.plates["1/03"]) is PlateState.REPLACED
    farm.controller.handle(ev.PlanRevised(**dict(make_revised_fields(farm, [1.0] * 3, "abc"), job=1)))
    books = farm.controller.books
    assert books.find_plate_state(books.plates["1/03"]) is PlateState.WAITING
    assert validate_books(books) == []


def make_revised_fields(farm, durations_h, printers):
    plan = make_plan(1, durations_h, printers)
    event = make_plan_event(1, len(durations_h))
    return event.model_copy(update={"plates": plan.plates, "at_s": farm.controller.clock.now()})


def test_plan_of_a_started_job_is_never_replaced(farm):
    farm.clear_bed("a")
    assert list_open_prints(farm) == {"a": "1/01"}
    with pytest.raises(InvalidTransition, match="has started"):
        farm.controller.handle(ev.PlanRevised(**dict(make_revised_fields(farm, [1.0] * 3, "abc"), job=1)))
    clear_other_beds_at_once(farm)
    assert len(farm.effects.plans) == 1


def test_cancelled_job_is_not_planned_again(farm):
    clear_other_beds_at_once(farm)
    farm.jobs.cancel(1, "ann")
    assert ev.StopPlanning(job=1) in farm.effects.instructions
    farm.controller.on_plan(1, make_plan(1, [3.0] * 6, "cdefgh"))
    assert farm.controller.books.jobs[1].state is JobState.CANCELLED
    assert list_open_prints(farm) == {}


def test_new_daemon_examines_the_job_again(farm, tmp_path):
    clear_other_beds_at_once(farm)
    old_plan = farm.effects.plans[-1]
    farm.store.close()
    restarted_farm = Farm(tmp_path, [PLUS_MODEL] * 8)
    restarted_farm.controller.is_stopping = True
    restarted_farm.report_ready(*"ab", bed_clear=False)
    restarted_farm.report_ready(*"cdefgh")
    restarted_farm.controller.is_stopping = False
    restarted_farm.controller.handle()
    assert restarted_farm.effects.plans == [old_plan]
    assert list_open_prints(restarted_farm) == {}


def test_each_scheduling_run_starts_one_job_if_the_forecasts_are_large(tmp_path, monkeypatch):
    monkeypatch.setattr(revisions, "MAX_FORECAST_SIZE", 0)
    monkeypatch.setattr(revisions, "may_revise", lambda *_: True)
    farm = Farm(tmp_path, [PLUS_MODEL] * 8)
    farm.report_ready(*"abcdefgh", bed_clear=False)
    for number in (1, 2, 3):
        farm.jobs.submit(f"{number:08d}", "m.stl", INSPECTED_MODEL, JobOptions(printers=2))
        farm.controller.on_plan(number, make_plan(number, [8.0, 8.0], farm.effects.plans[-1][1]))
    controller: Controller = farm.controller
    controller.is_stopping = True
    at_s = controller.clock.now()
    controller.handle(*(ev.BedCleared(at_s=at_s, printer=name, by="ann") for name in "abcdefgh"))
    controller.is_stopping = False
    started_jobs = []
    for _ in range(3):
        controller.tick()
        started_jobs.append({plate.partition("/")[0] for plate in list_open_prints(farm).values()})
    assert started_jobs == [{"1"}, {"1", "2"}, {"1", "2", "3"}]
    assert len(list_open_prints(farm)) == 6


def test_job_with_a_later_start_is_not_examined_again_when_printers_become_idle(farm, monkeypatch):
    examined_jobs = []
    monkeypatch.setattr(revisions, "choose_revision", lambda job, *_: examined_jobs.append(job.id))
    controller: Controller = farm.controller
    at_s = controller.clock.now()
    controller.handle(ev.JobRescheduled(at_s=at_s, job=1, not_before_s=at_s + 9 * HOUR_S))
    farm.report_ready(*"cdefgh", bed_clear=False)
    farm.report_ready("a", link=Link.ABSENT, reason="unplugged")
    examined_count = len(examined_jobs)
    assert examined_count > 0
    for name in "cdef":
        controller.handle(ev.BedCleared(at_s=at_s, printer=name, by="ann"))
    assert len(examined_jobs) == examined_count
