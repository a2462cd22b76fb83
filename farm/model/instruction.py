"""Instructions that follow from events (imperative), to agents and to the daemon."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from farm.model.printer import FilamentState


class Instruction(BaseModel):
    model_config = ConfigDict(frozen=True)


class SendStart(Instruction):
    """Start a print, within the limits of hours when it is sent."""

    print_id: str
    printer: str
    not_after_s: float | None = None
    ends_by_s: float | None = None


class SendEndBy(Instruction):
    print_id: str
    printer: str
    ends_by_s: float | None


class SendCancel(Instruction):
    print_id: str
    printer: str
    reason: str


class SendPause(Instruction):
    print_id: str
    printer: str
    wanted: bool


class SendForget(Instruction):
    print_id: str
    printer: str


class SendCleared(Instruction):
    printer: str
    filament: FilamentState | None


class StopPlanning(Instruction):
    job: int


class NameFiles(Instruction):
    """Link a planned job's files under readable names."""

    job: int


AnyInstruction = (
    SendStart | SendEndBy | SendCancel | SendPause | SendForget | SendCleared | StopPlanning | NameFiles
)
