"""Commands on jobs: held plans, start times, spares, and own G-code beside a decomposition."""

import asyncio
import hashlib
from dataclasses import replace
from datetime import datetime

import pytest

from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from farm.api import LoadRequest
from farm.config import FieldError
from farm.control import job_commands, printer_commands
from farm.errors import ErrorCode, FarmError, RefusedError
from farm.model import HoldCode, JobOptions, JobState, OwnGcode
from farm.paths import StateFolder
from farm.planning.plan import InspectedSubmission, Plan
from farm.state import events as ev
from farm.state.books import put
from farm.state.storage.file_store import compute_sha256
from farm.views import describe_job, describe_timeline, list_tasks

GCODE = InspectedSubmission(
    "x.gcode", (), 1.0, OwnGcode(nozzle_mm=0.4, min_mm=(-5.0, -5.0, 0.2), max_mm=(5.0, 5.0, 9.0))
)


class ThreadlessAsyncio:
    """Replacement of asyncio that calls functions directly instead of in threads."""

    @staticmethod
    async def to_thread(work, *args):
        return work(*args)


@pytest.fixture
def state(tmp_path):
    folder = StateFolder(tmp_path / "state")
    folder.make()
    return folder


@pytest.fixture
def farm(tmp_path):
    farm = Farm(tmp_path)
    farm.report_ready("a", "b")
    return farm


def submit_job(farm, name="r", model=INSPECTED_MODEL, **options):
    return farm.jobs.submit(name * 8, "m.stl", model, JobOptions(**options))[0]


def make_stored_plan(number, state, plates=2):
    """Make a plan whose G-code is in the file store."""
    event = make_plan_event(number, plates)
    gcode = b"G28\n"
    (state.files / "g.gcode").write_bytes(gcode)
    fields = {"sha256": hashlib.sha256(gcode).hexdigest()}
    new_plates = tuple(plate.model_copy(update=fields) for plate in event.plates)
    return Plan(event.parts, new_plates, (), 1.0, 500.0)


def describe_job_timeline(farm, state, number):
    controller = farm.controller
    return describe_timeline(
        controller.build_view_context(state), number, controller.situations.build_for_forecast()
    )


def list_started_printers(farm):
    return [
        instruction.printer
        for instruction in farm.effects.instructions
        if isinstance(instruction, ev.SendStart)
    ]


def test_changes_during_an_approval_are_noticed(farm, state, monkeypatch):
    number = submit_job(farm, hold=True)
    farm.controller.on_plan(number, make_stored_plan(number, state))
    plan = farm.controller.books.get_job(number).plan

    def cancel_job():
        if not farm.controller.books.get_job(number).state.ended:
            farm.controller.handle(ev.JobCancelled(at_s=1.0, job=number))

    with monkeypatch.context() as patch:
        patch.setattr(job_commands, "compute_sha256", lambda path: (cancel_job(), compute_sha256(path))[1])
        patch.setattr(job_commands, "asyncio", ThreadlessAsyncio)
        with pytest.raises(RefusedError, match="is not waiting for approval: it is cancelled"):
            asyncio.run(farm.jobs.approve(number, plan, state, "ann"))
    other_job = submit_job(farm, "s", hold=True)
    farm.controller.on_plan(other_job, make_stored_plan(other_job, state))

    def start_print(section, fleet_options):
        farm.controller.handle(ev.JobApproved(at_s=1.0, job=other_job, by="ann"))
        return section

    monkeypatch.setattr(printer_commands, "complete_section", start_print)
    monkeypatch.setattr(printer_commands, "asyncio", ThreadlessAsyncio)
    with pytest.raises(RefusedError, match="a is printing"):
        asyncio.run(farm.printers.load_reel("a", LoadRequest(grams=500.0), "ann"))


def test_plan_of_an_earlier_version_is_approvable_after_a_restore(farm, state):
    number = submit_job(farm)
    farm.controller.on_plan(number, make_stored_plan(number, state))
    job = farm.controller.books.get_job(number).model_copy(update={"plan": None})
    farm.controller.books = put(farm.controller.books, job)
    farm.controller.handle(ev.BooksRestored(at_s=1.0, copied_s=0.0))
    assert farm.controller.books.get_job(number).state is JobState.HELD
    asyncio.run(farm.jobs.approve(number, "", state, "ann"))
    assert farm.controller.books.get_job(number).state is JobState.PRINTING


