"""Requests and responses of the daemon: what the CLI may ask, and the form of `--json`.

Moments are ISO 8601 in the fleet's time zone on the farm's clock; spans are seconds.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from farm.model import Bed, FilamentState, Hold, JobOptions, JobState, PlanProgress, PrintState, Verdict
from farm.text import flatten_text

SCHEMA = 1
Line = Annotated[str, AfterValidator(flatten_text)]
"""What a person writes, and others are shown."""


class _View(BaseModel):
    model_config = ConfigDict(extra="forbid")


class PrintView(_View):
    """One attempt at the plate that a part is on."""

    part: str  # as it was called then: a piece has the prints of its whole before it was cut
    printer: str
    state: PrintState
    fault: str | None
    reason: str | None
    verdict: Verdict | None
    why: str | None  # the verdict
    started: str | None
    ended: str | None


class PartView(_View):
    id: str
    cut_from: str | None = None  # the part that failed, of which it is a piece
    verdict: Verdict | None
    plate: str
    file: str
    prints: list[PrintView]

    @property
    def own_prints(self) -> list[PrintView]:
        """Without those of the part that it is a piece of."""
        return [one for one in self.prints if one.part == self.id]


class PlateStatus(_View):
    id: str
    parts: list[str]
    printer: str  # where it is or was printed last, else where the plan puts it
    gcode: str
    estimated_s: float
    grams: float
    filament_mm: float
    price: float | None
    cached: bool  # its G-code was there already: the engine did not run
    warnings: list[str]  # walls too thin to print, a part that may fall over
    printing: bool
    hold: Hold | None


class JobView(_View):
    id: int
    name: str
    state: JobState
    error: str | None
    reason: str | None
    paused: bool
    exit_code: int
    hold: Hold | None
    progress: PlanProgress | None  # while it is being planned
    submitted: str
    submitted_by: str | None  # the user, by the kernel's word
    options: JobOptions
    parts: list[PartView]
    plates: list[PlateStatus]
    repairs: list[str]
    scale: float | None
    plan: str | None  # its hash: what `farm approve` releases
    starts: str | None  # not before
    estimated_s: float | None
    lower_bound_s: float | None  # no order of its plates on these printers takes less
    eta: str | None
    elapsed_s: float | None  # parallel printing time so far, or reached
    serial_s: float | None
    speedup: float | None
    utilisation: float | None
    printed: int  # plates
    good: int  # by a person's word
    current_s: float | None  # parallel printing time by what is known now; reached, once printed
    wasted_s: float  # of prints that failed, were cancelled, or are bad
    wasted_grams: float
    grams: float | None
    filament_mm: float | None
    price: float | None  # of its filament; None where a reel's price is not known
    currency: str | None
    starved_share: float | None  # simulated printers that could not keep up; over 1 % the run is not valid
    folder: str | None  # its files by name: parts (STL), plates (G-code), the picture
    waits_for_person: bool

    @property
    def prints(self) -> list[PrintView]:
        """Each once: the pieces of a part share those of the whole."""
        each = {(p.part, p.printer, p.started, p.ended): p for part in self.parts for p in part.prints}
        return list(each.values())


class Targets(_View):
    nozzle_c: float | None
    bed_c: float | None


class Reel(_View):
    material: str
    colour: str | None
    grams: float | None  # left; null where nobody said
    nozzle_mm: float


class PrintProgress(_View):
    """What a printer is printing."""

    job: int
    plate: str
    state: PrintState
    progress: float = Field(ge=0, le=1)
    remaining_s: float
    layer: int | None  # from 1; null before the first
    layers: int
    z_mm: float | None
    feature: str | None  # what is printed, by Cura's name: WALL-OUTER, FILL, ...
    pause_ends: str | None  # paused: when it is ended, unless it is resumed


class LastPrint(_View):
    """What was printed on a printer last; it lies on the bed until that is cleared."""

    plate: str
    state: PrintState
    ended: str | None
    off: float | None  # how much longer it took than expected, as a share; null where it did not end done
    verdict: Verdict | None


class PrinterView(_View):
    name: str
    model: str
    state: str
    bed: Bed
    filament: FilamentState
    reel: Reel
    agent_pid: int | None
    nozzle_c: float | None
    bed_c: float | None
    targets: Targets
    heaters_off: bool
    time_factor: float  # its layers' time, reached over expected, as learned from its prints
    print: PrintProgress | None
    last: LastPrint | None
    look: str | None
    maintenance: str | None  # why a person has taken it out of use
    hold: Hold | None


class Todo(_View):
    """What a person has to do now."""

    code: str
    printers: list[str]
    text: str
    brief: str = ""  # the same in few words


class NightView(_View):
    """What was printed since the afternoon before; of the plates, one is counted once."""

    since: str
    plates: int
    printed: int
    failed: int
    printing: int
    waiting: int  # not started
    grams: float
    wasted_grams: float


class HistoryRow(PrintView):
    """A print that has ended."""

    job: int
    name: str  # the job's
    submitted_by: str | None
    took_s: float
    expected_s: float
    grams: float
    wasted: bool


class History(_View):
    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    prints: list[HistoryRow]  # oldest first


class JobName(_View):
    id: int
    name: str
    state: JobState
    parts: list[str]


class Names(_View):
    """What a person may mean: what a shell completes."""

    printers: list[str]
    jobs: list[JobName]


class FleetView(_View):
    name: str
    timezone: str
    time_scale: float
    now: str
    file: str


class DaemonView(_View):
    pid: int
    version: str
    since: str


class Status(_View):
    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    daemon: DaemonView
    todo: list[Todo]
    fleet: FleetView
    printers: list[PrinterView]
    jobs: list[JobView]  # those that go on or wait for a verdict, and the last of the others
    night: NightView | None  # null where nothing ended since


class JobStatus(_View):
    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    daemon: DaemonView
    job: JobView


class Submitted(_View):
    """The daemon has the model; `again` where this request id had been submitted before."""

    job: int
    again: bool


class Problem(_View):
    """Why a request was refused."""

    error: str
    code: str
    exit_code: int


class Reason(_View):
    """Why a person does something."""

    why: Line = Field(default="", max_length=200)


class ClearedRequest(_View):
    """A bed is clear; what was printed there is good, or bad."""

    filament: FilamentState | None = None
    bad: bool = False
    why: Line | None = Field(default=None, max_length=200)
    good: Line | None = Field(default=None, max_length=40)  # the part of a failed print, whole after all


class Cleared(_View):
    """A bed was cleared; what was bad there is printed again, unless nobody wants it any more."""

    again: str | None = None  # the part
    good: str | None = None  # the part that was found whole
    printed_on: list[str] = []  # printers that had begun to print that part again


class Named(_View):
    """The part, or the printer, that was meant."""

    name: str


class LoadRequest(_View):
    """What is on a printer now; what is not said stays as it was."""

    material: str | None = Field(default=None, max_length=100)
    colour: Line | None = Field(default=None, max_length=40)
    grams: float | None = Field(default=None, ge=0, allow_inf_nan=False)
    nozzle_mm: float | None = Field(default=None, gt=0, allow_inf_nan=False)


class ApproveRequest(_View):
    """The plan that a person has seen."""

    plan: str


class SlotView(_View):
    """A plate's time on a printer: as reached, or as expected."""

    plate: str
    parts: list[str]
    printer: str
    starts: str
    ends: str
    grams: float
    price: float | None


class Timeline(_View):
    """When and where a planned job prints."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    job: int
    plan: str
    slots: list[SlotView]
    left: list[str]  # plates that no printer can ever take, by material, reel or hours
    notices: list[str]  # what was done to the model, and what of what was asked cannot be
    makespan_s: float
    lower_bound_s: float
    grams: float
    price: float | None
    currency: str | None


class DownRequest(_View):
    """`now`: end every print safely first; `wait`: let them end, and begin nothing new."""

    now: bool = False
    wait: bool = False
