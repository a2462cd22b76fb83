"""Planner with workers in one process: progress reports, and reuse of slices."""

import asyncio
import shutil
from dataclasses import replace

import pytest
import trimesh

from farm.config import Fleet
from farm.errors import ErrorCode, FarmError
from farm.model import Job, JobOptions, PlanProgress, PlanStep
from farm.paths import StateFolder
from farm.planning import job_planner, slice_batch
from farm.planning.inspection.inspect_submission import inspect_model
from farm.planning.job_planner import ROOM_BYTES, JobPlanner
from farm.planning.parts import drawings
from farm.planning.plan import Plan, PlanRequest
from farm.planning.plan_builder import PlanBuilder
from farm.views import list_tasks
from recording_controller import Farm
from same_process import SameProcess

MODEL = "ultimaker2_plus"


@pytest.fixture
def state(tmp_path):
    folder = StateFolder(tmp_path / "state")
    folder.make()
    return folder


def plan(state, job, factor=1.0):
    """Return the planner's events of a job, and its plan for two printers with that factor."""
    printers = [{"name": n, "model": MODEL, "port": f"sim://{MODEL}"} for n in "ab"]
    fleet = Fleet.model_validate({"printers": printers})
    reports = []

    async def main():
        done = asyncio.get_running_loop().create_future()
        planner = JobPlanner(
            state,
            SameProcess(),
            20.0,
            lambda _, result: done.set_result(result),
            lambda _, step_progress: reports.append(step_progress),
        )
        planner.start(PlanRequest(job, fleet.printers, time_factors=dict.fromkeys("ab", factor)))
        return await done

    return reports, asyncio.run(main())


@pytest.mark.usefixtures("without_pictures")
def test_plan_reports_progress_and_slices_nothing_twice(state, bar):
    def slicing(done, cached=0):
        return PlanProgress(step=PlanStep.SLICING, done=done, of=2, cached=cached)

    waiting = PlanProgress(step=PlanStep.WAITING)
    reports, first = plan(state, bar)
    assert isinstance(first, Plan), first
    assert reports == [waiting, slicing(0), slicing(1), slicing(2)]
    assert [plate.cached for plate in first.plates] == [False, False]
    reports, again = plan(state, bar.model_copy(update={"id": 2}), factor=1.1)
    assert reports == [waiting, slicing(0), slicing(1, 1), slicing(2, 2)]
    assert [plate.cached for plate in again.plates] == [True, True]
    assert [plate.sha256 for plate in again.plates] == [plate.sha256 for plate in first.plates]
    # What was learned of the printers is in the expected time, without slicing anew.
    longest = max(first.plates, key=lambda plate: plate.expected_s)
    assert again.expected_s == pytest.approx(longest.compute_expected_s(1.1))
    assert not list(state.work.iterdir())


@pytest.fixture
def bar(state, tmp_path):
    """A job for a bar that two printers have to share, and the books' file of it."""
    path = tmp_path / "bar.stl"
    trimesh.creation.box((260.0, 14.0, 12.0)).export(path)
    options = JobOptions(engine="guillotine")
    model = inspect_model(path, "bar.stl", options, state.files)
    return Job(id=1, request_id="r" * 8, name="bar", model_file=model.file, options=options, submitted_s=0.0)


def slowed(monkeypatch, late_s, fail=None):
    """Add seconds to the slices of parts; slices of parts that were cut again fail with `fail`."""
    slice_part, requests = slice_batch.slice_part, []

    def slow(task):
        requests.append(task.stl)
        if fail and "levelled" in str(task.stl):
            raise fail
        sliced = slice_part(task)
        mesh = trimesh.load_mesh(task.stl)
        return replace(sliced, sliced_s=sliced.sliced_s + late_s(task.stl, mesh.extents.max()))

    monkeypatch.setattr(slice_batch, "slice_part", slow)
    return requests


