"""When what waits should end is foreseen when it may have changed, and not more often than it can be."""

from farm.scheduling.forecast import ForecastCache
from make_books import printing
from scheduling_examples import printer, rules


def test_it_is_foreseen_anew_where_the_books_have_changed_but_not_at_every_look():
    asked = []

    def fleet():
        asked.append(True)
        return [printer("a")]

    cache, books = ForecastCache(rules(), scale=2.0), printing(plates=2)
    first = cache.ends_s(books, fleet, 1000.0)
    assert first == {"1/01": 1100.0, "1/02": 1100.0 + 900.0 + 100.0}  # a bed is cleared between them
    assert cache.ends_s(books, fleet, 1050.0) is first
    other = printing(plates=1)
    assert cache.ends_s(other, fleet, 1009.0) is first  # 4.5 s of the wall later
    assert cache.ends_s(other, fleet, 1011.0) == {"1/01": 1111.0}
    assert cache.ends_s(other, fleet, 1072.0) == {"1/01": 1172.0}  # nobody has come for a minute
    assert len(asked) == 3
