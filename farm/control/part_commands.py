"""Commands on parts: print again, cancel, pause."""

from __future__ import annotations

from datetime import datetime

from farm.control.controller import Controller
from farm.control.printer_commands import PrinterCommands
from farm.errors import NotFoundError, RefusedError
from farm.model import Plate
from farm.state import PlateState, find_stopped_print
from farm.state import events as ev
from farm.text import parse_part_number

_REFUSAL_REASONS = {
    PlateState.PRINTED: "is already printed",
    PlateState.GOOD: "is already printed",
    PlateState.CANCELLED: "is already cancelled",
}
_PENDING_REASONS = {
    PlateState.PRINTING: "is being printed: `farm fail {printer}` ends that print and prints the part again",
    PlateState.WAITING: "is already waiting to be printed",
}


class PartCommands:
    """Commands that people give for parts; each is checked, then handled as an event.

    Every method raises NotFoundError for an unknown name, and RefusedError for a command that is not allowed.
    """

    def __init__(self, controller: Controller, printers: PrinterCommands) -> None:
        self._controller, self._printers = controller, printers

    def reprint(self, job_id: int, part: str, reason: str, caller_name: str) -> str:
        """Print a part again, unless it is already waiting or being printed; return the part's name."""
        plate = self._find_plate(job_id, part)
        job = self._controller.books.get_job(job_id)
        if job.pruned_s is not None:
            pruned_at = datetime.fromtimestamp(job.pruned_s, self._controller.fleet.zone)
            raise RefusedError(
                f"the files of job {job_id} were pruned on {pruned_at:%Y-%m-%d} (`fleet.keep` in "
                f"fleet.yaml): submit {job.name} again; `farm report {job_id}` still shows how it was printed"
            )
        state = self._controller.books.find_plate_state(plate)
        stopped_print = find_stopped_print(plate, self._controller.books.list_prints(plate))
        if state in _PENDING_REASONS and stopped_print is None:
            printer = self._find_printer(plate)
            raise RefusedError(f"part {plate.parts[0]} {_PENDING_REASONS[state].format(printer=printer)}")
        at_s = self._controller.clock.now()
        self._controller.handle(ev.ReprintRequested(at_s=at_s, plate=plate.id, why=reason, by=caller_name))
        return plate.parts[0]

    def cancel(self, job_id: int, part: str, caller_name: str) -> str:
        """Cancel a part, so that it is not printed; return the part's name."""
        return self._cancel_plate(self._find_plate(job_id, part), caller_name)

    def cancel_on_printer(self, printer: str, caller_name: str) -> str:
        """Cancel the part that a printer is printing; return the part's name."""
        attempt = self._printers.find_open_print(printer)
        return self._cancel_plate(self._controller.books.plates[attempt.plate], caller_name)

    def _cancel_plate(self, plate: Plate, caller_name: str) -> str:
        state = self._controller.books.find_plate_state(plate)
        if state in _REFUSAL_REASONS and (state is not PlateState.GOOD or self._find_printer(plate) is None):
            raise RefusedError(f"part {plate.parts[0]} {_REFUSAL_REASONS[state]}")
        self._controller.handle(
            ev.PlateCancelled(at_s=self._controller.clock.now(), plate=plate.id, by=caller_name)
        )
        return plate.parts[0]

    def set_paused(self, job_id: int, part: str, is_paused: bool, caller_name: str) -> str:
        """Pause or resume a part; return the printer that prints it, or an empty string if it is queued."""
        plate = self._find_plate(job_id, part)
        printer = self._find_printer(plate)
        if printer is not None:
            self._printers.set_paused(printer, is_paused, caller_name)
            return printer
        name, state = plate.parts[0], self._controller.books.find_plate_state(plate)
        if state is not PlateState.WAITING:
            reason = _REFUSAL_REASONS.get(
                state, f"failed too often: print it again with `farm reprint {job_id} {part}`"
            )
            raise RefusedError(f"part {name} {reason}")
        if plate.paused is is_paused:
            if not is_paused and self._controller.books.get_job(job_id).paused:
                raise RefusedError(f"job {job_id} is paused: `farm resume {job_id}` resumes its parts")
            raise RefusedError(f"part {name} is {'already paused' if is_paused else 'not paused'}")
        at_s = self._controller.clock.now()
        self._controller.handle(ev.PlatePaused(at_s=at_s, plate=plate.id, wanted=is_paused, by=caller_name))
        return ""

    def _find_plate(self, job_id: int, part: str) -> Plate:
        """Find the plate of a part, which may be named with or without its job: 3/p01, p01, 01 or 1."""
        books = self._controller.books
        job = books.get_job(job_id)
        for name in job.parts:
            if parse_part_number(name) == parse_part_number(part):
                return books.plates[books.parts[name].plate]
        for cut_part in books.parts.values():
            if cut_part.job == job_id and parse_part_number(cut_part.id) == parse_part_number(part):
                names = books.plates[cut_part.plate].replaced_by
                pieces = " ".join(name for plate in names for name in books.plates[plate].parts)
                raise RefusedError(
                    f"part {cut_part.id} failed and was cut into smaller parts: name one of {pieces}"
                )
        part_names = " ".join(name.rpartition("/")[2] for name in job.parts) or "none yet"
        raise NotFoundError(f"job {job_id} has no part {part}; its parts are {part_names}")

    def _find_printer(self, plate: Plate) -> str | None:
        """Return the printer that is printing a plate; None if there is none."""
        attempts = self._controller.books.list_prints(plate)
        return next((attempt.printer for attempt in attempts if not attempt.state.ended), None)
