"""Dry runs end when no client requests their plan."""

from farm.control.dry_runs import PATIENCE_S, DryRuns
from farm.model import JobOptions, JobState
from farm.state.books import Books
from farm.views.tasks import list_requests
from make_books import job as make_job
from recording_controller import MODEL, Farm


def submit(farm, name, **options):
    return farm.jobs.submit(name * 8, "m.stl", MODEL, JobOptions(**options))[0]


def test_abandoned_dry_run_is_cancelled(tmp_path):
    farm = Farm(tmp_path)
    expected, removed = (submit(farm, name, dry_run=True, hold=True) for name in "ab")
    held = submit(farm, "c", hold=True)
    dry_runs = DryRuns(farm.controller)
    dry_runs.cancel_abandoned(0.0)
    dry_runs.keep(expected, PATIENCE_S)
    dry_runs.cancel_abandoned(PATIENCE_S)
    jobs = farm.controller.books.jobs
    assert not any(job.state.ended for job in jobs.values())
    dry_runs.cancel_abandoned(PATIENCE_S + 1.0)
    jobs = farm.controller.books.jobs
    assert [jobs[n].state.ended for n in (expected, removed, held)] == [False, True, False]
    assert jobs[removed].reason == "cancelled by the farm: nobody waits for its plan any more"
    dry_runs.cancel_abandoned(3 * PATIENCE_S)
    assert farm.controller.books.jobs[expected].state is JobState.CANCELLED


def test_dry_run_needs_no_approval():
    options = JobOptions(dry_run=True, hold=True)
    held = make_job().model_copy(update={"options": options, "state": JobState.HELD})
    assert list_requests(Books.from_entities([held]), {}) == []
    assert (
        len(
            list_requests(
                Books.from_entities([held.model_copy(update={"options": JobOptions(hold=True)})]), {}
            )
        )
        == 1
    )
