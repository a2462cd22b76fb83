"""Order of the jobs in the queue, which people may change."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.make_books import apply_events, make_fleet_events, make_job, make_plan_event
from farm.model import JobOptions
from farm.scheduling.situation_builder import describe_plates
from farm.state import events as ev
from farm.state.books import Books
from farm.state.lifecycles import InvalidTransition


def make_queued_books(*priorities):
    """Make books with one queued job for each of these priorities."""
    events = (
        ev.JobSubmitted(
            at_s=0.0, job=make_job(n).model_copy(update={"options": JobOptions(priority=priority)})
        )
        for n, priority in enumerate(priorities, 1)
    )
    return apply_events(Books(), *make_fleet_events(), *events)[0]


def list_job_numbers(books):
    return [job.id for job in books.list_open_jobs()]


def move_job(books, number, next_number):
    return apply_events(books, ev.JobMoved(at_s=1.0, job=number, before=next_number, by="ann"))[0]


def test_jobs_are_served_by_priority_and_submission_until_they_are_moved():
    books = make_queued_books(0, 0, 5, 0)
    assert list_job_numbers(books) == [3, 1, 2, 4]
    books = move_job(books, 4, next_number=1)
    assert list_job_numbers(books) == [3, 4, 1, 2]
    # The job moves before one of a higher priority.
    assert list_job_numbers(move_job(books, 2, next_number=3)) == [2, 3, 4, 1]
    assert list_job_numbers(move_job(books, 3, next_number=None)) == [4, 1, 2, 3]
    assert [job.id for job in move_job(books, 2, next_number=3).list_unplanned_jobs()] == [2, 3, 4, 1]


@given(
    st.lists(st.integers(-2, 2), min_size=1, max_size=6),
    st.lists(st.tuples(st.integers(1, 6), st.one_of(st.none(), st.integers(1, 6))), max_size=12),
)
def test_moved_job_keeps_its_place_and_the_others_keep_their_order(priorities, moves):
    books = make_queued_books(*priorities)
    for number, next_number in moves:
        if number > len(priorities) or next_number == number or (next_number or 0) > len(priorities):
            continue
        other_numbers = [n for n in list_job_numbers(books) if n != number]
        index = len(other_numbers) if next_number is None else other_numbers.index(next_number)
        books = move_job(books, number, next_number)
        assert list_job_numbers(books) == [*other_numbers[:index], number, *other_numbers[index:]]
    later_event = ev.JobSubmitted(at_s=2.0, job=make_job(len(priorities) + 1))
    last_order = list_job_numbers(apply_events(books, later_event)[0])
    default_priority_numbers = [n for n in last_order if books.jobs.get(n, later_event.job).priority == 0]
    assert default_priority_numbers[-1] == len(priorities) + 1  # behind all jobs of its priority


def test_two_jobs_can_be_swapped_any_number_of_times():
    books = make_queued_books(0, 0, 0)
    for _ in range(200):
        first_number, second_number, _last = list_job_numbers(books)
        books = move_job(books, second_number, next_number=first_number)
        assert list_job_numbers(books)[:2] == [second_number, first_number]
    for _ in range(200):
        _first, second_number, third_number = list_job_numbers(books)
        books = move_job(books, second_number, next_number=None)
        assert list_job_numbers(books)[1:] == [third_number, second_number]
    later_books = apply_events(books, ev.JobSubmitted(at_s=2.0, job=make_job(4)))[0]
    assert list_job_numbers(later_books)[-1] == 4


def test_job_cannot_be_moved_before_a_job_that_is_not_in_the_queue():
    books = make_queued_books(0, 0)
    books, _ = apply_events(books, ev.JobCancelled(at_s=1.0, job=1))
    with pytest.raises(InvalidTransition, match="not in the queue"):
        move_job(books, 2, next_number=1)
    with pytest.raises(InvalidTransition):
        move_job(books, 1, next_number=2)


def test_plates_are_served_in_the_order_of_their_jobs():
    books = apply_events(Books(), *make_fleet_events())[0]
    for number in (1, 2):
        submitted_event = ev.JobSubmitted(at_s=0.0, job=make_job(number))
        books, _ = apply_events(
            books,
            submitted_event,
            ev.PlanningStarted(at_s=0.0, job=number),
            make_plan_event(number, plates=2),
        )
    books = move_job(books, 2, next_number=1)
    waiting_plates = sorted(
        describe_plates(books.list_waiting_plates(), books), key=lambda plate: plate.priority_key
    )
    assert [plate.id for plate in waiting_plates] == ["2/01", "2/02", "1/01", "1/02"]
