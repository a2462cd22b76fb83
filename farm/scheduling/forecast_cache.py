"""Cache of the forecast: the expected ends of all waiting plates, and when they were worked out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from drivers.clock import Clock
from farm.scheduling.forecast import forecast_prints
from farm.scheduling.situation import Situation
from farm.state import Books

LARGE_QUEUE = 1000
"""Waiting plates from which no caller waits for a forecast: 10,000 on 1,000 printers take 0.3 s."""
_MAX_AGE_S = 60.0  # farm seconds for which a forecast of unchanged books is kept
_MIN_INTERVAL_S = 5.0  # wall seconds between two forecasts
_LARGE_INTERVAL_S = 45.0  # the same for a large queue


@dataclass(frozen=True, slots=True)
class ExpectedEnds:
    """Expected ends of waiting plates.

    Attributes
    ----------
    by_plate
        End of each plate that a printer can take, in seconds since the epoch.
    at_s
        Farm time of the forecast; minus infinity before the first.
    """

    by_plate: Mapping[str, float] = field(default_factory=dict)
    at_s: float = -math.inf


class ForecastCache:
    """Forecasts the ends of all waiting plates, at most every few wall seconds.

    That of a large queue is made by `find_background_work`, in a thread of the daemon; callers get the last.

    Parameters
    ----------
    clock
        The farm's clock.
    find_books, find_situation
        Return the committed books, and the situation to forecast.
    """

    def __init__(
        self, clock: Clock, find_books: Callable[[], Books], find_situation: Callable[[], Situation]
    ) -> None:
        self._clock, self._find_books, self._find_situation = clock, find_books, find_situation
        self._books: Books | None = None
        self._ends = ExpectedEnds()
        self._is_large = False

    def clock_set(self) -> None:
        """Drop the forecast after a step of the host's clock, as hours have shifted."""
        self._ends = ExpectedEnds()

    def find_ends(self) -> ExpectedEnds:
        """Return the expected ends; of a large queue, as they were last worked out."""
        if not self._is_large or self._ends.at_s == -math.inf:
            work = self._find_due_work()
            if work is not None:
                work()
        return self._ends

    def find_background_work(self) -> Callable[[], None] | None:
        """Return what makes the forecast of a large queue, in any thread; None if none is due."""
        return self._find_due_work() if self._is_large else None

    def _find_due_work(self) -> Callable[[], None] | None:
        books, now_s, ends_before = self._find_books(), self._clock.now(), self._ends
        age_s = now_s - ends_before.at_s
        interval_s = (_LARGE_INTERVAL_S if self._is_large else _MIN_INTERVAL_S) * self._clock.scale
        if age_s <= interval_s or (books is self._books and age_s <= _MAX_AGE_S):
            return None
        situation = self._find_situation()
        self._is_large = len(situation.waiting) >= LARGE_QUEUE

        def work() -> None:
            slots = forecast_prints(situation, has_bound=False).slots
            if self._ends is ends_before:  # else the clock was set meanwhile
                self._books, self._ends = books, ExpectedEnds({s.plate: s.ends_s for s in slots}, now_s)

        return work
