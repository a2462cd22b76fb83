"""Holds of plates: a code, and a sentence with the reason and the way to end the wait. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from farm.config import PrinterSection
from farm.model import Hold, HoldCode, Job, JobState, Plate
from farm.scheduling.matching import Capabilities, WaitingPlate, may_take_spare
from farm.scheduling.situation import Situation
from farm.scheduling.start_rules import find_filament_shortage
from farm.state import LOSSES, Books, PlateState, find_stopped_print


def may_hold_back(books: Books, job: Job) -> bool:
    """Return whether a plate of a printing job may be held back by the job's own state."""
    if job.paused:
        return True
    for plate in books.list_plates(job):
        state = books.find_plate_state(plate)
        if state is PlateState.OUT_OF_ATTEMPTS:
            return True
        last_print = books.prints[plate.prints[-1]] if plate.prints else None
        if state is PlateState.WAITING and (
            plate.paused or (last_print is not None and last_print.fault in LOSSES)
        ):
            return True
    return False


def find_held_back_plates(
    books: Books,
    jobs: Iterable[Job],
    printers: Iterable[PrinterSection],
    now_s: float,
    may_hold: Callable[[Books, Job], bool] = may_hold_back,
) -> dict[str, Hold]:
    """Find the waiting plates that are excluded from assignment, even if a printer is free for them.

    Parameters
    ----------
    books
        All jobs, plates, prints and printers.
    jobs
        The jobs whose plates are checked.
    printers
        The printers of `fleet.yaml`.
    now_s
        Farm time, seconds since the epoch.
    may_hold
        `may_hold_back`, or a function that caches its results.

    Returns
    -------
    dict
        Hold of each excluded plate, by its id.
    """
    holds = {}
    printing_jobs = [job for job in jobs if job.state is JobState.PRINTING]
    unreported_printers = ""
    if any(job.restored for job in printing_jobs):
        names = (section.name for section in printers if section.enabled)
        unreported_printers = " ".join(name for name in names if _has_not_reported(books, name))
    has_outage = books.outage is not None
    for job in printing_jobs:
        if not (has_outage or (unreported_printers and job.restored) or may_hold(books, job)):
            continue
        for plate in books.list_plates(job):
            hold = _find_hold(books, job, plate, unreported_printers if job.restored else "", now_s)
            if hold is not None:
                holds[plate.id] = hold
    return holds


def _find_loss_window_end_s(books: Books, holds: Mapping[str, Hold]) -> float:
    """Return the earliest end of a hold with the code JUST_LOST; infinity if there is none."""
    lost_prints = (
        books.plates[name].prints[-1] for name, hold in holds.items() if hold.code is HoldCode.JUST_LOST
    )
    ends_s = ((books.prints[name].ended_s or 0.0) + books.outage_window_s for name in lost_prints)
    return math.nextafter(min(ends_s, default=math.inf), math.inf)


def find_next_change_s(
    situation: Situation, books: Books, held_back_plates: Mapping[str, Hold], other_times_s: Iterable[float]
) -> float:
    """Return the next time at which a decision may change without an event; infinity for never.

    Parameters
    ----------
    situation
        The plates that still wait, and the fleet.
    books
        The committed books.
    held_back_plates
        The plates that are excluded from assignment, with the reasons.
    other_times_s
        Other times at which decisions may change.
    """
    starts_s = (job.not_before_s for job in books.jobs.values() if not job.state.ended)
    times_s = (*other_times_s, *(at_s for at_s in starts_s if at_s is not None))
    return min(
        situation.find_next_change_s(),
        _find_loss_window_end_s(books, held_back_plates),
        *(at_s for at_s in times_s if at_s > situation.now_s),
    )


def _has_not_reported(books: Books, printer: str) -> bool:
    """Return whether an agent has not reported its prints since the database was restored from a backup.

    The result is False for a printer in maintenance.
    """
    entry = books.get_printer(printer)
    return entry.unreported_since_s is not None and entry.maintenance is None


