"""Moments and amounts as a person reads them."""

from __future__ import annotations

import sys
from datetime import datetime

from farm.model import PlanProgress, PlanStep
from farm.text import count


def say(line: str) -> None:
    """One line for a person, on stderr."""
    print(f"farm: {line}", file=sys.stderr)


def off_plan(share: float) -> str:
    """How much longer or shorter than planned."""
    return f"{round(100 * share):+d} %"


def filament(grams: float, length_mm: float, price: float | None = None, currency: str | None = None) -> str:
    """How much filament, and what it costs where that is known."""
    parts = [f"{_short(grams)} g", f"{_short(length_mm / 1000)} m"]
    if price is not None:
        parts.append(f"{price:.2f} {currency}" if currency else f"price {price:.2f}")
    return ", ".join(parts)


def planning(progress: PlanProgress) -> str:
    """Where the planning of a job is."""
    if progress.step is PlanStep.DECOMPOSING:
        return "decomposing"
    if progress.step is PlanStep.LEVELLING:
        return "levelling what was sliced"
    if progress.step is PlanStep.NO_ROOM:
        return "waiting for room on the disk"
    return f"slicing {progress.done} of {progress.of}" + (
        f" ({from_cache(progress.cached)})" if progress.cached else ""
    )


def from_cache(plates: int) -> str:
    """That the engine did not run for these plates."""
    return f"{count(plates, 'plate')} from the cache"


def _short(amount: float) -> str:
    decimals = 0 if amount >= 100 else 1 if amount >= 1 else 2
    return f"{amount:.{decimals}f}"


def moment(iso: str | None) -> str:
    """The time of day, with the weekday."""
    return "-" if iso is None else datetime.fromisoformat(iso).strftime("%a %H:%M")
