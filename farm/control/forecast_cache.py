"""When what waits should end: foreseen anew when the books have changed, but not at every look."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from farm.scheduling.forecast import forecast
from farm.scheduling.situation import PrinterView
from farm.scheduling.situation_builder import plate_views
from farm.scheduling.start_rules import Rules
from farm.state.books import Books

_KEPT_S = 60.0  # farm seconds in which nothing has happened
_APART_S = 5.0  # wall seconds: 300 plates on 100 printers take a third of one


class Foresight:
    """The night ahead of all plates that wait; `scale` is farm seconds in a wall second."""

    def __init__(self, rules: Rules, scale: float) -> None:
        self._rules, self._apart_s = rules, _APART_S * scale
        self._books: Books | None = None
        self._at_s = float("-inf")
        self._ends_s: Mapping[str, float] = {}

    def clock_set(self) -> None:
        """The host's clock was set: what was foreseen counted on other hours."""
        self._at_s = float("-inf")

    def ends_s(
        self, books: Books, printers: Callable[[], Sequence[PrinterView]], now_s: float
    ) -> Mapping[str, float]:
        """When each waiting plate should end, since the epoch; none of what no printer can take."""
        old_s = now_s - self._at_s
        if old_s > self._apart_s and (books is not self._books or old_s > _KEPT_S):
            waiting = list(plate_views(books.waiting_plates(), books))
            slots = forecast(waiting, printers(), self._rules, now_s, bounded=False).slots if waiting else ()
            self._books, self._at_s = books, now_s
            self._ends_s = {slot.plate: slot.ends_s for slot in slots}
        return self._ends_s
