"""Spans as a person reads them. Pure."""

from __future__ import annotations


def span(seconds: float | None) -> str:
    """Hours and minutes, or seconds where it is short; a dash where it is not known."""
    if seconds is None:
        return "-"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours}h{minutes:02d}" if hours else f"{minutes} min"
