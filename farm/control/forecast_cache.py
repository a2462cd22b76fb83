"""Cached forecast of when each waiting plate ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from farm.scheduling.forecast import forecast
from farm.scheduling.situation import Situation
from farm.state.books import Books

_KEPT_S = 60.0  # farm seconds in which nothing has happened
_APART_S = 5.0  # wall seconds: 2,000 plates on 200 printers with hours take most of one


class ForecastCache:
    """Forecasts the ends of all waiting plates, at most every few wall seconds.

    Parameters
    ----------
    scale
        Farm seconds in a wall second.
    """

    def __init__(self, scale: float) -> None:
        self._apart_s = _APART_S * scale
        self._books: Books | None = None
        self._at_s = float("-inf")
        self._ends_s: Mapping[str, float] = {}

    def clock_set(self) -> None:
        """Forecast anew: the host's clock was set, and hours are others."""
        self._at_s = float("-inf")

    def ends_s(self, books: Books, situation: Callable[[], Situation], now_s: float) -> Mapping[str, float]:
        """Return when each waiting plate that a printer can take ends, in seconds since the epoch."""
        old_s = now_s - self._at_s
        if old_s > self._apart_s and (books is not self._books or old_s > _KEPT_S):
            slots = forecast(situation(), bounded=False).slots
            self._books, self._at_s = books, now_s
            self._ends_s = {slot.plate: slot.ends_s for slot in slots}
        return self._ends_s
