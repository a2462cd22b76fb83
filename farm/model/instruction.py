"""Instructions to agents and to the daemon. They follow from events, and their names are imperatives."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from farm.model.printer import FilamentState


class Instruction(BaseModel):
    """Base of all instructions."""

    model_config = ConfigDict(frozen=True)


class SendStart(Instruction):
    """Start a print; the attended and quiet hours limit when it may start and end."""

    print_id: str
    printer: str
    not_after_s: float | None = None  # time after which it must not start; None for no limit
    ends_by_s: float | None = None  # time at which it is ended if it is still running; None for no limit


class SendEndBy(Instruction):
    """Set the time at which an open print is ended if it is still running; None for no limit."""

    print_id: str
    printer: str
    ends_by_s: float | None


class SendCancel(Instruction):
    """End an open print safely."""

    print_id: str
    printer: str
    reason: str


class SendPause(Instruction):
    """Pause or resume an open print."""

    print_id: str
    printer: str
    pause: bool  # False: resume


class SendForget(Instruction):
    """Remove an ended print from the agent's records."""

    print_id: str
    printer: str


class SendCleared(Instruction):
    """Report to an agent that the bed of its printer is clear."""

    printer: str
    filament: FilamentState | None


class StopPlanning(Instruction):
    """Stop the planning of a job."""

    job: int


class LinkFiles(Instruction):
    """Create links with readable names to the files of a planned job."""

    job: int


AnyInstruction = (
    SendStart | SendEndBy | SendCancel | SendPause | SendForget | SendCleared | StopPlanning | LinkFiles
)
