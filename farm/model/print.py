"""Prints: attempts to print a plate."""

from __future__ import annotations

from enum import StrEnum

from farm.model.entity import Entity


class PrintState(StrEnum):
    ASSIGNED = "assigned"  # in the books; the agent has been or will be told
    HEATING = "heating"
    PRINTING = "printing"
    PAUSED = "paused"  # by a person: parked, its bed warm
    ENDING = "ending"  # heaters going off
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        return self in (PrintState.DONE, PrintState.FAILED, PrintState.CANCELLED)


class Verdict(StrEnum):
    """Judgement of a person on what was printed."""

    GOOD = "good"
    BAD = "bad"


class Print(Entity):
    """Attempt to print a plate. Its id never comes back, even where the books are lost."""

    id: str
    plate: str
    job: int
    printer: str
    number: int = 0  # of all prints, in the order of their beginning: a clock may be set back meanwhile
    state: PrintState = PrintState.ASSIGNED
    assigned_s: float
    started_s: float | None = None
    ended_s: float | None = None
    fault: str | None = None
    reason: str | None = None
    extruded: bool = False
    cancel_reason: str | None = None
    restored: bool = False  # from a copy of the books: it may have begun or ended since, and is never begun
    fail_reason: str | None = None  # a person saw it go wrong: what they said of it
    charged: bool = True  # its failure counts as an attempt
    verdict: Verdict | None = None  # once it is done
    verdict_why: str | None = None
    pause_requested: bool = False  # a person wants it to wait
    paused: bool = False  # it did at some time: how long it took says nothing of its printer
    starved_s: float = 0.0
    grams: float = 0.0  # what it took off its reel, once it has ended
