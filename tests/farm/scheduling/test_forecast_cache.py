"""Cached forecast: made again if it may have changed, and not more often than allowed."""

from farm.scheduling.forecast import ForecastCache
from farm.scheduling.situation_builder import describe_plates
from make_books import make_printing_books
from scheduling_examples import printer, situation


def test_forecast_is_computed_again_after_changes_with_a_minimum_interval():
    requested = []

    def ends_s(books, now_s):
        def moment():
            requested.append(True)
            waiting = describe_plates(books.waiting_plates(), books)
            return situation(waiting, [printer("a")], now_s=now_s)

        return cache.ends_s(books, moment, now_s)

    cache, books = ForecastCache(scale=2.0), make_printing_books(plates=2)
    first = ends_s(books, 1000.0)
    assert first == {"1/01": 1100.0, "1/02": 1100.0 + 900.0 + 100.0}  # a bed is cleared between them
    assert ends_s(books, 1050.0) is first
    other = make_printing_books(plates=1)
    assert ends_s(other, 1009.0) is first  # 4.5 s of the wall later
    assert ends_s(other, 1011.0) == {"1/01": 1111.0}
    assert ends_s(other, 1072.0) == {"1/01": 1172.0}  # nobody has come for a minute
    assert len(requested) == 3
