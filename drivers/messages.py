"""Messages between a daemon and an agent: one JSON object a line over the agent's Unix socket.

The daemon sends `Request`s, each with an `id` of its own; the agent answers each with one `Reply` of the same
id, and pushes a `Snapshot` whenever something changed, and about once a wall second while anything is warm or
prints. Requests are idempotent by `print_id`: sent again, they change nothing and are answered as before.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, ClassVar, Literal

from pydantic import Base64Bytes, BaseModel, ConfigDict, Field, TypeAdapter

AGENT_SOCKET = "agent.sock"  # in an agent's folder

PROTOCOL = 2
"""Protocol of this version: one more where requests get a field, or there is a new one. An agent says its own
with each snapshot; the first that did say none are 1."""


@dataclass(frozen=True, slots=True)
class Since:
    """The protocol in which a field of a request appeared."""

    protocol: int


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Request(_Message):
    """Request to an agent. It refuses what it does not know, so an older one is not asked it."""

    since: ClassVar[int] = 1  # the protocol in which the request appeared


class _Said(_Message):
    """Message of an agent. It may be of another version than who reads it: an upgrade ends no print."""

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
    CONNECTING = "connecting"  # opened; waiting for the banner or for the first answer
    READY = "ready"  # answers, no print
    BUSY = "busy"  # a print is open
    FAULT = "fault"  # a person has to look; nothing is started


class Filament(StrEnum):
    """Place of the filament's end."""

    PARKED = "parked"  # 20 mm back, as the end code and the printer's own menu leave it
    AT_NOZZLE = "at_nozzle"
    UNKNOWN = "unknown"


class PrintPhase(StrEnum):
    """One print as the agent sees it. The last three are ends."""

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


class PrintSnapshot(_Said):
    """The print that is open, or the last one that ended and was not yet forgotten."""

    print_id: str
    phase: PrintPhase
    fault: str | None = None  # a name: a value of `drivers.errors.Fault`
    reason: str | None = None  # one sentence for a person
    line: int = 0  # lines of the stripped file that the printer has acknowledged
    lines: int = 0
    progress_s: float = 0.0  # print time done, by the slicer's ;TIME_ELAPSED
    print_time_s: float = 0.0  # of the whole file
    layer: int | None = None  # from 1, once the file's first has begun
    layers: int = 0
    z_mm: float | None = None  # of that layer
    feature: str | None = None  # a value of `drivers.gcode.Feature`
    extruded: bool = False  # something of this print may lie on the bed
    started_s: float | None = None  # farm clock, first command of this print
    ended_s: float | None = None  # farm clock, heaters off and the head still
    pause_ends_s: float | None = None  # farm clock; a pause that nobody has ended by then ends the print
    ends_by_s: float | None = None  # farm clock; the print is ended safely where it has not ended by then
    starved_s: float = 0.0  # emulator only: farm seconds of this print in which it waited for the host
    sha256: str | None = None  # of the file that it was given; None: an older agent began it


class Snapshot(_Said):
    """Everything the daemon may know of an agent. Times on the farm's clock."""

    kind: Literal["snapshot"] = "snapshot"
    protocol: int = 1  # what the agent understands
    printer: str
    agent_pid: int
    now_s: float = 0.0  # the agent's clock: its host's may have been set since it began
    model: str = ""  # what the agent was started with
    port: str = ""
    link: LinkState
    reason: str | None = None  # why ABSENT or FAULT, one sentence
    nozzle: Heater | None = None
    bed: Heater | None = None
    heaters_off: bool = False  # a report has shown both targets 0 since the last heating command
    filament: Filament = Filament.UNKNOWN
    bed_clear: bool | None = None  # an emulator's own word; a real board cannot tell
    starved_s: float = 0.0  # emulator only: farm seconds in which it waited for the host
    board_resets: int = 0  # resets since the agent started that it did not cause itself
    # why bed and filament are not known, until `BedCleared`; "doubt" on the wire
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

    needed: ClassVar[int] = 2  # what an agent has to understand to get a print: no start is ever late
    do: Literal["start"] = "start"
    id: int
    print_id: str
    gcode: str | None  # absolute path; None: it was sent by `Upload`
    sha256: str
    print_time_s: float
    filament: Filament  # what the daemon's books say; UNKNOWN is refused
    not_after_s: Annotated[float | None, Since(2)] = (
        None  # the agent's clock; delivered later it is refused (`Reply.late`)
    )
    ends_by_s: Annotated[float | None, Since(2)] = None  # see `EndPrintBy`


class EndPrintBy(_Request):
    """Set when a print is ended safely where it has not ended by itself, daemon or no daemon."""

    since: ClassVar[int] = 2
    do: Literal["end_by"] = "end_by"
    id: int
    print_id: str
    ends_by_s: float | None  # the agent's clock; None: it takes what it takes


class Upload(_Request):
    """A piece of a G-code file, for an agent that shares no disk with the daemon."""

    do: Literal["upload"] = "upload"
    id: int
    print_id: str
    at: Annotated[int, Field(ge=0)]  # bytes before this piece; 0 begins the file anew
    data: Base64Bytes


class CancelPrint(_Request):
    """End a print safely: head away, heaters off, filament parked. No such print open: nothing happens."""

    do: Literal["cancel"] = "cancel"
    id: int
    print_id: str
    reason: str = "cancelled"


class PausePrint(_Request):
    """Stop where it can be gone on from; nothing happens where it does not print."""

    do: Literal["pause"] = "pause"
    id: int
    print_id: str


class ResumePrint(_Request):
    """Go on where `PausePrint` stopped."""

    do: Literal["resume"] = "resume"
    id: int
    print_id: str


class ForgetPrint(_Request):
    """The daemon has the end of this print in its books; the agent may drop it and its spool file."""

    do: Literal["forget"] = "forget"
    id: int
    print_id: str


class ListPrints(_Request):
    """Say what became of all prints that had not ended then: a daemon's books are a copy of that moment."""

    since: ClassVar[int] = 2
    do: Literal["list"] = "list"
    id: int
    since_s: float  # the agent's clock


class BedCleared(_Request):
    """A person cleared the bed (an emulator is told so; a fault that waited for a person is lifted)."""

    do: Literal["cleared"] = "cleared"
    id: int
    filament: Filament | None = None  # what the person says of it, if anything


class Commission(_Request):
    """Pulse DTR, and see whether the board starts again; a person has seen that the printer is idle."""

    do: Literal["commission"] = "commission"
    id: int


class Shutdown(_Request):
    """End the agent: with `now` an open print is ended safely first; without, refused while printing."""

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
    """The answer to one request. `error` is one sentence where it was refused."""

    kind: Literal["reply"] = "reply"
    id: int
    error: str | None = None
    late: bool = False  # what was refused came after its moment: nothing of it was begun
    snapshot: Snapshot | None = None
    prints: tuple[PrintSnapshot, ...] = ()  # of `ListPrints`, in order


def for_protocol(request: Request, protocol: int) -> str | None:
    """The line of a request for an agent of this protocol.

    Fields that it does not know are left out where they have their defaults. None: it cannot be asked this.
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
