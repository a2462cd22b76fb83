"""Durations, amounts and errors as people read them. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic_core import ErrorDetails


def span(seconds: float | None) -> str:
    """Hours and minutes, or seconds where it is short; a dash where it is not known."""
    if seconds is None:
        return "-"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours}h{minutes:02d}" if hours else f"{minutes} min"


def mass(grams: float) -> str:
    """Grams, or kilograms where it is much."""
    return f"{grams / 1000:.2f} kg" if grams >= 1000 else f"{grams:.0f} g"


def one_line(text: str) -> str:
    """Text without what would move a terminal's cursor: printable, on one line."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def count(number: int, what: str) -> str:
    """1 part, 2 parts."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def first_of(mistakes: Sequence[ErrorDetails]) -> str:
    """Where the first mistake in some data is, and what it is, as the library that found it says."""
    return f"{'.'.join(map(str, mistakes[0]['loc']))}: {mistakes[0]['msg']}"


def part_number(part: str) -> str:
    """The number of a part in its job: of 3/p01, p01, 01 or 1 it is 1."""
    return part.rpartition("/")[2].removeprefix("p").lstrip("0")
