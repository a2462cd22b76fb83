"""Jobs: their states and options, and the progress of their planning."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Annotated

from pydantic import AfterValidator, Field

from decompose.options import MAX_PIN_MM, MIN_PIN_MM, Engine
from farm.errors import ErrorCode
from farm.model.entity import Entity
from farm.model.hold import Hold
from farm.text import flatten_text


class JobState(StrEnum):
    """State of a job."""

    QUEUED = "queued"
    PLANNING = "planning"  # being decomposed and sliced
    HELD = "held"  # planned; waits until a person approves it
    PRINTING = "printing"  # the plan is stored; plates are assigned to printers
    PRINTED = "printed"  # every part is printed, but a person has not judged all of them
    DONE = "done"  # a person has judged every part good
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def ended(self) -> bool:
        """True if the job has ended: nothing more is printed unless a person requests it."""
        return self in (JobState.PRINTED, JobState.DONE, JobState.FAILED, JobState.CANCELLED)


class Gluing(Entity):
    """Gluing of a job's parts, as a person reported it."""

    minutes: float
    at_s: float
    by: str


ShortText = Annotated[str, AfterValidator(flatten_text)]
"""Text that a user writes and others see, on one line."""


class JobOptions(Entity):
    """Options of a job, as submitted."""

    printers: int | None = Field(
        default=None, ge=1
    )  # None: the number of free printers that saves the most time
    longest_side_mm: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    scale: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    engine: Engine = Engine.BEST
    material: str | None = None  # None: any
    colour: str | None = None
    only: tuple[str, ...] = ()  # names of the printers that may print the job; empty: any
    quality: str = "glue"
    priority: int = Field(default=0, ge=-100, le=100)  # jobs of higher priority print earlier
    at: str | None = Field(default=None, max_length=40)  # earliest start, as the user wrote it
    overnight: bool = False  # the job starts when attended hours end
    done_by: str | None = Field(default=None, max_length=40)  # use as few parts as can be printed by then
    assembled_by: str | None = Field(default=None, max_length=40)  # like `done_by`, but including the gluing
    spares: int = Field(default=0, ge=0)  # free printers kept in reserve for failed plates
    hold: bool = False  # nothing prints before `farm approve`
    dry_run: bool = False  # the job is only planned, and cancelled once its plan has been shown
    pin_mm: float | None = Field(default=None, ge=MIN_PIN_MM, le=MAX_PIN_MM)  # None: no holes for pins
    pin_fit_mm: float | None = Field(
        default=None, ge=0, le=2
    )  # clearance of a hole around its pin; None: as fleet.yaml sets it for each printer
    marks: bool = False  # part numbers are cut into the faces that are glued
    copies: int = Field(default=1, ge=1, le=500)
    name: ShortText | None = Field(default=None, max_length=60)  # shown instead of the file's name
    note: ShortText | None = Field(default=None, max_length=200)


class OwnGcode(Entity):
    """Requirements of G-code that a person submitted: the nozzle's size, and the box of all extrusion."""

    nozzle_mm: float | None  # None: not stated in the file
    min_mm: tuple[float, float, float]  # corners of the box, relative to the bed's centre
    max_mm: tuple[float, float, float]


class Reopening(Entity):
    """Reopening of a job that had ended, because a person requested a reprint or judged a part bad."""

    ended_s: float  # time at which it had ended
    reopened_s: float


class ModelSize(Entity):
    """Size of a model: its extents after scaling, and its number of triangles."""

    extents_mm: tuple[float, float, float]
    faces: int


