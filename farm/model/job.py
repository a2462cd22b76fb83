"""Jobs: their states and options, and the progress of their plans."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from pydantic import Field

from farm.errors import ErrorCode
from farm.model.entity import Entity
from farm.model.hold import Hold


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


class Engine(StrEnum):
    """Algorithm that decomposes a model."""

    BEST = "best"  # whichever of the engines gives the least parallel printing time
    GUILLOTINE = "guillotine"
    PARALLELOBOX = "parallelobox"  # the paper's


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