@pytest.mark.usefixtures("without_pictures")
def test_part_with_a_slow_slice_is_cut_again(state, bar, monkeypatch):
    """One end of the bar takes ten seconds a mm longer; after it both ends end together."""
    slowed(monkeypatch, lambda stl, length_mm: 10.0 * length_mm * (stl.stem == "p02"))
    reports, result = plan(state, bar)
    assert isinstance(result, Plan), result
    steps = [step_progress.step for step_progress in reports]
    assert steps.count(PlanStep.LEVELLING) >= 1
    assert steps.index(PlanStep.LEVELLING) > steps.index(PlanStep.SLICING)
    a, b = (plate.sliced_s for plate in result.plates)
    assert b == pytest.approx(a, rel=0.03)
    left, right = sorted(result.parts, key=lambda part: part.geometry.volume_mm3)
    assert left.geometry.volume_mm3 < 0.75 * right.geometry.volume_mm3
    assert left.geometry.volume_mm3 + right.geometry.volume_mm3 == pytest.approx(260 * 14 * 12)
    for part in result.parts:  # what is booked is what was cut last
        mesh = trimesh.load_mesh(state.files / part.file)
        assert mesh.volume == pytest.approx(part.geometry.volume_mm3, rel=1e-4)
    assert not list(state.work.iterdir())


@pytest.mark.parametrize(
    "fail",
    [
        None,
        FarmError("the engine refuses it", ErrorCode.SLICE),
        OSError(28, "No space left"),
        ValueError("lp"),
    ],
)
@pytest.mark.usefixtures("without_pictures")
def test_useless_relevel_is_discarded(state, bar, fail, monkeypatch):
    """The part is slower after it was sliced again, or something fails."""
    times = iter([600.0, 9000.0])
    requests = slowed(monkeypatch, lambda stl, _: next(times) if stl.stem == "p02" else 0.0, fail)
    reports, result = plan(state, bar)
    assert isinstance(result, Plan), result
    assert PlanStep.LEVELLING in [step_progress.step for step_progress in reports]
    assert any("levelled" in str(stl) for stl in requests)
    first, second = result.parts
    assert first.geometry.volume_mm3 == pytest.approx(second.geometry.volume_mm3, rel=0.05)
    assert result.plates[1].sliced_s - result.plates[0].sliced_s == pytest.approx(600.0, rel=0.1)


class NotingWorkers(SameProcess):
    """Workers that note their tasks, each in a turn of the event loop of its own; drawings may be held."""

    def __init__(self, held=(), has_idle=True):
        self.begun, self.ended, self.held, self.has_idle = [], [], held, has_idle

    async def run(self, work, *args, limit=None, group=None):
        name = getattr(work, "target", "slow").rpartition(":")[2]
        number = sum(other.startswith(name) for other in self.begun)
        call = f"{name} {number}"
        self.begun.append(call)
        await asyncio.sleep(0)
        if call in self.held:
            await asyncio.Event().wait()
        result = work(*args)
        self.ended.append(call)
        return result


def plan_noted(state, job, workers, monkeypatch):
    monkeypatch.setattr(SameProcess, "run", workers.run)
    monkeypatch.setattr(SameProcess, "has_idle", workers.has_idle)
    return plan(state, job)[1]


def test_parts_are_drawn_while_they_are_sliced(state, bar, monkeypatch):
    workers = NotingWorkers()
    result = plan_noted(state, bar, workers, monkeypatch)
    assert isinstance(result, Plan), result
    assert workers.begun == ["decompose_job 0", "slice_part 0", "slice_part 1", "draw_job 0"]
    for name in (result.picture, result.assembly, result.instructions):
        assert (state.files / name).is_file()


def test_the_drawing_of_parts_that_are_cut_again_is_stopped(state, bar, monkeypatch):
    slowed(monkeypatch, lambda stl, length_mm: 10.0 * length_mm * (stl.stem == "p02"))
    workers = NotingWorkers(held={"draw_job 0"})
    result = plan_noted(state, bar, workers, monkeypatch)
    assert isinstance(result, Plan), result
    assert {"draw_job 0", "draw_job 1"} <= set(workers.begun) and "draw_job 0" not in workers.ended
    page = (state.files / result.instructions).read_text()
    left, right = (part.geometry.max_mm[0] - part.geometry.min_mm[0] for part in result.parts)
    assert left != pytest.approx(right, rel=0.1) and f"{left:.0f} x" in page
    assert not list(state.work.iterdir())


