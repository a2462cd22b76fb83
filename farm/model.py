"""Records of the farm: jobs, parts, plates, prints, printers, and the snapshots of agents.

Everything here is frozen. Times are seconds since the epoch on the farm's clock (`drivers.clock`), spans are
seconds, lengths millimetres, temperatures degrees Celsius.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from pydantic import AliasChoices, AliasGenerator, BaseModel, ConfigDict, Field, model_validator

from farm.errors import ErrorCode

FORMER_NAMES = {
    "attention_reason": "look",
    "attention_since_s": "look_s",
    "cancel_reason": "cancel_asked",
    "disconnected_at_s": "lost_s",
    "expected_s": "estimated_s",
    "fail_reason": "fail_asked",
    "pause_requested": "pause_asked",
    "sliced_s": "print_time_s",
    "unreported_since_s": "untold_since_s",
}
"""Fields that the books of farm 0.1 have under another name."""


def _accepted_names(field: str) -> str | AliasChoices:
    former = FORMER_NAMES.get(field)
    return field if former is None else AliasChoices(field, former)


class Entity(BaseModel):
    """Frozen record of the books."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", alias_generator=AliasGenerator(validation_alias=_accepted_names)
    )


class JobState(StrEnum):
    QUEUED = "queued"
    PLANNING = "planning"  # being repaired, decomposed and sliced
    HELD = "held"  # planned and frozen, until a person approves it
    PRINTING = "printing"  # planned and committed; plates go to printers
    PRINTED = "printed"  # every part has been printed; not every one has been looked at
    DONE = "done"  # every part is good, by a person's word
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        """Tell whether nothing more of it is printed, unless a person wishes it."""
        return self in (JobState.PRINTED, JobState.DONE, JobState.FAILED, JobState.CANCELLED)


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


class Bed(StrEnum):
    CLEAR = "clear"
    NOT_CLEAR = "not_clear"
    UNKNOWN = "unknown"


class FilamentState(StrEnum):
    PARKED = "parked"
    AT_NOZZLE = "at_nozzle"
    UNKNOWN = "unknown"


class Link(StrEnum):
    """State of the connection to a board."""

    STARTING = "starting"  # no word from its agent yet
    ABSENT = "absent"
    CONNECTING = "connecting"
    READY = "ready"
    BUSY = "busy"
    FAULT = "fault"


class HoldCode(StrEnum):
    """Reason for which a plate, or a job that has no plates yet, waits."""

    NOT_FRONT = "not_front"
    NO_SUCH_PRINTER = "no_such_printer"
    TOO_FEW_PRINTERS = "too_few_printers"
    PRINTER_BUSY = "printer_busy"
    ALL_ITS_PRINTERS_BUSY = "all_its_printers_busy"
    BED_NOT_CLEAR = "bed_not_clear"
    REEL_DOUBTED = "reel_doubted"  # nobody knows what the restored books do not tell
    FILAMENT_UNKNOWN = "filament_unknown"
    NEEDS_A_LOOK = "needs_a_look"
    PRINTER_ABSENT = "printer_absent"
    PRINTER_CONNECTING = "printer_connecting"
    REEL_TOO_SHORT = "reel_too_short"
    START_TIME = "start_time"  # its job starts later (--at, --overnight)
    QUIET_HOURS = "quiet_hours"
    UNATTENDED = "unattended"  # somebody has to be there
    TOO_LONG = "too_long"  # for the hours of fleet.yaml
    HEATING_LIMIT = "heating_limit"
    KEPT_AS_SPARE = "kept_as_spare"
    UNTOLD = "untold"  # a printer has not said what it printed since the books were copied
    APPROVAL = "approval"  # `farm approve` lets it begin
    MAINTENANCE = "maintenance"
    PAUSED = "paused"
    STOPPED = (
        "stopped"  # a person stopped its print by `farm estop`, and has not said that it may begin again
    )
    OUT_OF_ATTEMPTS = "out_of_attempts"
    CUT_AGAIN = "cut_again"  # it failed, and its part is being recut for several printers
    JUST_LOST = "just_lost"
    OUTAGE = "outage"


class Engine(StrEnum):
    """Algorithm that decomposes a model."""

    BEST = "best"  # whichever of the engines gives the least parallel printing time
    GUILLOTINE = "guillotine"
    PARALLELOBOX = "parallelobox"  # the paper's


class ShortReel(Entity):
    """Printer that would take a plate if it had more filament, and how much it has and needs."""

    printer: str
    text: str


class Hold(Entity):
    """Reason to wait: a code, and a sentence that may change while the reason stays."""

    code: HoldCode
    text: str
    reel: ShortReel | None = None

    def same_reason(self, other: Hold | None) -> bool:
        """Tell whether another hold differs in its sentence alone (a time, a printer)."""
        return other is not None and (self.code, self.reel) == (other.code, other.reel)


