"""Messages between a daemon and an agent: one JSON object per line over the agent's Unix socket.

The daemon sends `Request`s with a unique `id`. The agent answers each with one `Reply` of the same id. It
also pushes a `Snapshot` after every change, and about once per wall second while the printer is warm or
printing. Requests are idempotent by `print_id`: a repeated request changes nothing and gets the same answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Base64Bytes, BaseModel, ConfigDict, Field, TypeAdapter

AGENT_SOCKET = "agent.sock"  # socket in an agent's folder

PROTOCOL = 4
"""Version of the protocol, increased when a request or a field is added, or when its meaning changes. Each
snapshot contains the version of its agent; the first agents sent no version, which counts as version 1."""


@dataclass(frozen=True, slots=True)
class AddedField:
    """Annotation of a request's field with the protocol version that added it."""

    protocol: int


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Request(_Message):
    """Request to an agent. Agents refuse unknown fields, so older agents are not sent new ones."""

    first_protocol: ClassVar[int] = 1  # protocol version that added the request


class _AgentMessage(_Message):
    """Message of an agent, whose version may differ from the reader's, as upgrades do not end prints."""

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

    ABSENT = "absent"  # the port is missing, or cannot be opened
    CONNECTING = "connecting"  # opened; waits for the banner or the first answer
    READY = "ready"  # the board answers; no print
    BUSY = "busy"  # a print is open
    FAULT = "fault"  # a person has to check the printer; no print is started


class Filament(StrEnum):
    """Position of the filament's tip."""

    PARKED = "parked"  # retracted by `Profile.park_retraction_mm`, as by the end code
    AT_NOZZLE = "at_nozzle"
    UNKNOWN = "unknown"


class PrintPhase(StrEnum):
    """Phase of a print, as reported by its agent. The last three are final."""

    SPOOLED = "spooled"
    CONNECTING = "connecting"
    HEATING = "heating"
    PRINTING = "printing"
    PAUSED = "paused"  # filament parked, head aside, nozzle off, bed warm
    ENDING = "ending"  # heaters are being switched off, by end code or abort
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        """True if the phase is final."""
        return self in (PrintPhase.DONE, PrintPhase.FAILED, PrintPhase.CANCELLED)


class Heater(_AgentMessage):
    """Last reported temperatures of a heater, in degrees Celsius."""

    now_c: float
    target_c: float


class PrintReadings(BaseModel):
    """Values of a print that are only shown to people.

    `farm.model.AgentPrint` and `farm.api.PrintProgress` inherit them: `--json` shows new fields too.
    """

    layer: int | None = None  # counted from 1; null before the first layer of the file
    z_mm: float | None = None  # height of that layer
    feature: str | None = None  # type of the current lines, as Cura names it: WALL-OUTER, FILL, ...

    def dump_readings(self) -> dict[str, Any]:
        """Dump the fields of this class alone, for another record that has them."""
        return {name: getattr(self, name) for name in PrintReadings.model_fields}


class PrintSnapshot(PrintReadings, _AgentMessage):
    """The open print, or the last ended one that the daemon has not yet stored."""

    print_id: str
    phase: PrintPhase
    fault: str | None = None  # a value of `drivers.errors.Fault`
    reason: str | None = None  # one sentence for a person
    line: int = 0  # number of acknowledged lines of the stripped file
    lines: int = 0  # number of all lines of that file
    progress_s: float = 0.0  # elapsed print time, by the slicer's ;TIME_ELAPSED
    print_time_s: float = 0.0  # print time of the whole file
    layers: int = 0
    extruded: bool = False  # material of this print may be on the bed
    started_s: float | None = None  # farm clock, at the first command of this print
    ended_s: float | None = None  # farm clock, when heaters were off and the head had stopped
    pause_ends_s: float | None = None  # farm clock; the print is ended unless resumed by then
    ends_by_s: float | None = None  # farm clock; the print is ended safely at this time
    starved_s: float = 0.0  # emulator only: farm seconds of this print spent waiting for the host
    sha256: str | None = None  # hash of the G-code file; None from an older agent


class PrinterReadings(BaseModel):
    """Values of a printer that are only shown to people.

    `farm.model.AgentSnapshot` and `farm.api.PrinterView` inherit them: `--json` shows new fields too.
    """

    heaters_off: bool = False  # a report has shown both targets 0 since the last heating command
    board_resets: int = 0  # resets since the agent's start that it did not cause

    def dump_readings(self) -> dict[str, Any]:
        """Dump the fields of this class alone, for another record that has them."""
        return {name: getattr(self, name) for name in PrinterReadings.model_fields}