def test_parts_that_may_be_cut_again_are_drawn_by_idle_workers_alone(state, bar, monkeypatch):
    slowed(monkeypatch, lambda stl, length_mm: 10.0 * length_mm * (stl.stem == "p02"))
    workers = NotingWorkers(has_idle=False)
    result = plan_noted(state, bar, workers, monkeypatch)
    assert isinstance(result, Plan), result
    assert "relevel_parts 0" in workers.begun
    assert [call for call in workers.begun if call.startswith("draw")] == ["draw_job 0"]
    page = (state.files / result.instructions).read_text()
    left, right = (part.geometry.max_mm[0] - part.geometry.min_mm[0] for part in result.parts)
    assert left != pytest.approx(right, rel=0.1) and f"{left:.0f} x" in page


def test_a_plan_without_its_drawing_fails(state, bar, monkeypatch):
    def refuse(*_):
        raise FarmError("no room for a picture")

    monkeypatch.setattr(drawings, "draw_job", refuse)
    _, result = plan(state, bar)
    assert str(result) == "no room for a picture"
    assert not list(state.work.iterdir())


def test_plan_is_retried_after_a_full_disk(state, tmp_path, monkeypatch):
    """Jobs that wait for a full disk in a night would fail one after the other."""
    usage, looks = shutil.disk_usage(state.root), iter([ROOM_BYTES - 1] * 3 + [ROOM_BYTES] * 9)
    monkeypatch.setattr(job_planner, "_RETRY_S", 0.0)
    monkeypatch.setattr(job_planner.shutil, "disk_usage", lambda _: usage._replace(free=next(looks)))
    answers = iter([FarmError("the engine wrote half a file", ErrorCode.SLICE), OSError(28, "No space left")])

    class FullDisk:
        async def run(self, work, *args, limit=None, group=None):
            raise next(answers)

    reports, scenes = [], []

    def tell(number, progress):
        reports.append(progress.step)
        farm = Farm(tmp_path / "farm")
        farm.controller.on_plan_progress(number, progress)
        scenes.append([item.text for item in list_tasks(farm.view_context(state)) if item.code == "farm"])

    async def main():
        done = asyncio.get_running_loop().create_future()
        planner = JobPlanner(state, FullDisk(), 20.0, lambda _, result: done.set_result(result), tell)
        job = Job(id=7, request_id="r" * 8, name="x", model_file="x", options=JobOptions(), submitted_s=0.0)
        planner.start(PlanRequest(job, ()))
        return await done

    result = asyncio.run(main())
    assert reports == [PlanStep.WAITING, PlanStep.NO_ROOM, PlanStep.WAITING]
    assert "No space left" in str(result)  # the second time there was room: it is the job's own
    assert [len(texts) for texts in scenes] == [0, 1, 0]
    assert "free space" in scenes[1][0] and "job 7" in scenes[1][0]


def test_plan_that_cannot_be_recorded_fails_its_job(state, monkeypatch):
    """Such a job stayed in planning until the next start of the daemon, with only a line in the log."""
    monkeypatch.setattr(PlanBuilder, "plan_model", lambda _: asyncio.sleep(0, object.__new__(Plan)))
    reports = []

    def done(number, result):
        reports.append(result)
        if isinstance(result, Plan):
            raise KeyError("p07")

    async def main():
        planner = JobPlanner(state, SameProcess(), 20.0, done, lambda *_: None)
        job = Job(id=7, request_id="r" * 8, name="x", model_file="x", options=JobOptions(), submitted_s=0.0)
        planner.start(PlanRequest(job, ()))
        while asyncio.all_tasks() - {asyncio.current_task()}:
            await asyncio.sleep(0)

    asyncio.run(main())
    assert isinstance(reports[0], Plan)
    assert str(reports[1]).startswith("its plan was refused: KeyError: 'p07'")
    assert len(reports) == 2
