"""Spans, moments and amounts as a person reads them."""

from __future__ import annotations

from datetime import datetime


def span(seconds: float | None) -> str:
    """Hours and minutes, or seconds where it is short; a dash where it is not known."""
    if seconds is None:
        return "-"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours}h{minutes:02d}" if hours else f"{minutes} min"


def filament(grams: float, length_mm: float, price: float | None = None, currency: str | None = None) -> str:
    """How much filament, and what it costs where that is known."""
    parts = [f"{grams:.0f} g", f"{length_mm / 1000:.1f} m"]
    if price is not None:
        parts.append(f"{price:.2f} {currency or ''}".rstrip())
    return ", ".join(parts)


def moment(iso: str | None) -> str:
    """The time of day, with the weekday."""
    return "-" if iso is None else datetime.fromisoformat(iso).strftime("%a %H:%M")
