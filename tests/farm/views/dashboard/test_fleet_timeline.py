"""Timeline of the fleet, and what-if changes."""

import dataclasses
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.make_books import apply_events
from books.scheduling_examples import UTC, make_hours
from farm.errors import NotFoundError
from farm.model import AgentPrint, AgentSnapshot, Link, PrintState
from farm.scheduling import Hours
from farm.state import events as ev
from farm.views.dashboard import Change, describe_fleet_timeline
from farm.views.dashboard.fleet_plan import list_spans
from farm.week_windows import parse_window
from farms.dashboard_farm import (
    START_S,
    add_planned_job,
    add_print,
    judge_print,
    make_context,
    make_empty_books,
    make_situation,
)

NOW_S = START_S + 1000.0


def make_night_books():
    """Make books with a good, a failed and a running print on one printer, and three waiting jobs."""
    books = add_planned_job(make_empty_books("a"), 1, 3)
    books = judge_print(add_print(books, "1/01", "a", START_S, 100.0), "a", START_S + 150.0)
    books = add_print(
        books, "1/02", "a", START_S + 200.0, 50.0, state=PrintState.FAILED, fault="noisy_line", reason="noise"
    )
    books = judge_print(books, "a", START_S + 300.0)
    books, _ = apply_events(
        books, ev.PlateAssigned(at_s=NOW_S - 10.0, plate="1/03", printer="a", print_id="running")
    )
    for number in (2, 3):
        books = add_planned_job(books, number, 1)
    return books


def describe_timeline(books, change=None, past_s=3600.0, **hours):
    context, situation = make_context(books, NOW_S), make_situation(books, NOW_S, "a", **hours)
    return describe_fleet_timeline(context, situation, past_s, change)


def test_past_running_and_planned_prints_are_shown_in_order():
    view = describe_timeline(make_night_books())
    assert [(row.part, row.kind) for row in view.table] == [
        ("1/p01", "good"),
        ("1/p02", "failed"),
        ("1/p03", "printing"),
        ("1/p02", "planned"),
        ("2/p01", "planned"),
        ("3/p01", "planned"),
    ]
    assert [job.id for job in view.waiting_jobs] == [1, 2, 3]
    rows = {row.printer: row.bars for row in view.chart.rows}
    assert [len(rows[name]) for name in "abc"] == [6, 0, 0]
    assert all(bar.x + bar.width <= view.chart.width for bar in rows["a"])
    assert "1/p02 (bracket.stl) on a: failed, 50 s" in [bar.text for bar in rows["a"]]
    assert dict(view.chart.kinds) == {"good": "✓", "failed": "✗", "printing": "▶", "planned": ""}


def test_prints_before_the_period_are_omitted():
    kinds = [row.kind for row in describe_timeline(make_night_books(), past_s=800.0).table]
    assert "good" not in kinds
    assert "failed" in kinds  # this print ended 750 s ago


def test_attended_and_quiet_hours_are_in_the_background():
    chart = describe_timeline(make_night_books(), attended=["00:00-12:00"], quiet=["22:00-06:00"]).chart
    assert len(chart.attended_bands) == 1
    assert len(chart.quiet_bands) == 1
    assert chart.quiet_bands[0].x < chart.attended_bands[0].x


def test_job_that_is_moved_to_the_front_ends_earlier_and_delays_the_others():
    books = make_night_books()
    view = describe_timeline(books, Change(3, is_moved=True, successor=1))
    delays_s = {delay.job: delay.delay_s for delay in view.delays}
    assert delays_s[3] < 0.0 < delays_s[1]
    planned_parts = [row.part for row in view.table if row.kind == "planned"]
    assert planned_parts[0] == "3/p01"
    assert books.jobs[3].moved_rank is None  # the books are unchanged
    assert next(row.part for row in describe_timeline(books).table if row.kind == "planned") == "1/p02"


def test_later_start_delays_only_that_job():
    change = Change(2, not_before_s=NOW_S + 20_000.0)
    view = describe_timeline(make_night_books(), change)
    delays_s = {delay.job: delay.delay_s for delay in view.delays}
    assert delays_s[2] > 10_000.0
    assert delays_s[3] <= 0.0
    assert delays_s[1] == 0.0


def test_held_job_is_forecast_as_if_it_were_approved():
    books = make_night_books()
    held_books = add_planned_job(books, 4, 1, is_held=True)
    assert held_books.jobs[4].state == "held"
    (delay,) = (
        row
        for row in describe_timeline(held_books, Change(4, is_moved=True, successor=None)).delays
        if row.job == 4
    )
    assert delay.end is None
    assert delay.new_end is not None


def test_unknown_job_is_refused():
    with pytest.raises(NotFoundError, match="no job 9"):
        describe_timeline(make_night_books(), Change(9, is_moved=True))


def test_empty_farm_has_an_empty_timeline():
    view = describe_timeline(make_empty_books("abc"))
    assert (view.table, view.delays, view.unprintable_parts) == ((), (), ())
    assert view.chart.height > 0


WINDOWS = st.lists(
    st.sampled_from(["00:00-24:00", "mon-fri 08:00-18:00", "22:00-06:00", "sat 10:00-11:00"]), max_size=3
)


@given(WINDOWS, st.floats(0.0, 7 * 86400.0), st.floats(1.0, 7 * 86400.0))
def test_spans_are_disjoint_and_within_the_period_and_agree_with_the_hours(texts, begin_s, length_s):
    hours, end_s = make_hours(*texts), begin_s + length_s
    spans = list_spans(hours, begin_s, end_s)
    assert all(begin_s <= first_s < last_s <= end_s for first_s, last_s in spans)
    assert all(span[1] < next_span[0] for span, next_span in pairwise(spans))
    for at_s in (begin_s, begin_s + length_s / 2):
        is_open = any(first_s <= at_s < last_s for first_s, last_s in spans)
        assert is_open == (hours.find_span(at_s) is not None)


def test_attended_hours_that_never_end_are_one_span():
    assert list_spans(Hours((parse_window("00:00-24:00"),), UTC), 0.0, 1e6) == [(0.0, 1e6)]


def test_planned_print_does_not_begin_before_a_late_one_ends():
    books = make_night_books()
    late_print = AgentPrint(
        print_id="running", state=PrintState.PRINTING, fault=None, reason=None, progress_s=1.0,
        print_time_s=90.0, extruded=True, started_s=NOW_S - 5000.0, ended_s=None,
    )  # fmt: skip
    busy_snapshot = AgentSnapshot(printer="a", link=Link.BUSY, print=late_print)
    context = dataclasses.replace(make_context(books, NOW_S), snapshots={"a": busy_snapshot})
    rows = describe_fleet_timeline(context, make_situation(books, NOW_S, "a"), 3600.0).table
    ends = {row.kind: row.end for row in rows}
    starts = [row.start for row in rows if row.kind == "planned"]
    assert min(starts) >= ends["printing"]