def test_held_plan_prints_only_after_approval_of_its_hash(farm, state):
    number = submit_job(farm, hold=True)
    farm.controller.on_plan(number, make_stored_plan(number, state))
    job = farm.controller.books.get_job(number)
    assert (job.state, job.hold.code) == (JobState.HELD, HoldCode.APPROVAL)
    assert list_started_printers(farm) == []
    with pytest.raises(RefusedError, match="check it again"):
        asyncio.run(farm.jobs.approve(number, "0" * 12, state, "ann"))
    asyncio.run(farm.jobs.approve(number, job.plan, state, "ann"))
    assert list_started_printers(farm) == ["a", "b"]
    with pytest.raises(RefusedError, match="is not waiting for approval"):
        asyncio.run(farm.jobs.approve(number, job.plan, state, "ann"))


def test_held_job_is_released_before_its_plan_or_after_it(farm, state):
    early_job, late_job = submit_job(farm, hold=True), submit_job(farm, "s", hold=True)
    farm.controller.on_plan(late_job, make_stored_plan(late_job, state))
    assert farm.controller.books.get_job(late_job).state is JobState.HELD
    for number in (early_job, late_job):
        with pytest.raises(RefusedError, match="only an operator"):
            asyncio.run(farm.jobs.release(number, state, "bob", is_operator=False))
        asyncio.run(farm.jobs.release(number, state, "bob", is_operator=True))
    farm.controller.on_plan(early_job, make_stored_plan(early_job, state))
    assert [farm.controller.books.get_job(n).state for n in (early_job, late_job)] == [JobState.PRINTING] * 2


def test_plan_whose_files_changed_is_not_released(farm, state):
    number = submit_job(farm, hold=True)
    farm.controller.on_plan(number, make_stored_plan(number, state))
    (state.files / "g.gcode").write_bytes(b"G28 ; and more\n")
    with pytest.raises(RefusedError, match="has changed since it was planned"):
        plan = farm.controller.books.get_job(number).plan
        asyncio.run(farm.jobs.approve(number, plan, state, "ann"))
    assert list_started_printers(farm) == []


def test_fleet_option_requires_approval_of_every_job(tmp_path, state):
    farm = Farm(tmp_path, approve=True)
    farm.report_ready("a", "b")
    number = submit_job(farm)
    farm.controller.on_plan(number, make_stored_plan(number, state))
    assert farm.controller.books.get_job(number).state is JobState.HELD


def test_reel_survives_a_restart_and_short_reels_start_nothing(farm, state, tmp_path, monkeypatch):
    monkeypatch.setattr(printer_commands, "complete_section", lambda section, fleet_options: section)
    asyncio.run(farm.printers.load_reel("a", LoadRequest(grams=4.0, colour="white"), "ann"))
    reel = asyncio.run(
        farm.printers.load_reel("b", LoadRequest(material="generic_abs", grams=700.0, nozzle_mm=0.8), "ann")
    )
    assert (reel.material, reel.colour, reel.grams, reel.nozzle_mm) == ("generic_abs", None, 700.0, 0.8)
    number = submit_job(farm, material="generic_pla")
    assert farm.effects.plans == [(number, ["a"], 1)]
    farm.controller.on_plan(number, make_stored_plan(number, state, plates=1))
    hold = farm.controller.scheduler.find_plate_holds().get(f"{number}/01")
    assert hold.code is HoldCode.REEL_TOO_SHORT
    assert "a has 4 g, but this plate needs 8 g" in hold.text
    farm.store.close()
    restarted_farm = Farm(tmp_path)
    restarted_farm.report_ready("a", "b")
    assert restarted_farm.controller.fleet.find_printer("b").material == "generic_abs"
    asyncio.run(restarted_farm.printers.load_reel("a", LoadRequest(grams=300.0), "ann"))
    assert list_started_printers(restarted_farm) == ["a"]
    with pytest.raises(RefusedError, match="is printing"):
        asyncio.run(restarted_farm.printers.load_reel("a", LoadRequest(grams=300.0), "ann"))


def test_reel_of_an_unknown_material_is_refused(farm, state, monkeypatch):
    def refuse_material(section, fleet_options):
        raise FieldError("there is no generic_gold", "material")

    monkeypatch.setattr(printer_commands, "complete_section", refuse_material)
    with pytest.raises(RefusedError, match="a: there is no generic_gold"):
        asyncio.run(farm.printers.load_reel("a", LoadRequest(material="generic_gold"), "ann"))


def test_own_gcode_is_planned_during_decompositions(farm):
    first_job, second_job = submit_job(farm), submit_job(farm, "s")
    third_job, urgent_job = submit_job(farm, "t"), submit_job(farm, "u", priority=1)
    holds = {number: farm.controller.books.get_job(number).hold.code for number in (third_job, urgent_job)}
    assert set(holds.values()) == {HoldCode.NOT_FIRST}
    gcode_job = submit_job(farm, "v", GCODE)
    assert [plan[0] for plan in farm.effects.plans] == [first_job, second_job, gcode_job]
    farm.jobs.cancel(first_job, "ann")
    assert farm.effects.plans[-1][0] == urgent_job


