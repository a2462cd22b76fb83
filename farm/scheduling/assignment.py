"""Assignment of waiting plates to printers, and reasons why the other plates still wait. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from farm.model import Hold
from farm.scheduling.holds import HoldReasons
from farm.scheduling.matching import FleetPrinter, WaitingPlate, may_take_spare
from farm.scheduling.plate_matching import FleetOrder, MatchingInputs, match_plates
from farm.scheduling.situation import Situation
from farm.scheduling.start_rules import find_filament_shortage

LARGE_FLEET_SIZE = 200
"""Number of printers above which the scheduler runs only once a second, because a run takes a long time."""
MAX_STARTS = 15
"""Maximum number of starts in one commit. The daemon handles messages between two commits."""


@dataclass(frozen=True, slots=True)
class Assignment:
    """Plate and the printer to which it is assigned."""

    plate: str
    printer: str


def assign_plates(situation: Situation) -> list[Assignment]:
    """Assign waiting plates to printers.

    Plates are assigned by priority, then in order of submission, then the longest first (LPT). A plate
    gets the printer of its plan if that is free. Otherwise it gets a matching free printer, preferably one
    for which no waiting plate was planned, and of those the one with the lowest build height. If all matching
    printers are taken, an earlier plate moves to another matching printer (an augmenting path), so that no
    printer stays idle because of the order. A plate returns to a printer on which it failed only if no
    other is free. A job never prints on more printers at the same time than it requested.

    Parameters
    ----------
    situation
        Waiting plates, fleet and rules. The result does not depend on the order of plates and printers.

    Returns
    -------
    list of Assignment
        Each printer and each plate at most once, in the order of assignment.
    """
    pairs = sorted(_match_plates(situation).items(), key=lambda pair: pair[1].priority_key)
    return [Assignment(plate.id, name) for name, plate in pairs]


def select_possible_assignments(assignments: Iterable[Assignment], situation: Situation) -> list[Assignment]:
    """Select the assignments of an earlier situation that can be made together in the current one."""
    free, fleet = {p.name for p in situation.free_printers}, situation.fleet
    waiting = {plate.id: plate for plate in situation.waiting_plates}
    limit, started_by_job = _count_allowed_starts(situation), Counter[int]()
    starts: list[Assignment] = []
    for assignment in assignments:
        if len(starts) >= limit:
            break
        plate = waiting.get(assignment.plate)
        if (
            plate is None
            or assignment.printer not in free
            or plate.extra_printer_count == started_by_job[plate.job]
        ):
            continue
        if _can_take_plate(situation, fleet[assignment.printer], plate):
            starts.append(assignment)
            started_by_job[plate.job] += 1
    return starts


def _can_take_plate(situation: Situation, printer: FleetPrinter, plate: WaitingPlate) -> bool:
    """Return whether a plate may start now on this free printer."""
    return (
        plate.requirements.matches(printer.capabilities)
        and find_filament_shortage(plate, printer) is None
        and situation.can_start(plate, printer)
        and (printer.name not in situation.spare_printers or may_take_spare(plate, situation.fleet))
    )


def find_holds(situation: Situation, assignments: Iterable[Assignment]) -> dict[str, Hold]:
    """Find the reason why each waiting plate was not assigned to a printer.

    Parameters
    ----------
    situation
        Waiting plates, fleet and rules.
    assignments
        The result of `assign_plates`.
    """
    printer_by_plate = {assignment.plate: assignment.printer for assignment in assignments}
    start_limit, heating_limit = _count_allowed_starts(situation), situation.rules.max_heating
    reached_limit = heating_limit if len(printer_by_plate) >= start_limit else None
    reasons = HoldReasons(
        situation, frozenset(printer_by_plate.values()), situation.spare_printers, reached_limit
    )
    extra_printer_counts = situation.waiting_plates.extra_printer_counts
    for plate in situation.waiting_plates:
        if plate.id in printer_by_plate and plate.job in extra_printer_counts:
            extra_printer_counts[plate.job] -= 1
    return {
        plate.id: reasons.make_job_limit_hold()
        if extra_printer_counts.get(plate.job) == 0
        else reasons.find_hold(plate)
        for plate in situation.waiting_plates
        if plate.id not in printer_by_plate
    }


def _count_allowed_starts(situation: Situation) -> int:
    """Return the number of printers that may start to heat now."""
    limit = situation.rules.max_heating
    if limit is None:
        return len(situation.free_printers)
    return max(0, limit - sum(printer.is_heating for printer in situation.printers))


def _match_plates(situation: Situation) -> dict[str, WaitingPlate]:
    """Match free printers with waiting plates; return the plate of each printer that gets one."""
    kinds = {printer.capabilities for printer in situation.free_printers}
    met_demands = {
        demand for demand in situation.waiting_plates.demands if any(kind.meets(demand) for kind in kinds)
    }
    used_kinds = {kind for kind in kinds if any(kind.meets(demand) for demand in met_demands)}
    free = [printer for printer in situation.free_printers if printer.capabilities in used_kinds]
    if not free:
        return {}
    inputs = MatchingInputs(
        fleet=situation.fleet,
        free_printers=frozenset(printer.name for printer in free),
        order=FleetOrder.from_printers(free),
        planned_printers=situation.waiting_plates.planned_printers,
        spare_printers=situation.spare_printers,
        extra_printer_counts=situation.waiting_plates.extra_printer_counts,
        start_limit=_count_allowed_starts(situation),
        rules=situation.rules,
        now_s=situation.now_s,
    )
    return match_plates(situation.waiting_plates.list_plates_with_demands(met_demands), inputs)
