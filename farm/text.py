"""Formatting of durations, amounts and errors for people. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta

from pydantic_core import ErrorDetails


def format_duration(seconds: float | None) -> str:
    """Format a duration in hours and minutes, or in seconds if it is short; None gives a dash."""
    if seconds is None:
        return "-"
    total_s = round(seconds)
    if total_s < 120:
        return f"{total_s} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours}h{minutes:02d}" if hours else f"{minutes} min"


_WEEKDAY_RANGE = timedelta(days=6)
"""Maximum distance from now at which a weekday is unambiguous."""
_DATE_RANGE = timedelta(days=300)
"""Maximum distance from now at which a date is unambiguous without its year."""
_TIME_RANGE = timedelta(hours=20)
"""Maximum distance from now at which a past time is unambiguous without its weekday."""


def format_moment(moment: datetime, now: datetime) -> str:
    """Format a time with its weekday, or with its date if it is more than six days from now.

    Parameters
    ----------
    moment, now
        The time to format and the present time, with time zones. A distant time is shown with its year.
    """
    distance = abs(moment - now)
    if distance <= _WEEKDAY_RANGE:
        return f"{moment:%a %H:%M}"
    return f"{moment:%a %d %b %H:%M}" if distance <= _DATE_RANGE else f"{moment:%d %b %Y %H:%M}"


def format_recent_moment(moment: datetime, now: datetime) -> str:
    """Format a time in the last 20 hours without its weekday, and any other time as `format_moment` does."""
    return f"{moment:%H:%M}" if timedelta() <= now - moment <= _TIME_RANGE else format_moment(moment, now)


def format_mass(grams: float) -> str:
    """Format a mass in grams, or in kilograms from 1000 g."""
    return f"{grams / 1000:.2f} kg" if grams >= 1000 else f"{grams:.0f} g"


def flatten_text(text: str) -> str:
    """Join a text into one line, without terminal control characters."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def format_count(number: int, noun: str) -> str:
    """Format a number of things: 1 part, 2 parts."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def describe_first_error(errors: Sequence[ErrorDetails]) -> str:
    """Describe the first of pydantic's errors by the location of the value and the message."""
    return f"{'.'.join(map(str, errors[0]['loc']))}: {errors[0]['msg']}"


def parse_part_number(part: str) -> str:
    """Extract from a part's name its number in the job, without leading zeros: 1 for 3/p01, p01, 01 and 1."""
    return part.rpartition("/")[2].removeprefix("p").lstrip("0")