def _find_hold(books: Books, job: Job, plate: Plate, unreported_printers: str, now_s: float) -> Hold | None:
    """Find the hold of a plate that may not start on any printer; None if it may.

    `unreported_printers` are the names of the printers that may have printed the plate since the backup.
    """
    state = books.find_plate_state(plate)
    if state is PlateState.OUT_OF_ATTEMPTS:
        text = f"{plate.name} failed too often: print it again with `farm reprint {job.id} {plate.parts[0]}`"
        return Hold(code=HoldCode.OUT_OF_ATTEMPTS, text=text)
    if state is not PlateState.WAITING:
        return None
    if books.outage is not None:
        text = (
            f"{' '.join(books.outage.printers)} were lost at the same time: inspect them, then `farm resume`"
        )
        return Hold(code=HoldCode.OUTAGE, text=text)
    if unreported_printers:
        text = (
            f"{unreported_printers} may have printed it since the backup of the database: "
            "connect them, or `farm maintenance`"
        )
        return Hold(code=HoldCode.PRINTER_UNREPORTED, text=text)
    if job.paused:
        return Hold(code=HoldCode.PAUSED, text=f"job {job.id} is paused: `farm resume {job.id}`")
    part = plate.parts[0]
    if (stopped_print := find_stopped_print(plate, books.list_prints(plate))) is not None:
        text = f"`farm estop` stopped it on {stopped_print.printer}: `farm resume {part}` prints it again"
        return Hold(code=HoldCode.STOPPED, text=text)
    if plate.paused:
        return Hold(code=HoldCode.PAUSED, text=f"part {part} is paused: `farm resume {part}`")
    last_print = books.prints[plate.prints[-1]] if plate.prints else None
    lost_s = last_print.ended_s if last_print is not None and last_print.fault in LOSSES else None
    if last_print is not None and lost_s is not None and abs(now_s - lost_s) <= books.outage_window_s:
        text = f"{last_print.printer} was lost just now: waiting in case others are lost too"
        return Hold(code=HoldCode.JUST_LOST, text=text)
    return None


_MAX_NAMES = 4  # maximum number of names in a sentence; the others are counted


@dataclass(frozen=True, slots=True)
class _PrinterGroup:
    """Printers that match the same plates, and their state, which is found once for all of these plates.

    Attributes
    ----------
    names
        Names of the printers.
    idle_printers
        Names of the idle printers with a clear bed to which no plate is assigned now.
    busy_hold
        Hold for printers that are busy or get another plate now; None if there are none.
    obstacle
        Hold of the first printer on which no print can start; None if prints can start on all.
    """

    names: frozenset[str]
    idle_printers: tuple[str, ...]
    busy_hold: Hold | None
    obstacle: Hold | None