def test_own_gcode_is_planned_beside_an_unprintable_job(farm):
    """Plan G-code at once although the job before it in the queue matches no printer."""
    blocked_job = submit_job(farm, material="generic_abs")
    assert farm.controller.books.get_job(blocked_job).hold.code is HoldCode.NO_SUCH_PRINTER
    gcode_job = submit_job(farm, "s", GCODE, hold=True, dry_run=True)
    assert farm.effects.plans == [(gcode_job, ["a", "b"], 1)]


def test_job_with_a_start_time_is_planned_at_once_and_starts_at_that_time(farm, state):
    start_at = datetime.fromtimestamp(farm.controller.clock.now() + 3600).astimezone().isoformat()
    later_job = submit_job(farm, at=start_at)
    assert farm.effects.plans == [(later_job, ["a", "b"], 1)]
    farm.controller.on_plan(later_job, make_stored_plan(later_job, state))
    assert {hold.code for hold in farm.controller.scheduler.find_plate_holds().values()} == {
        HoldCode.START_TIME
    }
    farm.controller.clock = type("Later", (), {"now": lambda _: farm.clock_s, "scale": 1.0})()
    farm.clock_s = farm.controller.books.get_job(later_job).not_before_s
    farm.controller.tick()
    assert list_started_printers(farm) == ["a", "b"]


def test_invalid_start_time_is_refused_at_submission(farm):
    for options in ({"at": "soon"}, {"overnight": True}):
        with pytest.raises(FarmError) as error:
            submit_job(farm, **options)
        assert error.value.code is ErrorCode.SETTINGS


def test_missed_deadline_is_reported_with_the_earliest_end(farm, state):
    def list_deadline_notices(delay_s):
        deadline = datetime.fromtimestamp(farm.controller.clock.now() + delay_s).astimezone().isoformat()
        number = submit_job(farm, name=f"{delay_s:03d}", done_by=deadline, hold=True)
        farm.controller.on_plan(number, make_stored_plan(number, state))
        return farm.controller.books.get_job(number).repairs

    assert list_deadline_notices(3600) == ()
    (notice,) = list_deadline_notices(50)
    assert notice.startswith("It cannot be printed by") and "the earliest possible time is" in notice
    assert list_deadline_notices(600) == ()
    for name in "ab":  # a person has to clear both beds first
        farm.controller.handle(
            ev.BedBecameUnknown(at_s=farm.controller.clock.now(), printer=name, reason="test")
        )
    assert len(list_deadline_notices(601)) == 1


def test_plan_of_several_materials_is_reported(farm, state):
    for name, other_material, notice_count in (("1", "generic_pla", 0), ("2", "generic_abs", 1)):
        number = submit_job(farm, name=name, hold=True)
        plan = make_stored_plan(number, state)
        first_plate, second_plate = plan.plates
        plates = (first_plate, second_plate.model_copy(update={"material": other_material}))
        farm.controller.on_plan(number, replace(plan, plates=plates))
        result = farm.controller.books.get_job(number).repairs
        assert len(result) == notice_count
        assert all("generic_abs and generic_pla" in notice for notice in result)


def test_deadline_without_a_date_follows_the_start_time(farm):
    number = submit_job(farm, at="22:00", done_by="08:00")
    job = farm.controller.books.get_job(number)
    assert job.done_by_s - job.not_before_s == pytest.approx(10 * 3600)


def test_assembly_deadline_replaces_the_printing_deadline(farm):
    number = submit_job(farm, at="22:00", assembled_by="08:00")
    job = farm.controller.books.get_job(number)
    assert job.done_by_s is None
    assert job.assembled_by_s - job.not_before_s == pytest.approx(10 * 3600)
    with pytest.raises(FarmError, match="not both"):
        submit_job(farm, name="s", done_by="07:00", assembled_by="08:00")


def test_missed_deadline_of_the_assembly_is_reported(farm, state):
    def list_deadline_notices(delay_s):
        deadline = datetime.fromtimestamp(farm.controller.clock.now() + delay_s).astimezone().isoformat()
        number = submit_job(farm, name=f"{delay_s:04d}", assembled_by=deadline, hold=True)
        farm.controller.on_plan(number, replace(make_stored_plan(number, state), assembly_s=3600.0))
        return farm.controller.books.get_job(number).repairs

    assert list_deadline_notices(3600 + 600) == ()
    (notice,) = list_deadline_notices(3600 + 50)
    assert notice.startswith("It cannot be assembled by") and "the earliest possible time is" in notice


def test_assembly_is_not_recorded_before_all_parts_are_printed(farm):
    number = submit_job(farm)
    with pytest.raises(RefusedError, match="once all parts are printed"):
        farm.jobs.record_assembly(number, 45.0, "ann")


