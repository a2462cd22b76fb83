"""Events, named in the past tense, and the resulting instructions, named in the imperative.

They are one list of records without code, so that a reader sees all that can happen in one file.
"""

from __future__ import annotations

from pydantic import Field

from farm.errors import ErrorCode
from farm.model import Bed, FilamentState, Hold, Job, Part, Plate, PrintState, Reel, Still, Verdict
from farm.model.event import Event as Event
from farm.model.event import HostConnected as HostConnected
from farm.model.event import HostLost as HostLost
from farm.model.event import KeyAdded as KeyAdded
from farm.model.event import KeyRevoked as KeyRevoked
from farm.model.event import SessionExtended as SessionExtended
from farm.model.event import SessionOpened as SessionOpened
from farm.model.instruction import AnyInstruction as AnyInstruction
from farm.model.instruction import Instruction as Instruction
from farm.model.instruction import LinkFiles as LinkFiles
from farm.model.instruction import SendCancel as SendCancel
from farm.model.instruction import SendCleared as SendCleared
from farm.model.instruction import SendEndBy as SendEndBy
from farm.model.instruction import SendForget as SendForget
from farm.model.instruction import SendPause as SendPause
from farm.model.instruction import SendStart as SendStart
from farm.model.instruction import StopPlanning as StopPlanning

UNKNOWN_CALLER = "a person"  # name for an unknown caller of a command


class PrinterAdded(Event):
    """A printer was added to `fleet.yaml`."""

    printer: str
    bed: Bed


class ClockSet(Event):
    """The host's clock was set forward by `by_s` seconds, or back if `by_s` is negative."""

    by_s: float


class JobSubmitted(Event):
    """A person submitted a job."""

    job: Job


class JobHeld(Event):
    """The reason for which a queued job waits has changed."""

    job: int
    hold: Hold | None


class PlanningStarted(Event):
    """The planning of a queued job started."""

    job: int


class PlanningAbandoned(Event):
    """Planning ended without a plan (the daemon died, or printers were missing); the job is queued again."""

    job: int
    hold: Hold | None


class JobPlanned(Event):
    """A job was planned: its parts, plates, printers and times."""

    job: int
    parts: tuple[Part, ...]
    plates: tuple[Plate, ...]
    repairs: tuple[str, ...]  # repairs of the model, and other notices, such as deadlines that will be missed
    scale: float
    serial_s: float
    expected_s: float
    picture: str | None
    assembly: str | None = None
    decomposition: str | None = None
    instructions: str | None = None
    lower_bound_s: float | None = None
    plan: str | None = None
    held: bool = False  # True if held until a person approves this plan
    printers: tuple[str, ...] = ()  # printers that the plan could use
    planning_s: float | None = None  # duration of the planning
    assembly_s: float | None = None  # expected time for a person to glue its parts


class PlanRevised(JobPlanned):
    """A job whose plates had not started was planned again for other printers; its plates were replaced."""


class JobApproved(Event):
    """A person approved the plan of a held job."""

    job: int
    by: str


class JobReleased(Event):
    """A person approved a job before it was planned, or converted a dry run to a job to approve."""

    job: int
    by: str
    hold: bool = False  # True if held until a person approves its plan


class JobFailed(Event):
    """The planning of a job failed with an error."""

    job: int
    error: ErrorCode
    reason: str


class JobCancelled(Event):
    """A person, or the farm for an abandoned dry run, cancelled a job."""

    job: int
    by: str = UNKNOWN_CALLER


class JobPruned(Event):
    """The files of an ended job, except its pictures, were marked for deletion."""

    job: int
    by: str
    # Small pictures of the parts: names in the file store, by part id.
    part_pictures: dict[str, str] = Field(default_factory=dict)


class EventsCompacted(Event):
    """Events up to number `last`, which a verified backup contains, were marked for deletion."""

    last: int
    backup: str


class PlateAssigned(Event):
    """A waiting plate was assigned to a printer, as a new print."""

    plate: str
    printer: str
    print_id: str


class PlateReplaced(Event):
    """A waiting plate was sliced again for another kind of printer, or its part was cut for several printers.

    `parts` are those of the new plates; a part that was only sliced again keeps its name. The new plates keep
    the prints of the old plate, so that its failures still count.
    """

    plate: str
    parts: tuple[Part, ...]
    plates: tuple[Plate, ...]
    picture: str | None = None  # picture of all parts of the job; None if there are no new parts
    assembly: str | None = None  # GLB file of all parts of the job; None if there are no new parts
    decomposition: str | None = None  # report on the cut of the part
    instructions: str | None = None  # instructions for gluing the new parts


class PrintProgressed(Event):
    """A print changed its state, or began to extrude."""

    print_id: str
    state: PrintState
    started_s: float | None
    extruded: bool


