"""Weekly time windows in the notation of `fleet.yaml`: `mon-fri 08:00-18:00`. Pure."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import time

DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
_WINDOW_PATTERN = re.compile(r"(?:([a-z,-]+)\s+)?(\d{1,2}):(\d{2})\s*-\s*(\d{1,2}):(\d{2})")
_ADVICE = "write it as 'mon-fri 08:00-18:00', 'sat,sun 10:00-14:00' or '22:00-06:00'"


@dataclass(frozen=True, slots=True)
class Window:
    """Time from `start` to `end` on each of `days`; if `end` is not after `start`, it is on the next day."""

    days: frozenset[int]  # 0 is Monday
    start: time
    end: time


def parse_window(text: str) -> Window:
    """Parse a window of `fleet.yaml`; a window without days applies every day.

    Raises
    ------
    ValueError
        If the text is not a window; the message gives an example.
    """
    match = _WINDOW_PATTERN.fullmatch(text.strip().lower())
    if match is None:
        raise ValueError(f"{text!r} is not a weekly time window; {_ADVICE}")
    days, *numbers = match.groups()
    hour, minute, end_hour, end_minute = map(int, numbers)
    if (end_hour, end_minute) == (24, 0):
        end_hour = 0
    try:
        start, end = time(hour, minute), time(end_hour, end_minute)
    except ValueError as error:
        raise ValueError(f"{text!r}: {error}; {_ADVICE}") from error
    return Window(_parse_days(days, text), start, end)


def _parse_days(words: str | None, text: str) -> frozenset[int]:
    if words is None:
        return frozenset(range(7))
    days: set[int] = set()
    for word in words.split(","):
        first, _, last = word.partition("-")
        if first not in DAYS or (last or first) not in DAYS:
            raise ValueError(f"{text!r}: {word!r} is not a day; use {', '.join(DAYS)}")
        begin, end = DAYS.index(first), DAYS.index(last or first)
        days |= {(begin + step) % 7 for step in range((end - begin) % 7 + 1)}
    return frozenset(days)
