"""What people ask of prints, parts and printers: each wish is checked, then booked."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from fastapi import FastAPI

from farm import api
from farm.control.controller import Core
from farm.errors import NoSuchThing, Refused
from farm.http.callers import By, ByOperator
from farm.model import FilamentState, Plate, Print, PrintState, Verdict
from farm.state import events as ev
from farm.state.plate_state import PlateState, stopped_print
from farm.state.salvaged_parts import failed_print_on, part_name, reprinting_printers

_UNWANTED = {
    PlateState.PRINTED: "is printed already",
    PlateState.GOOD: "is printed already",
    PlateState.CANCELLED: "is cancelled already",
}
_COMING = {
    PlateState.PRINTING: "is being printed: `farm fail {printer}` ends that print and prints it again",
    PlateState.WAITING: "waits to be printed already",
}


class Desk:
    """Where a person's wish becomes an event. Every method raises NoSuchThing or Refused."""

    def __init__(self, core: Core) -> None:
        self._core = core

    def fail(self, printer: str, why: str, by: str) -> None:
        """End what is printed there, because it goes wrong, and print its parts again."""
        books = self._core.books
        books.printer(printer)
        attempt = books.open_print_on(printer)
        if attempt is None:
            raise Refused(f"{printer} prints nothing; of what is printed, `farm cleared {printer} --bad`")
        if attempt.cancel_reason is not None or attempt.state is PrintState.ENDING:
            raise Refused(f"{printer}: its print is ending; take it off, then `farm cleared {printer}`")
        self._happened(lambda at_s: ev.PrintFailRequested(at_s=at_s, print_id=attempt.id, why=why, by=by))

    def cleared(
        self,
        printer: str,
        by: str,
        filament: FilamentState | None,
        verdict: Verdict = Verdict.GOOD,
        why: str | None = None,
        good: str | None = None,
    ) -> api.Cleared:
        """A person cleared a bed, and says how what lay there is.

        `good` is the part of a failed print that is whole and good after all.
        """
        books = self._core.books
        books.printer(printer)
        if books.open_print_on(printer) is not None:
            raise Refused(f"{printer} is printing: its bed cannot be clear")
        judged = books.print_to_judge(printer)
        if verdict is Verdict.BAD and judged is None:
            raise Refused(f"nothing that was printed on {printer} waits for a verdict: leave --bad out")
        whole = None if good is None else self._whole(printer, good)
        self._happened(
            lambda at_s: ev.BedCleared(
                at_s=at_s,
                printer=printer,
                by=by,
                filament=filament,
                verdict=verdict,
                why=why,
                whole=None if whole is None else whole.id,
            )
        )
        books = self._core.books
        if whole is not None:
            return api.Cleared(good=part_name(books, whole), printed_on=reprinting_printers(books, whole))
        plate = None if judged is None else books.plates[judged.plate]
        again = plate is not None and books.plate_state(plate) in _COMING
        return api.Cleared(again=plate.parts[0] if plate is not None and again else None)

    def _whole(self, printer: str, part: str) -> Print | None:
        """The failed print on a bed that made a part; None where it is booked as printed anyway."""
        books = self._core.books
        judged, failed = books.print_to_judge(printer), failed_print_on(books, printer)
        attempt = judged or failed
        if attempt is None:
            raise Refused(
                f"no part is known to lie on {printer}: `farm history {printer}` has what it printed"
            )
        name = part_name(books, attempt)
        job = part.rpartition("/")[0]
        if _number(part) != _number(name) or job not in ("", str(attempt.job)):
            raise Refused(f"what lies on {printer} is part {name}, not {part}")
        return failed if judged is None else None

    def reprint(self, job: int, part: str, why: str, by: str) -> str:
        """Print a part again, whatever became of it. Returns its name."""
        plate = self._plate(job, part)
        stands = self._core.books.plate_state(plate)
        printer = self._printing(plate)
        halted = stopped_print(plate, self._core.books.prints_of(plate))
        if stands in _COMING and halted is None:
            raise Refused(f"part {plate.parts[0]} {_COMING[stands].format(printer=printer)}")
        self._happened(lambda at_s: ev.ReprintRequested(at_s=at_s, plate=plate.id, why=why, by=by))
        return plate.parts[0]

    def cancel_job(self, number: int, by: str) -> None:
        """Print nothing more of a job."""
        job = self._core.books.job(number)
        if job.state.ended:
            again = f"; `farm reprint {number} PART` prints a part again" if job.parts else ""
            raise Refused(f"job {number} has ended already: it is {job.state}{again}")
        self._happened(lambda at_s: ev.JobCancelled(at_s=at_s, job=number, by=by))

    def cancel_part(self, job: int, part: str, by: str) -> str:
        """Never print a part. Returns its name."""
        return self._cancel(self._plate(job, part), by)

    def cancel_printer(self, printer: str, by: str) -> str:
        """End what is printed there, and never try it again. Returns the part's name."""
        self._core.books.printer(printer)
        attempt = self._core.books.open_print_on(printer)
        if attempt is None:
            raise Refused(f"{printer} prints nothing: `farm status` shows what prints")
        return self._cancel(self._core.books.plates[attempt.plate], by)

    def pause_printer(self, printer: str, wanted: bool, by: str) -> None:
        """Have what is printed there wait, or go on; while it heats it is told when it prints."""
        self._core.books.printer(printer)
        attempt = self._core.books.open_print_on(printer)
        if attempt is None:
            raise Refused(f"{printer} prints nothing: `farm status` shows what prints")
        if attempt.cancel_reason is not None or attempt.state is PrintState.ENDING:
            raise Refused(f"{printer}: its print is ending; take it off, then `farm cleared {printer}`")
        if not wanted and not attempt.pause_requested and attempt.state is not PrintState.PAUSED:
            raise Refused(f"{printer} is not paused")
        if not wanted:
            self._refuse_away([printer])
        at_s = self._core.clock.now()
        self._core.happened(ev.PauseRequested(at_s=at_s, print_id=attempt.id, wanted=wanted, by=by))

    def pause_part(self, job: int, part: str, wanted: bool, by: str) -> str:
        """Have a part wait where it is, on a printer or for one, or go on. Returns the printer, if any."""
        plate = self._plate(job, part)
        name, stands = plate.parts[0], self._core.books.plate_state(plate)
        printer = self._printing(plate)
        if printer is not None:
            self.pause_printer(printer, wanted, by)
            return printer
        if stands is not PlateState.WAITING:
            what = _UNWANTED.get(stands, f"failed too often: `farm reprint {job} {part}`")
            raise Refused(f"part {name} {what}")
        if plate.paused is wanted:
            if not wanted and self._core.books.job(job).paused:
                raise Refused(f"job {job} is paused: `farm resume {job}` lets its parts go on")
            raise Refused(f"part {name} is {'paused already' if wanted else 'not paused'}")
        self._happened(lambda at_s: ev.PlatePaused(at_s=at_s, plate=plate.id, wanted=wanted, by=by))
        return ""

    def pause_job(self, job: int, wanted: bool, by: str) -> None:
        """Have all that is printed of a job wait, and start nothing of it; or go on."""
        entry = self._core.books.job(job)
        if entry.state.ended:
            raise Refused(f"job {job} has ended already: it is {entry.state}")
        parts = not wanted and any(plate.paused for plate in self._core.books.plates_of(entry))
        if entry.paused is wanted and not parts:
            raise Refused(f"job {job} is {'paused already' if wanted else 'not paused'}")
        if not wanted:
            paused = (p for p in self._core.books.open_prints(job) if p.pause_requested)
            self._refuse_away(sorted(attempt.printer for attempt in paused))
        self._happened(lambda at_s: ev.JobPaused(at_s=at_s, job=job, wanted=wanted, by=by))

    def _refuse_away(self, printers: Iterable[str]) -> None:
        """Raise Refused where nothing may print on some of them now, as nobody is there."""
        now_s = self._core.clock.now()
        views = [view for name in printers if (view := self._core.view(name)) is not None]
        away = [why for view in views if (why := self._core.rules.away(view, now_s)) is not None]
        if away:
            raise Refused("; ".join(away))

    def maintenance(self, printer: str, why: str, by: str) -> None:
        """Take a printer out of use; what it prints goes on to its end."""
        self._core.books.printer(printer)
        self._happened(lambda at_s: ev.MaintenanceStarted(at_s=at_s, printer=printer, why=why, by=by))

    def maintained(self, printer: str, by: str) -> None:
        """A printer can be used again."""
        if self._core.books.printer(printer).maintenance is None:
            raise Refused(f"{printer} is not in maintenance")
        self._happened(lambda at_s: ev.MaintenanceEnded(at_s=at_s, printer=printer, by=by))

    def confirm(self, by: str) -> str:
        """What took several printers at once has been seen to. Returns the printers."""
        outage = self._core.books.outage
        if outage is None:
            raise Refused("no printers were lost at once: name what to resume (a printer, a job, a part)")
        self._happened(lambda at_s: ev.OutageConfirmed(at_s=at_s, by=by))
        return " ".join(outage.printers)

    def _cancel(self, plate: Plate, by: str) -> str:
        stands = self._core.books.plate_state(plate)
        if stands in _UNWANTED and (stands is not PlateState.GOOD or self._printing(plate) is None):
            raise Refused(f"part {plate.parts[0]} {_UNWANTED[stands]}")
        self._happened(lambda at_s: ev.PlateCancelled(at_s=at_s, plate=plate.id, by=by))
        return plate.parts[0]

    def _plate(self, job: int, part: str) -> Plate:
        """The plate of a part, by its name with or without its job: 3/p01, p01, 01 or 1."""
        books = self._core.books
        entry = books.job(job)
        for name in entry.parts:
            if _number(name) == _number(part):
                return books.plates[books.parts[name].plate]
        for whole in books.parts.values():
            if whole.job == job and _number(whole.id) == _number(part):
                names = books.plates[whole.plate].replaced_by
                pieces = " ".join(name for plate in names for name in books.plates[plate].parts)
                raise Refused(f"part {whole.id} failed and was cut again: name its pieces {pieces}")
        known = " ".join(name.rpartition("/")[2] for name in entry.parts) or "none yet"
        raise NoSuchThing(f"job {job} has no part {part}; its parts are {known}")

    def _printing(self, plate: Plate) -> str | None:
        attempts = self._core.books.prints_of(plate)
        return next((attempt.printer for attempt in attempts if not attempt.state.ended), None)

    def _happened(self, event: Callable[[float], ev.AnyEvent]) -> None:
        self._core.happened(event(self._core.clock.now()))
        self._core.settle()


