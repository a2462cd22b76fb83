"""Cached contents of jobs: a view from the cache equals a fresh one after any changes."""

from dataclasses import replace
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from books.make_books import apply_events, make_job, make_planned_books
from farm import api
from farm.config import Fleet
from farm.model import Hold, HoldCode, PrintState, Verdict
from farm.paths import StateFolder
from farm.state import events as ev
from farm.state.books import put
from farm.views import JobCache, ViewContext, describe_jobs, group_waits, summarise_jobs
from farm.views import job_cache as module
from farm.views.job_cache import JobVersionCache
from farm.wording import group_holds

FLEET = Fleet.model_validate(
    {
        "printers": [
            {"name": name, "model": "ultimaker2_plus", "port": "sim://ultimaker2_plus"} for name in "ab"
        ]
    }
)
PLATES = ("1/01", "1/02")
HOLDS = [Hold(code=HoldCode.PRINTER_BUSY, text="a is printing"), Hold(code=HoldCode.PAUSED, text="paused")]


def make_context(books, cache, now_s, holds):
    """Make the context of a view with new hold objects, as the scheduler does."""
    copies = {plate: hold.model_copy() for plate, hold in holds.items()}
    return ViewContext(
        FLEET, books, {}, StateFolder(Path("/state")), now_s, plate_holds=copies, job_cache=cache
    )


def describe_all_jobs(books, cache, now_s, holds):
    return describe_jobs(make_context(books, cache, now_s, holds), books.jobs.values())


def assign_plate(books, plate, number):
    """Assign a plate to a printer, and use the number as the id of its print."""
    event = ev.PlateAssigned(at_s=float(number), plate=plate, printer="ab"[number % 2], print_id=str(number))
    return apply_events(books, event)[0]


def change_books(books, step):
    """Change one thing in the books: a job, a part, a plate or a print."""
    number, kind, plate, state, verdict = step
    job = books.jobs[1]
    if kind == "job":
        return put(books, job.model_copy(update={"paused": not job.paused, "pruned_s": 9.0}))
    if kind == "part":
        part = books.parts[books.plates[plate].parts[0]]
        return put(books, part.model_copy(update={"copy_number": number + 1}))
    if kind == "plate":
        return put(books, books.plates[plate].model_copy(update={"warnings": (str(number),)}))
    if books.prints:
        *_, attempt = books.prints.values()
        changes = {"state": state, "verdict": verdict, "started_s": 3.0, "ended_s": 4.0 + number}
        return put(books, attempt.model_copy(update=changes))
    return assign_plate(books, plate, number)


steps = st.tuples(
    st.integers(0, 5),
    st.sampled_from(["job", "part", "plate", "print"]),
    st.sampled_from(PLATES),
    st.sampled_from([PrintState.PRINTING, PrintState.DONE, PrintState.FAILED]),
    st.sampled_from([None, *Verdict]),
)
hold_sets = st.dictionaries(st.sampled_from(PLATES), st.sampled_from(HOLDS))


@given(st.lists(st.tuples(st.none() | steps, hold_sets), min_size=1, max_size=8))
def test_cached_view_equals_a_fresh_one(steps_and_holds):
    books, cache = make_planned_books(plates=2), JobCache()
    for now_s, (step, holds) in enumerate(steps_and_holds, 10):
        books = books if step is None else change_books(books, step)
        views = describe_all_jobs(books, cache, now_s, holds)
        assert views == describe_all_jobs(books, JobCache(), now_s, holds)
        context, jobs = make_context(books, cache, now_s, holds), books.jobs.values()
        for summary, view in zip(summarise_jobs(context, jobs), views, strict=True):
            assert summary.plate_count == len(view.plates)
            names = api.JobOverview.model_fields
            assert all(getattr(summary, name) == getattr(view, name) for name in names)
        waits = group_waits(context, jobs)
        assert [(wait.hold, wait.names) for wait in waits] == group_holds(views)
        for wait in waits:
            waiting_plates = [p for view in views for p in view.plates if p.id in wait.plates]
            assert [p.id for p in waiting_plates] == wait.plates
            assert [part for p in waiting_plates for part in p.parts] == wait.names


def test_unchanged_parts_and_plates_are_not_described_again():
    books, cache = make_planned_books(plates=2), JobCache()
    (first_view,) = describe_all_jobs(books, cache, 10.0, dict.fromkeys(PLATES, HOLDS[0]))
    (second_view,) = describe_all_jobs(books, cache, 11.0, {PLATES[0]: HOLDS[0], PLATES[1]: HOLDS[1]})
    assert all(map(lambda old, new: old is new, first_view.parts, second_view.parts))
    assert first_view.plates[0] is second_view.plates[0] and first_view.plates[1].hold == HOLDS[0]
    assert second_view.plates[1].hold == HOLDS[1]


def test_cache_keeps_a_limited_number_of_jobs(monkeypatch):
    monkeypatch.setattr(module, "MAX_JOBS", 2)
    cache, books = JobVersionCache(), put(make_planned_books(), *(make_job(number) for number in (2, 3)))
    books = replace(books, _job_versions=dict.fromkeys((1, 2, 3), "first"))
    described_jobs = []

    def find_contents(job):
        return cache.find(books, job, lambda: described_jobs.append(job) or job)

    assert [find_contents(job) for job in (1, 1, 2, 3, 3, 1)] == [1, 1, 2, 3, 3, 1]
    assert described_jobs == [1, 2, 3, 1]
