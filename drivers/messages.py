"""Messages between a daemon and an agent: one JSON object a line over the agent's Unix socket.

The daemon sends `Request`s, each with an `id` of its own; the agent answers each with one `Reply` of the same
id, and pushes a `Snapshot` after every change, and about once a wall second while anything is warm or prints.
Requests are idempotent by `print_id`: repeated, they change nothing and get the same answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Base64Bytes, BaseModel, ConfigDict, Field, TypeAdapter

AGENT_SOCKET = "agent.sock"  # in an agent's folder

PROTOCOL = 2
"""Version of the protocol: increased where a request is new or gets a field. Each snapshot has the version of
its agent; the first agents sent none, and have version 1."""


@dataclass(frozen=True, slots=True)
class Since:
    """The protocol in which a field of a request appeared."""

    protocol: int


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Request(_Message):
    """Request to an agent. Agents refuse fields that they do not know, so older ones are not sent them."""

    since: ClassVar[int] = 1  # the protocol in which the request appeared


class _Said(_Message):
    """Message of an agent, maybe of another version than its reader: an upgrade ends no print."""

    model_config = ConfigDict(
        extra="ignore",
        frozen=True,
        allow_inf_nan=False,
        validate_by_name=True,
        validate_by_alias=True,
        serialize_by_alias=True,
    )


class LinkState(StrEnum):
    """State of the link between an agent and its board."""

    ABSENT = "absent"  # the port is not there, or cannot be opened
    CONNECTING = "connecting"  # opened; waits for the banner or the first answer
    READY = "ready"  # answers, no print
    BUSY = "busy"  # a print is open
    FAULT = "fault"  # a person has to check the printer; nothing is started


class Filament(StrEnum):
    """Place of the filament's end."""

    PARKED = "parked"  # 20 mm back, as the end code and the printer's own menu leave it
    AT_NOZZLE = "at_nozzle"
    UNKNOWN = "unknown"


class PrintPhase(StrEnum):
    """Phase of a print, as its agent sees it. The last three are ends."""

    SPOOLED = "spooled"
    CONNECTING = "connecting"
    HEATING = "heating"
    PRINTING = "printing"
    PAUSED = "paused"  # filament parked, head away, nozzle off, bed warm
    ENDING = "ending"  # heaters going off, by end code or by an abort
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        return self in (PrintPhase.DONE, PrintPhase.FAILED, PrintPhase.CANCELLED)


class Heater(_Said):
    """A heater as last reported, in degrees Celsius."""

    now_c: float
    target_c: float


class PrintReadings(BaseModel):
    """Values of a print that people see and that decide nothing.

    `farm.model.AgentPrint` and `farm.api.PrintProgress` inherit them: a new one reaches `--json` by itself.
    """

    layer: int | None = None  # from 1; null before the file's first has begun
    z_mm: float | None = None  # of that layer
    feature: str | None = None  # type of the current lines, as Cura names it: WALL-OUTER, FILL, ...

    def readings(self) -> dict[str, Any]:
        """Return the fields of this class alone, to hand on to another record that has them."""
        return {name: getattr(self, name) for name in PrintReadings.model_fields}


class PrintSnapshot(PrintReadings, _Said):
    """The open print, or the last one that ended and was not forgotten yet."""

    print_id: str
    phase: PrintPhase
    fault: str | None = None  # a value of `drivers.errors.Fault`
    reason: str | None = None  # one sentence for a person
    line: int = 0  # lines of the stripped file that the printer has acknowledged
    lines: int = 0
    progress_s: float = 0.0  # print time that is done, by the slicer's ;TIME_ELAPSED
    print_time_s: float = 0.0  # of the whole file
    layers: int = 0
    extruded: bool = False  # something of this print may lie on the bed
    started_s: float | None = None  # farm clock, first command of this print
    ended_s: float | None = None  # farm clock, heaters off and the head still
    pause_ends_s: float | None = None  # farm clock; the print is ended if nobody has resumed it by then
    ends_by_s: float | None = None  # farm clock; the print is ended safely if it has not ended by then
    starved_s: float = 0.0  # emulator only: farm seconds of this print in which it waited for the host
    sha256: str | None = None  # of its file; None from an older agent


class Snapshot(_Said):
    """State of an agent and its printer. Times are on the farm's clock."""

    kind: Literal["snapshot"] = "snapshot"
    protocol: int = 1  # what the agent understands
    printer: str
    agent_pid: int
    now_s: float = 0.0  # the agent's clock: that of its host may have been set since
    model: str = ""  # what the agent was started with
    port: str = ""
    link: LinkState
    reason: str | None = None  # of ABSENT or FAULT, one sentence
    nozzle: Heater | None = None
    bed: Heater | None = None
    heaters_off: bool = False  # a report has shown both targets 0 since the last heating command
    filament: Filament = Filament.UNKNOWN
    bed_clear: bool | None = None  # from an emulator only
    starved_s: float = 0.0  # emulator only: farm seconds in which it waited for the host
    board_resets: int = 0  # resets since the agent started that it did not cause itself
    # reason for which bed and filament are unknown, until `BedCleared`; "doubt" on the wire
    bed_unknown_reason: str | None = Field(
        default=None, validation_alias="doubt", serialization_alias="doubt"
    )
    alarm: str | None = None  # a heater that cannot be switched off: a person has to go there now
    reset_verified: bool = True  # DTR was seen to reset the board behind this port
    print: PrintSnapshot | None = None


