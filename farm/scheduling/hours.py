"""Windows of the week on the calendar: when they begin and end, right over changes of the clock. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta, tzinfo
from functools import lru_cache

from farm.week_windows import Window

_HORIZON_DAYS = 15  # windows come again every week; twice that holds a span that lasts a week
_ALWAYS_S = 8 * 86400.0  # windows of a week that leave no gap
Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Hours:
    """Windows in a time zone. Moments are seconds since the epoch.

    A local time that a change of the clock skips is taken an hour later; of one that it brings twice, windows
    begin at the first and end at the second, so that no minute of a window is lost.
    """

    windows: tuple[Window, ...]
    zone: tzinfo

    def span(self, at_s: float) -> Span | None:
        """Return the half-open span around `at_s`; None where there is none. A last one ends at infinity."""
        return next((span for span in self._near(at_s) if span[0] <= at_s < span[1]), None)

    def following(self, at_s: float) -> Span | None:
        """Return the first span that begins after `at_s`; None where there is none."""
        return next((span for span in self._near(at_s) if span[0] > at_s), None)

    def edge_s(self, at_s: float) -> float | None:
        """Return the next begin or end of a window; None where there is none."""
        now, then = self.span(at_s), self.following(at_s)
        if now is not None:
            return None if math.isinf(now[1]) else now[1]
        return then[0] if then is not None else None

    def _near(self, at_s: float) -> tuple[Span, ...]:
        day = datetime.fromtimestamp(at_s, self.zone).toordinal()
        return _spans(self.windows, self.zone, day)


@lru_cache(maxsize=64)
def _spans(windows: tuple[Window, ...], zone: tzinfo, day: int) -> tuple[Span, ...]:
    """Return the spans from the day before this one on, merged, in order."""
    spans = []
    for ordinal in range(day - 1, day + _HORIZON_DAYS):
        date = datetime.fromordinal(ordinal).replace(tzinfo=zone)
        for window in windows:
            if date.weekday() in window.days:
                over = timedelta(days=window.ends <= window.begins)
                begins = datetime.combine(date, window.begins, zone)
                ends = datetime.combine(date + over, window.ends, zone)
                spans.append((begins.timestamp(), max(ends.timestamp(), ends.replace(fold=1).timestamp())))
    return tuple((begin, math.inf if end - begin > _ALWAYS_S else end) for begin, end in _merged(spans))


def _merged(spans: Iterable[Span]) -> list[Span]:
    merged: list[Span] = []
    for begin, end in sorted(spans):
        if end <= begin:
            continue  # a change of the clock skips all of it
        if merged and begin <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], end))
        else:
            merged.append((begin, end))
    return merged
