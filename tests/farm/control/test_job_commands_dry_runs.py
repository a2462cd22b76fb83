"""Dry runs end when no client requests their plan."""

import asyncio

import pytest

from books.make_books import make_job as make_job
from books.make_books import make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from farm.control.job_commands import DRY_RUN_TIMEOUT_S, PAGE_DRY_RUN_TIMEOUT_S, DryRuns
from farm.errors import RefusedError
from farm.model import JobOptions, JobState
from farm.planning.plan import Plan
from farm.state import events as ev
from farm.state.books import Books
from farm.views.tasks import list_request_tasks


def submit_job(farm, name, **options):
    return farm.jobs.submit(name * 8, "m.stl", INSPECTED_MODEL, JobOptions(**options), "ann")[0]


def test_abandoned_dry_run_is_cancelled(tmp_path):
    farm = Farm(tmp_path)
    kept_job, abandoned_job = (submit_job(farm, name, dry_run=True, hold=True) for name in "ab")
    held_job = submit_job(farm, "c", hold=True)
    dry_runs = DryRuns(farm.controller)
    dry_runs.cancel_abandoned_runs(0.0)
    dry_runs.keep(kept_job, DRY_RUN_TIMEOUT_S)
    dry_runs.cancel_abandoned_runs(DRY_RUN_TIMEOUT_S)
    jobs = farm.controller.books.jobs
    assert not any(job.state.ended for job in jobs.values())
    dry_runs.cancel_abandoned_runs(DRY_RUN_TIMEOUT_S + 1.0)
    jobs = farm.controller.books.jobs
    assert [jobs[n].state.ended for n in (kept_job, abandoned_job, held_job)] == [False, True, False]
    assert jobs[abandoned_job].reason == "cancelled by the farm: nobody is waiting for its plan any more"
    dry_runs.cancel_abandoned_runs(3 * DRY_RUN_TIMEOUT_S)
    assert farm.controller.books.jobs[kept_job].state is JobState.CANCELLED


def test_dry_run_needs_no_approval():
    options = JobOptions(dry_run=True, hold=True)
    held_job = make_job().model_copy(update={"options": options, "state": JobState.HELD})
    assert list_request_tasks(Books.from_entities([held_job]), {}) == []
    assert (
        len(
            list_request_tasks(
                Books.from_entities([held_job.model_copy(update={"options": JobOptions(hold=True)})]), {}
            )
        )
        == 1
    )


def test_page_keeps_a_dry_run_for_longer_than_a_command_does(tmp_path):
    farm = Farm(tmp_path)
    number = submit_job(farm, "a", dry_run=True, hold=True)
    dry_runs = DryRuns(farm.controller)
    dry_runs.keep(number, 0.0, PAGE_DRY_RUN_TIMEOUT_S)
    dry_runs.keep(number, 1.0)  # a command counts as a request too
    dry_runs.cancel_abandoned_runs(PAGE_DRY_RUN_TIMEOUT_S)
    assert not farm.controller.books.get_job(number).state.ended
    dry_runs.cancel_abandoned_runs(PAGE_DRY_RUN_TIMEOUT_S + 1.0)
    assert farm.controller.books.get_job(number).state.ended


def test_kept_dry_run_is_held_until_its_plan_is_approved(tmp_path):
    farm = Farm(tmp_path)
    number = submit_job(farm, "a", dry_run=True, hold=True)
    farm.jobs.keep_dry_run(number, "ann")
    job = farm.controller.books.get_job(number)
    assert (job.options.dry_run, job.options.hold) == (False, True)
    DryRuns(farm.controller).cancel_abandoned_runs(1e9)
    assert not farm.controller.books.get_job(number).state.ended
    with pytest.raises(RefusedError, match="is not a dry run"):
        farm.jobs.keep_dry_run(number, "ann")


def test_dry_run_may_be_printed_by_the_person_who_submitted_it(tmp_path):
    farm = Farm(tmp_path)
    number = submit_job(farm, "a", dry_run=True, hold=True)
    with pytest.raises(RefusedError, match="only an operator"):
        asyncio.run(farm.jobs.release(number, None, "bob", is_operator=False))
    asyncio.run(farm.jobs.release(number, None, "ann", is_operator=False))
    job = farm.controller.books.get_job(number)
    assert (job.options.dry_run, job.options.hold) == (False, False)


def test_approved_dry_run_is_not_cancelled(tmp_path):
    farm = Farm(tmp_path)
    farm.report_ready("a", "b")
    number = submit_job(farm, "a", dry_run=True, hold=True)
    event = make_plan_event(number)
    farm.controller.on_plan(number, Plan(event.parts, event.plates, (), 1.0, 500.0))
    farm.controller.handle(ev.JobApproved(at_s=1.0, job=number, by="ann"))
    dry_runs = DryRuns(farm.controller)
    dry_runs.cancel_abandoned_runs(0.0)
    dry_runs.cancel_abandoned_runs(1e9)
    assert farm.controller.books.get_job(number).state is JobState.PRINTING


def test_model_is_planned_again_without_another_upload(tmp_path):
    farm = Farm(tmp_path)
    number = submit_job(farm, "a", dry_run=True, hold=True)
    new_number = farm.jobs.resubmit(number, "b" * 8, JobOptions(printers=2, dry_run=True, hold=True), "ann")
    first_job, second_job = (farm.controller.books.get_job(n) for n in (number, new_number))
    assert (second_job.model_file, second_job.name, second_job.repairs) == (
        first_job.model_file,
        first_job.name,
        first_job.repairs,
    )
    assert second_job.options.printers == 2
    farm.jobs.cancel(number, "ann")
    farm.controller.handle(ev.JobPruned(at_s=1.0, job=number, by="ann"))
    with pytest.raises(RefusedError, match="were pruned"):
        farm.jobs.resubmit(number, "c" * 8, JobOptions(), "ann")
