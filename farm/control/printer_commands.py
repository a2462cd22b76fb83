"""Commands on printers: fail or pause a print, clear a bed, load a reel, start maintenance, end an outage."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

from farm import api
from farm.config import FieldError
from farm.control.controller import Controller
from farm.errors import RefusedError
from farm.model import Print, PrintState, Reel, Verdict
from farm.planning.inspection import complete_section
from farm.state import PlateState, apply_reel, find_failed_print, find_part_id, list_reprinting_printers
from farm.state import events as ev
from farm.text import parse_part_number


class PrinterCommands:
    """Commands that people give for printers; each is checked, then handled as an event.

    Every method raises NotFoundError for an unknown name, and RefusedError for a command that is not allowed.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    def fail_print(self, printer: str, reason: str, caller_name: str) -> None:
        """Stop a failing print, and print its part again."""
        attempt = self.find_open_print(printer, f"; for a printed part use `farm cleared {printer} --bad`")
        if attempt.cancel_reason is not None or attempt.state is PrintState.ENDING:
            raise RefusedError(f"{printer}: its print is ending; remove it, then `farm cleared {printer}`")
        self._controller.handle(
            ev.PrintFailRequested(
                at_s=self._controller.clock.now(), print_id=attempt.id, why=reason, by=caller_name
            )
        )

    def set_paused(self, printer: str, is_paused: bool, caller_name: str) -> None:
        """Pause or resume a print; a print that is still heating pauses when it starts to print."""
        attempt = self.find_open_print(printer)
        if attempt.cancel_reason is not None or attempt.state is PrintState.ENDING:
            raise RefusedError(f"{printer}: its print is ending; remove it, then `farm cleared {printer}`")
        if not is_paused and not attempt.pause_requested and attempt.state is not PrintState.PAUSED:
            raise RefusedError(f"{printer} is not paused")
        if not is_paused:
            self.refuse_unattended_printers([printer])
        at_s = self._controller.clock.now()
        self._controller.handle(
            ev.PauseRequested(at_s=at_s, print_id=attempt.id, wanted=is_paused, by=caller_name)
        )

    def refuse_unattended_printers(self, printers: Iterable[str]) -> None:
        """Raise RefusedError if one of the printers must not print now, because nobody is present."""
        now_s = self._controller.clock.now()
        fleet_printers = [
            p for name in printers if (p := self._controller.situations.describe_printer(name)) is not None
        ]
        reasons = [
            reason
            for printer in fleet_printers
            if (reason := self._controller.rules.find_unattended_reason(printer, now_s)) is not None
        ]
        if reasons:
            raise RefusedError("; ".join(reasons))

    def clear_bed(self, printer: str, request: api.ClearedRequest, caller_name: str) -> api.ClearedResponse:
        """Record that a person cleared a bed, and the verdict on the part that was on it.

        `request.good` names the part of a failed print if the part is usable. `request.seen` is the id of the
        last print that the person's page showed: the command is refused if there is a later print.
        """
        books = self._controller.books
        books.get_printer(printer)
        if books.find_open_print(printer) is not None:
            raise RefusedError(f"{printer} is printing: its bed cannot be clear")
        last_print = books.find_last_print(printer)
        if request.seen is not None and last_print is not None and request.seen != last_print.id:
            raise RefusedError(
                f"{books.plates[last_print.plate].name} was printed on {printer} after this page was shown: "
                "look at its bed"
            )
        judged_print = books.find_print_to_judge(printer)
        if request.bad and judged_print is None:
            raise RefusedError(f"no part printed on {printer} waits for a verdict: leave out --bad")
        good_print = None if request.good is None else self._find_failed_print(printer, request.good)
        self._controller.handle(
            ev.BedCleared(
                at_s=self._controller.clock.now(),
                printer=printer,
                by=caller_name,
                filament=request.filament,
                verdict=Verdict.BAD if request.bad else Verdict.GOOD,
                why=request.why,
                whole=None if good_print is None else good_print.id,
            )
        )
        books = self._controller.books
        if good_print is not None:
            return api.ClearedResponse(
                good=find_part_id(books, good_print), printed_on=list_reprinting_printers(books, good_print)
            )
        plate = None if judged_print is None else books.plates[judged_print.plate]
        is_reprinted = plate is not None and books.find_plate_state(plate) in (
            PlateState.WAITING,
            PlateState.PRINTING,
        )
        return api.ClearedResponse(again=plate.parts[0] if plate is not None and is_reprinted else None)

    def _find_failed_print(self, printer: str, part: str) -> Print | None:
        """Return the failed print of a part on a bed; None if the print is recorded as done."""
        books = self._controller.books
        judged_print, failed_print = books.find_print_to_judge(printer), find_failed_print(books, printer)
        attempt = judged_print or failed_print
        if attempt is None:
            raise RefusedError(
                f"no part is recorded on {printer}: `farm history --printer {printer}` lists its prints"
            )
        name = find_part_id(books, attempt)
        job = part.rpartition("/")[0]
        if parse_part_number(part) != parse_part_number(name) or job not in ("", str(attempt.job)):
            raise RefusedError(f"the part on {printer} is {name}, not {part}")
        return failed_print if judged_print is None else None

    async def load_reel(self, printer: str, request: api.LoadRequest, caller_name: str) -> Reel:
        """Record that a person loaded or weighed a reel; omitted fields keep their values.

        If the request names a material or a colour, the reel is new: grams or colour are unknown if omitted.
        """
        entry = self._controller.books.get_printer(printer)
        self._refuse_printing_printer(printer)
        section = self._controller.fleet.find_printer(printer)
        has_new_material = request.material is not None or request.colour is not None
        current_reel = entry.reel if not has_new_material else None
        grams = current_reel.grams if current_reel is not None else None
        reel = Reel(
            material=request.material or section.material,
            colour=request.colour if has_new_material else section.colour,
            grams=request.grams if request.grams is not None else grams,
            nozzle_mm=request.nozzle_mm or section.nozzle_mm,
            uncertain=current_reel is not None and current_reel.uncertain and request.grams is None,
        )
        fleet_section = self._controller.fleet.fleet
        try:
            loaded_section = await asyncio.to_thread(
                complete_section, apply_reel(section, reel), fleet_section
            )
        except FieldError as error:
            raise RefusedError(f"{printer}: {error}") from error
        filament = {
            "material": loaded_section.material,
            "kind": loaded_section.material_kind,
            "colour": loaded_section.colour,
        }
        reel = reel.model_copy(update=filament)
        self._refuse_printing_printer(printer)  # a print may have started in the meantime
        at_s = self._controller.clock.now()
        self._controller.handle(ev.ReelLoaded(at_s=at_s, printer=printer, reel=reel, by=caller_name))
        return reel

    def _refuse_printing_printer(self, printer: str) -> None:
        if self._controller.books.find_open_print(printer) is not None:
            raise RefusedError(f"{printer} is printing: use `farm load` after the print has ended")

    def begin_maintenance(self, printer: str, reason: str, caller_name: str) -> None:
        """Take a printer out of use; an open print on it continues."""
        self._controller.books.get_printer(printer)
        at_s = self._controller.clock.now()
        self._controller.handle(ev.MaintenanceStarted(at_s=at_s, printer=printer, why=reason, by=caller_name))

    def end_maintenance(self, printer: str, caller_name: str) -> None:
        """Put a printer back into use."""
        if self._controller.books.get_printer(printer).maintenance is None:
            raise RefusedError(f"{printer} is not in maintenance")
        self._controller.handle(
            ev.MaintenanceEnded(at_s=self._controller.clock.now(), printer=printer, by=caller_name)
        )

    def confirm_outage(self, caller_name: str) -> str:
        """Record that a person has resolved the outage; return the names of its printers."""
        outage = self._controller.books.outage
        if outage is None:
            raise RefusedError("there is no outage: give a printer, a job or a part to resume")
        self._controller.handle(ev.OutageConfirmed(at_s=self._controller.clock.now(), by=caller_name))
        return " ".join(outage.printers)

    def find_open_print(self, printer: str, advice: str = ": see `farm status`") -> Print:
        """Return the open print of a printer. Raises RefusedError, with `advice`, if there is none."""
        self._controller.books.get_printer(printer)
        attempt = self._controller.books.find_open_print(printer)
        if attempt is None:
            raise RefusedError(f"{printer} is not printing{advice}")
        return attempt
