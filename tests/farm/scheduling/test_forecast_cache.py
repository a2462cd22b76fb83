"""Cached forecast: made again if it may have changed, and not more often than allowed."""

import pytest

from farm.scheduling import forecast_cache
from farm.scheduling.forecast_cache import ForecastCache
from farm.scheduling.situation_builder import describe_plates
from make_books import make_printing_books
from scheduling_examples import printer, situation


class Scene:
    """Books and a time, whose situations are counted."""

    scale = 2.0

    def __init__(self):
        self.books, self.now_s, self.situations = make_printing_books(plates=2), 1000.0, 0
        self.cache = ForecastCache(self, lambda: self.books, self._make_situation)

    def now(self):
        return self.now_s

    def _make_situation(self):
        self.situations += 1
        waiting = describe_plates(self.books.waiting_plates(), self.books)
        return situation(waiting, [printer("a")], now_s=self.now_s)

    def move(self, now_s, plates):
        """Go to a time, at which a queue has this number of plates."""
        self.now_s, self.books = now_s, make_printing_books(plates=plates)


@pytest.fixture
def scene():
    return Scene()


def test_forecast_is_computed_again_after_changes_with_a_minimum_interval(scene):
    first = scene.cache.find_ends()
    # A bed is cleared between them.
    assert first.by_plate == {"1/01": 1100.0, "1/02": 1100.0 + 900.0 + 100.0} and first.at_s == 1000.0
    scene.now_s = 1050.0
    assert scene.cache.find_ends() is first
    scene.move(1009.0, plates=1)  # 4.5 s of the wall later
    assert scene.cache.find_ends() is first
    scene.now_s = 1011.0
    assert scene.cache.find_ends().by_plate == {"1/01": 1111.0}
    scene.now_s = 1072.0  # nobody has come for a minute
    assert scene.cache.find_ends().by_plate == {"1/01": 1172.0}
    assert scene.situations == 3


def test_no_caller_waits_for_the_forecast_of_a_large_queue(scene, monkeypatch):
    monkeypatch.setattr(forecast_cache, "LARGE_QUEUE", 2)
    cache = scene.cache
    assert cache.find_background_work() is None  # a small one is made when it is asked for
    first = cache.find_ends()
    assert first.at_s == 1000.0 and first.by_plate.keys() == {"1/01", "1/02"}
    scene.move(1089.0, plates=3)
    assert cache.find_background_work() is None
    scene.now_s = 1091.0
    assert cache.find_ends() is first
    work = cache.find_background_work()
    assert cache.find_ends() is first
    work()
    second = cache.find_ends()
    assert second.at_s == 1091.0 and second.by_plate.keys() == {"1/01", "1/02", "1/03"}
    scene.move(1200.0, plates=2)
    late = cache.find_background_work()
    cache.clock_set()
    late()  # it was made with the hours of before
    scene.now_s = 900.0
    assert cache.find_ends().at_s == 900.0
