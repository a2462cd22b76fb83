"""Times of a job: parallel printing time, speed-up, utilisation. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from farm.model import Job, JobState, Plate, Print, PrintState
from farm.state import PlateState
from farm.views.accounting import compute_duration_s, is_wasted
from farm.views.context import ViewContext

_UNFINISHED_STATES = (PlateState.WAITING, PlateState.PRINTING)
_PlateInState = tuple[Plate, PlateState]


@dataclass(frozen=True, slots=True)
class Run:
    """Interval in which a job is printed: from the first print command until the job ends.

    A job has several runs if parts were printed again after it had ended.

    Attributes
    ----------
    started_s, ended_s
        Seconds since the epoch; `ended_s` of an open run is the present time.
    printers
        Printers on which the job is printed in the run.
    is_open
        True until the job ends.
    """

    started_s: float
    ended_s: float
    printers: frozenset[str]
    is_open: bool

    @property
    def duration_s(self) -> float:
        return max(0.0, self.ended_s - self.started_s)


@dataclass(frozen=True, slots=True)
class JobTimes:
    """Times of a job, in seconds; None if unknown.

    Attributes
    ----------
    runs
        Intervals in which the job is printed.
    elapsed_s
        Parallel printing time so far: the total duration of all runs.
    makespan_s
        Parallel printing time: actual if the job is printed, otherwise expected.
    end_s
        Time at which the last part was or will be printed; None if unknown, for example during a pause.
    speedup
        Ratio of the printing time on a single large printer to the makespan.
    utilisation
        Share of the printers' time, over all runs, that is spent on parts that are not wasted.
    starved_share
        Share of the printing time during which simulated printers waited for the host.
    """

    runs: tuple[Run, ...]
    elapsed_s: float | None
    makespan_s: float | None
    end_s: float | None
    speedup: float | None
    utilisation: float | None
    starved_share: float | None


def compute_job_times(context: ViewContext, job: Job) -> JobTimes:
    """Compute the actual and expected times of a job."""
    prints = context.books.list_job_prints(job)
    plates = [(plate, context.books.find_plate_state(plate)) for plate in context.books.list_plates(job)]
    runs = tuple(list_runs(job, prints, context.now_s))
    is_printed = job.state in (JobState.PRINTED, JobState.DONE)
    elapsed_s = sum(run.duration_s for run in runs) if runs else None
    remaining_s = None if job.state is not JobState.PRINTING else _estimate_remaining_s(context, plates)
    makespan_s, end_s = None, job.ended_s if is_printed else None
    if is_printed:
        makespan_s = elapsed_s or job.expected_s
    elif not job.state.ended:  # a failed or cancelled job has no meaningful time
        makespan_s = job.expected_s
        if elapsed_s is not None:
            makespan_s = elapsed_s + _estimate_added_s(plates, runs, remaining_s or 0.0) or job.expected_s
        if remaining_s is not None and _is_end_known(context, job, plates):
            end_s = context.now_s + remaining_s
    printing_s = sum(map(compute_duration_s, prints))
    return JobTimes(
        runs=runs,
        elapsed_s=elapsed_s,
        makespan_s=makespan_s,
        end_s=end_s,
        speedup=job.serial_s / makespan_s if job.serial_s and makespan_s else None,
        utilisation=_compute_utilisation(job, prints, plates, runs, makespan_s) if makespan_s else None,
        starved_share=sum(p.starved_s for p in prints) / printing_s if printing_s else None,
    )


def list_runs(job: Job, prints: Sequence[Print], now_s: float) -> Iterator[Run]:
    """Yield the intervals in which a job was printed, oldest first.

    A run lasts from its first print command until the job ends, even if plates wait in between. A print
    belongs to the run in which it was assigned to its printer.
    """
    since_s = float("-inf")
    closed_runs = [(reopening.ended_s, reopening.reopened_s) for reopening in job.reopenings]
    for ended_s, until_s in [*closed_runs, (job.ended_s, float("inf"))]:
        run_prints = [p for p in prints if since_s <= p.assigned_s < until_s]
        starts_s = [p.started_s for p in run_prints if p.started_s is not None]
        since_s = until_s
        if not starts_s:
            continue
        end_s = max(min(starts_s), now_s if ended_s is None else ended_s)
        printers = frozenset(p.printer for p in run_prints if p.started_s is not None or not p.state.ended)
        yield Run(min(starts_s), end_s, printers, ended_s is None)


def _compute_utilisation(
    job: Job,
    prints: Sequence[Print],
    plates: Sequence[_PlateInState],
    runs: Sequence[Run],
    makespan_s: float,
) -> float | None:
    """Return the share of the printers' time, over all runs, that is spent on a job's plates."""
    unfinished_plates = [plate for plate, state in plates if state in _UNFINISHED_STATES]
    successes = [p for p in prints if p.state is PrintState.DONE and not is_wasted(p)]
    busy_s = sum(map(compute_duration_s, successes)) + sum(plate.expected_s for plate in unfinished_plates)
    ended_runs = [run for run in runs if not run.is_open]
    available_s = sum(len(run.printers) * run.duration_s for run in ended_runs)
    if not job.state.ended:
        current_printers = frozenset().union(*(run.printers for run in runs if run.is_open))
        planned_printers = frozenset(p.printer for p in unfinished_plates if not p.prints)
        used_printers = current_printers | planned_printers or frozenset(p.printer for p in unfinished_plates)
        available_s += len(used_printers) * max(0.0, makespan_s - sum(run.duration_s for run in ended_runs))
    return busy_s / available_s if available_s else None


def _estimate_added_s(plates: Sequence[_PlateInState], runs: Sequence[Run], remaining_s: float) -> float:
    """Estimate the seconds that the open run, or the next run, will add to the runs so far."""
    if any(run.is_open for run in runs):
        return remaining_s
    unfinished_plates = (plate for plate, state in plates if state in _UNFINISHED_STATES)
    return min(remaining_s, sum(plate.expected_s for plate in unfinished_plates))


def _estimate_remaining_s(context: ViewContext, plates: Sequence[_PlateInState]) -> float:
    """Estimate the seconds until the end of the last plate, at least 0.

    A waiting plate ends when the forecast says; without a forecast, it is assumed to start now.
    """
    return max((_estimate_plate_remaining_s(context, *plate) for plate in plates), default=0.0)


def _is_end_known(context: ViewContext, job: Job, plates: Sequence[_PlateInState]) -> bool:
    """Return True unless a plate waits for the farm's first forecast, or for a person to resume it."""
    waiting_plates = (plate for plate, state in plates if state is PlateState.WAITING)
    return not any(job.paused or plate.paused or context.awaits_forecast for plate in waiting_plates)


