"""Report of a person that the parts of a job are glued."""

import pytest

from books.make_books import make_job, make_planned_books
from farm.model import Gluing, Job, JobOptions, JobState, compute_assembly_ratio
from farm.state import events as ev
from farm.state.books import put, replace_fields
from farm.state.lifecycles import InvalidTransition
from farm.state.transitions import apply


@pytest.mark.parametrize("state", [JobState.PRINTED, JobState.DONE])
def test_time_of_gluing_is_kept_and_replaced_by_a_later_report(state):
    books = make_planned_books()
    books = put(books, replace_fields(books.jobs[1], state=state))
    for minutes in (45.0, 40.0):
        books, instructions = apply(ev.JobAssembled(at_s=9.0, job=1, minutes=minutes, by="ann"), books)
        assert books.jobs[1].gluing == Gluing(minutes=minutes, at_s=9.0, by="ann")
        assert (books.jobs[1].state, list(instructions)) == (state, [])


def test_unprinted_parts_cannot_be_reported_as_glued():
    with pytest.raises(InvalidTransition):
        apply(ev.JobAssembled(at_s=9.0, job=1, minutes=45.0), make_planned_books())


def test_expected_time_follows_the_reported_times_within_bounds():
    def make_glued_job(minutes: float, expected_s: float | None = 3600.0) -> Job:
        return make_job().model_copy(
            update={"assembly_s": expected_s, "gluing": Gluing(minutes=minutes, at_s=0.0, by="ann")}
        )

    assert (
        compute_assembly_ratio([])
        == compute_assembly_ratio([make_job()])
        == compute_assembly_ratio([make_glued_job(99.0, None)])
        == 1.0
    )
    assert compute_assembly_ratio([make_glued_job(60.0)]) == pytest.approx(1.0)
    # A single report counts half.
    assert compute_assembly_ratio([make_glued_job(90.0)]) == pytest.approx(1.25)
    assert compute_assembly_ratio([make_glued_job(90.0)] * 9) == pytest.approx(1.45)
    assert compute_assembly_ratio([make_glued_job(9_000.0)]) == pytest.approx(2.5)  # limited to 240 minutes
    assert compute_assembly_ratio([make_glued_job(0.1)] * 99) == pytest.approx(0.2575)
    # Correct reports outweigh a wrong one.
    assert compute_assembly_ratio([make_glued_job(9_000.0), *[make_glued_job(60.0)] * 9]) < 1.3


def test_print_deadline_leaves_time_for_the_gluing():
    options = JobOptions(assembled_by="18:00")
    waiting_job = make_job().model_copy(update={"options": options, "assembled_by_s": 10_000.0})
    assert waiting_job.compute_print_deadline_s(1.5) == 10_000.0
    expected_job = waiting_job.model_copy(update={"assembly_s": 3_000.0})
    assert (expected_job.compute_print_deadline_s(1.0), expected_job.compute_print_deadline_s(1.5)) == (
        7_000.0,
        5_500.0,
    )
    assert make_job().compute_print_deadline_s(1.5) is None
