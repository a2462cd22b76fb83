"""Totals of a job and of a night: printed and good plates, wasted time, used and wasted filament. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from farm.model import Job, Print, PrintState, Verdict
from farm.state import Books, PlateState

_PRINTED_STATES = (PlateState.PRINTED, PlateState.GOOD)
NIGHT_S = 16 * 3600.0
"""Length of the period that counts as last night; it ends now."""


@dataclass(frozen=True, slots=True)
class JobTotals:
    """Counts of the plates of a job, and the time and filament that were wasted."""

    printed_count: int = 0  # plates, with or without a verdict
    good_count: int = 0  # plates
    printed_copy_count: int = 0  # copies of the model of which all parts are printed
    wasted_s: float = 0.0
    wasted_grams: float = 0.0


@dataclass(frozen=True, slots=True)
class NightTotals:
    """Counts of plates in a period by outcome, and the filament of the prints that ended in it."""

    since_s: float
    printed_count: int = 0
    failed_count: int = 0
    printing_count: int = 0
    waiting_count: int = 0  # plates that have not started
    grams: float = 0.0  # of prints that are not wasted
    wasted_grams: float = 0.0

    @property
    def plate_count(self) -> int:
        return self.printed_count + self.failed_count + self.printing_count + self.waiting_count


def compute_duration_s(attempt: Print) -> float:
    """Return the seconds that an ended print occupied its printer; 0 if it never started."""
    if attempt.started_s is None or attempt.ended_s is None:
        return 0.0
    return max(0.0, attempt.ended_s - attempt.started_s)


def is_wasted(attempt: Print) -> bool:
    """Return whether a print failed, was cancelled, or produced a bad part."""
    return attempt.state.ended and (attempt.state is not PrintState.DONE or attempt.verdict is Verdict.BAD)


def compute_job_totals(books: Books, job: Job) -> JobTotals:
    """Count the plates of a job, and add up the wasted time and filament."""
    states = [books.find_plate_state(plate) for plate in books.list_plates(job)]
    copy_numbers = [books.parts[plate.parts[0]].copy_number for plate in books.list_plates(job)]
    unfinished_copies = {
        copy_number
        for copy_number, state in zip(copy_numbers, states, strict=True)
        if state not in _PRINTED_STATES
    }
    waste = [
        (compute_duration_s(attempt), attempt.grams)
        for attempt in books.list_job_prints(job)
        if is_wasted(attempt)
    ]
    return JobTotals(
        printed_count=sum(map(states.count, _PRINTED_STATES)),
        good_count=states.count(PlateState.GOOD),
        printed_copy_count=len(set(copy_numbers) - unfinished_copies),
        wasted_s=sum(seconds for seconds, _ in waste),
        wasted_grams=sum(grams for _, grams in waste),
    )


def compute_night_totals(books: Books, recent_prints: Iterable[Print], now_s: float) -> NightTotals | None:
    """Count the plates of last night, and add up their filament; return None if no print ended then.

    Parameters
    ----------
    books
        The books.
    recent_prints
        All prints that ended last night; may include others.
    now_s
        Farm time, in seconds since the epoch.
    """
    since_s = now_s - NIGHT_S
    ended_prints = [
        p for p in recent_prints if p.ended_s is not None and p.ended_s >= since_s and p.started_s is not None
    ]
    if not ended_prints:
        return None
    printed_plates = {p.plate for p in ended_prints if not is_wasted(p)}
    failed_plates = {p.plate for p in ended_prints if p.state is PrintState.FAILED} - printed_plates
    # If a failed part was cut again, its pieces are counted instead.
    failed_plates = {name for name in failed_plates if not books.plates[name].replaced_by}
    printing_plates = {p.plate for p in books.list_open_prints()} - printed_plates
    waiting_plates = {plate.id for plate in books.list_waiting_plates()} - printed_plates - failed_plates
    grams = [(is_wasted(p), p.grams) for p in ended_prints]
    return NightTotals(
        since_s=since_s,
        printed_count=len(printed_plates),
        failed_count=len(failed_plates - printing_plates),
        printing_count=len(printing_plates),
        waiting_count=len(waiting_plates),
        grams=sum(used_grams for wasted, used_grams in grams if not wasted),
        wasted_grams=sum(used_grams for wasted, used_grams in grams if wasted),
    )