class Hello(_Request):
    """Ask for a snapshot."""

    do: Literal["hello"] = "hello"
    id: int


class StartPrint(_Request):
    """Print a G-code file. The agent copies it into its spool and checks the hash before anything heats."""

    needed: ClassVar[int] = 2  # older agents get no prints: they would accept a late start
    do: Literal["start"] = "start"
    id: int
    print_id: str
    gcode: str | None  # absolute path; None: it was sent by `Upload`
    sha256: str
    print_time_s: float
    filament: Filament  # as the daemon knows it; UNKNOWN is refused
    not_after_s: Annotated[float | None, Since(2)] = (
        None  # the agent's clock; delivered later it is refused (`Reply.late`)
    )
    ends_by_s: Annotated[float | None, Since(2)] = None  # see `EndPrintBy`


class EndPrintBy(_Request):
    """Set the time at which a print is ended safely if it has not ended by then, even without a daemon."""

    since: ClassVar[int] = 2
    do: Literal["end_by"] = "end_by"
    id: int
    print_id: str
    ends_by_s: float | None  # the agent's clock; None: no limit


class Upload(_Request):
    """A piece of a G-code file, for an agent that shares no disk with the daemon."""

    do: Literal["upload"] = "upload"
    id: int
    print_id: str
    at: Annotated[int, Field(ge=0)]  # bytes before this piece; 0 begins a new file
    data: Base64Bytes


class CancelPrint(_Request):
    """End a print safely: head away, heaters off, filament parked. Nothing happens unless it is open."""

    do: Literal["cancel"] = "cancel"
    id: int
    print_id: str
    reason: str = "cancelled"


class PausePrint(_Request):
    """Pause a print so that it can be resumed. Nothing happens unless it prints."""

    do: Literal["pause"] = "pause"
    id: int
    print_id: str


class ResumePrint(_Request):
    """Resume a paused print."""

    do: Literal["resume"] = "resume"
    id: int
    print_id: str


class ForgetPrint(_Request):
    """Forget an ended print and its files: the daemon has stored its end."""

    do: Literal["forget"] = "forget"
    id: int
    print_id: str


class ListPrints(_Request):
    """List all prints that had not ended at a time: a restored daemon knows the state at that time."""

    since: ClassVar[int] = 2
    do: Literal["list"] = "list"
    id: int
    since_s: float  # the agent's clock


class BedCleared(_Request):
    """Note that a person has cleared the bed; this ends a fault that waited for a person."""

    do: Literal["cleared"] = "cleared"
    id: int
    filament: Filament | None = None  # as the person reports it, if at all


class Commission(_Request):
    """Pulse DTR to see whether the board restarts; a person has confirmed that the printer is idle."""

    do: Literal["commission"] = "commission"
    id: int


class Shutdown(_Request):
    """End the agent: with `now` it ends an open print safely first, else it refuses while it prints."""

    do: Literal["shutdown"] = "shutdown"
    id: int
    now: bool = False


Request = (
    Hello
    | StartPrint
    | Upload
    | CancelPrint
    | EndPrintBy
    | PausePrint
    | ResumePrint
    | ForgetPrint
    | ListPrints
    | BedCleared
    | Commission
    | Shutdown
)


class Reply(_Said):
    """Answer to one request. `error` is one sentence where the request was refused."""

    kind: Literal["reply"] = "reply"
    id: int
    error: str | None = None
    late: bool = False  # the start came after its latest time: nothing was begun
    snapshot: Snapshot | None = None
    prints: tuple[PrintSnapshot, ...] = ()  # of `ListPrints`, in order


def for_protocol(request: Request, protocol: int) -> str | None:
    """Dump a request for an agent of this protocol version.

    Fields that it does not know are left out if they have their defaults; None where that is not possible.
    """
    unknown = set()
    for name, field in type(request).model_fields.items():
        if any(isinstance(mark, Since) and mark.protocol > protocol for mark in field.metadata):
            unknown.add(name)
            if getattr(request, name) != field.default:
                return None
    return None if request.since > protocol else request.model_dump_json(exclude=unknown)


FromAgent = Snapshot | Reply

request_adapter: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="do")])
from_agent_adapter: TypeAdapter[FromAgent] = TypeAdapter(Annotated[FromAgent, Field(discriminator="kind")])