def test_spare_printers_are_excluded_from_the_plan(farm):
    number = submit_job(farm, spares=1)
    assert len(farm.effects.plans[0][1]) == 1
    assert farm.effects.plans[0][0] == number


def test_spares_are_kept_only_in_unattended_hours(tmp_path, state):
    planned_printers = {}
    for period, hours in {"day": ["00:00-24:00"], "night": []}.items():
        farm = Farm(tmp_path / period, attended=hours)
        farm.report_ready("a", "b")
        first_job = submit_job(farm, spares=1)
        farm.controller.on_plan(first_job, make_stored_plan(first_job, state, plates=1))
        submit_job(farm, "s")
        planned_printers[period] = [names for number, names, _ in farm.effects.plans if number != first_job]
        assert farm.controller.scheduler.list_reservations().get("b") == (
            "job 2" if period == "day" else "a failed part (--spares)"
        )
    assert planned_printers == {"day": [["b"]], "night": [["a", "b"]]}


def test_held_jobs_are_planned_for_the_whole_fleet_and_start_in_order_of_approval(farm, state):
    numbers = [submit_job(farm, name, hold=True) for name in "rs"]
    assert farm.effects.plans == [(number, ["a", "b"], 1) for number in numbers]
    for number in numbers:
        farm.controller.on_plan(number, make_stored_plan(number, state))
    for number in reversed(numbers):
        plan = farm.controller.books.get_job(number).plan
        asyncio.run(farm.jobs.approve(number, plan, state, "ann"))
    printing_jobs = {attempt.printer: attempt.job for attempt in farm.controller.books.list_open_prints()}
    assert printing_jobs == {"a": numbers[1], "b": numbers[1]}  # this job was approved first
    hold_codes = [
        farm.controller.scheduler.find_plate_holds().get(name).code
        for name in farm.controller.books.get_job(numbers[0]).plates
    ]
    assert hold_codes == [HoldCode.PRINTER_BUSY] * 2


def test_timeline_of_a_held_job_is_forecast(farm, state):
    number = submit_job(farm, hold=True)
    with pytest.raises(RefusedError, match="no plan yet"):
        describe_job_timeline(farm, state, number)
    farm.controller.on_plan(number, make_stored_plan(number, state, plates=3))
    timeline = describe_job_timeline(farm, state, number)
    assert {slot.plate for slot in timeline.slots} == {f"{number}/0{i}" for i in (1, 2, 3)}
    assert timeline.grams == pytest.approx(9.0)
    assert timeline.lower_bound_s <= timeline.makespan_s
    assert farm.controller.books.get_job(number).expected_s == pytest.approx(timeline.makespan_s)


def test_timeline_of_a_job_starts_after_the_plates_of_jobs_before_it(farm, state):
    first_job, second_job = submit_job(farm, hold=True), submit_job(farm, "s", hold=True)
    for number in (first_job, second_job):
        farm.controller.on_plan(number, make_stored_plan(number, state, plates=4))
    undisturbed_timeline = describe_job_timeline(farm, state, second_job)
    asyncio.run(farm.jobs.approve(first_job, farm.controller.books.get_job(first_job).plan, state, "ann"))
    second_timeline = describe_job_timeline(farm, state, second_job)
    assert {slot.plate for slot in second_timeline.slots} == {f"{second_job}/0{i}" for i in (1, 2, 3, 4)}
    last_end = max(slot.ends for slot in describe_job_timeline(farm, state, first_job).slots)
    assert (
        min(slot.starts for slot in undisturbed_timeline.slots)
        < last_end
        <= min(slot.starts for slot in second_timeline.slots)
    )


def test_tasks_name_the_approval_and_the_short_reel(farm, state, monkeypatch):
    monkeypatch.setattr(printer_commands, "complete_section", lambda section, fleet_options: section)
    first_job = submit_job(farm, hold=True)
    farm.controller.on_plan(first_job, make_stored_plan(first_job, state))
    for name in "ab":
        asyncio.run(farm.printers.load_reel(name, LoadRequest(grams=4.0), "ann"))
    second_job = submit_job(farm, "s")
    farm.controller.on_plan(second_job, make_stored_plan(second_job, state, plates=1))
    context = farm.build_view_context(state)
    assert [(item.code, item.text) for item in list_tasks(context)] == [
        ("approve", f"approve job {first_job} (2 parts, 6 g): `farm approve {first_job}`"),
        ("reel", f"a has 4 g, {second_job}/p01 needs 8 g: load a reel, then `farm load a`"),
    ]
    assert [
        describe_job(context, farm.controller.books.get_job(n)).waits_for_person
        for n in (first_job, second_job)
    ] == [True] * 2
