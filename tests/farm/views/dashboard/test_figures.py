"""Figures of ended prints."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.make_books import make_plan_event
from books.scheduling_examples import UTC
from farm.model import Print, PrintState, Verdict
from farm.views.dashboard.figures import group_figures, name_month, sum_figures

PLATES = {plate.id: plate for plate in make_plan_event(1, 2).plates}  # 100 s and 3 g each
DONE, FAILED, CANCELLED = PrintState.DONE, PrintState.FAILED, PrintState.CANCELLED


def make_attempt(state=DONE, duration_s=100.0, **changes):
    fields = {"id": "x", "plate": "1/01", "job": 1, "printer": "a", "assigned_s": 0.0, "started_s": 1000.0}
    ends_s = 1000.0 + duration_s if state.ended else None
    return Print(**{**fields, "state": state, "ended_s": ends_s, "grams": 3.0, **changes})


def test_prints_are_counted_by_outcome():
    figures = sum_figures(
        "all",
        [
            make_attempt(duration_s=110.0),
            make_attempt(duration_s=90.0, verdict=Verdict.GOOD),
            make_attempt(duration_s=130.0, verdict=Verdict.BAD, grams=4.0),
            make_attempt(FAILED, 50.0, grams=1.0),
            make_attempt(CANCELLED, 20.0, grams=0.5),
            make_attempt(CANCELLED, started_s=None),  # never started
            make_attempt(PrintState.PRINTING),
        ],
        PLATES,
    )
    assert (figures.print_count, figures.good_count, figures.failed_count, figures.cancelled_count) == (
        5,
        2,
        2,
        1,
    )
    assert figures.success_share == 0.5
    assert (figures.used_s, figures.wasted_s) == (400.0, 200.0)
    assert (figures.grams, figures.wasted_grams) == (11.5, 5.5)
    assert figures.deviation == pytest.approx(330.0 / 300.0 - 1)


def test_paused_print_has_no_deviation():
    assert sum_figures("all", [make_attempt(duration_s=5000.0, paused=True)], PLATES).deviation is None


def test_figures_of_no_prints_have_no_success_rate():
    assert sum_figures("all", [], PLATES).success_share is None


PRINTS = st.builds(
    make_attempt,
    st.sampled_from(PrintState),
    st.floats(0.0, 1e6),
    printer=st.sampled_from("abc"),
    verdict=st.sampled_from([None, *Verdict]),
    started_s=st.sampled_from([None, 1000.0]),
    grams=st.floats(0.0, 500.0),
)


@given(st.lists(PRINTS, max_size=30))
def test_groups_add_up_to_the_total_and_every_print_is_counted_once(prints):
    total = sum_figures("all", prints, PLATES)
    groups = group_figures(prints, PLATES, lambda row: row.printer)
    assert total.print_count == total.good_count + total.failed_count + total.cancelled_count
    assert total.wasted_grams <= total.grams + 1e-6
    counts = ("print_count", "good_count", "failed_count", "cancelled_count")
    for name in (*counts, "used_s", "wasted_s", "grams", "expected_s"):
        assert sum(getattr(row, name) for row in groups) == pytest.approx(getattr(total, name))


def test_month_of_a_print_is_in_the_time_zone_of_the_fleet():
    assert name_month(make_attempt(duration_s=0.0), UTC) == "1970-01"
    assert name_month(make_attempt(PrintState.PRINTING), UTC) == ""
