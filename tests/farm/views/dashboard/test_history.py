"""History of ended prints."""

import pytest

from farm.errors import NotFoundError
from farm.model import PrintState, Verdict
from farm.views.dashboard import HistoryFilter, describe_history, select_prints
from farms.dashboard_farm import (
    DAY_S,
    START_S,
    add_planned_job,
    add_print,
    judge_print,
    make_context,
    make_empty_books,
)

NOW_S = START_S + 10 * DAY_S


def make_books_of_ten_days():
    books = add_planned_job(make_empty_books(), 1, 2)
    books = judge_print(add_print(books, "1/01", "a", START_S, 120.0), "a", START_S + 130.0)
    books = judge_print(add_print(books, "1/02", "b", START_S, 80.0), "b", START_S + 130.0)
    books = add_planned_job(books, 2, 1)
    failure_fields = {"state": PrintState.FAILED, "fault": "no_answer", "reason": "silent"}
    books = judge_print(
        add_print(books, "2/01", "a", NOW_S - 5000.0, 60.0, **failure_fields), "a", NOW_S - 4000.0
    )
    return judge_print(
        add_print(books, "2/01", "c", NOW_S - 3000.0, 90.0), "c", NOW_S - 2000.0, Verdict.BAD, "warped"
    )


def describe_filtered_history(**filters):
    return describe_history(make_context(make_books_of_ten_days(), NOW_S), HistoryFilter(**filters))


def test_history_has_figures_jobs_and_prints():
    view = describe_filtered_history()
    assert (view.total.print_count, view.total.good_count, view.total.failed_count) == (4, 2, 2)
    print_counts = [(group.name, group.print_count) for group in view.figures_by_printer]
    assert print_counts == [("a", 2), ("b", 1), ("c", 1)]
    assert [group.name for group in view.figures_by_material] == ["PLA"]
    assert [group.name for group in view.figures_by_month] == ["2023-11"]
    assert [(job.id, job.expected_s, job.actual_s) for job in view.jobs] == [(1, 100.0, 120.0)]
    assert view.jobs[0].deviation == pytest.approx(0.2)
    assert [(row.printer, row.reason or row.why) for row in view.rows[:2]] == [
        ("c", "warped"),
        ("a", "silent"),
    ]


@pytest.mark.parametrize(
    ("filters", "prints"),
    [({"days": 1}, 2), ({"printer": "a"}, 2), ({"job": 2}, 2), ({"days": 1, "printer": "a"}, 1)],
)
def test_prints_are_filtered(filters, prints):
    view = describe_filtered_history(**filters)
    assert (view.total.print_count, len(view.rows)) == (prints, prints)


def test_long_history_is_shown_in_part_and_counted_in_full():
    view = describe_history(make_context(make_books_of_ten_days(), NOW_S), HistoryFilter(), max_rows=1)
    assert (len(view.rows), view.hidden_count, view.total.print_count) == (1, 3, 4)


def test_unknown_job_is_refused():
    with pytest.raises(NotFoundError, match="no job 9"):
        select_prints(make_context(make_empty_books(), NOW_S), HistoryFilter(job=9))