class HoldReasons:
    """Reasons why plates wait in one situation.

    Parameters
    ----------
    situation
        The current situation.
    assigned_printers
        Printers to which plates are assigned now.
    spare_printers
        Free printers that are kept as spares for failed plates.
    heating_limit
        Limit on printers that heat at the same time; None if it is not reached.
    """

    def __init__(
        self,
        situation: Situation,
        assigned_printers: frozenset[str],
        spare_printers: frozenset[str],
        heating_limit: int | None,
    ) -> None:
        self._situation, self._assigned_printers, self._spare_printers, self._heating_limit = (
            situation,
            assigned_printers,
            spare_printers,
            heating_limit,
        )
        fleet = situation.fleet
        self._obstacles = {name: printer.find_obstacle() for name, printer in fleet.items()}
        self._capabilities = tuple(dict.fromkeys(printer.capabilities for printer in fleet.values()))
        # The key of a group is the capabilities that do not match its plates.
        self._groups: dict[tuple[Capabilities, ...], _PrinterGroup] = {}
        idle_printers = frozenset(name for name, hold in self._obstacles.items() if hold is None)
        self._idle_printers = idle_printers - assigned_printers

    def make_job_limit_hold(self) -> Hold:
        """Make the hold for a job that prints on as many printers as it may use."""
        return Hold(
            code=HoldCode.JOB_PRINTER_LIMIT,
            text="its job already uses as many printers as it may (--printers)",
        )

    def find_hold(self, plate: WaitingPlate) -> Hold:
        """Return the reason why a plate waits, preferably one that ends without a person's action."""
        mismatches = tuple(
            capabilities
            for capabilities in self._capabilities
            if not plate.requirements.matches(capabilities)
        )
        group = self._groups.get(mismatches)
        if group is None:
            group = self._groups[mismatches] = self._make_group(mismatches)
        if not group.names:
            requirements = plate.requirements.describe() or "no requirements"
            return Hold(
                code=HoldCode.NO_SUCH_PRINTER, text=f"no printer of the fleet matches: {requirements}"
            )
        needs = plate.requirements.describe(mismatches) if mismatches else ""
        hold = self._find_group_hold(plate, group)
        return hold.model_copy(update={"text": f"needs {needs}: {hold.text}"}) if needs else hold

    def _make_group(self, mismatches: tuple[Capabilities, ...]) -> _PrinterGroup:
        fleet = self._situation.fleet
        names = tuple(name for name, printer in fleet.items() if printer.capabilities not in mismatches)
        obstacles = (hold for name in names if (hold := self._obstacles[name]) is not None)
        idle = tuple(name for name in names if name in self._idle_printers)
        return _PrinterGroup(frozenset(names), idle, self._make_busy_hold(names), next(obstacles, None))

    def _find_group_hold(self, plate: WaitingPlate, group: _PrinterGroup) -> Hold:
        """Return the reason why no printer of a group gets a plate; see `find_hold`."""
        rules, now_s = self._situation.rules, self._situation.now_s
        if plate.not_before_s is not None and plate.not_before_s > now_s:
            return rules.make_start_hold(plate.not_before_s, now_s)  # no printer would start it now
        reel_hold: Hold | None = None
        for name in group.idle_printers:
            hold = self._find_printer_hold(plate, name)
            if hold is not None and hold.code is not HoldCode.REEL_TOO_SHORT:
                return hold  # it ends without a person's action
            reel_hold = reel_hold or hold
        busy_hold = group.busy_hold
        if busy_hold is not None:
            if reel_hold is None:
                return busy_hold
            text = f"{busy_hold.text}; {reel_hold.text}"
            return busy_hold.model_copy(update={"text": text, "reel": reel_hold.reel})
        planned_hold = (
            self._obstacles.get(plate.planned_printer) if plate.planned_printer in group.names else None
        )
        return planned_hold or reel_hold or group.obstacle or _make_all_assigned_hold()

    def _find_printer_hold(self, plate: WaitingPlate, name: str) -> Hold | None:
        """Return the reason why an idle printer does not get a plate; None if there is none."""
        printer = self._situation.fleet[name]
        reel_hold = find_filament_shortage(plate, printer)
        if reel_hold is not None:
            return reel_hold
        start = self._situation.rules.find_start(plate, printer, self._situation.now_s)
        if start.at_s != self._situation.now_s:
            return start.reason
        if name in self._spare_printers and not may_take_spare(plate, self._situation.fleet):
            return Hold(
                code=HoldCode.KEPT_AS_SPARE, text=f"{name} is kept in reserve for a failed part (--spares)"
            )
        if self._heating_limit is not None:
            return Hold(
                code=HoldCode.HEATING_LIMIT,
                text=f"{self._heating_limit} printers are heating up, which is the limit (max_heating)",
            )
        return None

    def _make_busy_hold(self, names: tuple[str, ...]) -> Hold | None:
        """Make the hold for busy printers: until when they print, and how a plate could start earlier."""
        obstacles = {n: hold for n in names if (hold := self._obstacles[n]) is not None}
        busy = [n for n, hold in obstacles.items() if hold.code is HoldCode.PRINTER_BUSY]
        if not busy:
            return _make_all_assigned_hold() if any(n in self._assigned_printers for n in names) else None
        ends_s = [
            end_s
            for n in busy
            if (end_s := self._situation.fleet[n].print_end_s) is not None and end_s > self._situation.now_s
        ]
        rules, now_s = self._situation.rules, self._situation.now_s
        times = (rules.make_text_time(min(ends_s), now_s),) if ends_s else ()
        end_text = f" until {times[0].text}" if times else ""
        text = f"{join_names(busy)} {'is' if len(busy) == 1 else 'are'} printing{end_text}"
        uncleared_printers = [n for n, hold in obstacles.items() if hold.code is HoldCode.BED_NOT_CLEAR]
        if uncleared_printers:
            name = uncleared_printers[0]
            text += f"; `farm cleared {name}` would let this plate start now, if that bed is clear"
        return Hold(code=HoldCode.PRINTER_BUSY, text=text, times=times)


def _make_all_assigned_hold() -> Hold:
    return Hold(code=HoldCode.PRINTER_BUSY, text="every matching printer was assigned another plate")


def join_names(names: Iterable[str]) -> str:
    """Join names for a sentence, as in "a, b and c"; a long list ends with the number of omitted names."""
    *rest, last = names
    if len(rest) >= _MAX_NAMES:
        rest, last = rest[: _MAX_NAMES - 1], f"{len(rest) - _MAX_NAMES + 2} more"
    return f"{', '.join(rest)} and {last}" if rest else last
