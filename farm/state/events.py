"""Events (past tense) and the instructions that follow from them (imperative)."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from farm.errors import ErrorCode
from farm.model import Bed, FilamentState, Hold, Job, Part, Plate, PrintState, Reel, Verdict

A_PERSON = "a person"
"""Who asked, where nobody knows more."""


class Event(BaseModel):
    """Something that happened at `at_s` on the farm's clock."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    at_s: float


class PrinterAdded(Event):
    """A printer of `fleet.yaml` that the books did not know."""

    printer: str
    bed: Bed


class ClockSet(Event):
    """The host's clock was set ahead by so many seconds, or back where it is negative."""

    by_s: float


class JobSubmitted(Event):
    job: Job


class JobHeld(Event):
    """The job in front cannot begin yet."""

    job: int
    hold: Hold | None


class PlanningStarted(Event):
    job: int


class PlanningAbandoned(Event):
    """The plan could not be made now (a daemon died, too few printers): the job waits in front again."""

    job: int
    hold: Hold | None


class JobPlanned(Event):
    job: int
    parts: tuple[Part, ...]
    plates: tuple[Plate, ...]
    repairs: tuple[str, ...]
    scale: float
    serial_s: float
    expected_s: float
    picture: str | None
    assembly: str | None = None
    decomposition: str | None = None
    lower_bound_s: float | None = None
    plan: str | None = None
    held: bool = False  # until a person approves this very plan


class JobApproved(Event):
    """A person lets a held job print as it was planned."""

    job: int
    by: str


class JobFailed(Event):
    job: int
    error: ErrorCode
    reason: str


class JobCancelled(Event):
    job: int
    by: str = A_PERSON


class PlateAssigned(Event):
    plate: str
    printer: str
    print_id: str


class PlateReplaced(Event):
    """A waiting plate was sliced for another kind of printer, or its part was cut for several.

    `parts` are those of the new plates; a part that was only sliced again keeps its name. The new plates go
    on with the old one's prints, and so with its attempts.
    """

    plate: str
    parts: tuple[Part, ...]
    plates: tuple[Plate, ...]
    picture: str | None = None  # of the whole job, where parts are new; and the GLB
    assembly: str | None = None
    decomposition: str | None = None  # the report on the cut


class PrintProgressed(Event):
    """A print entered another state, or began to extrude."""

    print_id: str
    state: PrintState
    started_s: float | None
    extruded: bool


class PauseRequested(Event):
    """A person wants an open print to wait, or to go on."""

    print_id: str
    wanted: bool
    by: str = A_PERSON


class PrintWithdrawn(Event):
    """A print that its printer cannot begin was taken back; its plate goes elsewhere once the agent knows."""

    print_id: str
    reason: str


class PrintEnded(Event):
    print_id: str
    state: PrintState
    fault: str | None
    reason: str | None
    started_s: float | None
    ended_s: float
    extruded: bool
    filament: FilamentState
    starved_s: float = 0.0
    printed_share: float | None = None  # of its layers' time; None: not known


class PrintFailRequested(Event):
    """A person saw an open print go wrong: it is ended, and its plate printed again."""

    print_id: str
    why: str
    by: str


class PlatePaused(Event):
    """A person keeps a plate that waits from every printer, or lets it go on."""

    plate: str
    wanted: bool
    by: str


class PlateCancelled(Event):
    """A person wants nothing more of a plate."""

    plate: str
    by: str


class ReprintRequested(Event):
    """A person wants a plate printed again, whatever became of it."""

    plate: str
    why: str
    by: str


class JobPaused(Event):
    """A person wants a job to wait (what prints is parked, nothing of it starts), or to go on."""

    job: int
    wanted: bool
    by: str = A_PERSON


class MaintenanceStarted(Event):
    """A person takes a printer out of use; what it prints goes on to its end."""

    printer: str
    why: str
    by: str


class MaintenanceEnded(Event):
    """A person put a printer back into use, and looked at what had to be looked at."""

    printer: str
    by: str


class PrinterLost(Event):
    """The board of an idle printer, or the way to it, is gone."""

    printer: str


class OutageConfirmed(Event):
    """A person has seen to what took several printers at once."""

    by: str


class BedCleared(Event):
    """A person cleared the bed, looked at what had to be looked at, and judged what was printed there."""

    printer: str
    by: str
    filament: FilamentState | None = None
    verdict: Verdict = Verdict.GOOD
    why: str | None = None
    whole: str | None = None  # a print that had failed there: its part is whole and good


class BooksRestored(Event):
    """The books were damaged; these are as they were at `copied_s`. What was printed since is not known."""

    copied_s: float


class PrintFound(Event):
    """An agent has, or had, a print that books restored from a copy do not know; its plate they do."""

    plate: str
    printer: str
    print_id: str


class AgentJournalImported(Event):
    """An agent has said what it printed since the books were copied; no plate waits for `unknown` of it."""

    printer: str
    unknown: int


class ReelLoaded(Event):
    """A person put a reel on a printer, or said how much is on it."""

    printer: str
    reel: Reel
    by: str


class BedReported(Event):
    """An emulator reported its bed and filament; it counts where the books do not know."""

    printer: str
    bed: Bed
    filament: FilamentState


class PrinterAlarmed(Event):
    """A heater cannot be switched off, or what was done about it became known."""

    printer: str
    reason: str


class BedBecameUnknown(Event):
    """Something happened at the printer that the farm did not cause: bed and filament are not known."""

    printer: str
    reason: str


AnyEvent = (
    PrinterAdded
    | ClockSet
    | JobSubmitted
    | JobHeld
    | PlanningStarted
    | PlanningAbandoned
    | JobPlanned
    | JobApproved
    | JobFailed
    | JobCancelled
    | PlateAssigned
    | PlateReplaced
    | PrintProgressed
    | PauseRequested
    | PrintWithdrawn
    | PrintEnded
    | PrintFailRequested
    | PlatePaused
    | PlateCancelled
    | ReprintRequested
    | JobPaused
    | MaintenanceStarted
    | MaintenanceEnded
    | PrinterLost
    | OutageConfirmed
    | BedCleared
    | ReelLoaded
    | BooksRestored
    | PrintFound
    | AgentJournalImported
    | BedReported
    | BedBecameUnknown
    | PrinterAlarmed
)


class Instruction(BaseModel):
    model_config = ConfigDict(frozen=True)


class SendStart(Instruction):
    """Have an agent begin a print, within the hours that are known when it is sent."""

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
