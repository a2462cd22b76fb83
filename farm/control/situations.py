"""Source of current situations, built from the farm's fleet and books and the agents' latest snapshots."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Protocol

from drivers.clock import Clock
from farm.config import Fleet
from farm.control.telemetry import Telemetry
from farm.model import Hold, HoldCode, Job, JobState
from farm.scheduling import (
    Assignment,
    BuildVolumeFinder,
    FleetPrinter,
    PrintLimits,
    Situation,
    SituationBuilder,
    StartRules,
    count_spares,
    find_held_back_plates,
    find_print_limits,
    update_print_ends,
)
from farm.state import Books

CONNECT_GRACE_S = 30.0
"""Wall seconds after the start of the farm within which its printers should have connected."""


class FarmState(Protocol):
    """State of the farm, which the controller provides."""

    @property
    def clock(self) -> Clock: ...

    @property
    def fleet(self) -> Fleet: ...

    @property
    def books(self) -> Books: ...

    @property
    def rules(self) -> StartRules: ...

    @property
    def telemetry(self) -> Telemetry: ...

    @property
    def started_s(self) -> float: ...


class Situations:
    """Source of situations that describe the current state of a farm.

    Parameters
    ----------
    farm
        The state, which changes over time.
    find_build_volumes
        Function that returns the boxes in which a printer can print.
    """

    def __init__(self, farm: FarmState, find_build_volumes: BuildVolumeFinder) -> None:
        self._farm, self._builder = farm, SituationBuilder(find_build_volumes)

    @property
    def now_s(self) -> float:
        return self._farm.clock.now()

    @property
    def books(self) -> Books:
        """Committed books."""
        return self._farm.books

    @property
    def startup_end_s(self) -> float:
        return self._farm.started_s + CONNECT_GRACE_S * self._farm.clock.scale

    def is_starting(self) -> bool:
        """Return whether the farm has just started, and printers may still be connecting."""
        return self.now_s < self.startup_end_s

    def find_held_back_plates(self, jobs: Collection[Job] | None = None) -> dict[str, Hold]:
        """Return the holds of plates that are excluded from assignment, for some jobs or (None) for all."""
        farm = self._farm
        jobs = farm.books.jobs.values() if jobs is None else jobs
        return find_held_back_plates(
            farm.books, jobs, farm.fleet.printers, self.now_s, self._builder.may_hold_back
        )

    def build(self, held_back_plates: Mapping[str, Hold]) -> Situation:
        """Return the current situation, with all waiting plates except those held back."""
        farm = self._farm
        return Situation(
            waiting_plates=self._builder.describe_waiting_plates(farm.books),
            printers=self.describe_printers(),
            rules=farm.rules,
            now_s=self.now_s,
            time_scale=farm.clock.scale,
            spares=count_spares(farm.books),
        ).without(held_back_plates)

    def build_for_assignments(self, assignments: Collection[Assignment]) -> Situation:
        """Return the current situation, reduced to the jobs and printers of some assignments to save time.

        If the number of printers that heat up at once is limited, the situation contains all printers. It
        reserves no spares, because these must not prevent an assignment that was possible before.
        """
        farm, books = self._farm, self._farm.books
        job_ids = dict.fromkeys(books.plates[assignment.plate].job for assignment in assignments)
        jobs = [job for job in map(books.jobs.__getitem__, job_ids) if job.state is JobState.PRINTING]
        names = [assignment.printer for assignment in assignments]
        printers = (
            self.describe_printers() if farm.rules.max_heating is not None else self._list_printers(names)
        )
        plates = self._builder.describe_job_plates(books, jobs).without(self.find_held_back_plates(jobs))
        return Situation(plates, printers, farm.rules, self.now_s, farm.clock.scale)

    def build_for_display(self, held_back_plates: Mapping[str, Hold]) -> Situation:
        """Return the current situation, with the expected ends of open prints as users see them."""
        return update_print_ends(self.build(held_back_plates), self.books, self._farm.telemetry.snapshots)

    def build_for_forecast(self) -> Situation:
        """Return the situation for the forecast, without plates that a person has paused or stopped."""
        codes, held_back_plates = (HoldCode.PAUSED, HoldCode.STOPPED), self.find_held_back_plates()
        return self.build_for_display(
            {name: hold for name, hold in held_back_plates.items() if hold.code in codes}
        )

    def fill_cache(self) -> None:
        """Fill the cache with all printers and plates, so that the first run is as fast as later ones."""
        plates = self.build(self.find_held_back_plates()).waiting_plates
        _ = plates.planned_printers, plates.demands  # computed and cached by job

    def apply_starts(self, situation: Situation, starts: Collection[Assignment]) -> Situation:
        """Return a situation updated by some starts, which have just been committed."""
        started_printers = {p.name: p for p in self._list_printers([start.printer for start in starts])}
        printers = tuple([started_printers.get(p.name, p) for p in situation.printers])
        return situation.without({start.plate for start in starts}).with_printers(printers)

    def describe_printers(self) -> tuple[FleetPrinter, ...]:
        """Describe the enabled printers for the scheduler."""
        farm = self._farm
        return self._builder.describe_printers(farm.fleet, farm.books, farm.telemetry.snapshots)

    def describe_printer(self, name: str) -> FleetPrinter | None:
        """Describe a printer for the scheduler; None if it is disabled or unknown."""
        farm = self._farm
        return self._builder.describe_printer(farm.fleet, name, farm.books, farm.telemetry.snapshots)

    def _list_printers(self, names: Collection[str]) -> tuple[FleetPrinter, ...]:
        return tuple([printer for name in names if (printer := self.describe_printer(name)) is not None])

    def find_limits(self, print_id: str) -> PrintLimits:
        """Find the time limits that the attended and quiet hours set for a print."""
        attempt = self.books.prints[print_id]
        printer = self.describe_printer(attempt.printer)
        if printer is None:
            return PrintLimits(None, None)
        return find_print_limits(attempt, self.books, printer, self._farm.rules, self.now_s)
