"""Moments as people say them."""

from datetime import datetime
from zoneinfo import ZoneInfo

import pytest

from farm.scheduling.moments import moment_s

LONDON = ZoneInfo("Europe/London")
NOW_S = datetime(2026, 10, 23, 17, 30, tzinfo=LONDON).timestamp()  # a Friday before the clocks change


@pytest.mark.parametrize(
    ("text", "then"),
    [
        ("22:00", "2026-10-23T22:00:00+01:00"),
        ("07:15", "2026-10-24T07:15:00+01:00"),
        ("Sun 22:00", "2026-10-25T22:00:00+00:00"),
        ("fri 17:30", "2026-10-30T17:30:00+00:00"),
        ("2026-10-24 08:00", "2026-10-24T08:00:00+01:00"),
        ("2026-10-24T08:00:00+02:00", "2026-10-24T07:00:00+01:00"),
    ],
)
def test_the_next_such_moment(text, then):
    assert datetime.fromtimestamp(moment_s(text, NOW_S, LONDON), LONDON).isoformat() == then


@pytest.mark.parametrize("text", ["soon", "25:00", "fry 10:00", "2026-10-22 10:00", "", "10"])
def test_what_is_no_moment_to_come_is_refused(text):
    with pytest.raises(ValueError, match=r"is no time|has passed"):
        moment_s(text, NOW_S, LONDON)
