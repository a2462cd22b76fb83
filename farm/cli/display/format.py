"""Times and amounts as text."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from farm import api
from farm.model import PlanProgress, PlanStep
from farm.text import format_count


def format_deviation(share: float) -> str:
    """Format how much longer (+) or shorter (-) than planned something took, in percent."""
    return f"{round(100 * share):+d} %"


def format_share(share: float) -> str:
    """Format a share of 1 in percent."""
    return f"{100 * share:.0f} %"


def format_filament(
    grams: float, length_mm: float, price: float | None = None, currency: str | None = None
) -> str:
    """Format an amount of filament, with its price if that is known."""
    parts = [f"{_short(grams)} g", f"{_short(length_mm / 1000)} m"]
    if price is not None:
        parts.append(f"{price:.2f} {currency}" if currency else f"price {price:.2f}")
    return ", ".join(parts)


def format_planning(progress: PlanProgress) -> str:
    """Describe the current step in planning a job."""
    if progress.step is PlanStep.DECOMPOSING:
        return "decomposing"
    if progress.step is PlanStep.LEVELLING:
        return "balancing the parts by their sliced times"
    if progress.step is PlanStep.NO_ROOM:
        return "waiting for space on the disk"
    return f"slicing {progress.done} of {progress.of}" + (
        f" ({format_cached(progress.cached)})" if progress.cached else ""
    )


def format_cached(plates: int) -> str:
    """Format the number of plates taken from the slice cache."""
    return f"{format_count(plates, 'plate')} from the cache"


def _short(amount: float) -> str:
    decimals = 0 if amount >= 100 else 1 if amount >= 1 else 2
    return f"{amount:.{decimals}f}"


def format_time(iso: str | None) -> str:
    """Format a time of day with its weekday; a dash if there is none."""
    return "-" if iso is None else datetime.fromisoformat(iso).strftime("%a %H:%M")


def format_runs(runs: Sequence[api.RunView]) -> str:
    """Format the intervals in which a job was printed."""
    return ", ".join(
        f"{format_time(run.started)} to {format_time(run.ended) if run.ended else 'now'}" for run in runs
    )
