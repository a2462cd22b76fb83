"""Prints: attempts to print a plate."""

from __future__ import annotations

from enum import StrEnum

from farm.model.entity import Entity


class PrintState(StrEnum):
    """State of a print."""

    ASSIGNED = "assigned"  # stored in the database; its agent is requested to start it
    HEATING = "heating"
    PRINTING = "printing"
    PAUSED = "paused"  # a person has paused it: the head is parked, and the bed is kept warm
    ENDING = "ending"  # being stopped: the heaters are being switched off
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        """True if the print has ended."""
        return self in (PrintState.DONE, PrintState.FAILED, PrintState.CANCELLED)


class Verdict(StrEnum):
    """Judgement of a person on a printed part."""

    GOOD = "good"
    BAD = "bad"


class Moment(StrEnum):
    """Moment of a print at which a still (a picture by the camera) is kept."""

    FIRST_LAYER = "first_layer"
    END = "end"
    FAILURE = "failure"


class Still(Entity):
    """Picture of a print by its printer's camera."""

    moment: Moment
    at_s: float
    file: str  # name in the file store


class Print(Entity):
    """Attempt to print a plate. Its id is never reused, even if the database is lost."""

    id: str
    plate: str
    job: int
    printer: str
    number: int = 0  # sequence number in order of assignment, because clocks may be set back
    state: PrintState = PrintState.ASSIGNED
    assigned_s: float
    started_s: float | None = None
    ended_s: float | None = None
    fault: str | None = None
    reason: str | None = None
    extruded: bool = False
    cancel_reason: str | None = None
    restored: bool = False  # True if read from a backup; never started, as it may have run since that backup
    fail_reason: str | None = None  # reason why a person marked it as failed (`farm fail`)
    charged: bool = True  # True if its failure counts as an attempt of its plate
    verdict: Verdict | None = None  # judgement of its part; None until a person has judged it
    verdict_why: str | None = None  # reason for the verdict
    pause_requested: bool = False  # True if a person has requested a pause
    paused: bool = False  # True if it was ever paused, so that no time factor is learned from it
    starved_s: float = 0.0
    grams: float = 0.0  # used filament; 0 until the print has ended
    stills: tuple[Still, ...] = ()  # at most one for each moment

    @property
    def shown_state(self) -> PrintState:
        """State as shown to users: a resumed print is heating until it continues."""
        resumes = self.state is PrintState.PAUSED and not self.pause_requested
        return PrintState.HEATING if resumes else self.state