class JobOptions(Entity):
    """Wishes of a person for a job."""

    printers: int | None = Field(default=None, ge=1)  # None: of the free ones as many as are worth it
    longest_side_mm: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    scale: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    engine: Engine = Engine.BEST
    material: str | None = None  # None: whatever the printers have
    colour: str | None = None
    quality: str = "glue"
    priority: int = Field(default=0, ge=-100, le=100)  # higher is earlier
    at: str | None = Field(default=None, max_length=40)  # when it may start, as a person says it
    overnight: bool = False  # when attended hours end
    done_by: str | None = Field(default=None, max_length=40)  # as few parts as are printed by then
    spares: int = Field(default=0, ge=0)  # free printers that are kept for plates that fail
    hold: bool = False  # nothing of it prints before `farm approve`
    dry_run: bool = False  # its plan is looked at, then it is cancelled


class OwnGcode(Entity):
    """Needs of a person's own G-code."""

    nozzle_mm: float | None  # None: the file does not say
    min_mm: tuple[float, float, float]  # of all that it extrudes, from the bed's centre
    max_mm: tuple[float, float, float]


class Job(Entity):
    id: int
    request_id: str  # of the submission: a retry never submits twice
    name: str
    model_file: str  # in the file store
    options: JobOptions
    own_gcode: OwnGcode | None = None  # where G-code was submitted: it is printed as one plate
    state: JobState = JobState.QUEUED
    submitted_s: float
    submitted_by: str | None = None  # the user; None: an older farm took it
    hold: Hold | None = None  # why it has not begun
    error: ErrorCode | None = None
    reason: str | None = None
    repairs: tuple[str, ...] = ()
    scale: float | None = None
    not_before_s: float | None = None
    done_by_s: float | None = None
    plan: str | None = None  # hash of the plan and its files, which `farm approve` releases
    lower_bound_s: float | None = None  # no order of its plates takes less
    expected_s: float | None = None  # parallel printing time of the plan
    serial_s: float | None = None
    picture: str | None = None  # of the assembly, and the two below, in the file store
    assembly: str | None = None  # as a GLB
    decomposition: str | None = None  # the report on it, as JSON
    cuts: Mapping[str, str] = Field(default_factory=dict)  # reports on parts that were recut, by part
    plates: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()
    paused: bool = False  # by a person: none of its plates starts
    restored: bool = False  # from a copy of the books: it may be printed further than they know
    planned_s: float | None = None
    ended_s: float | None = None


class PlanStep(StrEnum):
    DECOMPOSING = "decomposing"
    SLICING = "slicing"
    LEVELLING = "levelling"  # its cuts are moved: the slices show which part is too slow
    NO_ROOM = "no_room"  # it failed on a full disk, and begins anew when that has room


class PlanProgress(Entity):
    """Progress of a job's plan. Telemetry: it never enters the books."""

    step: PlanStep
    done: int = 0  # plates sliced
    of: int = 0  # plates; 0 while that is not known
    cached: int = 0  # of those done: from the cache, without the engine


class PartGeometry(Entity):
    """Size and pose of a part.

    Attributes
    ----------
    to_model
        4 x 4, row by row: from the part's file (printing pose) to the model's frame, mm.
    min_mm, max_mm
        Corners of its box in the model's frame.
    """

    to_model: tuple[float, ...]
    min_mm: tuple[float, float, float]
    max_mm: tuple[float, float, float]
    volume_mm3: float


class PartPrintOptions(Entity):
    """Print settings that the decomposition chooses for one part, in its printing pose.

    Attributes
    ----------
    brim_width_mm, layer_0_expansion_mm
        None: the quality's.
    stands
        Whether the part stays upright while it is printed.
    """

    brim_width_mm: float | None = None
    layer_0_expansion_mm: float | None = None
    stands: bool = True


DEFAULT_PRINT_OPTIONS = PartPrintOptions()


class Part(Entity):
    id: str  # "3/p01"
    job: int
    plate: str
    file: str  # STL in printing pose; a person's own G-code as it was submitted
    geometry: PartGeometry
    print_options: PartPrintOptions = DEFAULT_PRINT_OPTIONS
    cut_from: str | None = None  # the part that it is a piece of: that one failed, and was recut

    @model_validator(mode="before")
    @classmethod
    def _nest_flat_fields(cls, fields: Any) -> Any:
        """Read a part of farm 0.1, whose geometry and print options stood beside its name."""
        if not isinstance(fields, dict) or "geometry" in fields:
            return fields
        nested: dict[str, Any] = dict(fields)
        for name, record in (("geometry", PartGeometry), ("print_options", PartPrintOptions)):
            nested[name] = {key: nested.pop(key) for key in record.model_fields if key in nested}
        return nested


