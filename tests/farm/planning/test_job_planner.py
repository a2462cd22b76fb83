"""Planner with workers in one process: progress reports, and reuse of slices."""

import asyncio
import shutil
from dataclasses import replace
from itertools import chain, repeat

import pytest
import trimesh

from books.recording_controller import Farm
from clusters.same_process import SameProcess
from farm.config import Fleet
from farm.errors import ErrorCode, FarmError
from farm.model import Job, JobOptions, PlanProgress, PlanStep, TimeFactors
from farm.paths import StateFolder
from farm.planning import job_planner, plan_builder, slice_batch
from farm.planning.inspection.inspect_submission import inspect_model
from farm.planning.job_planner import MIN_FREE_BYTES, JobPlanner
from farm.planning.parts import drawings
from farm.planning.plan import MIN_REBALANCE_DELAY_S, Plan, PlanRequest, SlicedJob
from farm.planning.plan_builder import PlanBuilder
from farm.views import list_tasks

PRINTER_MODEL = "ultimaker2_plus"


@pytest.fixture
def state(tmp_path):
    folder = StateFolder(tmp_path / "state")
    folder.make()
    return folder


def plan_job(state, job, time_factor=1.0):
    """Plan a job for two printers with this time factor; return the planner's events and the plan."""
    printers = [{"name": n, "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}"} for n in "ab"]
    fleet = Fleet.model_validate({"printers": printers})
    reports = []

    async def main():
        future = asyncio.get_running_loop().create_future()
        planner = JobPlanner(
            state,
            SameProcess(),
            20.0,
            lambda _, result: future.set_result(result),
            lambda _, step_progress: reports.append(step_progress),
        )
        planner.start(
            PlanRequest(job, fleet.printers, time_factors=dict.fromkeys("ab", TimeFactors(time_factor)))
        )
        return await future

    return reports, asyncio.run(main())


@pytest.mark.usefixtures("without_pictures")
def test_plan_reports_progress_and_slices_nothing_twice(state, bar):
    def make_slicing_progress(done_count, cached_count=0):
        return PlanProgress(step=PlanStep.SLICING, done=done_count, of=2, cached=cached_count)

    waiting_progress = PlanProgress(step=PlanStep.WAITING)
    reports, first_plan = plan_job(state, bar)
    assert isinstance(first_plan, Plan), first_plan
    assert reports == [
        waiting_progress,
        make_slicing_progress(0),
        make_slicing_progress(1),
        make_slicing_progress(2),
    ]
    assert [plate.cached for plate in first_plan.plates] == [False, False]
    reports, second_plan = plan_job(state, bar.model_copy(update={"id": 2}), time_factor=1.1)
    assert reports == [
        waiting_progress,
        make_slicing_progress(0),
        make_slicing_progress(1, 1),
        make_slicing_progress(2, 2),
    ]
    assert [plate.cached for plate in second_plan.plates] == [True, True]
    assert [plate.sha256 for plate in second_plan.plates] == [plate.sha256 for plate in first_plan.plates]
    # The learned time factors are in the expected time without another slice.
    longest_plate = max(first_plan.plates, key=lambda plate: plate.expected_s)
    assert second_plan.expected_s == pytest.approx(longest_plate.compute_expected_s(TimeFactors(1.1)))
    assert not list(state.work.iterdir())


@pytest.fixture
def bar(state, tmp_path):
    """Make a job for a bar that two printers have to share."""
    path = tmp_path / "bar.stl"
    trimesh.creation.box((260.0, 14.0, 12.0)).export(path)
    options = JobOptions(engine="guillotine")
    model = inspect_model(path, "bar.stl", options, state.files)
    return Job(id=1, request_id="r" * 8, name="bar", model_file=model.file, options=options, submitted_s=0.0)


def slow_down_slices(monkeypatch, compute_delay_s, error=None):
    """Add seconds to the slices of parts; slices of parts that were cut again raise `error`."""
    slice_part, requests = slice_batch.slice_part, []

    def slice_slowly(task):
        requests.append(task.stl)
        if error and "rebalanced" in str(task.stl):
            raise error
        slice_result = slice_part(task)
        mesh = trimesh.load_mesh(task.stl)
        return replace(
            slice_result, sliced_s=slice_result.sliced_s + compute_delay_s(task.stl, mesh.extents.max())
        )

    monkeypatch.setattr(slice_batch, "slice_part", slice_slowly)
    return requests


