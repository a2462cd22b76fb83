"""Formatting of durations, amounts and errors for people. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta

from pydantic_core import ErrorDetails


def format_duration(seconds: float | None) -> str:
    """Format a duration in hours and minutes, a short one in seconds; an unknown one is a dash."""
    if seconds is None:
        return "-"
    total = round(seconds)
    if total < 120:
        return f"{total} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours}h{minutes:02d}" if hours else f"{minutes} min"


_SAME_WEEK = timedelta(days=6)
"""Distance up to which a weekday is unambiguous."""
_SAME_YEAR = timedelta(days=300)
_SAME_NIGHT = timedelta(hours=20)


def format_moment(moment: datetime, now: datetime) -> str:
    """Format a time with its weekday; with its date if it is more than six days from now.

    Parameters
    ----------
    moment, now
        The time, and that of the reader, with time zones. A time in another year is shown with the year.
    """
    distance = abs(moment - now)
    if distance <= _SAME_WEEK:
        return f"{moment:%a %H:%M}"
    return f"{moment:%a %d %b %H:%M}" if distance <= _SAME_YEAR else f"{moment:%d %b %Y %H:%M}"


def format_recent(moment: datetime, now: datetime) -> str:
    """Format a time of the last hours without its weekday, and any other as `format_moment` does."""
    return f"{moment:%H:%M}" if timedelta() <= now - moment <= _SAME_NIGHT else format_moment(moment, now)


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
    """Name the place of the first error in some data, and pydantic's message for it."""
    return f"{'.'.join(map(str, errors[0]['loc']))}: {errors[0]['msg']}"


def parse_part_number(part: str) -> str:
    """Extract the number of a part in its job, without zeros before it: 1 for 3/p01, p01, 01 and 1."""
    return part.rpartition("/")[2].removeprefix("p").lstrip("0")
