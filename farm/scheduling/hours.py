"""Weekly hours as spans on the calendar, and parsing of times that a user enters. Pure."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta, tzinfo
from functools import lru_cache

from farm.week_windows import DAYS, Window

_SEARCH_DAYS = 15  # in two weeks, every weekly window occurs as a whole
_MAX_SPAN_S = 8 * 86400.0  # a longer span has no gap and never ends
Span = tuple[float, float]
"""Start and end of windows that touch or overlap, in seconds since the epoch."""


@dataclass(frozen=True, slots=True)
class Hours:
    """Weekly windows in a time zone, such as the attended hours.

    A local time that daylight saving time skips is moved an hour later. At a local time that occurs twice,
    windows start at the first occurrence and end at the second, so that they include every minute.
    """

    windows: tuple[Window, ...]
    zone: tzinfo

    def find_span(self, at_s: float) -> Span | None:
        """Return the half-open span that contains `at_s`; None if there is none. It may end at infinity."""
        return next((span for span in self._list_spans_near(at_s) if span[0] <= at_s < span[1]), None)

    def find_next_span(self, at_s: float) -> Span | None:
        """Return the first span that starts after `at_s`; None if there is none."""
        return next((span for span in self._list_spans_near(at_s) if span[0] > at_s), None)

    def find_next_edge_s(self, at_s: float) -> float | None:
        """Return the next start or end of a span; None if there is none."""
        current, next_span = self.find_span(at_s), self.find_next_span(at_s)
        if current is not None:
            return None if math.isinf(current[1]) else current[1]
        return next_span[0] if next_span is not None else None

    def _list_spans_near(self, at_s: float) -> tuple[Span, ...]:
        day = datetime.fromtimestamp(at_s, self.zone).toordinal()
        return _list_spans(self.windows, self.zone, day)


@lru_cache(maxsize=64)
def _list_spans(windows: tuple[Window, ...], zone: tzinfo, day: int) -> tuple[Span, ...]:
    """Return the spans of two weeks in order, from the day before `day`, the ordinal of a date."""
    spans = []
    for ordinal in range(day - 1, day + _SEARCH_DAYS):
        date = datetime.fromordinal(ordinal).replace(tzinfo=zone)
        for window in windows:
            if date.weekday() in window.days:
                day_offset = timedelta(days=window.end <= window.start)
                start = datetime.combine(date, window.start, zone)
                end = datetime.combine(date + day_offset, window.end, zone)
                spans.append((start.timestamp(), max(end.timestamp(), end.replace(fold=1).timestamp())))
    return tuple(
        (start_s, math.inf if end_s - start_s > _MAX_SPAN_S else end_s)
        for start_s, end_s in _merge_spans(spans)
    )


def _merge_spans(spans: Iterable[Span]) -> list[Span]:
    merged_spans: list[Span] = []
    for start_s, end_s in sorted(spans):
        if end_s <= start_s:
            continue  # daylight saving time skips the whole span
        if merged_spans and start_s <= merged_spans[-1][1]:
            merged_spans[-1] = (merged_spans[-1][0], max(merged_spans[-1][1], end_s))
        else:
            merged_spans.append((start_s, end_s))
    return merged_spans


_MAX_LEAD_TIME_S = 366 * 86400.0
_TIME_PATTERN = re.compile(r"(?:([a-z]{3})\s+)?(\d{1,2}):(\d{2})")


def parse_moment_s(text: str, now_s: float, zone: tzinfo) -> float:
    """Parse a time that a user enters; return its next occurrence, in seconds since the epoch.

    Raises
    ------
    ValueError
        If the text is not a time, or a time that has passed or is more than a year ahead.
    """
    now = datetime.fromtimestamp(now_s, zone)
    match = _TIME_PATTERN.fullmatch(text.strip().lower())
    try:
        if match is None:
            moment = datetime.fromisoformat(text.strip())
            at_s = (moment if moment.tzinfo is not None else moment.replace(tzinfo=zone)).timestamp()
        else:
            day, hour, minute = match.groups()
            if day is not None and day not in DAYS:
                raise ValueError(f"{day!r} is not a day of the week")
            at_s = _find_next_occurrence(now, day, int(hour), int(minute)).timestamp()
    except ValueError as error:
        example = "write it like 22:00, fri 22:00 or 2026-11-21T22:00"
        cause = f" ({error})" if match is not None else ""
        raise ValueError(f"{text!r} is not a time{cause}; {example}") from error
    if at_s <= now_s:
        raise ValueError(f"{text!r} has passed: it is {now:%a %Y-%m-%d %H:%M}")
    if at_s > now_s + _MAX_LEAD_TIME_S:
        raise ValueError(f"{text!r} is more than a year ahead: it is {now:%a %Y-%m-%d %H:%M}")
    return at_s


def _find_next_occurrence(now: datetime, day: str | None, hour: int, minute: int) -> datetime:
    """Return the next occurrence of a local time, which daylight saving time may repeat."""
    moment = now.replace(hour=hour, minute=minute, second=0, microsecond=0, fold=0)
    for _ in range(9):
        repeated = moment.replace(fold=1)  # an hour later if it occurs twice, earlier if it is skipped
        if day is None or DAYS[moment.weekday()] == day:
            for candidate in (moment, repeated) if repeated.timestamp() > moment.timestamp() else (moment,):
                if candidate.timestamp() > now.timestamp():
                    return candidate
        moment += timedelta(days=1)
    raise AssertionError("a week has every day")