def _estimate_plate_remaining_s(context: ViewContext, plate: Plate, state: PlateState) -> float:
    if state is PlateState.WAITING:
        return max(0.0, context.ends_s.get(plate.id, context.now_s + plate.expected_s) - context.now_s)
    if state is not PlateState.PRINTING:
        return 0.0
    attempt = context.books.prints[plate.prints[-1]]
    return plate.expected_s if attempt.started_s is None else context.estimate_remaining_s(attempt)


@dataclass(frozen=True, slots=True)
class AssemblyTimes:
    """Times of the assembly of a job, in seconds; None if unknown.

    Attributes
    ----------
    work_s
        Time that a person needs to glue the parts: reported, or expected.
    end_s
        Time at which the parts were glued, or will be if a person begins when the last part is printed.
    """

    work_s: float | None
    end_s: float | None


def compute_assembly_times(job: Job, printed_s: float | None, ratio: float) -> AssemblyTimes:
    """Compute the times of gluing the parts of a job: reported, or expected.

    Parameters
    ----------
    job
        The job.
    printed_s
        Time at which the last part was or will be printed, seconds since the epoch; None if unknown.
    ratio
        Ratio of reported to expected gluing times (`compute_assembly_ratio`).
    """
    if job.gluing is not None:
        return AssemblyTimes(job.gluing_s, job.assembled_s)
    if job.assembly_s is None:
        return AssemblyTimes(None, None)
    work_s = job.assembly_s * ratio
    is_abandoned = job.state in (JobState.FAILED, JobState.CANCELLED)
    return AssemblyTimes(work_s, None if printed_s is None or is_abandoned else printed_s + work_s)
