"""Requests and responses of the daemon, which are also the objects that `--json` prints.

Times are ISO 8601 in the fleet's time zone, by the farm's clock; durations are in seconds.
"""

from __future__ import annotations

from pydantic import ConfigDict, Field

from drivers.messages import PrinterReadings, PrintReadings
from farm.api.base import NETWORK_PREFIX as NETWORK_PREFIX
from farm.api.base import SCHEMA as SCHEMA
from farm.api.base import Line as Line
from farm.api.base import View
from farm.api.cluster import ClusterTaskView as ClusterTaskView
from farm.api.cluster import ClusterView as ClusterView
from farm.api.cluster import ClusterWorkerView as ClusterWorkerView
from farm.api.events import EventView as EventView
from farm.api.events import JobRow as JobRow
from farm.api.events import Jobs as Jobs
from farm.api.files import FileView as FileView
from farm.api.files import JobFiles as JobFiles
from farm.api.hosts import HostAgentView as HostAgentView
from farm.api.hosts import HostList as HostList
from farm.api.hosts import HostPortView as HostPortView
from farm.api.hosts import HostUpdate as HostUpdate
from farm.api.hosts import HostView as HostView
from farm.api.keys import AppKeyGrant as AppKeyGrant
from farm.api.keys import AppKeyRequestView as AppKeyRequestView
from farm.api.keys import EndedSessions as EndedSessions
from farm.api.keys import KeyRequest as KeyRequest
from farm.api.keys import Keys as Keys
from farm.api.keys import KeyView as KeyView
from farm.api.keys import LoginLink as LoginLink
from farm.api.keys import NetworkView as NetworkView
from farm.api.keys import NewKey as NewKey
from farm.api.prints import History as History
from farm.api.prints import HistoryRow as HistoryRow
from farm.api.prints import PrintRow as PrintRow
from farm.api.prints import Prints as Prints
from farm.api.prints import PrintView as PrintView
from farm.api.prints import StillView as StillView
from farm.api.requests import ApproveRequest as ApproveRequest
from farm.api.requests import AssembledRequest as AssembledRequest
from farm.api.requests import ClearedRequest as ClearedRequest
from farm.api.requests import ClearedResponse as ClearedResponse
from farm.api.requests import DownRequest as DownRequest
from farm.api.requests import JobStart as JobStart
from farm.api.requests import LoadRequest as LoadRequest
from farm.api.requests import NameResponse as NameResponse
from farm.api.requests import PruneRequest as PruneRequest
from farm.api.requests import Queue as Queue
from farm.api.requests import QueueEntry as QueueEntry
from farm.api.requests import QueueMove as QueueMove
from farm.api.requests import QueuePlace as QueuePlace
from farm.api.requests import Reason as Reason
from farm.model import (
    Bed,
    FilamentState,
    Hold,
    JobOptions,
    JobState,
    PlanProgress,
    PrintState,
    TextTime,
    Verdict,
)


class PartView(View):
    id: str
    cut_from: str | None = None  # the failed part that it is a piece of
    copy_number: int = 1  # of the copies of the model
    glue_rank: int | None = None  # place in the order in which parts are glued, from 1
    verdict: Verdict | None
    plate: str
    file: str | None  # null if the files of its job were pruned
    picture: str | None = None  # small PNG of a part whose file was pruned
    prints: list[PrintView]

    @property
    def own_prints(self) -> list[PrintView]:
        """Prints of this part, without those of the part that it was cut from."""
        return [attempt for attempt in self.prints if attempt.part == self.id]


class PlateStatus(View):
    id: str
    parts: list[str]
    printer: str  # of its last print, or of the plan
    gcode: str | None  # null if the files of its job were pruned
    estimated_s: float
    grams: float
    filament_mm: float
    price: float | None
    cached: bool  # its G-code was in the cache
    warnings: list[str]  # such as walls too thin to print, or a part that may fall over
    printing: bool
    hold: Hold | None


class RunView(View):
    """Interval in which a job was printed."""

    started: str
    ended: str | None  # null for the present one


class JobView(View):
    id: int
    name: str
    state: JobState
    error: str | None
    reason: str | None
    paused: bool
    exit_code: int
    hold: Hold | None
    progress: PlanProgress | None  # while it is planned
    now: str  # of this view, on the farm's clock
    submitted: str
    submitted_by: str | None  # user name, from the socket's credentials
    options: JobOptions
    parts: list[PartView]
    plates: list[PlateStatus]
    repairs: list[str]
    scale: float | None
    plan: str | None  # hash of the plan, to pass to `farm approve`
    starts: str | None  # earliest start time
    estimated_s: float | None
    lower_bound_s: float | None  # of the parallel printing time on these printers
    eta: str | None
    elapsed_s: float | None  # parallel printing time so far, or actual
    runs: list[RunView]  # more than one if parts were printed again after it had ended
    serial_s: float | None
    speedup: float | None
    utilisation: float | None
    printed: int  # plates
    good: int  # judged good by a person
    printed_copies: int  # copies of the model with all their parts printed
    current_s: float | None  # parallel printing time: expected from what is known now, or actual
    wasted_s: float  # by prints that failed, were cancelled, or are bad
    wasted_grams: float
    grams: float | None
    filament_mm: float | None
    price: float | None  # of its filament; None if a price is not known
    currency: str | None
    starved_share: (
        float | None
    )  # time that simulated printers waited for the host; over 1 % the run is not valid
    folder: str | None  # with its files by name: parts (STL), plates (G-code), the picture
    pruned: str | None = None  # when its files were pruned; figures and pictures stay
    waits_for_person: bool
    assembly_s: float | None = None  # a person's time to glue the parts: expected, or reported
    assembled: str | None = None  # when they were glued: reported, or expected from what is known now
    glued: bool = False  # whether a person has reported it
    submitted_to_assembled_s: float | None = None  # from submission to that time

    @property
    def parts_by_use(self) -> list[PartView]:
        """Parts of each copy in the order in which they are glued."""
        return sorted(self.parts, key=lambda part: (part.copy_number, part.glue_rank or len(self.parts)))

    @property
    def prints(self) -> list[PrintView]:
        """Prints of the job; prints shared by several pieces of a part appear once."""
        prints = {(p.part, p.printer, p.started, p.ended): p for part in self.parts for p in part.prints}
        return list(prints.values())


