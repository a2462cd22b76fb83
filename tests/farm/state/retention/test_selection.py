"""Selection of jobs to prune: ended ones, the oldest first, and none whose files are needed."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.make_books import apply_events, make_end_event, make_fleet_events, make_job, make_plan_event
from books.old_jobs import DAY_S, NOW_S, make_old_books
from farm.model import Bed, JobState, Outage, Verdict
from farm.state import events as ev
from farm.state.books import Books, put, replace_fields
from farm.state.lifecycles import InvalidTransition
from farm.state.retention import (
    MIN_AGE_S,
    RetentionRules,
    find_keep_reason,
    list_deletable_files,
    list_job_file_names,
    list_jobs_pruned_since_backup,
    list_prunable_files,
    list_referenced_files,
    select_jobs,
)
from farm.state.transitions import apply


def make_sizes(books, file_bytes=100):
    return dict.fromkeys(list_referenced_files(books), file_bytes)


def prune_job(books, number):
    return apply(ev.JobPruned(at_s=NOW_S, job=number, by="ann"), books)[0]


def test_expired_jobs_are_selected_oldest_first():
    books = make_old_books(
        (JobState.DONE, 91), (JobState.DONE, 89), (JobState.CANCELLED, 200), (JobState.PRINTING, 0)
    )
    rules = RetentionRules(max_age_days=90, max_bytes=1e12)
    assert select_jobs(books, make_sizes(books), rules, NOW_S, NOW_S) == [3, 1]


def test_oldest_jobs_are_selected_until_the_rest_fits():
    books = make_old_books(*((JobState.DONE, 10 + number) for number in range(5)))  # 7 files per job
    assert len(list_job_file_names(books, books.jobs[1])) == 7
    rules = RetentionRules(max_age_days=90, max_bytes=2500)
    # Two pruned jobs, which keep only their pictures, leave 3500 - 2 * 600 bytes.
    assert select_jobs(books, make_sizes(books), rules, NOW_S, NOW_S) == [
        5,
        4,
    ]
    assert select_jobs(books, make_sizes(books), RetentionRules(90, 3500), NOW_S, NOW_S) == []


def test_files_shared_with_another_job_are_not_freed():
    books = make_old_books((JobState.DONE, 20), (JobState.DONE, 10), shared_numbers=(1, 2))
    sizes = dict.fromkeys(list_referenced_files(books), 0) | {"shared.npz": 500}
    assert select_jobs(books, sizes, RetentionRules(90, 400), NOW_S, NOW_S) == [1, 2]
    assert select_jobs(books, sizes, RetentionRules(90, 500), NOW_S, NOW_S) == []


def test_recent_jobs_and_those_without_a_backup_are_not_selected():
    books = make_old_books((JobState.DONE, 1.9), (JobState.DONE, 5), (JobState.DONE, 2.1))
    full_rules = RetentionRules(max_age_days=2, max_bytes=0.0)
    assert select_jobs(books, make_sizes(books), full_rules, NOW_S, NOW_S) == [2, 3]
    assert select_jobs(books, make_sizes(books), full_rules, NOW_S, NOW_S - 3 * DAY_S) == [2]


@pytest.mark.parametrize("state", [s for s in JobState if s not in ("done", "failed", "cancelled")])
def test_job_that_is_open_or_not_judged_is_never_pruned(state):
    books = make_old_books((state, 500))
    assert select_jobs(books, make_sizes(books), RetentionRules(2, 0.0), NOW_S, NOW_S) == []
    with pytest.raises(InvalidTransition):
        prune_job(books, 1)


def test_part_on_a_bed_or_without_a_verdict_keeps_the_files():
    """Keep files that may be needed for a reprint after a verdict."""
    cancelled_event = ev.JobCancelled(at_s=201.0, job=1, by="ann")
    books, _ = apply_events(
        Books(),
        *make_fleet_events(),
        ev.JobSubmitted(at_s=0.0, job=make_job()),
        ev.PlanningStarted(at_s=0.0, job=1),
        make_plan_event(plates=2),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        make_end_event("x"),
        cancelled_event,
    )
    assert find_keep_reason(books, books.jobs[1]) == "on the bed of a"
    with pytest.raises(InvalidTransition, match="on the bed of a"):
        prune_job(books, 1)
    books, _ = apply_events(books, ev.BedCleared(at_s=300.0, printer="a", by="ann", verdict=Verdict.BAD))
    assert books.jobs[1].state is JobState.CANCELLED
    assert find_keep_reason(books, books.jobs[1]) is None


def test_open_print_keeps_the_files_of_a_cancelled_job():
    books, _ = apply_events(
        Books(),
        *make_fleet_events(),
        ev.JobSubmitted(at_s=0.0, job=make_job()),
        ev.PlanningStarted(at_s=0.0, job=1),
        make_plan_event(plates=1),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        ev.JobCancelled(at_s=3.0, job=1, by="ann"),
    )
    assert find_keep_reason(books, books.jobs[1]) == "being printed"


def test_pruned_job_keeps_its_pictures_and_is_not_printed_again():
    books = make_old_books((JobState.DONE, 100), (JobState.DONE, 100))
    event = ev.JobPruned(at_s=NOW_S, job=1, by="ann", part_pictures={"1/p01": "small.png"})
    new_books, instructions = apply(event, books)
    assert list_job_file_names(new_books, new_books.jobs[1]) == {"picture-1.png", "small.png"}
    assert instructions == (ev.LinkFiles(job=1),)
    assert list_job_file_names(new_books, new_books.jobs[2]) == list_job_file_names(books, books.jobs[2])
    with pytest.raises(InvalidTransition, match="pruned"):
        apply(ev.ReprintRequested(at_s=NOW_S, plate="1/01", why="", by="ann"), new_books)
    with pytest.raises(InvalidTransition, match="already pruned"):
        prune_job(new_books, 1)


def test_replaced_parts_keep_their_files_while_the_job_is_open():
    books = make_old_books((JobState.PRINTING, 0))
    books = put(books, replace_fields(books.jobs[1], parts=("1/p02",), plates=("1/02",)))
    assert {"1-p01.stl", "1-01.gcode"} <= list_referenced_files(books)


def test_jobs_with_missing_files_are_found_after_a_restore():
    books = make_old_books((JobState.DONE, 100), (JobState.PRINTING, 0))
    files = list_referenced_files(books) - {"1-p02.stl", "2-p02.stl"}
    assert list_jobs_pruned_since_backup(books, files) == [1]
    assert list_jobs_pruned_since_backup(prune_job(books, 1), files) == []


def test_no_job_counts_as_lost_if_the_store_is_unavailable():
    """Keep all jobs if the disk is not mounted, or if a person has moved the folder."""
    books = make_old_books((JobState.DONE, 100), (JobState.PRINTING, 0))
    assert list_jobs_pruned_since_backup(books, set()) == []
    other_files = list_referenced_files(books) - {"picture-1.png", "1-p01.stl"}
    assert list_jobs_pruned_since_backup(books, other_files) == []
    unplanned_books = put(books, replace_fields(books.jobs[1], picture=None, parts=(), plates=()))
    assert list_jobs_pruned_since_backup(unplanned_books, set()) == []


_job_lists = st.lists(st.tuples(st.sampled_from(JobState), st.floats(0, 400)), min_size=1, max_size=8)


@given(jobs=_job_lists, days=st.floats(2, 365), max_total_bytes=st.integers(0, 6000), data=st.data())
def test_only_unused_files_of_old_jobs_are_deleted(jobs, days, max_total_bytes, data):
    shared_numbers = data.draw(st.sets(st.integers(1, len(jobs))))
    bed = data.draw(st.sampled_from(Bed))
    books = make_old_books(*jobs, shared_numbers=shared_numbers)
    books = put(books, replace_fields(books.printers["a"], bed=bed), Outage(id=1, at_s=0.0, printers=()))
    sizes, rules = make_sizes(books), RetentionRules(days, max_total_bytes)
    selected_jobs = select_jobs(books, sizes, rules, NOW_S, NOW_S)
    new_books = books
    for number in selected_jobs:
        assert books.jobs[number].state in (JobState.DONE, JobState.FAILED, JobState.CANCELLED)
        assert books.jobs[number].ended_s < NOW_S - MIN_AGE_S
        new_books = prune_job(new_books, number)
    deleted_names = list_referenced_files(books) - list_referenced_files(new_books)
    assert list_deletable_files(new_books) == deleted_names and not list_deletable_files(books)
    assert deleted_names <= list_prunable_files(books, list_referenced_files(books), NOW_S)
    for number, job in books.jobs.items():
        if number not in selected_jobs:
            assert not list_job_file_names(books, job) & deleted_names
        assert job.picture in list_referenced_files(new_books)
    ended_times_s = [books.jobs[number].ended_s for number in selected_jobs]
    assert ended_times_s == sorted(ended_times_s)
    kept_jobs = [
        e
        for n, e in new_books.jobs.items()
        if n not in selected_jobs and find_keep_reason(new_books, e) is None
    ]
    old_jobs = [e for e in kept_jobs if e.ended_s < NOW_S - MIN_AGE_S]
    assert all(e.ended_s >= NOW_S - days * DAY_S for e in old_jobs)
    assert not old_jobs or sum(sizes[name] for name in list_referenced_files(new_books)) <= max_total_bytes
