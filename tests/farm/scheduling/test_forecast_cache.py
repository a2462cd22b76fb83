"""Cached forecast: it is computed again, at a limited rate, when it may have changed."""

import math

import pytest

from books.make_books import make_planned_books
from books.scheduling_examples import make_printer, make_situation
from farm.scheduling import forecast_cache
from farm.scheduling.forecast_cache import ForecastCache
from farm.scheduling.situation_builder import describe_plates


class CachedForecast:
    """Forecast cache with books and a clock that the test sets; it counts the situations that are built."""

    scale = 2.0

    def __init__(self):
        self.books, self.now_s, self.situation_count = make_planned_books(plates=2), 1000.0, 0
        self.cache = ForecastCache(self, lambda: self.books, self._make_situation)

    def now(self):
        return self.now_s

    def _make_situation(self):
        self.situation_count += 1
        waiting_plates = describe_plates(self.books.list_waiting_plates(), self.books)
        return make_situation(waiting_plates, [make_printer("a")], now_s=self.now_s)

    def set_time_and_queue(self, now_s, plates):
        """Set the time, and fill the queue with this number of plates."""
        self.now_s, self.books = now_s, make_planned_books(plates=plates)


@pytest.fixture
def cached_forecast():
    return CachedForecast()


def test_forecast_is_computed_again_after_changes_with_a_minimum_interval(cached_forecast):
    first_ends = cached_forecast.cache.find_ends()
    # A bed is cleared between the two prints.
    assert (
        first_ends.ends_by_plate_s == {"1/01": 1100.0, "1/02": 1100.0 + 900.0 + 100.0}
        and first_ends.at_s == 1000.0
    )
    cached_forecast.now_s = 1050.0
    assert cached_forecast.cache.find_ends() is first_ends
    cached_forecast.set_time_and_queue(1009.0, plates=1)  # 4.5 s of wall time later
    assert cached_forecast.cache.find_ends() is first_ends
    cached_forecast.now_s = 1011.0
    assert cached_forecast.cache.find_ends().ends_by_plate_s == {"1/01": 1111.0}
    cached_forecast.now_s = 1072.0  # no request for a minute
    assert cached_forecast.cache.find_ends().ends_by_plate_s == {"1/01": 1172.0}
    assert cached_forecast.situation_count == 3


def run_steps(steps):
    for _ in steps:
        pass


def test_no_caller_waits_for_the_forecast_of_a_large_queue(cached_forecast, monkeypatch):
    monkeypatch.setattr(forecast_cache, "LARGE_QUEUE_SIZE", 2)
    cache = cached_forecast.cache
    # Not even the first caller waits.
    assert cache.find_ends().ends_by_plate_s == {} and cache.find_ends().at_s == -math.inf
    run_steps(cache.find_background_work())
    first_ends = cache.find_ends()
    assert first_ends.at_s == 1000.0 and first_ends.ends_by_plate_s.keys() == {"1/01", "1/02"}
    cached_forecast.set_time_and_queue(1089.0, plates=3)
    assert cache.find_background_work() is None
    cached_forecast.now_s = 1091.0
    assert cache.find_ends() is first_ends
    steps = cache.find_background_work()
    assert cache.find_ends() is first_ends
    run_steps(steps)
    second_ends = cache.find_ends()
    assert second_ends.at_s == 1091.0 and second_ends.ends_by_plate_s.keys() == {"1/01", "1/02", "1/03"}
    cached_forecast.set_time_and_queue(1200.0, plates=2)
    steps = cache.find_background_work()
    cache.on_clock_set()
    run_steps(steps)  # the result is discarded, because it was computed before the clock was set
    assert cache.find_ends().at_s == -math.inf


def test_forecast_of_a_queue_that_has_become_small_is_made_on_request(cached_forecast, monkeypatch):
    monkeypatch.setattr(forecast_cache, "LARGE_QUEUE_SIZE", 2)
    run_steps(cached_forecast.cache.find_background_work())
    cached_forecast.set_time_and_queue(1200.0, plates=1)
    assert cached_forecast.cache.find_background_work() is None
    assert cached_forecast.cache.find_ends().ends_by_plate_s.keys() == {"1/01"}
    cached_forecast.set_time_and_queue(1300.0, plates=2)
    assert cached_forecast.cache.find_ends().at_s == 1200.0
    run_steps(cached_forecast.cache.find_background_work())
    assert cached_forecast.cache.find_ends().at_s == 1300.0
