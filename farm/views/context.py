"""Data from which all views are built: fleet, books and the agents' latest snapshots. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime

from farm.config import Fleet
from farm.model import AgentPrint, AgentSnapshot, Hold, Job, Link, PlanProgress, Plate, Print
from farm.paths import StateFolder
from farm.scheduling import estimate_remaining_s
from farm.state import Books
from farm.views.job_cache import JobCache


@dataclass(frozen=True, slots=True)
class ViewContext:
    """Data from which the views at one moment are built."""

    fleet: Fleet
    books: Books
    snapshots: Mapping[str, AgentSnapshot]
    state: StateFolder
    now_s: float
    ends_s: Mapping[str, float] = field(default_factory=dict)  # forecast end of each waiting plate
    forecast_computed_s: float = -math.inf  # time at which the forecast was computed
    awaits_forecast: bool = False  # True until the first forecast of a large queue is ready
    is_startup_over: bool = True  # True once all printers have had the time to connect
    progress: Mapping[int, PlanProgress] = field(default_factory=dict)  # by id of a job that is being planned
    warnings: tuple[str, ...] = ()  # problems of the farm as a whole
    plate_holds: Mapping[str, Hold] = field(default_factory=dict)  # current holds of waiting plates
    job_holds: Mapping[int, Hold] = field(default_factory=dict)  # latest holds of queued jobs
    job_cache: JobCache = field(default_factory=JobCache)

    def find_plate_hold(self, plate: Plate) -> Hold | None:
        """Return the hold of a waiting plate; None if it has none."""
        return self.plate_holds.get(plate.id)

    def find_job_hold(self, job: Job) -> Hold | None:
        """Return the recorded hold of a job, or a newer hold of the scheduler with the same reason."""
        latest = self.job_holds.get(job.id)
        return latest if latest is not None and latest.has_same_reason(job.hold) else job.hold

    def format_time(self, at_s: float | None) -> str | None:
        """Format seconds since the epoch as ISO 8601 in the fleet's time zone."""
        return (
            None if at_s is None else datetime.fromtimestamp(at_s, self.fleet.zone).isoformat("T", "seconds")
        )

    @property
    def forecast_at(self) -> str | None:
        """Time of the forecast as ISO 8601; None before the first forecast."""
        return self.format_time(self.forecast_computed_s) if math.isfinite(self.forecast_computed_s) else None

    def find_snapshot(self, printer: str) -> AgentSnapshot:
        """Return the latest snapshot of a printer's agent; a snapshot without data if there is none."""
        return self.snapshots.get(printer) or AgentSnapshot(printer=printer, link=Link.STARTING)

    def find_reported_print(self, attempt: Print) -> AgentPrint | None:
        """Return the print as its agent last reported it; None if the agent does not report it."""
        return self.find_snapshot(attempt.printer).find_print(attempt.id)

    def estimate_remaining_s(self, attempt: Print) -> float:
        """Estimate the remaining time of an open print in seconds."""
        plate, factors = (
            self.books.plates[attempt.plate],
            self.books.get_printer(attempt.printer).time_factors,
        )
        return estimate_remaining_s(attempt, plate, self.find_reported_print(attempt), factors, self.now_s)
