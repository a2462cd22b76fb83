"""Parsing of moments as a person writes them: `22:00`, `fri 22:00`, `2026-11-21 22:00`. Pure."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, tzinfo

from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions
from farm.scheduling.start_rules import StartRules
from farm.week_windows import DAYS

_FARTHEST_S = 366 * 86400.0
_TIME = re.compile(r"(?:([a-z]{3})\s+)?(\d{1,2}):(\d{2})")


def moment_s(text: str, now_s: float, zone: tzinfo) -> float:
    """Parse the next such moment after now, in seconds since the epoch.

    Raises
    ------
    ValueError
        Where it cannot be read, has passed, or is more than a year ahead, with what to write instead.
    """
    now = datetime.fromtimestamp(now_s, zone)
    found = _TIME.fullmatch(text.strip().lower())
    try:
        if found is None:
            then = datetime.fromisoformat(text.strip())
            at_s = (then if then.tzinfo is not None else then.replace(tzinfo=zone)).timestamp()
        else:
            day, hour, minute = found.groups()
            if day is not None and day not in DAYS:
                raise ValueError(f"{day!r} is not a day of the week")
            at_s = _next(now, day, int(hour), int(minute)).timestamp()
    except ValueError as error:
        example = "write it like 22:00, fri 22:00 or 2026-11-21T22:00"
        why = f" ({error})" if found is not None else ""
        raise ValueError(f"{text!r} is not a time{why}; {example}") from error
    if at_s <= now_s:
        raise ValueError(f"{text!r} has passed: it is {now:%a %Y-%m-%d %H:%M}")
    if at_s > now_s + _FARTHEST_S:
        raise ValueError(f"{text!r} is more than a year ahead: it is {now:%a %Y-%m-%d %H:%M}")
    return at_s


def start_and_deadline_s(
    options: JobOptions, rules: StartRules, now_s: float
) -> tuple[float | None, float | None]:
    """Parse when a job may start and by when it is wanted; None for what was not said.

    Raises
    ------
    FarmError
        Where what they said is no moment to come.
    """
    try:
        if options.at is not None:
            begins_s: float | None = moment_s(options.at, now_s, rules.zone)
        else:
            begins_s = rules.evening_s(now_s) if options.overnight else None
        done_by = options.done_by
        return begins_s, None if done_by is None else moment_s(done_by, begins_s or now_s, rules.zone)
    except ValueError as error:
        raise FarmError(str(error), ErrorCode.SETTINGS) from error


def _next(now: datetime, day: str | None, hour: int, minute: int) -> datetime:
    """Return the next such local time; one that a change of the clock brings twice is met twice."""
    then = now.replace(hour=hour, minute=minute, second=0, microsecond=0, fold=0)
    for _ in range(9):
        again = then.replace(fold=1)  # an hour later where it comes twice, earlier where it is skipped
        if day is None or DAYS[then.weekday()] == day:
            for moment in (then, again) if again.timestamp() > then.timestamp() else (then,):
                if moment.timestamp() > now.timestamp():
                    return moment
        then += timedelta(days=1)
    raise AssertionError("a week has every day")
