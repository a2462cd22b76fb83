"""Times of a job over its runs."""

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.make_books import apply_events, make_end_event, make_planned_books
from farm.config import Fleet
from farm.model import Verdict
from farm.paths import StateFolder
from farm.state import events as ev
from farm.views import ViewContext
from farm.views.jobs.times import compute_job_times, list_runs

FLEET = Fleet.model_validate(
    {"printers": [{"name": name, "model": "m", "port": f"/dev/{name}"} for name in "abc"]}
)
DAY_S = 86400.0


def compute_times(books, now_s):
    context = ViewContext(FLEET, books, {}, StateFolder(Path("/state")), now_s)
    return compute_job_times(context, books.get_job(1))


def make_attempt_events(name, plate, printer, started_s, ended_s):
    """Make the events of a completed print and of its bed, which is cleared at the same time."""
    return (
        ev.PlateAssigned(at_s=started_s, plate=plate, printer=printer, print_id=name),
        make_end_event(name, at_s=ended_s, started_s=started_s),
        ev.BedCleared(at_s=ended_s, printer=printer, by="ann"),
    )


@pytest.fixture
def done_books():
    """Make books with a job of two plates of 100 s, which were printed at the same time."""
    return apply_events(
        make_planned_books(),
        *make_attempt_events("x", "1/01", "a", 0.0, 100.0),
        *make_attempt_events("y", "1/02", "b", 0.0, 100.0),
    )[0]


def test_time_between_the_end_of_a_job_and_a_reprint_is_not_counted(done_books):
    first_times = compute_times(done_books, DAY_S)
    assert (first_times.elapsed_s, first_times.speedup, first_times.utilisation) == (100.0, 5.0, 1.0)
    repeated_event = ev.ReprintRequested(at_s=DAY_S, plate="1/01", why="lost", by="ann")
    books, _ = apply_events(
        done_books, repeated_event, *make_attempt_events("z", "1/01", "c", DAY_S + 50.0, DAY_S + 150.0)
    )
    second_times = compute_times(books, 3 * DAY_S)
    assert [(item.started_s, item.ended_s) for item in second_times.runs] == [
        (0.0, 100.0),
        (DAY_S + 50.0, DAY_S + 150.0),
    ]
    assert (second_times.elapsed_s, second_times.makespan_s, second_times.speedup) == (200.0, 200.0, 2.5)
    assert second_times.utilisation == pytest.approx(200.0 / 300.0)  # two printers, then one
    assert second_times.end_s == DAY_S + 150.0


def test_reprint_that_waits_for_a_printer_is_expected_to_take_its_own_time(done_books):
    repeated_event = ev.ReprintRequested(at_s=DAY_S, plate="1/01", why="lost", by="ann")
    waiting_times = compute_times(apply_events(done_books, repeated_event)[0], DAY_S + 5000.0)
    assert (waiting_times.elapsed_s, waiting_times.makespan_s) == (100.0, 200.0)
    assert waiting_times.end_s == DAY_S + 5100.0


def test_wait_for_a_printer_within_a_run_is_counted():
    books, _ = apply_events(
        make_planned_books(),
        *make_attempt_events("x", "1/01", "a", 0.0, 100.0),
        *make_attempt_events("y", "1/02", "a", 400.0, 500.0),
    )
    times = compute_times(books, DAY_S)
    assert (len(times.runs), times.elapsed_s, times.utilisation) == (1, 500.0, pytest.approx(0.4))


def test_cancelled_reprint_does_not_change_the_figures(done_books):
    old_times = compute_times(done_books, DAY_S)
    repeated_event = ev.ReprintRequested(at_s=DAY_S, plate="1/01", why="lost", by="ann")
    cancelled_books, _ = apply_events(
        done_books, repeated_event, ev.PlateCancelled(at_s=DAY_S + 9.0, plate="1/01", by="ann")
    )
    new_times = compute_times(cancelled_books, 2 * DAY_S)
    assert (new_times.elapsed_s, new_times.speedup) == (old_times.elapsed_s, old_times.speedup)


def test_part_judged_bad_later_begins_another_run():
    bad_event = ev.BedCleared(at_s=9000.0, printer="a", by="ann", verdict=Verdict.BAD, why="warped")
    books, _ = apply_events(
        make_planned_books(1), *make_attempt_events("x", "1/01", "a", 0.0, 100.0)[:2], bad_event
    )
    books, _ = apply_events(books, *make_attempt_events("y", "1/01", "a", 9100.0, 9200.0))
    assert [item.duration_s for item in compute_times(books, DAY_S).runs] == [100.0, 100.0]


SPANS = st.lists(st.tuples(st.floats(0.0, 1e5), st.floats(1.0, 1e5)), min_size=1, max_size=6)


@given(SPANS)
def test_runs_are_disjoint_and_each_print_is_in_one(spans):
    """Make one reprint after another, each some time after the end of the job."""
    books, at_s = make_planned_books(1), 0.0
    for number, (wait_s, duration_s) in enumerate(spans):
        at_s += 1.0 + wait_s
        if number:
            requested_event = ev.ReprintRequested(at_s=at_s, plate="1/01", why="", by="ann")
            books, _ = apply_events(books, requested_event)
        books, _ = apply_events(
            books, *make_attempt_events(f"x{number}", "1/01", "a", at_s, at_s + duration_s)
        )
        at_s += duration_s
    job = books.get_job(1)
    runs = list(list_runs(job, books.list_job_prints(job), at_s + DAY_S))
    assert len(runs) == len(spans) == len(job.reopenings) + 1
    assert all(item.ended_s <= next_run.started_s for item, next_run in pairwise(runs))
    assert sum(item.duration_s for item in runs) == pytest.approx(sum(duration_s for _, duration_s in spans))


def test_job_of_older_books_has_one_run():
    books, _ = apply_events(make_planned_books(1), *make_attempt_events("x", "1/01", "a", 0.0, 100.0))
    record = books.get_job(1).model_dump()
    del record["reopenings"]
    job = type(books.get_job(1)).model_validate(record)
    assert job.reopenings == ()
    assert len(list(list_runs(job, books.list_job_prints(job), DAY_S))) == 1


def test_end_of_a_paused_job_is_not_known_while_a_plate_waits(done_books):
    waiting_books = apply_events(
        done_books, ev.ReprintRequested(at_s=DAY_S, plate="1/01", why="lost", by="ann")
    )[0]
    paused_books = apply_events(waiting_books, ev.JobPaused(at_s=DAY_S, job=1, wanted=True, by="ann"))[0]
    resumed_books = apply_events(paused_books, ev.JobPaused(at_s=DAY_S, job=1, wanted=False, by="ann"))[0]
    ends_s = [compute_times(books, DAY_S).end_s for books in (waiting_books, paused_books, resumed_books)]
    assert ends_s == [DAY_S + 100.0, None, DAY_S + 100.0]
