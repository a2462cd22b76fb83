"""Coordinator of replanning: the plates that are being resliced or recut, and their results."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from farm.errors import FarmError
from farm.model import Hold, HoldCode, Plate, PrintState, Verdict
from farm.planning.replanning import policy
from farm.planning.replanning.replan import ReplannedPlate
from farm.scheduling import (
    Assignment,
    Capabilities,
    FleetPrinter,
    Situation,
    WaitingPlate,
    describe_plates,
    find_holds,
    join_names,
    may_take_spare,
)
from farm.state import Books
from farm.state import events as ev

log = logging.getLogger(__name__)

_SEARCH_INTERVAL_S = 10.0  # wall seconds between two searches for plates to reslice
_AttemptKey = tuple[str, int, str | None, float]
"""Id of a plate, its number of prints, and the family and nozzle diameter in mm of a kind of printer."""


@dataclass(frozen=True, slots=True)
class StartReplan:
    """Instruction to slice the part of a plate for some printers, or to cut it for them."""

    plate: str
    printers: tuple[str, ...]
    is_cut: bool


class ReplanCoordinator:
    """Coordinator that decides which plates are replanned, and whether the results are used.

    The plates that are being replanned are in memory only: after a restart, plates are examined again.
    """

    def __init__(self) -> None:
        self._running: dict[str, StartReplan] = {}
        self._examined_keys: set[tuple[str, int]] = set()  # failed plates, with their numbers of prints
        # Plates and kinds of printer for which replanning saved no time.
        self._attempted_keys: set[_AttemptKey] = set()
        self._search_due_s = -math.inf
        self.next_search_s = math.inf
        """Time at which another search may succeed; infinity if none is needed."""

    @property
    def reserved_printers(self) -> dict[str, str]:
        """Printers for which plates are being replanned, each with its plate."""
        return {name: replan.plate for replan in self._running.values() for name in replan.printers}

    def filter_assignments(self, books: Books, assignments: Iterable[Assignment]) -> list[Assignment]:
        """Return the assignments without those that give reserved printers to jobs that have not started."""
        reserved_printers = self.reserved_printers
        return [
            assignment
            for assignment in assignments
            if assignment.printer not in reserved_printers
            or books.has_started(books.plates[assignment.plate].job)
        ]

    def on_clock_set(self) -> None:
        """Allow the next search immediately, after a step of the host's clock."""
        self._search_due_s = -math.inf

    def list_holds(self) -> dict[str, Hold]:
        """Return a hold for each plate whose part is being cut, so that it is not assigned."""
        return {
            name: Hold(
                code=HoldCode.BEING_RECUT,
                text=f"it failed and is being cut for {join_names(replan.printers)}, to finish sooner",
            )
            for name, replan in self._running.items()
            if replan.is_cut
        }

    def recut_failures(self, books: Books, situation: Situation) -> Iterator[StartReplan]:
        """Yield instructions to cut the parts of plates that just failed, before they are assigned again."""
        for waiting_plate in situation.waiting_plates.reprints:
            plate = books.plates[waiting_plate.id]
            key = (plate.id, len(plate.prints))
            if (
                key in self._examined_keys
                or not _has_failed(books, plate)
                or not _may_be_replanned(books, plate)
            ):
                continue
            self._examined_keys.add(key)
            recut = policy.choose_recut(waiting_plate, situation)
            if recut is not None:
                yield self._start_replan(plate, recut.printers, is_cut=True)

    def reslice_waiting_plates(self, books: Books, situation: Situation) -> Iterator[StartReplan]:
        """Yield instructions to slice waiting plates for another kind of printer than they were sliced for.

        Parameters
        ----------
        situation
            The plates that remain after the assignment, and the fleet after it.
        """
        if situation.now_s < self._search_due_s:
            self.next_search_s = self._search_due_s if situation.waiting_plates else math.inf
            return
        self.next_search_s = math.inf
        if not situation.waiting_plates:
            return
        self._search_due_s = situation.now_s + _SEARCH_INTERVAL_S * situation.time_scale
        reserved_printers = self.reserved_printers
        free_printers = [
            printer for printer in situation.free_printers if printer.name not in reserved_printers
        ]
        kinds = {printer.capabilities for printer in free_printers}
        demands = {
            demand
            for demand in situation.waiting_plates.demands
            if any(policy.is_other_kind(demand, k) for k in kinds)
        }
        holds = find_holds(situation, ()) if demands else {}
        end_forecast = policy.EndForecast(situation)
        for waiting_plate in [
            waiting_plate for waiting_plate in situation.waiting_plates if waiting_plate.demand in demands
        ]:
            plate = books.plates[waiting_plate.id]
            if not free_printers or waiting_plate.id in self._running or not _may_be_replanned(books, plate):
                continue
            if waiting_plate.id not in holds or not policy.depends_on_printer_kind(
                holds[waiting_plate.id].code
            ):
                continue
            candidates = [p for p in free_printers if self._is_candidate(plate, waiting_plate, p, situation)]
            if candidates:
                self.next_search_s = self._search_due_s
            reslice = policy.choose_reslice(waiting_plate, situation, candidates, end_forecast)
            if reslice is not None:
                yield self._start_replan(plate, (reslice.printer,), is_cut=False)
                free_printers = [p for p in free_printers if p.name != reslice.printer]

    def _is_candidate(
        self,
        plate: Plate,
        waiting_plate: WaitingPlate,
        printer: FleetPrinter,
        situation: Situation,
    ) -> bool:
        is_untried = _make_attempt_key(plate, printer.capabilities) not in self._attempted_keys
        return is_untried and (
            printer.name not in situation.spare_printers or may_take_spare(waiting_plate, situation.fleet)
        )

    def finish(
        self, plate_id: str, result: ReplannedPlate | FarmError, books: Books, situation: Situation
    ) -> ev.PlateReplaced | None:
        """Return the event that replaces a replanned plate; None if the plate stays as it is.

        Parameters
        ----------
        plate_id
            The plate.
        result
            The replacement, or the error that prevented it.
        situation
            The plates available for assignment now, including those that are being cut.
        """
        replan = self._running.pop(plate_id, None)
        plate = books.plates[plate_id]
        waiting_plate = next(
            (waiting_plate for waiting_plate in situation.waiting_plates if waiting_plate.id == plate_id),
            None,
        )
        if replan is None or waiting_plate is None:
            return None  # the plate was cancelled or printed in the meantime
        for printer in replan.printers:
            if printer in situation.fleet:
                self._attempted_keys.add(_make_attempt_key(plate, situation.fleet[printer].capabilities))
        if isinstance(result, FarmError):
            log.warning("plate %s is unchanged: %s", plate_id, result, extra={"plate": plate_id})
            return None
        if not self._saves_time(waiting_plate, result, replan.is_cut, books, situation):
            log.info(
                "plate %s is unchanged: replanning would not finish it sooner",
                plate_id,
                extra={"plate": plate_id},
            )
            return None
        # If the event cannot be written (a full disk), the plate is examined again at the next decision.
        self._examined_keys.discard((plate.id, len(plate.prints)))
        self._attempted_keys = {key for key in self._attempted_keys if key[0] != plate.id}
        return ev.PlateReplaced(
            at_s=situation.now_s,
            plate=plate_id,
            parts=result.parts,
            plates=result.plates,
            picture=result.picture,
            assembly=result.assembly,
            decomposition=result.decomposition,
            instructions=result.instructions,
        )

    def _saves_time(
        self,
        waiting_plate: WaitingPlate,
        result: ReplannedPlate,
        is_cut: bool,
        books: Books,
        situation: Situation,
    ) -> bool:
        plate = books.plates[waiting_plate.id]
        history = {"prints": plate.prints, "counted_from": plate.counted_from}
        new_plates = tuple(describe_plates([p.model_copy(update=history) for p in result.plates], books))
        new_situation = situation.with_waiting_plates(
            (*situation.waiting_plates.without({plate.id}), *new_plates)
        )
        compute_end_s = policy.compute_one_piece_end_s if is_cut else policy.compute_expected_end_s
        new_end_s = max(
            policy.compute_expected_end_s(piece_plate, new_situation) for piece_plate in new_plates
        )
        new_end_s += policy.JOINING_TIME_S * len(new_plates) if is_cut else 0.0
        return policy.saves_enough(compute_end_s(waiting_plate, situation), new_end_s, situation.now_s)

    def _start_replan(self, plate: Plate, printers: tuple[str, ...], is_cut: bool) -> StartReplan:
        log.info(
            "plate %s is %s for %s",
            plate.id,
            "recut" if is_cut else "resliced",
            " ".join(printers),
            extra={"plate": plate.id},
        )
        self._running[plate.id] = StartReplan(plate.id, printers, is_cut)
        return self._running[plate.id]


def _make_attempt_key(plate: Plate, capabilities: Capabilities) -> _AttemptKey:
    return plate.id, len(plate.prints), capabilities.family, capabilities.nozzle_mm


def _has_failed(books: Books, plate: Plate) -> bool:
    last_print = books.prints[plate.prints[-1]] if plate.prints else None
    if last_print is None:
        return False
    return last_print.state is PrintState.FAILED or last_print.verdict is Verdict.BAD


def _may_be_replanned(books: Books, plate: Plate) -> bool:
    """Return whether a plate may be replaced: it is not a user's G-code, and its plan needs no approval."""
    job = books.jobs[plate.job]
    meshes = [books.parts[name].file for name in plate.parts if books.parts[name].file.endswith(".stl")]
    return not job.options.hold and len(plate.parts) == len(meshes) == 1
