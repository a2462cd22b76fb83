"""Jobs with their parts and plates."""

from __future__ import annotations

from typing import Annotated

from farm.api.base import EXPECTED_S, View
from farm.api.prints import PrintView
from farm.model import Hold, JobOptions, JobState, PlanProgress, Verdict


class PartView(View):
    """Part of a job, with its prints."""

    id: str
    cut_from: str | None = None  # the failed part of which it is a piece
    copy_number: int = 1  # number of the copy of the model to which it belongs, from 1
    glue_rank: int | None = None  # place in the order of gluing, from 1
    verdict: Verdict | None
    plate: str
    file: str | None  # null if the files of its job were pruned
    picture: str | None = None  # small PNG of a part whose file was pruned
    prints: list[PrintView]

    @property
    def own_prints(self) -> list[PrintView]:
        """Prints of this part itself, without those of the part from which it was cut."""
        return [attempt for attempt in self.prints if attempt.part == self.id]


class PlateStatus(View):
    """Plate of a job, with the reason why it waits."""

    id: str
    parts: list[str]
    printer: str  # printer of its last print; before the first print, that of the plan
    gcode: str | None  # null if the files of its job were pruned
    expected_s: Annotated[float, EXPECTED_S]
    grams: float
    filament_mm: float
    price: float | None
    cached: bool  # whether its G-code was in the cache
    warnings: list[str]  # such as walls too thin to print, or a part that may fall over
    printing: bool
    hold: Hold | None


class RunView(View):
    """Interval during which a job was printed."""

    started: str
    ended: str | None  # null while the job is printing


class JobOverview(View):
    """Job, without its parts and plates."""

    id: int
    name: str
    state: JobState
    error: str | None
    reason: str | None
    paused: bool
    exit_code: int
    hold: Hold | None
    progress: PlanProgress | None  # null unless the job is being planned
    now: str  # time of this view, on the farm's clock
    submitted: str
    submitted_by: str | None  # name of the user or key that submitted it
    options: JobOptions
    repairs: list[str]  # repairs of the model, and other notices on the model or the plan
    scale: float | None
    plan: str | None  # hash of the plan, by which `farm approve` names it
    starts: str | None  # earliest start time
    expected_s: Annotated[float | None, EXPECTED_S]
    lower_bound_s: float | None  # lower bound of the parallel printing time on the printers of the plan
    eta: str | None
    elapsed_s: float | None  # parallel printing time: so far, or in total if the job is printed
    runs: list[RunView]  # several runs if parts were printed again after the job had ended
    serial_s: float | None  # printing time of the whole model on one imaginary large printer
    speedup: float | None  # `serial_s` divided by the parallel printing time
    # printing time of the parts, divided by the parallel printing time and the number of printers
    utilisation: float | None
    printed: int  # number of printed plates
    good: int  # number of plates that a person judged good
    printed_copies: int  # number of copies of the model whose parts are all printed
    current_s: float | None  # parallel printing time: actual, or as the forecast expects
    wasted_s: float  # time of prints that failed, were cancelled, or were judged bad
    wasted_grams: float
    grams: float | None
    filament_mm: float | None
    price: float | None  # price of the filament; null if a price is unknown
    currency: str | None
    # share of the time in which simulated printers waited for their host; above 0.01, the times are not valid
    starved_share: float | None
    folder: str | None  # folder with its parts (STL), plates (G-code) and picture
    pruned: str | None = None  # time at which its files were pruned; figures and pictures stay
    waits_for_person: bool
    assembly_s: float | None = None  # time that gluing the parts takes: reported, or expected
    assembled: str | None = None  # time at which the parts are glued: reported, or as the forecast expects
    glued: bool = False  # whether a person has reported that the parts are glued
    submitted_to_assembled_s: float | None = None  # time from submission to `assembled`


class JobSummary(JobOverview):
    """Job as `farm status` shows it among all jobs."""

    plate_count: int


class JobView(JobOverview):
    """Job with its parts and plates."""

    parts: list[PartView]
    plates: list[PlateStatus]

    @property
    def plate_count(self) -> int:
        return len(self.plates)

    @property
    def parts_in_gluing_order(self) -> list[PartView]:
        """Parts of each copy in the order in which they are glued."""
        return sorted(self.parts, key=lambda part: (part.copy_number, part.glue_rank or len(self.parts)))

    @property
    def prints(self) -> list[PrintView]:
        """Prints of the job, each once, even if several pieces that were cut from one part list it."""
        prints = {(p.part, p.printer, p.started, p.ended): p for part in self.parts for p in part.prints}
        return list(prints.values())
