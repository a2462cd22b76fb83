"""Parsing of times as people write them."""

from datetime import datetime
from zoneinfo import ZoneInfo

import pytest

from farm.control.job_commands import parse_start_and_deadline_s
from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions
from farm.scheduling.hours import Hours, parse_moment_s
from farm.scheduling.start_rules import StartRules
from farm.week_windows import parse_window

LONDON, BERLIN = ZoneInfo("Europe/London"), ZoneInfo("Europe/Berlin")
NOW_S = datetime(2026, 10, 23, 17, 30, tzinfo=LONDON).timestamp()  # a Friday before the clocks change


@pytest.mark.parametrize(
    ("text", "expected_time"),
    [
        ("22:00", "2026-10-23T22:00:00+01:00"),
        ("07:15", "2026-10-24T07:15:00+01:00"),
        ("Sun 22:00", "2026-10-25T22:00:00+00:00"),
        ("fri 17:30", "2026-10-30T17:30:00+00:00"),
        ("2026-10-24 08:00", "2026-10-24T08:00:00+01:00"),
        ("2026-10-24T08:00:00+02:00", "2026-10-24T07:00:00+01:00"),
    ],
)
def test_time_is_parsed_as_its_next_occurrence(text, expected_time):
    assert datetime.fromtimestamp(parse_moment_s(text, NOW_S, LONDON), LONDON).isoformat() == expected_time


INVALID_DATES = ["9999-12-31T23:59-12:00", "9999-12-31", "0001-01-01", "2027-11-01 10:00"]


@pytest.mark.parametrize("text", ["soon", "25:00", "fry 10:00", "2026-10-22 10:00", "", "10", *INVALID_DATES])
def test_past_or_invalid_time_is_refused(text):
    with pytest.raises(ValueError, match=r"is not a time|has passed|is more than a year ahead"):
        parse_moment_s(text, NOW_S, LONDON)


@pytest.mark.parametrize(
    ("now", "expected_time"),
    [
        ("2026-03-28T20:00:00+01:00", "2026-03-29T03:30:00+02:00"),  # that time is skipped
        ("2026-03-29T03:40:00+02:00", "2026-03-30T02:30:00+02:00"),
        ("2026-10-24T20:00:00+02:00", "2026-10-25T02:30:00+02:00"),  # here the time occurs twice
        ("2026-10-25T02:40:00+02:00", "2026-10-25T02:30:00+01:00"),
        ("2026-10-25T02:10:00+01:00", "2026-10-25T02:30:00+01:00"),
        ("2026-10-25T02:40:00+01:00", "2026-10-26T02:30:00+01:00"),
    ],
)
def test_time_in_a_skipped_or_repeated_hour_is_resolved(now, expected_time):
    at_s = parse_moment_s("02:30", datetime.fromisoformat(now).timestamp(), BERLIN)
    assert at_s == datetime.fromisoformat(expected_time).timestamp()


@pytest.mark.parametrize(("day", "night_h"), [("2026-03-28", 9), ("2026-10-24", 11), ("2026-11-20", 10)])
def test_length_of_a_night_follows_daylight_saving(day, night_h):
    """Compute nights from the end of attended hours, or from 22:00, to the same hour of the morning."""
    attended_hours = Hours((parse_window("08:00-21:00"),), BERLIN)
    start_rules = StartRules(attended_hours, Hours((), BERLIN))
    now_s = datetime.fromisoformat(f"{day} 18:00").replace(tzinfo=BERLIN).timestamp()
    begins_s, ends_s = parse_start_and_deadline_s(
        JobOptions(overnight=True, done_by="07:00"), start_rules, now_s
    )
    assert (begins_s - now_s, ends_s - begins_s) == (3 * 3600.0, night_h * 3600.0)
    begins_s, ends_s = parse_start_and_deadline_s(JobOptions(at="22:00", done_by="08:00"), start_rules, now_s)
    assert (begins_s - now_s, ends_s - begins_s) == (4 * 3600.0, night_h * 3600.0)


@pytest.mark.parametrize(
    ("now", "expected_time"),
    [("2026-11-20 18:00", "Fri 20:00"), ("2026-11-20 20:30", "Sat 20:00"), ("2026-11-20 23:00", "Sat 20:00")],
)
def test_overnight_is_refused_if_first_layers_need_attendance(now, expected_time):
    attended_hours = Hours((parse_window("08:00-21:00"),), BERLIN)
    start_rules = StartRules(attended_hours, Hours((), BERLIN), first_layers_attended=True)
    now_s = datetime.fromisoformat(now).replace(tzinfo=BERLIN).timestamp()
    with pytest.raises(
        FarmError, match=rf"attended first layers .*use --at .*, like --at '{expected_time}'"
    ) as error:
        parse_start_and_deadline_s(JobOptions(overnight=True), start_rules, now_s)
    assert error.value.code is ErrorCode.SETTINGS
    begins_s, _ = parse_start_and_deadline_s(JobOptions(at=expected_time), start_rules, now_s)
    assert begins_s is not None
    assert start_rules.attended_hours.find_span(begins_s) is not None


@pytest.mark.parametrize("first_layers_attended", [False, True])
def test_overnight_is_refused_if_attended_hours_never_end(first_layers_attended):
    """Refuse a start at infinity, which cannot be formatted and would stop all scheduling."""
    start_rules = StartRules(
        Hours((parse_window("00:00-24:00"),), BERLIN), Hours((), BERLIN), first_layers_attended
    )
    now_s = datetime.fromisoformat("2026-11-20 18:00").replace(tzinfo=BERLIN).timestamp()
    with pytest.raises(FarmError, match=r"`attended` hours of fleet\.yaml never end") as error:
        parse_start_and_deadline_s(JobOptions(overnight=True), start_rules, now_s)
    assert error.value.code is ErrorCode.SETTINGS
