"""Cache of the forecast: the expected ends of all waiting plates, and the time at which it was made."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from drivers.clock import Clock
from farm.scheduling.forecast import forecast_in_steps
from farm.scheduling.situation import Situation
from farm.state import Books

LARGE_QUEUE_SIZE = 1000
"""Minimum number of waiting plates for which callers get the last forecast instead of awaiting a new one.

The forecast of 10,000 plates on 1,000 printers takes 0.3 s.
"""
_MAX_AGE_S = 60.0  # farm seconds for which a forecast of unchanged books is kept
_MIN_INTERVAL_S = 5.0  # wall seconds between two forecasts
_LARGE_QUEUE_INTERVAL_S = 45.0  # wall seconds between two forecasts of a large queue


@dataclass(frozen=True, slots=True)
class ExpectedEnds:
    """Expected ends of waiting plates.

    Attributes
    ----------
    ends_by_plate_s
        End of each plate that a printer can take, in seconds since the epoch.
    at_s
        Farm time at which the forecast was made; minus infinity before the first.
    """

    ends_by_plate_s: Mapping[str, float] = field(default_factory=dict)
    at_s: float = -math.inf


class ForecastCache:
    """Cache of the expected ends of all waiting plates, renewed at most every few wall seconds.

    The forecast of a large queue is computed in the steps of `find_background_work`, and the daemon does
    other work between them; until it is complete, callers get the last forecast.

    Parameters
    ----------
    clock
        The farm's clock.
    find_books, find_situation
        Functions that return the committed books, and the situation to forecast.
    """

    def __init__(
        self, clock: Clock, find_books: Callable[[], Books], find_situation: Callable[[], Situation]
    ) -> None:
        self._clock, self._find_books, self._find_situation = clock, find_books, find_situation
        self._books: Books | None = None
        self._ends = ExpectedEnds()
        self._is_large = False

    def on_clock_set(self) -> None:
        """Drop the forecast after a step of the host's clock, which shifts the expected ends."""
        self._ends = ExpectedEnds()

    def find_ends(self) -> ExpectedEnds:
        """Return the expected ends; for a large queue those of the last forecast, which may be empty."""
        if not self._is_large:
            steps = self._find_due_work()
            if not self._is_large:
                for _ in steps or ():
                    pass
        return self._ends

    def find_background_work(self) -> Iterator[None] | None:
        """Return the steps that compute the forecast of a large queue; None if there are none to do."""
        steps = self._find_due_work()
        return steps if self._is_large else None

    def _find_due_work(self) -> Iterator[None] | None:
        books, now_s = self._find_books(), self._clock.now()
        age_s = now_s - self._ends.at_s
        interval_s = (_LARGE_QUEUE_INTERVAL_S if self._is_large else _MIN_INTERVAL_S) * self._clock.scale
        if age_s <= interval_s or (books is self._books and age_s <= _MAX_AGE_S):
            return None
        situation = self._find_situation()
        self._is_large = len(situation.waiting_plates) >= LARGE_QUEUE_SIZE
        return self._forecast_ends(situation, books, self._ends)

    def _forecast_ends(
        self, situation: Situation, books: Books, previous_ends: ExpectedEnds
    ) -> Iterator[None]:
        forecast = yield from forecast_in_steps(situation, include_bound=False)
        if self._ends is previous_ends:  # otherwise, the clock was set during the forecast
            ends_s = {slot.plate: slot.end_s for slot in forecast.slots}
            self._books, self._ends = books, ExpectedEnds(ends_s, situation.now_s)
