"""Time axis of a chart: the positions of times, and marks at round times. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta, tzinfo

_STEPS_S = (900, 1800, 3600, 7200, 14_400, 21_600, 43_200, 86_400, 172_800, 604_800)
_MIN_SPAN_S = 60.0


@dataclass(frozen=True, slots=True)
class TimeMark:
    """Mark of a time axis at `x` px, with its time as ISO 8601 and as a short text."""

    x: float
    at: str
    text: str


@dataclass(frozen=True, slots=True)
class TimeAxis:
    """Axis from `begin_s` to `end_s` (seconds since the epoch), drawn from `left` to `left + width` px."""

    begin_s: float
    end_s: float
    left: float
    width: float
    zone: tzinfo

    def compute_x(self, at_s: float) -> float:
        """Compute the position of a time in px; times outside the axis are placed at its ends."""
        span_s = max(_MIN_SPAN_S, self.end_s - self.begin_s)
        return self.left + self.width * min(1.0, max(0.0, (at_s - self.begin_s) / span_s))

    def list_marks(self, max_marks: int = 10) -> list[TimeMark]:
        """List marks at round local times; the first mark, and each mark at midnight, shows the weekday."""
        marks, has_shown_day = [], False
        for moment in self.list_times(max_marks):
            shows_day = not has_shown_day or (moment.hour, moment.minute) == (0, 0)
            has_shown_day = True
            marks.append(
                TimeMark(
                    self.compute_x(moment.timestamp()),
                    moment.isoformat("T", "seconds"),
                    f"{moment:%a %H:%M}" if shows_day else f"{moment:%H:%M}",
                )
            )
        return marks

    def list_times(self, max_times: int) -> Iterator[datetime]:
        """Yield round local times on the axis in ascending order, about `max_times` at most."""
        span_s = max(_MIN_SPAN_S, self.end_s - self.begin_s)
        step_s = next((step for step in _STEPS_S if span_s / step <= max_times), _STEPS_S[-1])
        step = timedelta(seconds=step_s)
        day = datetime.fromtimestamp(self.begin_s, self.zone).replace(
            hour=0, minute=0, second=0, microsecond=0
        )
        moment = day  # local time, so that times stay round when daylight saving time begins or ends
        while moment.timestamp() <= self.end_s:
            if moment.timestamp() >= self.begin_s:
                yield moment
            moment += step
