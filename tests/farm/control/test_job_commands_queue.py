"""Moves of jobs in the queue, and changes of their start times."""

from datetime import datetime
from pathlib import Path

import pytest

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from farm.api import QueueMove, QueuePlace
from farm.errors import FarmError, NotFoundError, RefusedError
from farm.model import HoldCode, JobOptions
from farm.paths import StateFolder
from farm.planning.plan import Plan
from farm.views.jobs import describe_queue

STATE = StateFolder(Path("/state"))


@pytest.fixture
def farm(tmp_path):
    """Plan three jobs of three plates on two printers; two plates of the first are being printed."""
    farm = Farm(tmp_path)
    farm.report_ready("a", "b")
    for number in (1, 2, 3):
        farm.jobs.submit(f"request-{number}", f"m{number}.stl", INSPECTED_MODEL, JobOptions())
        event = make_plan_event(number, 3)
        plates = tuple(plate.model_copy(update={"printer": "a"}) for plate in event.plates)
        farm.controller.on_plan(number, Plan(event.parts, plates, (), 1.0, 500.0))
    return farm


def list_queue(farm):
    return [entry.id for entry in describe_queue(farm.build_view_context(STATE)).jobs]


def move_job(farm, number, to=None, before=None):
    farm.jobs.move(number, QueueMove(to=to and QueuePlace(to), before=before), "ann")
    return list_queue(farm)


def test_jobs_move_up_down_first_last_and_before_each_other(farm):
    assert list_queue(farm) == [1, 2, 3]
    assert move_job(farm, 3, "up") == [1, 3, 2]
    assert move_job(farm, 1, "down") == [3, 1, 2]
    assert move_job(farm, 3, "last") == [1, 2, 3]
    assert move_job(farm, 2, "first") == [2, 1, 3]
    assert move_job(farm, 3, before=1) == [2, 3, 1]
    assert move_job(farm, 2, "down") == [3, 2, 1]
    assert move_job(farm, 2, "down") == [3, 1, 2]


def test_impossible_move_is_refused_with_the_reason(farm):
    for number, place in ((1, "up"), (1, "first"), (3, "down"), (3, "last")):
        with pytest.raises(RefusedError, match="already"):
            move_job(farm, number, place)
    for before in (1, 9):
        with pytest.raises(RefusedError, match="only before another job in the queue"):
            move_job(farm, 1, before=before)
    with pytest.raises(NotFoundError):
        move_job(farm, 9, "up")
    farm.jobs.cancel(2, "ann")
    with pytest.raises(RefusedError, match="already ended"):
        move_job(farm, 2, "up")
    assert list_queue(farm) == [1, 3]


def test_moved_job_gets_the_next_free_printer_and_forecast(farm, tmp_path):
    def list_expected_ends():
        farm.controller.handle()
        context = farm.build_view_context(STATE)
        return {entry.id: entry.eta for entry in describe_queue(context).jobs}

    old_ends = list_expected_ends()
    assert old_ends[1] <= old_ends[2] <= old_ends[3]
    move_job(farm, 3, "first")
    waiting_plates = list(farm.controller.situations.build_for_forecast().waiting_plates)
    assert [plate.job for plate in waiting_plates[:3]] == [3, 3, 3]
    farm.store.close()
    restarted_farm = Farm(tmp_path)  # the order is stored in the books
    assert list_queue(restarted_farm) == [3, 1, 2]
    waiting_plates = list(restarted_farm.controller.situations.build_for_forecast().waiting_plates)
    assert [plate.job for plate in waiting_plates[:3]] == [3, 3, 3]


def test_start_time_is_changed_and_removed(farm):
    start_at = datetime.fromtimestamp(farm.controller.clock.now() + 7200.0, farm.controller.fleet.zone)
    farm.jobs.reschedule(3, start_at.isoformat(" "), "ann")
    assert farm.controller.books.get_job(3).not_before_s == pytest.approx(
        farm.controller.clock.now() + 7200.0
    )
    hold_codes = {
        hold.code
        for name, hold in farm.controller.scheduler.find_plate_holds().items()
        if name.startswith("3/")
    }
    assert hold_codes == {HoldCode.START_TIME}
    farm.jobs.reschedule(3, "now", "ann")
    assert farm.controller.books.get_job(3).not_before_s is None
    for text, error in (("25:00", "not a time"), ("2001-01-01 00:00", "has passed")):
        with pytest.raises(FarmError, match=error):
            farm.jobs.reschedule(3, text, "ann")
    farm.jobs.cancel(3, "ann")
    with pytest.raises(RefusedError, match="has already ended"):
        farm.jobs.reschedule(3, "now", "ann")