class Plate(Entity):
    id: str  # "3/01"
    job: int
    parts: tuple[str, ...]
    gcode: str
    sha256: str
    sliced_s: float  # its layers, by CuraEngine; of own G-code by the firmware's planner
    expected_s: float  # with heat-up, start and end code, at the printer's factor
    grams: float
    filament_mm: float
    price: float | None = None  # in the fleet's currency, by the reel of the printer as planned
    layers: int
    min_mm: tuple[float, float, float]  # of all that it extrudes, from the bed's centre
    max_mm: tuple[float, float, float]
    material: str
    nozzle_mm: float
    kin: str | None = None  # `Profile.kin` of the printers that it was sliced for; None: any
    printer: str  # as planned
    time_factor: float = 1.0  # of that printer, when it was planned; it is in `expected_s`
    cached: bool = False  # sliced before: the engine did not run
    warnings: tuple[str, ...] = ()  # walls that are not printed, parts that may fall over, in sentences
    prints: tuple[str, ...] = ()
    counted_from: int = 0  # a person asked for it again: only failures of these prints count
    replaced_by: tuple[str, ...] = ()  # the plates that are printed in its place
    cancelled: bool = False  # by a person: never printed, unless a person wishes it
    paused: bool = False  # by a person: it waits until it is resumed

    @model_validator(mode="before")
    @classmethod
    def _drop_hold(cls, fields: Any) -> Any:
        """Read a plate of farm 0.1, which kept why it waited; that is found anew whenever it is shown."""
        return {k: v for k, v in fields.items() if k != "hold"} if isinstance(fields, dict) else fields

    @property
    def prelude_s(self) -> float:
        """Expected time beside its layers: heat-up, start and end code."""
        return self.expected_s - self.sliced_s * self.time_factor

    @property
    def first_layer_s(self) -> float:
        """Expected time until its first layer lies, which is printed at half the speed of the others."""
        return self.prelude_s + 2.0 * self.sliced_s * self.time_factor / max(1, self.layers)

    def expected_on(self, time_factor: float) -> float:
        """Return the expected time on a printer with this factor."""
        return self.prelude_s + self.sliced_s * time_factor


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


class Reel(Entity):
    """Filament on a printer, and its nozzle, as a person reported last."""

    material: str
    colour: str | None = None
    grams: float | None = None  # left; None: nobody said
    nozzle_mm: float
    doubted: bool = False  # `grams` are of a copy of the books: prints may have taken of them since


class Printer(Entity):
    """State of a printer in the books; the rest is telemetry."""

    name: str
    bed: Bed = Bed.NOT_CLEAR
    filament: FilamentState = FilamentState.UNKNOWN
    attention_reason: str | None = None  # why a person has to look before it prints again
    attention_since_s: float | None = None  # since when
    alarm: str | None = None  # what its agent last said of a heater that cannot be switched off
    alarm_s: float | None = None  # when it said so
    maintenance: str | None = None  # why a person has taken it out of use
    disconnected_at_s: float | None = None  # when its board was last found to be gone
    restored_s: float | None = None  # when its books were last put back from a copy
    unreported_since_s: float | None = None  # the books are a copy; its agent has not reported since
    reel: Reel | None = None  # None: as fleet.yaml says
    time_factor: float = 1.0  # its layers' time, reached over expected, as learned from its prints


class Outage(Entity):
    """Loss of several printers at once. Nothing starts until a person has confirmed that all is well."""

    id: int
    at_s: float
    printers: tuple[str, ...]
    confirmed_s: float | None = None


class AgentPrint(Entity):
    """State of an agent's open print, as the agent reports it."""

    print_id: str
    state: PrintState
    fault: str | None
    reason: str | None
    progress_s: float
    print_time_s: float
    extruded: bool
    started_s: float | None
    ended_s: float | None
    starved_s: float = 0.0  # simulated printers: how long it waited for the host
    layer: int | None = None  # from 1
    layers: int = 0
    z_mm: float | None = None
    feature: str | None = None  # by Cura's name
    pause_ends_s: float | None = None  # when its agent ends it, unless it is resumed
    ends_by_s: float | None = None  # when its agent ends it, unless it has ended
    sha256: str | None = None  # of the file that it was given


class AgentSnapshot(Entity):
    """Last report of an agent."""

    printer: str
    link: Link
    agent_pid: int | None = None
    reason: str | None = None
    nozzle_c: float | None = None
    bed_c: float | None = None
    nozzle_target_c: float | None = None
    bed_target_c: float | None = None
    heaters_off: bool = False
    filament: FilamentState = FilamentState.UNKNOWN
    bed_clear: bool | None = None  # an emulator's own word
    alarm: str | None = None  # a heater that cannot be switched off: a person has to go there now
    bed_unknown_reason: str | None = (
        None  # why bed and filament are not known, until a person has cleared the bed
    )
    outdated: bool = False  # its agent is of an older version, and gets no more prints
    reset_verified: bool = True  # its board can be stopped by a reset; else it prints only while attended
    heard_cancel: str | None = None  # a print that it had been told to end when it said this
    print: AgentPrint | None = None