class PauseRequested(Event):
    """A person paused or resumed an open print."""

    print_id: str
    wanted: bool  # True: pause; False: resume
    by: str = UNKNOWN_CALLER


class PrintWithdrawn(Event):
    """A print that its printer cannot start was withdrawn; its plate is free once the agent confirms this."""

    print_id: str
    reason: str


class PrintEnded(Event):
    """A print ended: done, failed or cancelled."""

    print_id: str
    state: PrintState
    fault: str | None
    reason: str | None
    started_s: float | None
    ended_s: float
    extruded: bool
    filament: FilamentState
    starved_s: float = 0.0  # time that a simulated printer waited for the host
    printed_share: float | None = None  # printed share of the time of all its layers; None: unknown


class StillKept(Event):
    """The daemon stored a picture of a print, taken by its printer's camera."""

    print_id: str
    still: Still


class PrintFailRequested(Event):
    """A person marked an open print as failed: it is stopped, and its plate is printed again."""

    print_id: str
    why: str
    by: str


class PlatePaused(Event):
    """A person paused or resumed a waiting plate."""

    plate: str
    wanted: bool  # True: pause; False: resume
    by: str


class PlateCancelled(Event):
    """A person cancelled a plate."""

    plate: str
    by: str


class ReprintRequested(Event):
    """A person requested that a plate be printed again."""

    plate: str
    why: str
    by: str


class JobMoved(Event):
    """A person moved a job in the queue: before the job `before`, or to the end."""

    job: int
    before: int | None
    by: str = UNKNOWN_CALLER


class JobRescheduled(Event):
    """A person set or removed the time before which no plate of a job starts."""

    job: int
    not_before_s: float | None
    by: str = UNKNOWN_CALLER


class JobPaused(Event):
    """A person paused a job (its prints pause, and none of its plates start), or resumed it."""

    job: int
    wanted: bool  # True: pause; False: resume
    by: str = UNKNOWN_CALLER


class JobAssembled(Event):
    """A person glued the parts of a job, and reported the minutes that it took."""

    job: int
    minutes: float
    by: str = UNKNOWN_CALLER


class MaintenanceStarted(Event):
    """A person took a printer out of use; its open print continues."""

    printer: str
    why: str
    by: str


class MaintenanceEnded(Event):
    """A person inspected a printer and put it back into use."""

    printer: str
    by: str


class PrinterLost(Event):
    """The connection to the board of an idle printer was lost."""

    printer: str


class OutageConfirmed(Event):
    """A person confirmed that an outage is resolved."""

    by: str


class BedCleared(Event):
    """A person cleared the bed, inspected the printer, and judged the printed part."""

    printer: str
    by: str
    filament: FilamentState | None = None
    verdict: Verdict = Verdict.GOOD
    why: str | None = None
    whole: str | None = None  # id of a failed print whose part is complete and good nevertheless


class BooksRestored(Event):
    """The database was restored from a backup made at `copied_s`; later prints are unknown."""

    copied_s: float


class PrintFound(Event):
    """An agent reported a print of a known plate that is missing from the restored books."""

    plate: str
    printer: str
    print_id: str


class AgentJournalImported(Event):
    """An agent listed its prints since the backup; `unknown` of them match no waiting plate."""

    printer: str
    unknown: int


class ReelLoaded(Event):
    """A person loaded a reel on a printer, or reported how much filament is left on it."""

    printer: str
    reel: Reel
    by: str


class BedReported(Event):
    """An emulator reported its bed, or an agent its filament; only states unknown to the books change."""

    printer: str
    bed: Bed
    filament: FilamentState


class PrinterAlarmed(Event):
    """An agent reported a heater that cannot be switched off, or the action that the agent took."""

    printer: str
    reason: str


class BedBecameUnknown(Event):
    """Something that the farm did not cause happened at a printer: its bed and filament are unknown."""

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
    | PlanRevised
    | JobApproved
    | JobReleased
    | JobFailed
    | JobCancelled
    | JobPruned
    | EventsCompacted
    | PlateAssigned
    | PlateReplaced
    | PrintProgressed
    | PauseRequested
    | PrintWithdrawn
    | PrintEnded
    | StillKept
    | PrintFailRequested
    | PlatePaused
    | PlateCancelled
    | ReprintRequested
    | JobMoved
    | JobRescheduled
    | JobPaused
    | JobAssembled
    | MaintenanceStarted
    | MaintenanceEnded
    | PrinterLost
    | HostLost
    | HostConnected
    | OutageConfirmed
    | BedCleared
    | ReelLoaded
    | BooksRestored
    | PrintFound
    | AgentJournalImported
    | BedReported
    | BedBecameUnknown
    | PrinterAlarmed
    | KeyAdded
    | KeyRevoked
    | SessionOpened
    | SessionExtended
)