class Targets(View):
    nozzle_c: float | None
    bed_c: float | None


class Reel(View):
    material: str
    kind: str | None = None  # of the material, like PLA; null if it is not known
    colour: str | None
    grams: float | None  # left; null if it is not known
    nozzle_mm: float


class PrintProgress(PrintReadings, View):
    """Progress of an open print."""

    job: int
    plate: str
    state: PrintState
    progress: float = Field(ge=0, le=1)
    remaining_s: float
    layers: int
    pause_ends: str | None  # while it is paused: when it is cancelled unless it is resumed


class LastPrint(View):
    """The last print on a printer; its part is on the bed until that is cleared."""

    id: str = ""
    plate: str
    state: PrintState
    ended: str | None
    off: float | None  # share by which it took longer than expected; null unless it ended as `done`
    verdict: Verdict | None


class PrinterView(PrinterReadings, View):
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
    time_factor: float  # actual over expected time of its layers, learned from its prints
    print: PrintProgress | None
    last: LastPrint | None
    look: str | None
    maintenance: str | None  # reason why it is out of use
    hold: Hold | None
    kept_for: str | None = None  # plate or job that it is kept for while it is free
    camera: bool = False  # GET /printers/NAME/camera shows it


class Todo(View):
    """A task of a person."""

    code: str
    printers: list[str]
    text: str
    brief: str = ""  # the text in a few words
    jobs: list[int] = Field(default_factory=list)  # that it is about
    good: dict[str, str] = Field(default_factory=dict)  # by printer: a failed part that may be good
    times: list[TextTime] = Field(default_factory=list)  # that the text names


class NightView(View):
    """Counts of the plates since the afternoon before; each plate is counted once."""

    since: str
    plates: int
    printed: int
    failed: int
    printing: int
    waiting: int  # not started
    grams: float
    wasted_grams: float


class JobName(View):
    id: int
    name: str
    state: JobState
    parts: list[str]


class Names(View):
    """Names of printers, jobs and parts, for shell completion."""

    printers: list[str]
    jobs: list[JobName]


class FleetView(View):
    name: str
    timezone: str
    time_scale: float
    now: str
    forecast: str | None = None  # when the expected ends of jobs were worked out
    file: str


class DaemonView(View):
    pid: int
    version: str
    since: str


class Status(View):
    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    daemon: DaemonView
    todo: list[Todo]
    fleet: FleetView
    printers: list[PrinterView]
    jobs: list[JobView]  # those that are open or wait for a verdict, and the last of the others
    night: NightView | None  # null if no print ended in it
    cluster: ClusterView | None = None  # null if this computer plans alone


class JobStatus(View):
    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    daemon: DaemonView
    job: JobView


class SubmitResponse(View):
    """Response to a submission; `again` if this request id was submitted before."""

    job: int
    again: bool
    # requests that cannot be met, such as more printers than the fleet has
    notices: list[str] = Field(default_factory=list)


class UploadView(View):
    """Progress of a submission that has no answer yet."""

    step: str  # in words
    received: int  # bytes
    size: int  # bytes


class PrunedJob(View):
    """Job whose files are deleted; its figures and pictures stay."""

    id: int
    name: str
    size_bytes: int  # some files may be shared with other jobs, which keep them


class PruneResponse(View):
    """Result of `farm prune`: the files, jobs and events that were deleted, or would be."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    dry_run: bool
    jobs: list[PrunedJob]  # the one that ended first at the beginning
    freed_bytes: int
    stored_bytes: int  # size of the files of jobs after that
    events: int  # entries of the database's log


class Problem(View):
    """Error of a request."""

    error: str
    code: str
    exit_code: int


class SlotView(View):
    """Time of a plate on a printer: actual or expected."""

    plate: str
    parts: list[str]
    printer: str
    starts: str
    ends: str
    grams: float
    price: float | None


class Timeline(View):
    """Times and printers of the plates of a planned job."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    job: int
    now: str
    plan: str
    slots: list[SlotView]
    left: list[str]  # plates that no printer can take (material, reel or hours)
    notices: list[str]  # changes to the model, and options that cannot be met
    makespan_s: float
    lower_bound_s: float
    grams: float
    price: float | None
    currency: str | None


class Submission(View):
    """Outcome of one of several models that were submitted at once."""

    model: str
    job: JobView | None = None
    timeline: Timeline | None = None  # of a dry run
    error: str | None = None
    exit_code: int = 0


class Submissions(View):
    """Outcomes of several models that were submitted at once."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    submissions: list[Submission]