class Snapshot(PrinterReadings, _AgentMessage):
    """State of an agent and its printer. Times are on the farm's clock."""

    filament_protocol: ClassVar[int] = 3  # protocol version of `filament` in its present meaning
    kind: Literal["snapshot"] = "snapshot"
    protocol: int = 1  # version of the agent
    printer: str
    agent_pid: int
    now_s: float = 0.0  # the agent's clock, which may differ from its host's
    model: str = ""  # as in the agent's start file
    port: str = ""
    link: LinkState
    reason: str | None = None  # one sentence about ABSENT or FAULT
    nozzle: Heater | None = None
    bed: Heater | None = None
    filament: Filament = Filament.UNKNOWN  # since version 3, also UNKNOWN if it may have been moved
    bed_clear: bool | None = None  # from an emulator only
    starved_s: float = 0.0  # emulator only: farm seconds spent waiting for the host
    # Reason for which bed and filament are unknown, until `BedCleared`; named "doubt" on the wire.
    bed_unknown_reason: str | None = Field(
        default=None, validation_alias="doubt", serialization_alias="doubt"
    )
    alarm: str | None = None  # a heater that cannot be switched off: a person must act immediately
    reset_verified: bool = True  # a pulse of DTR was confirmed to reset this board
    print: PrintSnapshot | None = None


class Hello(_Request):
    """Request a snapshot."""

    do: Literal["hello"] = "hello"
    id: int


class StartPrint(_Request):
    """Print a G-code file. The agent copies it into its spool and checks the hash before anything heats."""

    min_protocol: ClassVar[int] = 2  # older agents get no prints: they would accept a late start
    do: Literal["start"] = "start"
    id: int
    print_id: str
    gcode: str | None  # absolute path; None: sent by `Upload`
    sha256: str
    print_time_s: float
    filament: Filament  # position known to the daemon; UNKNOWN is refused
    # Time on the agent's clock; a start delivered later is refused (`Reply.late`).
    not_after_s: Annotated[float | None, AddedField(2)] = None
    ends_by_s: Annotated[float | None, AddedField(2)] = None  # see `EndPrintBy`


class EndPrintBy(_Request):
    """Set the time limit of a print, which the agent then ends safely even without a daemon."""

    first_protocol: ClassVar[int] = 2
    do: Literal["end_by"] = "end_by"
    id: int
    print_id: str
    ends_by_s: float | None  # the agent's clock; None: no limit


class Upload(_Request):
    """A piece of a G-code file, for an agent that shares no disk with the daemon."""

    model_config = ConfigDict(validate_by_name=True, validate_by_alias=True, serialize_by_alias=True)

    do: Literal["upload"] = "upload"
    id: int
    print_id: str
    # Number of bytes before this piece; 0 begins a new file.
    offset: Annotated[int, Field(ge=0, validation_alias="at", serialization_alias="at")]
    data: Base64Bytes


class CancelPrint(_Request):
    """End a print safely: head aside, heaters off, filament parked.

    It has no effect unless the print is open.
    """

    do: Literal["cancel"] = "cancel"
    id: int
    print_id: str
    reason: str = "cancelled"


class PausePrint(_Request):
    """Pause a print, which can then be resumed. It has no effect unless the phase is PRINTING."""

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
    """List all prints that had not ended at a given time, such as the time of a restored backup."""

    first_protocol: ClassVar[int] = 2
    do: Literal["list"] = "list"
    id: int
    since_s: float  # the agent's clock


class ListLines(_Request):
    """List the last lines on the wire."""

    first_protocol: ClassVar[int] = 4
    do: Literal["lines"] = "lines"
    id: int


class BedCleared(_Request):
    """Report that a person has cleared the bed, which also clears the faults that required a person."""

    do: Literal["cleared"] = "cleared"
    id: int
    filament: Filament | None = None  # None if the person did not state it


class Commission(_Request):
    """Verify that a pulse of DTR restarts the board; a person has confirmed that the printer is idle."""

    do: Literal["commission"] = "commission"
    id: int


class Shutdown(_Request):
    """End the agent, which refuses this while printing; with `now`, it first ends an open print safely."""

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
    | ListLines
    | BedCleared
    | Commission
    | Shutdown
)


class WireLine(_AgentMessage):
    """Line on the wire between an agent and its board."""

    at_s: float  # the agent's clock
    sent: bool  # True if sent to the board, False if received from it
    text: str


class Reply(_AgentMessage):
    """Reply to one request; `error` is a sentence if the request was refused."""

    kind: Literal["reply"] = "reply"
    id: int
    error: str | None = None
    late: bool = False  # the start arrived after its latest time and was refused
    snapshot: Snapshot | None = None
    prints: tuple[PrintSnapshot, ...] = ()  # of `ListPrints`, in order
    lines: tuple[WireLine, ...] = ()  # of `ListLines`, oldest first


def encode_for_protocol(request: Request, protocol: int) -> str | None:
    """Dump a request for an agent of this protocol version; None if the agent does not support it.

    Fields that such an agent does not know are omitted; they must have their default values.
    """
    omitted_names = set()
    for name, field in type(request).model_fields.items():
        if any(isinstance(note, AddedField) and note.protocol > protocol for note in field.metadata):
            omitted_names.add(name)
            if getattr(request, name) != field.default:
                return None
    return None if request.first_protocol > protocol else request.model_dump_json(exclude=omitted_names)


FromAgent = Snapshot | Reply

request_adapter: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="do")])
from_agent_adapter: TypeAdapter[FromAgent] = TypeAdapter(Annotated[FromAgent, Field(discriminator="kind")])
