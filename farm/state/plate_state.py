"""What has become of a plate, and of the job that it belongs to. Pure.

A print that is done is not yet good: a person's word makes it good or bad. A bad one counts for nothing; the
plate waits again. A failure of the farm's own is charged to the plate's attempts; what a person ended is not.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from enum import Enum, auto

from drivers.errors import Fault
from farm.model import JobState, Plate, Print, PrintState, Verdict

ATTEMPTS = 3
"""How often a plate may fail before a person has to ask for it again."""


class Standing(Enum):
    """Where a plate is."""

    WAITING = auto()
    PRINTING = auto()
    PRINTED = auto()  # nobody has looked at it
    GOOD = auto()
    OUT_OF_ATTEMPTS = auto()
    CANCELLED = auto()


def printed(prints: Iterable[Print]) -> Print | None:
    """The print that a plate's parts come from: done, and not called bad."""
    return next((p for p in prints if p.state is PrintState.DONE and p.verdict is not Verdict.BAD), None)


def stopped(plate: Plate, prints: Iterable[Print]) -> Print | None:
    """The print that a person stopped by `farm estop`, where the plate waits for their word since."""
    last = next(reversed(list(prints)), None)
    return last if plate.paused and last is not None and last.fault == Fault.ESTOP else None


def failures(plate: Plate, prints: Iterable[Print]) -> list[Print]:
    """The failures that are charged to a plate since a person last asked for it."""
    counted = frozenset(plate.prints[plate.counted_from :])
    return [p for p in prints if p.id in counted and p.state is PrintState.FAILED and p.charged]


def standing(plate: Plate, prints: Collection[Print]) -> Standing:
    """Where a plate is, by all of its prints."""
    done = printed(prints)
    if done is not None:
        return Standing.GOOD if done.verdict is Verdict.GOOD else Standing.PRINTED
    if plate.cancelled:
        return Standing.CANCELLED
    if any(not p.state.ended for p in prints):
        return Standing.PRINTING
    return Standing.OUT_OF_ATTEMPTS if len(failures(plate, prints)) >= ATTEMPTS else Standing.WAITING


def job_state(plates: Collection[Standing]) -> JobState:
    """The state of a planned job. A plate that is out of attempts stops none of the others."""
    if Standing.WAITING in plates or Standing.PRINTING in plates:
        return JobState.PRINTING
    if Standing.OUT_OF_ATTEMPTS in plates:
        return JobState.FAILED
    if Standing.PRINTED in plates:
        return JobState.PRINTED
    return JobState.DONE if Standing.GOOD in plates else JobState.CANCELLED