class Job(Entity):
    """Model submitted by a person, with its options, its plan and its state."""

    id: int
    request_id: str  # id of the submission; a repeated request does not submit a second job
    name: str
    model_file: str  # name in the file store
    options: JobOptions
    own_gcode: OwnGcode | None = None  # requirements of submitted G-code, which is printed as one plate
    size: ModelSize | None = None  # None: submitted G-code, or a job from an earlier version
    state: JobState = JobState.QUEUED
    submitted_s: float
    submitted_by: str | None = None  # name of the user; None: a job from an earlier version
    hold: Hold | None = None  # reason why its planning has not started, or why it is held after planning
    error: ErrorCode | None = None
    reason: str | None = None
    repairs: tuple[str, ...] = ()  # repairs of the model, and other notices on the model or the plan
    scale: float | None = None  # factor by which the model is scaled
    not_before_s: float | None = None  # time before which none of its plates starts
    done_by_s: float | None = None
    assembled_by_s: float | None = None
    plan: str | None = None  # hash of the plan and its files, for `farm approve`
    lower_bound_s: float | None = None  # lower bound on the printing time of its plates, for any schedule
    expected_s: float | None = None  # parallel printing time of the plan
    serial_s: float | None = None  # printing time of the uncut model on one large printer
    picture: str | None = None  # name of a picture of the assembly in the file store
    assembly: str | None = None  # name of a GLB of the assembly in the file store
    decomposition: str | None = None  # name of the report on the decomposition (JSON) in the file store
    instructions: str | None = None  # name of the instructions for gluing (HTML) in the file store
    cuts: Mapping[str, str] = Field(default_factory=dict)  # names of the reports on recut parts, by part
    cut_instructions: Mapping[str, str] = Field(
        default_factory=dict
    )  # names of the gluing instructions of recut parts, by part
    plates: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()
    paused: bool = False  # True if a person has paused it; none of its plates starts
    moved_priority: int | None = None  # replaces the priority of its options after a move in the queue
    moved_rank: float | None = None  # replaces its id in the order of jobs with equal priority
    restored: bool = False  # True if read from a backup; more may have been printed than is recorded
    planned_s: float | None = None  # time at which its plan was complete
    planned_for: tuple[str, ...] = ()  # names of the printers for which it was planned; empty: unknown
    planning_s: float | None = None  # duration of its planning, on the farm's clock
    assembly_s: float | None = None  # expected time for a person to glue its parts
    gluing: Gluing | None = None
    revisions: int = 0  # number of plans that replaced the first one
    ended_s: float | None = None
    pruned_s: float | None = None  # time at which its files, except the pictures, were deleted
    part_pictures: Mapping[str, str] = Field(
        default_factory=dict
    )  # names of pictures of a pruned job, by part
    reopenings: tuple[Reopening, ...] = ()

    @property
    def priority(self) -> int:
        """Priority of the job in the queue."""
        return self.options.priority if self.moved_priority is None else self.moved_priority

    def compute_print_deadline_s(self, assembly_ratio: float) -> float | None:
        """Return the time by which the last part of the job has to be printed; None for no limit.

        Parameters
        ----------
        assembly_ratio
            Ratio of reported to expected times of assembly (`compute_assembly_ratio`).
        """
        if self.done_by_s is not None or self.assembled_by_s is None:
            return self.done_by_s
        return self.assembled_by_s - assembly_ratio * (self.assembly_s or 0.0)

    @property
    def assembled_s(self) -> float | None:
        """Time at which a person reported that all parts are glued; None before that report."""
        return None if self.gluing is None else self.gluing.at_s

    @property
    def gluing_s(self) -> float | None:
        """Duration of the gluing in seconds, as a person reported it; None before that report."""
        return None if self.gluing is None else 60.0 * self.gluing.minutes

    @property
    def queue_rank(self) -> tuple[int, float, int]:
        """Sort key of the queue: the job with the smallest key gets printers first."""
        return -self.priority, self.id if self.moved_rank is None else self.moved_rank, self.id


class PlanStep(StrEnum):
    """Step of the planning of a job."""

    WAITING = "waiting"  # waits for a worker
    DECOMPOSING = "decomposing"
    SLICING = "slicing"
    REBALANCING = "levelling"  # moving the cuts according to the sliced times; the value is an older name
    NO_ROOM = "no_room"  # the disk was full; planning restarts when there is space


class PlanProgress(Entity):
    """Progress of the planning of a job, kept only in memory."""

    step: PlanStep
    done: int = 0  # number of sliced plates
    of: int = 0  # total number of plates; 0 while unknown
    cached: int = 0  # number of these plates that came from the cache
    share: float | None = None  # used share, 0 to 1, of the search's time budget; the search may end sooner
    remaining_s: float | None = None  # maximum remaining time of that search, in wall seconds


_PRIOR_TIME_S = 3600.0  # the prior is one assembly of this duration that took as long as expected
_MAX_RATIO, _MIN_RATIO = 4.0, 0.25  # bounds on the ratio of each report, in case the entered time is wrong


def compute_assembly_ratio(jobs: Iterable[Job]) -> float:
    """Compute the ratio of reported to expected times of assembly; 1 if nothing was reported."""
    times_s = [
        (
            min(_MAX_RATIO * job.assembly_s, max(_MIN_RATIO * job.assembly_s, 60.0 * job.gluing.minutes)),
            job.assembly_s,
        )
        for job in jobs
        if job.gluing is not None and job.assembly_s
    ]
    total_reported_s = _PRIOR_TIME_S + sum(reported_s for reported_s, _ in times_s)
    total_expected_s = _PRIOR_TIME_S + sum(expected_s for _, expected_s in times_s)
    return total_reported_s / total_expected_s
