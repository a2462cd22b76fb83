"""Times as text."""

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farm.text import format_moment, format_recent_moment

NOW = datetime(2026, 11, 22, 7, 0, tzinfo=UTC)  # a Sunday


@pytest.mark.parametrize(
    ("hours", "text"),
    [
        (0, "Sun 07:00"),
        (6 * 24, "Sat 07:00"),
        (6 * 24 + 1, "Sat 28 Nov 08:00"),
        (-6 * 24, "Mon 07:00"),
        (-7 * 24, "Sun 15 Nov 07:00"),
        (400 * 24, "27 Dec 2027 07:00"),
    ],
)
def test_ambiguous_weekday_is_shown_with_its_date(hours, text):
    assert format_moment(NOW + timedelta(hours=hours), NOW) == text


@given(st.timedeltas(timedelta(), timedelta(days=20)), st.integers(0, 3), st.sampled_from([1, -1]))
def test_two_times_weeks_apart_differ_in_the_past_and_in_the_future(distance, weeks, side):
    texts = {format_moment(NOW + side * (distance + timedelta(weeks=i)), NOW) for i in (0, weeks)}
    assert len(texts) == (2 if weeks else 1)


@pytest.mark.parametrize(
    ("hours", "text"),
    [(-1, "06:00"), (-20, "11:00"), (-21, "Sat 10:00"), (1, "Sun 08:00"), (-144, "Mon 07:00")],
)
def test_time_of_the_same_night_has_no_weekday(hours, text):
    assert format_recent_moment(NOW + timedelta(hours=hours), NOW) == text
