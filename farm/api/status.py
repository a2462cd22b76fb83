"""Status of the whole farm: printers, tasks for people, last night, jobs, cluster."""

from __future__ import annotations

from pydantic import ConfigDict, Field

from drivers.messages import PrinterReadings, PrintReadings
from farm.api.base import SCHEMA, View
from farm.api.jobs import JobSummary, JobView
from farm.api.prints import FeatureFactorsView
from farm.model import Bed, FilamentState, Hold, PrintState, TextTime, Verdict, name_plate


class ClusterWorkerView(View):
    """Worker of the cluster."""

    name: str
    slots: int  # number of tasks that it runs at the same time
    refused: str | None  # reason why the farm sends it no tasks


class ClusterTaskView(View):
    """Task that was sent to the cluster."""

    what: str  # kind of work
    group: str | None  # its job, or the plate that is replanned
    worker: str | None  # null until it starts


class ClusterView(View):
    """State of the cluster."""

    scheduler: str
    # place where new tasks run: `cluster`, `here` (the daemon's computer), or `waiting` (for the cluster)
    place: str
    text: str  # state of the cluster in a sentence
    workers: list[ClusterWorkerView]
    tasks: list[ClusterTaskView]
    waiting: int  # number of tasks that wait for a worker
    here: int  # number of tasks that run on the daemon's computer instead of the cluster


class Targets(View):
    """Target temperatures of the heaters; null if unknown."""

    nozzle_c: float | None
    bed_c: float | None


class Reel(View):
    """Filament on a printer, and its nozzle."""

    material: str
    kind: str | None = None  # kind of material, such as PLA; null if unknown
    colour: str | None
    grams: float | None  # mass of the filament left; null if unknown
    nozzle_mm: float


class PlateOfPrint(View):
    """Plate of a print."""

    plate: str
    parts: list[str] = Field(default_factory=list)  # parts on the plate

    @property
    def name(self) -> str:
        """Name for people: that of the part if there is only one, such as `2/p01`."""
        return name_plate(self.plate, self.parts)

    @property
    def label(self) -> str:
        """Name after the word for it, such as `part 2/p01`."""
        return f"{'part' if len(self.parts) == 1 else 'plate'} {self.name}"


class PrintProgress(PrintReadings, PlateOfPrint):
    """Progress of an open print."""

    job: int
    state: PrintState
    progress: float = Field(ge=0, le=1)
    remaining_s: float
    layers: int
    pause_ends: str | None  # time at which a paused print is stopped unless a person resumes it


class LastPrint(PlateOfPrint):
    """Last print on a printer; its part is on the bed until a person clears the bed."""

    id: str = ""
    state: PrintState
    ended: str | None
    # (actual - expected time) / expected time; null unless the print is `done` and was never paused
    off: float | None
    verdict: Verdict | None


class PrinterView(PrinterReadings, View):
    """Printer with its state, readings and prints."""

    name: str
    model: str
    state: str  # the state `look` means that a person must inspect the printer
    bed: Bed
    filament: FilamentState
    reel: Reel
    agent_pid: int | None
    nozzle_c: float | None
    bed_c: float | None
    targets: Targets
    time_factor: float  # ratio of the actual to the sliced time of layers, learned from its prints
    # the same ratios by feature; null until enough prints have ended
    feature_factors: FeatureFactorsView | None = None
    print: PrintProgress | None
    last: LastPrint | None
    look: str | None  # reason why a person must inspect the printer; null if no inspection is needed
    maintenance: str | None  # reason why it is out of use
    hold: Hold | None
    # plate or job for which the free printer is reserved; null if it is not reserved
    kept_for: str | None = None
    camera: bool = False  # whether it has a camera; GET /printers/NAME/camera returns a still


class Todo(View):
    """Task for a person."""

    code: str
    printers: list[str]
    text: str
    brief: str = ""  # the same in a few words
    jobs: list[int] = Field(default_factory=list)  # jobs that the task concerns
    # by printer: part of a failed print that may nevertheless be good
    good: dict[str, str] = Field(default_factory=dict)
    times: list[TextTime] = Field(default_factory=list)  # times that the text contains


class NightView(View):
    """Numbers of plates since the previous afternoon, by outcome; each plate is counted once."""

    since: str
    plates: int
    printed: int
    failed: int
    printing: int
    waiting: int  # number of plates that have not started
    grams: float
    wasted_grams: float


class FleetView(View):
    """Fleet and its clock."""

    name: str
    timezone: str
    time_scale: float
    now: str
    forecast: str | None = None  # time at which the forecast (the expected ends of the jobs) was computed
    file: str  # path of fleet.yaml


class DaemonView(View):
    """Process of the daemon."""

    pid: int
    version: str
    since: str  # time at which it started


class FarmOverview(View):
    """Whole farm, without its jobs."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    daemon: DaemonView
    todo: list[Todo]
    fleet: FleetView
    printers: list[PrinterView]
    night: NightView | None  # null if no print ended last night
    cluster: ClusterView | None = None  # null if only the daemon's host computes plans


class Status(FarmOverview):
    """Whole farm, with the parts and plates of its jobs."""

    jobs: list[JobView]  # open jobs, jobs that await a verdict on a part, and the most recent of the others


class Wait(View):
    """Plates that wait for the same reason."""

    hold: Hold
    plates: list[str]
    names: list[str]  # names of the plates for people: that of the part if there is only one


class StatusSummary(FarmOverview):
    """Whole farm as `farm status` prints it: without the parts and plates of jobs."""

    jobs: list[JobSummary]  # the same jobs as in `Status`
    waits: list[Wait]