def _number(part: str) -> str:
    return part.rpartition("/")[2].removeprefix("p").lstrip("0")


def add_desk(app: FastAPI, desk: Desk) -> None:
    """The routes of what people ask of prints, parts and printers."""

    @app.post("/printers/{name}/cleared")
    async def cleared(name: str, request: api.ClearedRequest, by: ByOperator) -> api.Cleared:
        verdict = Verdict.BAD if request.bad else Verdict.GOOD
        return desk.cleared(name, by, request.filament, verdict, request.why, request.good)

    @app.post("/printers/{name}/pause")
    async def pause(name: str, by: By) -> None:
        desk.pause_printer(name, True, by)

    @app.post("/printers/{name}/resume")
    async def resume(name: str, by: By) -> None:
        desk.pause_printer(name, False, by)

    @app.post("/outage/confirm")
    async def confirm(by: ByOperator) -> api.Named:
        return api.Named(name=desk.confirm(by))

    @app.post("/printers/{name}/fail")
    async def fail(name: str, request: api.Reason, by: By) -> None:
        desk.fail(name, request.why or "it went wrong", by)

    @app.post("/printers/{name}/cancel")
    async def cancel_printer(name: str, by: By) -> api.Named:
        return api.Named(name=desk.cancel_printer(name, by))

    @app.post("/printers/{name}/maintenance")
    async def maintenance(name: str, request: api.Reason, by: By) -> None:
        desk.maintenance(name, request.why, by)

    @app.post("/printers/{name}/maintained")
    async def maintained(name: str, by: ByOperator) -> None:
        desk.maintained(name, by)

    @app.post("/jobs/{number}/parts/{part}/reprint")
    async def reprint(number: int, part: str, request: api.Reason, by: By) -> api.Named:
        return api.Named(name=desk.reprint(number, part, request.why or "asked for again", by))

    @app.post("/jobs/{number}/parts/{part}/cancel")
    async def cancel_part(number: int, part: str, by: By) -> api.Named:
        return api.Named(name=desk.cancel_part(number, part, by))

    @app.post("/jobs/{number}/parts/{part}/pause")
    async def pause_part(number: int, part: str, by: By) -> api.Named:
        return api.Named(name=desk.pause_part(number, part, True, by))

    @app.post("/jobs/{number}/parts/{part}/resume")
    async def resume_part(number: int, part: str, by: By) -> api.Named:
        return api.Named(name=desk.pause_part(number, part, False, by))

    @app.post("/jobs/{number}/pause")
    async def pause_job(number: int, by: By) -> None:
        desk.pause_job(number, True, by)

    @app.post("/jobs/{number}/resume")
    async def resume_job(number: int, by: By) -> None:
        desk.pause_job(number, False, by)
