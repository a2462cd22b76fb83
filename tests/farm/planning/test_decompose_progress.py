"""Progress of a decomposition: written by its worker, read by the daemon."""

import asyncio

import pytest

from decompose.best import listen_to_progress, report_progress
from farm.model import PlanStep
from farm.paths import StateFolder
from farm.planning import plan_builder
from farm.planning.decompose_progress import (
    PROGRESS_FILE_NAME,
    DecomposeProgress,
    ProgressFile,
    ProgressRate,
    read_share,
)
from farm.planning.plan_builder import PlanBuilder
from farm.planning.tasks import decompose_job


def test_remaining_time_follows_from_the_rate_so_far():
    rate = ProgressRate()
    assert rate.estimate_progress(0.0, 100.0) == DecomposeProgress(share=0.0)
    assert rate.estimate_progress(0.1, 110.0) == DecomposeProgress(share=0.1)
    progress = rate.estimate_progress(0.25, 120.0)
    assert (progress.share, progress.remaining_s) == (0.25, pytest.approx(50.0))


def test_reports_of_one_interval_are_written_once(tmp_path):
    progress = ProgressFile(tmp_path)
    assert read_share(tmp_path) is None
    for share, now_s in ((0.1, 110.0), (0.15, 110.2)):
        progress.report(share, now_s)
    assert read_share(tmp_path) == 0.1
    progress.report(0.25, 120.0)
    assert read_share(tmp_path) == 0.25


def test_unreadable_and_unwritable_files_cause_no_error(tmp_path):
    (tmp_path / PROGRESS_FILE_NAME).write_text('{"share": ')
    assert read_share(tmp_path) is None
    ProgressFile(tmp_path / "missing").report(0.5, 1.0)


def test_progress_is_reported_only_to_the_listener_of_its_context():
    reports = []
    with listen_to_progress(reports.append):
        report_progress(0.5)
    report_progress(0.6)
    assert reports == [0.5]


def test_planner_shows_the_progress_that_a_decomposition_reports(tmp_path, monkeypatch):
    """Run a worker that decomposes until a progress of 50 % has been shown."""
    monkeypatch.setattr(plan_builder, "_POLL_INTERVAL_S", 0.0)
    shown_progress, is_quarter_shown, is_half_shown = [], asyncio.Event(), asyncio.Event()

    class Worker:
        async def run(self, work, task, limit=None):
            assert work is decompose_job
            ProgressFile(tmp_path).report(0.25, 0.0)
            await is_quarter_shown.wait()
            ProgressFile(tmp_path).report(0.5, 10.0)
            await is_half_shown.wait()
            raise RuntimeError("ended")

    def record_progress(progress):
        shown_progress.append(progress)
        if progress.share == 0.25:
            is_quarter_shown.set()
        if progress.share == 0.5:
            is_half_shown.set()

    class Task:
        folder = tmp_path

    with pytest.raises(RuntimeError, match="ended"):
        asyncio.run(PlanBuilder(Task(), Worker(), StateFolder(tmp_path), record_progress).plan_model())
    assert shown_progress[0].step is PlanStep.WAITING
    last_progress = shown_progress[-1]
    assert (last_progress.step, last_progress.share) == (PlanStep.DECOMPOSING, 0.5)
    assert last_progress.remaining_s is not None and last_progress.remaining_s > 0.0
