"""What has been printed, as a person sees it: the night, the jobs that are over, every print. Pure."""

from __future__ import annotations

from farm import api
from farm.model import Job, JobState, Print
from farm.state.books import Books
from farm.views.accounting import night, took_s, wasted
from farm.views.context import Scene
from farm.views.jobs import print_view

ENDED_SHOWN = 10
"""Jobs that are over: `farm history` has their prints."""


def shown_jobs(books: Books) -> list[Job]:
    """The jobs that go on or wait for a verdict, and the last of the others, in order of submission.

    A dry run that is over is nothing to a person.
    """
    going: list[Job] = []
    over: list[Job] = []
    for job in books.jobs.values():
        if job.options.dry_run and job.state.ended:
            continue
        (over if job.state.ended and job.state is not JobState.PRINTED else going).append(job)
    return sorted([*going, *sorted(over, key=lambda job: job.id)[-ENDED_SHOWN:]], key=lambda job: job.id)


def night_view(scene: Scene) -> api.NightView | None:
    """What was printed since the afternoon before."""
    came = night(scene.books, scene.books.prints.values(), scene.now_s)
    if came is None:
        return None
    return api.NightView(
        since=scene.moment(came.since_s) or "",
        plates=came.plates,
        printed=came.printed,
        failed=came.failed,
        printing=came.printing,
        waiting=came.waiting,
        grams=came.grams,
        wasted_grams=came.wasted_grams,
    )


def history(
    scene: Scene, job: int | None = None, printer: str | None = None, last: int = 100
) -> list[api.HistoryRow]:
    """The prints that ended last, of one job or printer or of all, oldest first."""
    ended = [
        attempt
        for attempt in scene.books.prints.values()
        if attempt.state.ended and job in (None, attempt.job) and printer in (None, attempt.printer)
    ]
    ended.sort(key=lambda attempt: (attempt.ended_s or 0.0, attempt.id))
    return [_history_row(scene, attempt) for attempt in ended[-last:]]


def _history_row(scene: Scene, attempt: Print) -> api.HistoryRow:
    plate = scene.books.plates[attempt.plate]
    return api.HistoryRow(
        **dict(print_view(scene, attempt)),
        job=attempt.job,
        name=scene.books.jobs[attempt.job].name,
        submitted_by=scene.books.jobs[attempt.job].submitted_by,
        took_s=took_s(attempt),
        expected_s=plate.estimated_s,
        grams=attempt.grams,
        wasted=wasted(attempt),
    )