@pytest.mark.usefixtures("without_pictures")
def test_part_with_a_slow_slice_is_cut_again(state, bar, monkeypatch):
    """Use a bar whose second part takes 10 s/mm longer; after the new cut, both parts end together."""
    slow_down_slices(monkeypatch, lambda stl, length_mm: 10.0 * length_mm * (stl.stem == "p02"))
    reports, result = plan_job(state, bar)
    assert isinstance(result, Plan), result
    steps = [step_progress.step for step_progress in reports]
    assert steps.count(PlanStep.REBALANCING) >= 1
    assert steps.index(PlanStep.REBALANCING) > steps.index(PlanStep.SLICING)
    first_s, second_s = (plate.sliced_s for plate in result.plates)
    assert second_s == pytest.approx(first_s, abs=2.0 * MIN_REBALANCE_DELAY_S)
    left_part, right_part = sorted(result.parts, key=lambda part: part.geometry.volume_mm3)
    assert left_part.geometry.volume_mm3 < 0.75 * right_part.geometry.volume_mm3
    assert left_part.geometry.volume_mm3 + right_part.geometry.volume_mm3 == pytest.approx(260 * 14 * 12)
    for part in result.parts:  # the last cut is in the books
        mesh = trimesh.load_mesh(state.files / part.file)
        assert mesh.volume == pytest.approx(part.geometry.volume_mm3, rel=1e-4)
    assert not list(state.work.iterdir())


@pytest.mark.usefixtures("without_pictures")
def test_cut_is_moved_for_a_small_gain_on_slow_printers(state, bar, monkeypatch):
    """Use printers that take three times as long for the layers, but as long as others to heat up."""
    slow_down_slices(monkeypatch, lambda stl, _: 100.0 * (stl.stem == "p02"))
    _, result = plan_job(state, bar, time_factor=3.0)
    assert isinstance(result, Plan), result
    first_part, second_part = result.parts
    assert second_part.geometry.volume_mm3 < 0.97 * first_part.geometry.volume_mm3
    first_s, second_s = (plate.expected_s for plate in result.plates)
    assert second_s == pytest.approx(first_s, abs=60.0)


@pytest.mark.parametrize(
    "error",
    [
        None,
        FarmError("the engine refuses it", ErrorCode.SLICE),
        OSError(28, "No space left"),
        ValueError("lp"),
    ],
)
@pytest.mark.usefixtures("without_pictures")
def test_useless_rebalance_is_discarded(state, bar, error, monkeypatch):
    """Use a part that takes longer after the new cut, or a slice that fails."""
    times_s = chain([600.0], repeat(9000.0))
    requests = slow_down_slices(
        monkeypatch, lambda stl, _: next(times_s) if stl.stem == "p02" else 0.0, error
    )
    reports, result = plan_job(state, bar)
    assert isinstance(result, Plan), result
    assert PlanStep.REBALANCING in [step_progress.step for step_progress in reports]
    assert any("rebalanced" in str(stl) for stl in requests)
    first_part, second_part = result.parts
    assert first_part.geometry.volume_mm3 == pytest.approx(second_part.geometry.volume_mm3, rel=0.05)
    assert result.plates[1].sliced_s - result.plates[0].sliced_s == pytest.approx(600.0, rel=0.1)


@pytest.mark.usefixtures("without_pictures")
def test_cut_is_moved_again_after_a_move_at_which_a_time_jumps(state, bar, monkeypatch):
    """Use a bar whose second part takes 600 s longer, and the first one 400 s as soon as it is longer."""
    sliced_times_s = []  # longest time of each slicing

    def compute_delay_s(stl, length_mm):
        return 600.0 if stl.stem == "p02" else 400.0 * (length_mm > 130.5)

    def record_job(*args):
        sliced_job = SlicedJob(*args)
        sliced_times_s.append(max(part.result.sliced_s for part in sliced_job.parts))
        return sliced_job

    slow_down_slices(monkeypatch, compute_delay_s)
    monkeypatch.setattr(plan_builder, "SlicedJob", record_job)
    _, result = plan_job(state, bar)
    assert isinstance(result, Plan), result
    first_s, moved_s, *later_s = sliced_times_s
    assert moved_s > first_s > min(later_s) + 60.0
    assert max(plate.sliced_s for plate in result.plates) == pytest.approx(min(later_s), abs=1.0)


class RecordingWorkers(SameProcess):
    """Workers that record their tasks, each in its own step of the event loop, and may suspend some calls."""

    def __init__(self, held_calls=(), has_idle_worker=True):
        self.started_calls, self.ended_calls = [], []
        self.held_calls, self.has_idle_worker = held_calls, has_idle_worker

    async def run(self, work, *args, limit=None, group=None):
        name = getattr(work, "target", "slow").rpartition(":")[2]
        number = sum(other_call.startswith(name) for other_call in self.started_calls)
        call = f"{name} {number}"
        self.started_calls.append(call)
        await asyncio.sleep(0)
        if call in self.held_calls:
            await asyncio.Event().wait()
        result = work(*args)
        self.ended_calls.append(call)
        return result


def plan_with_workers(state, job, workers, monkeypatch):
    monkeypatch.setattr(SameProcess, "run", workers.run)
    monkeypatch.setattr(SameProcess, "has_idle_worker", workers.has_idle_worker)
    return plan_job(state, job)[1]


def test_parts_are_drawn_while_they_are_sliced(state, bar, monkeypatch):
    workers = RecordingWorkers()
    result = plan_with_workers(state, bar, workers, monkeypatch)
    assert isinstance(result, Plan), result
    assert workers.started_calls == ["decompose_job 0", "slice_part 0", "slice_part 1", "draw_job_parts 0"]
    for name in (result.picture, result.assembly, result.instructions):
        assert (state.files / name).is_file()


