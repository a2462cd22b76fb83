"""Windows of the week on the calendar, including clock changes."""

import math
from datetime import datetime, timedelta
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farm.scheduling.hours import Hours
from farm.week_windows import DAYS, parse_window

LONDON = ZoneInfo("Europe/London")


def parse_time_s(text, fold=0):
    return datetime.fromisoformat(text).replace(tzinfo=LONDON, fold=fold).timestamp()


def make_hours(*texts):
    return Hours(tuple(map(parse_window, texts)), LONDON)


@pytest.mark.parametrize(
    ("text", "days"),
    [("08:00-18:00", 7), ("mon-fri 8:00-18:00", 5), ("sat,sun 10:00-14:00", 2), ("fri-mon 22:00-24:00", 4)],
)
def test_windows_are_read_as_people_write_them(text, days):
    assert len(parse_window(text).days) == days


@pytest.mark.parametrize("text", ["8-18", "mon", "mo 08:00-18:00", "08:00-25:00", "mon-fry 08:00-09:00", ""])
def test_invalid_window_is_refused_with_an_example(text):
    with pytest.raises(ValueError, match=r"write it as|is not a day; use"):
        parse_window(text)


def test_spans_may_cross_midnight_and_the_end_of_the_week():
    night = make_hours("fri 22:00-06:00", "sat 06:00-08:00")
    begin_s, end_s = parse_time_s("2026-11-20 22:00"), parse_time_s("2026-11-21 08:00")
    assert night.find_span(parse_time_s("2026-11-21 05:00")) == (begin_s, end_s)
    assert night.find_span(parse_time_s("2026-11-21 08:00")) is None
    assert night.find_next_span(end_s) == (begin_s + 7 * 86400, end_s + 7 * 86400)
    assert night.find_next_edge_s(parse_time_s("2026-11-21 05:00")) == end_s
    assert night.find_next_edge_s(end_s) == begin_s + 7 * 86400


def test_windows_may_cover_nothing_or_the_whole_week():
    assert make_hours().find_span(parse_time_s("2026-11-20 22:00")) is None
    assert make_hours().find_next_edge_s(parse_time_s("2026-11-20 22:00")) is None
    whole_week = make_hours("00:00-12:00", "12:00-24:00")
    assert whole_week.find_span(parse_time_s("2026-11-20 22:00"))[1] == math.inf
    assert whole_week.find_next_edge_s(parse_time_s("2026-11-20 22:00")) is None


def test_length_of_a_night_changes_with_daylight_saving():
    night = make_hours("22:00-06:00")
    lengths_h = [
        (end_s - begin_s) / 3600
        for time in ("2026-03-28 23:00", "2026-10-24 23:00", "2026-11-20 23:00")
        for begin_s, end_s in [night.find_span(parse_time_s(time))]
    ]
    assert lengths_h == [7, 9, 8]


def test_window_edges_in_skipped_or_repeated_hours_are_resolved():
    skipped_span = make_hours("01:30-04:00").find_span(parse_time_s("2026-03-29 03:00"))
    assert skipped_span == (parse_time_s("2026-03-29 02:30"), parse_time_s("2026-03-29 04:00"))
    repeated_span = make_hours("00:30-01:30").find_span(parse_time_s("2026-10-25 01:10", fold=1))
    assert repeated_span == (parse_time_s("2026-10-25 00:30"), parse_time_s("2026-10-25 01:30", fold=1))
    assert make_hours("01:15-01:45").find_span(parse_time_s("2026-03-29 02:20")) == (
        parse_time_s("2026-03-29 02:15"),
        parse_time_s("2026-03-29 02:45"),
    )


@pytest.mark.parametrize(
    ("window", "begin", "end"),
    [
        ("02:30-04:00", "2026-03-29T03:30:00+02:00", "2026-03-29T04:00:00+02:00"),  # skipped: an hour later
        ("22:00-02:30", "2026-03-28T22:00:00+01:00", "2026-03-29T03:30:00+02:00"),
        # A repeated hour: a window begins in the first one, and ends in the second one.
        ("02:30-04:00", "2026-10-25T02:30:00+02:00", "2026-10-25T04:00:00+01:00"),
        ("22:00-02:30", "2026-10-24T22:00:00+02:00", "2026-10-25T02:30:00+01:00"),
    ],
)
def test_skipped_edge_is_an_hour_later_and_a_repeated_hour_is_covered_twice(window, begin, end):
    """Check the edges of attended and of quiet hours."""
    berlin_hours = Hours((parse_window(window),), ZoneInfo("Europe/Berlin"))
    span = tuple(datetime.fromisoformat(text).timestamp() for text in (begin, end))
    assert berlin_hours.find_span(span[0]) == berlin_hours.find_span(span[1] - 1.0) == span
    assert berlin_hours.find_span(span[0] - 1.0) is None and berlin_hours.find_span(span[1]) is None
    assert berlin_hours.find_next_edge_s(span[0] - 60.0) == span[0]
    assert berlin_hours.find_next_edge_s(span[0]) == span[1]


windows = st.lists(
    st.builds(
        lambda day, begin, end: f"{day} {begin // 60:02d}:{begin % 60:02d}-{end // 60:02d}:{end % 60:02d}",
        st.sampled_from(DAYS),
        st.integers(0, 1439),
        st.integers(0, 1439),
    ),
    max_size=4,
)


@given(windows, st.datetimes(datetime(2026, 1, 1), datetime(2027, 12, 31)))
def test_spans_keep_their_invariants(texts, moment):
    calendar = make_hours(*texts)
    now_s = moment.replace(tzinfo=LONDON).timestamp()
    span, next_span, edge_s = (
        calendar.find_span(now_s),
        calendar.find_next_span(now_s),
        calendar.find_next_edge_s(now_s),
    )
    if span is not None:
        assert span[0] <= now_s < span[1]
    if next_span is not None:
        assert now_s < next_span[0] < next_span[1]
        assert next_span[0] - now_s <= timedelta(days=8).total_seconds()
        assert span is None or span[1] < next_span[0]
    if edge_s is not None:
        assert (calendar.find_span(edge_s) is None) is (span is not None)
        assert (calendar.find_span((now_s + edge_s) / 2) is None) is (span is None)
