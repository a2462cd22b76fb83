"""Records of a job at the stages of planning: inspected, to be decomposed, decomposed, sliced, planned.

If a step fails, the job gets no plan. For the order of the steps see `farm.planning`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from farm.config import PrinterSection
from farm.errors import ErrorCode, FarmError
from farm.model import (
    NOMINAL_TIME_FACTORS,
    Job,
    JobOptions,
    ModelSize,
    OwnGcode,
    Part,
    Plate,
    TimeFactors,
)
from farm.planning.part_records import DecomposedPart, SlicedPart

MIN_REBALANCE_DELAY_S, MIN_REBALANCE_DELAY_SHARE = 120.0, 0.01
"""The cuts are moved if the last printer ends later than the mean of all printers: by at least this time, and
by at least this share of the longest printing time."""


class TooFewPrinters(FarmError):
    """Error for a model that needs more parts than its job has printers; `needed_count` printers suffice."""

    def __init__(self, message: str, needed_count: int) -> None:
        super().__init__(message, ErrorCode.NO_FIT)
        self.needed_count = needed_count

    def __reduce__(self) -> tuple[Any, ...]:
        return TooFewPrinters, (str(self), self.needed_count)


def make_inspection_step_path(upload: Path) -> Path:
    """Return the path of the file, beside an upload, that contains the current step of its inspection."""
    return upload.with_name(f"{upload.name}.step")


@dataclass(frozen=True, slots=True)
class InspectedSubmission:
    """Printable content of a submission, in the file store: a solid in mm, or a person's own G-code.

    Attributes
    ----------
    file
        Name in the file store.
    repairs
        Repairs, other changes and warnings, in sentences.
    scale
        Factor by which the model was scaled.
    """

    file: str
    repairs: tuple[str, ...]
    scale: float
    own_gcode: OwnGcode | None = None
    size: ModelSize | None = None


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """Request to plan a job.

    Attributes
    ----------
    printers
        The printers for which it is planned.
    round_count
        Number of rounds of printing: the maximum number of parts per printer.
    time_factors, time_limit_s, assembly_ratio
        See `DecomposeTask`.
    is_quick
        True if planning is expected to take seconds, and must not wait for other work.
    """

    job: Job
    printers: tuple[PrinterSection, ...]
    round_count: int = 1
    time_factors: Mapping[str, TimeFactors] = field(default_factory=dict)
    time_limit_s: float | None = None
    assembly_ratio: float = 1.0
    is_quick: bool = False


@dataclass(frozen=True, slots=True)
class DecomposeTask:
    """Task to decompose a job for some printers.

    Attributes
    ----------
    job
        Id of the job.
    model
        The model, or the person's own G-code, as its inspection stored it.
    folder
        Scratch folder of the plan.
    time_factors
        Time factors that were learned from prints, by the name of the printer; printers without an entry have
        nominal factors.
    time_limit_s
        Time within which the job must be printed (`--done-by`), or printed and glued (`--assembled-by`);
        None for no limit.
    assembly_ratio
        Ratio of the assembly times that people reported to the expected times.
    budget_s
        Time budget of the search for parts; None for the default of the decomposition.
    may_pause
        True to return a `PausedDecomposition` before each round in which the search makes several attempts.
    """

    job: int
    model: Path
    options: JobOptions
    printers: tuple[PrinterSection, ...]
    round_count: int
    folder: Path
    time_factors: Mapping[str, TimeFactors] = field(default_factory=dict)
    time_limit_s: float | None = None
    assembly_ratio: float = 1.0
    budget_s: float | None = None
    may_pause: bool = False

    def find_time_factors(self, printer: str) -> TimeFactors:
        """Return the time factors of a printer."""
        return self.time_factors.get(printer, NOMINAL_TIME_FACTORS)


@dataclass(frozen=True, slots=True)
class PausedDecomposition:
    """Decomposition whose search for parts has paused before a round of attempts.

    See `farm.planning.parts.paused_decomposition`.

    Attributes
    ----------
    record
        File with the best result so far.
    attempt_count
        Number of attempts of the round, which may run in parallel.
    spent_share
        Used share of the budget, 0 to 1.
    """

    record: Path
    attempt_count: int
    spent_share: float


@dataclass(frozen=True, slots=True)
class DecomposedJob:
    """Figures and file names of a decomposition, without geometry, as its worker returns them.

    Attributes
    ----------
    serial_price_s
        Printing time of the whole model in one piece, as estimated by the cost model, including the heat-up.
    drawing_record
        File that `draw_job_parts` reads (farm.planning.parts.job_drawing).
    cut_record
        File that `rebalance_parts` reads (farm.planning.parts.cut_record); None if the cuts cannot be moved.
    assembly_s
        A person's time to glue the parts; None for a single part.
    step_count
        Number of steps of the assembly.
    """

    parts: tuple[DecomposedPart, ...]
    serial_price_s: float
    repairs: tuple[str, ...]
    scale: float
    drawing_record: Path
    cut_record: Path | None = None
    assembly_s: float | None = None
    step_count: int = 0


@dataclass(frozen=True, slots=True)
class SlicedJob:
    """Decomposition with the slice of each part, in the order of its parts."""

    task: DecomposeTask
    decomposed_job: DecomposedJob
    parts: tuple[SlicedPart, ...]

    def compute_printer_times_s(self) -> dict[str, float]:
        """Return the expected printing time of each printer that has a part."""
        printer_times_s: dict[str, float] = {}
        for part in self.parts:
            name = part.printer.name
            printer_times_s[name] = printer_times_s.get(name, 0.0) + part.compute_expected_s(
                self.task.find_time_factors(name)
            )
        return printer_times_s

    def compute_makespan_s(self) -> float:
        """Return the longest printing time of a printer, without the time to clear beds between rounds."""
        return max(self.compute_printer_times_s().values())

    def should_rebalance(self) -> bool:
        """Return whether the last printer ends late enough to justify moving the cuts and reslicing.

        The result is False if a printer has several parts, because moving the cuts makes the times of the
        parts equal, not those of the printers.
        """
        printer_times_s = self.compute_printer_times_s()
        delay_s = self.compute_makespan_s() - sum(printer_times_s.values()) / len(printer_times_s)
        min_delay_s = max(MIN_REBALANCE_DELAY_S, MIN_REBALANCE_DELAY_SHARE * self.compute_makespan_s())
        can_move_cuts = self.decomposed_job.cut_record is not None and len(printer_times_s) == len(self.parts)
        return can_move_cuts and delay_s >= min_delay_s


@dataclass(frozen=True, slots=True)
class Plan:
    """Complete plan of a job, committed before anything is printed.

    Attributes
    ----------
    serial_s
        Expected time of the whole model on one large printer, which need not exist.
    picture, assembly, decomposition, instructions
        Names in the file store.
    assembly_s
        Expected time for a person to glue the parts of all copies; None if there is nothing to glue.
    """

    parts: tuple[Part, ...]
    plates: tuple[Plate, ...]
    repairs: tuple[str, ...]
    scale: float
    serial_s: float
    picture: str | None = None
    assembly: str | None = None
    decomposition: str | None = None
    instructions: str | None = None
    assembly_s: float | None = None

    @property
    def expected_s(self) -> float:
        """Longest expected time of a printer, without the time to clear beds between its plates."""
        printer_times_s: defaultdict[str, float] = defaultdict(float)
        for plate in self.plates:
            printer_times_s[plate.printer] += plate.expected_s
        return max(printer_times_s.values())
