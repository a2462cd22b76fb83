"""Derivation of the states of plates and jobs. Pure.

A person judges the part of a done print good or bad; after a bad verdict the plate waits again. A failure
counts as one of the plate's attempts, unless the plate is not its cause (`farm.state.faults`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from enum import StrEnum

from drivers.errors import Fault
from farm.model import JobState, Plate, Print, PrintState, Verdict

MAX_ATTEMPTS = 3
"""Number of failures after which a plate is printed again only if a person requests it."""


class PlateState(StrEnum):
    """State of a plate, derived from its prints and from commands of people."""

    WAITING = "waiting"
    PRINTING = "printing"
    PRINTED = "printed"  # without a verdict
    GOOD = "good"
    OUT_OF_ATTEMPTS = "out_of_attempts"
    CANCELLED = "cancelled"
    REPLACED = "replaced"  # other plates are printed instead


def find_successful_print(prints: Iterable[Print]) -> Print | None:
    """Return the done print of a plate whose part is not judged bad; None if there is none."""
    return next((p for p in prints if p.state is PrintState.DONE and p.verdict is not Verdict.BAD), None)


def find_stopped_print(plate: Plate, prints: Iterable[Print]) -> Print | None:
    """Return the print that `farm estop` stopped, if a person has not resumed its plate yet; else None."""
    last_print = next(reversed(list(prints)), None)
    return last_print if plate.paused and last_print is not None and last_print.fault == Fault.ESTOP else None


def list_counted_failures(plate: Plate, prints: Iterable[Print]) -> list[Print]:
    """Return the failures that count as attempts of a plate since its last reprint request."""
    counted_ids = frozenset(plate.prints[plate.counted_from :])
    return [p for p in prints if p.id in counted_ids and p.state is PrintState.FAILED and p.charged]


def derive_plate_state(plate: Plate, prints: Collection[Print]) -> PlateState:
    """Derive the state of a plate from all of its prints."""
    if plate.replaced_by:
        return PlateState.REPLACED
    if not prints:  # the usual case in a large queue
        return PlateState.CANCELLED if plate.cancelled else PlateState.WAITING
    success = find_successful_print(prints)
    if success is not None:
        return PlateState.GOOD if success.verdict is Verdict.GOOD else PlateState.PRINTED
    if plate.cancelled:
        return PlateState.CANCELLED
    if any(not p.state.ended for p in prints):
        return PlateState.PRINTING
    return (
        PlateState.OUT_OF_ATTEMPTS
        if len(list_counted_failures(plate, prints)) >= MAX_ATTEMPTS
        else PlateState.WAITING
    )


def derive_job_state(plate_states: Collection[PlateState]) -> JobState:
    """Derive the state of a planned job from the states of its plates."""
    if PlateState.WAITING in plate_states or PlateState.PRINTING in plate_states:
        return JobState.PRINTING
    if PlateState.OUT_OF_ATTEMPTS in plate_states:
        return JobState.FAILED
    if PlateState.PRINTED in plate_states:
        return JobState.PRINTED
    return JobState.DONE if PlateState.GOOD in plate_states else JobState.CANCELLED
