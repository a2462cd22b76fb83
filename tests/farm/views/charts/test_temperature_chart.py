"""Chart of temperatures."""

from hypothesis import given
from hypothesis import strategies as st

from books.scheduling_examples import UTC
from farm.model import Temperatures
from farm.views.charts import lay_out_temperatures


def lay_out_chart_in_utc(readings, now_s=36_000.0):
    return lay_out_temperatures(readings, now_s, UTC, lambda at_s: f"{at_s:.0f}")


def test_silent_printer_has_no_chart():
    assert lay_out_chart_in_utc([]) is None
    assert lay_out_chart_in_utc([Temperatures(0.0, None, None, None, None)]) is None


def test_line_is_interrupted_while_the_printer_does_not_answer():
    hot_readings = [Temperatures(60.0 * n, 200 + n, 60, 210, 60) for n in range(10)]
    gap, cold_reading = Temperatures(700.0, None, None, None, None), Temperatures(900.0, 30, 25, 0, 0)
    nozzle, target, bed, _ = lay_out_chart_in_utc([*hot_readings, gap, cold_reading]).curves
    assert [len(piece) for piece in nozzle.pieces] == [10, 1]
    assert [len(piece) for piece in bed.pieces] == [2, 1]  # a level line has only its two ends
    assert nozzle.pieces[0][0][1] > nozzle.pieces[0][-1][1]  # hotter is higher
    assert target.kind == "nozzle target"


TEMPERATURES_C = st.none() | st.integers(-20, 400)


@given(st.lists(st.tuples(TEMPERATURES_C, TEMPERATURES_C, TEMPERATURES_C, TEMPERATURES_C), max_size=60))
def test_every_point_is_inside_the_chart(values):
    chart = lay_out_chart_in_utc([Temperatures(600.0 * n, *value) for n, value in enumerate(values)])
    if chart is None:
        assert all(nozzle_c is None and bed_c is None for nozzle_c, bed_c, *_ in values)
        return
    points = [point for curve in chart.curves[::2] for piece in curve.pieces for point in piece]
    assert all(chart.left <= x <= chart.width and chart.top <= y <= chart.bottom for x, y in points)
    assert len(chart.rows) <= 49
