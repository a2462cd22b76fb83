"""Time axis of charts."""

from datetime import datetime
from zoneinfo import ZoneInfo

from hypothesis import given
from hypothesis import strategies as st

from farm.views.charts import TimeAxis

BERLIN = ZoneInfo("Europe/Berlin")


def make_axis(begin, end):
    begin_s, end_s = (
        datetime.fromisoformat(text).replace(tzinfo=BERLIN).timestamp() for text in (begin, end)
    )
    return TimeAxis(begin_s, end_s, 100.0, 800.0, BERLIN)


def test_marks_are_round_times_of_the_zone_and_midnight_has_its_day():
    marks = make_axis("2026-11-20T21:10", "2026-11-21T03:00").list_marks(6)
    assert [mark.text for mark in marks] == ["Fri 22:00", "23:00", "Sat 00:00", "01:00", "02:00", "03:00"]
    assert marks[-1].x == 900.0


def test_marks_stay_round_when_daylight_saving_ends():
    marks = make_axis("2026-10-24T18:00", "2026-10-25T12:00").list_marks(6)
    assert [mark.text for mark in marks] == ["Sat 20:00", "Sun 00:00", "04:00", "08:00", "12:00"]


@given(st.floats(0.0, 4e9), st.floats(0.0, 3e6), st.floats(-1e7, 1e7))
def test_all_times_and_marks_are_on_the_axis(begin_s, length_s, offset_s):
    axis = TimeAxis(begin_s, begin_s + length_s, 100.0, 800.0, BERLIN)
    assert 100.0 <= axis.compute_x(begin_s + offset_s) <= 900.0
    marks = axis.list_marks()
    assert len(marks) <= 12
    assert all(100.0 <= mark.x <= 900.0 for mark in marks)