def test_drawing_of_parts_that_are_cut_again_is_stopped(state, bar, monkeypatch):
    slow_down_slices(monkeypatch, lambda stl, length_mm: 10.0 * length_mm * (stl.stem == "p02"))
    workers = RecordingWorkers(held_calls={"draw_job_parts 0"})
    result = plan_with_workers(state, bar, workers, monkeypatch)
    assert isinstance(result, Plan), result
    assert {"draw_job_parts 0", "draw_job_parts 1"} <= set(
        workers.started_calls
    ) and "draw_job_parts 0" not in workers.ended_calls
    page = (state.files / result.instructions).read_text()
    left_mm, right_mm = (part.geometry.max_mm[0] - part.geometry.min_mm[0] for part in result.parts)
    assert left_mm != pytest.approx(right_mm, rel=0.1) and f"{left_mm:.0f} x" in page
    assert not list(state.work.iterdir())


def test_parts_that_may_be_cut_again_are_drawn_only_by_idle_workers(state, bar, monkeypatch):
    slow_down_slices(monkeypatch, lambda stl, length_mm: 10.0 * length_mm * (stl.stem == "p02"))
    workers = RecordingWorkers(has_idle_worker=False)
    result = plan_with_workers(state, bar, workers, monkeypatch)
    assert isinstance(result, Plan), result
    assert "rebalance_parts 0" in workers.started_calls
    assert [call for call in workers.started_calls if call.startswith("draw")] == ["draw_job_parts 0"]
    page = (state.files / result.instructions).read_text()
    left_mm, right_mm = (part.geometry.max_mm[0] - part.geometry.min_mm[0] for part in result.parts)
    assert left_mm != pytest.approx(right_mm, rel=0.1) and f"{left_mm:.0f} x" in page


def test_plan_without_its_drawing_fails(state, bar, monkeypatch):
    def refuse_drawing(*_):
        raise FarmError("no room for a picture")

    monkeypatch.setattr(drawings, "draw_job_parts", refuse_drawing)
    _, result = plan_job(state, bar)
    assert str(result) == "no room for a picture"
    assert not list(state.work.iterdir())


def test_plan_is_retried_after_a_full_disk(state, tmp_path, monkeypatch):
    """Retry the plan, because otherwise all jobs of a night would fail on a full disk."""
    usage, free_bytes = shutil.disk_usage(state.root), iter([MIN_FREE_BYTES - 1] * 3 + [MIN_FREE_BYTES] * 9)
    monkeypatch.setattr(job_planner, "_RETRY_INTERVAL_S", 0.0)
    monkeypatch.setattr(job_planner.shutil, "disk_usage", lambda _: usage._replace(free=next(free_bytes)))
    answers = iter([FarmError("the engine wrote half a file", ErrorCode.SLICE), OSError(28, "No space left")])

    class FullDisk:
        async def run(self, work, *args, limit=None, group=None):
            raise next(answers)

    reports, task_texts = [], []

    def record_progress(number, progress):
        reports.append(progress.step)
        farm = Farm(tmp_path / "farm")
        farm.controller.planning.on_progress(number, progress)
        task_texts.append(
            [item.text for item in list_tasks(farm.build_view_context(state)) if item.code == "farm"]
        )

    async def main():
        future = asyncio.get_running_loop().create_future()
        planner = JobPlanner(
            state, FullDisk(), 20.0, lambda _, result: future.set_result(result), record_progress
        )
        job = Job(id=7, request_id="r" * 8, name="x", model_file="x", options=JobOptions(), submitted_s=0.0)
        planner.start(PlanRequest(job, ()))
        return await future

    result = asyncio.run(main())
    assert reports == [PlanStep.WAITING, PlanStep.NO_ROOM, PlanStep.WAITING]
    assert "No space left" in str(result)  # the second time, there was free space: the job itself failed
    assert [len(texts) for texts in task_texts] == [0, 1, 0]
    assert "free some space" in task_texts[1][0] and "job 7" in task_texts[1][0]


def test_plan_that_cannot_be_recorded_fails_its_job(state, monkeypatch):
    """Fail the job, which would otherwise stay in planning until the next start of the daemon."""
    monkeypatch.setattr(PlanBuilder, "plan_model", lambda _: asyncio.sleep(0, object.__new__(Plan)))
    results = []

    def record_result(number, result):
        results.append(result)
        if isinstance(result, Plan):
            raise KeyError("p07")

    async def main():
        planner = JobPlanner(state, SameProcess(), 20.0, record_result, lambda *_: None)
        job = Job(id=7, request_id="r" * 8, name="x", model_file="x", options=JobOptions(), submitted_s=0.0)
        planner.start(PlanRequest(job, ()))
        while asyncio.all_tasks() - {asyncio.current_task()}:
            await asyncio.sleep(0)

    asyncio.run(main())
    assert isinstance(results[0], Plan)
    assert str(results[1]).startswith("its plan cannot be recorded: KeyError: 'p07'")
    assert len(results) == 2
