"""What people settle beforehand: which reel is on, which plan may print, and what the night will be."""

from __future__ import annotations

import asyncio

from fastapi import FastAPI

from farm import api
from farm.control.controller import Core
from farm.errors import Refused
from farm.http.callers import ByOperator
from farm.model import Job, JobState, Plate, Reel
from farm.paths import StateFolder
from farm.planning.inspection.fleet_check import mistake_in
from farm.scheduling.forecast import Slot, forecast
from farm.scheduling.situation import Situation
from farm.scheduling.situation_builder import describe_plates
from farm.state import events as ev
from farm.state.plate_state import PlateState
from farm.state.reels import section_with_reel
from farm.state.storage.file_store import sha256_of


class Ahead:
    """Every method raises NoSuchThing or Refused."""

    def __init__(self, core: Core, state: StateFolder) -> None:
        self._core, self._state = core, state

    async def load(self, printer: str, request: api.LoadRequest, by: str) -> Reel:
        """A reel was put on, or what is on it was weighed; what is not said stays as it was."""
        entry = self._core.books.printer(printer)
        self._idle(printer)
        section = self._core.fleet.printer(printer)
        other = request.material is not None or request.colour is not None
        same = entry.reel if not other else None
        grams = same.grams if same is not None else None
        reel = Reel(
            material=request.material or section.material,
            colour=request.colour if other else section.colour,
            grams=request.grams if request.grams is not None else grams,
            nozzle_mm=request.nozzle_mm or section.nozzle_mm,
            doubted=same is not None and same.doubted and request.grams is None,
        )
        mistake = await asyncio.to_thread(mistake_in, section_with_reel(section, reel))
        if mistake is not None:
            raise Refused(f"{printer}: {mistake[1]}")
        self._idle(printer)  # still
        now_s = self._core.clock.now()
        self._core.happened(ev.ReelLoaded(at_s=now_s, printer=printer, reel=reel, by=by))
        self._core.settle()
        return reel

    def _idle(self, printer: str) -> None:
        if self._core.books.open_print_on(printer) is not None:
            raise Refused(f"{printer} is printing: say what is on its reel when it has ended")

    async def approve(self, number: int, request: api.ApproveRequest, by: str) -> None:
        """Let a held job print: exactly the plan that the person has seen, with the files it was made of."""
        job = self._held(number)
        if request.plan != (job.plan or ""):  # one that an older farm planned has no hash
            raise Refused(f"the plan of job {number} is {job.plan}, not {request.plan}: look at it again")
        for plate in list(self._core.books.plates_of(job)):
            path = self._state.files / plate.gcode
            if not path.is_file() or await asyncio.to_thread(sha256_of, path) != plate.sha256:
                raise Refused(f"plate {plate.id} is not what was planned: {path}; submit the model again")
        self._held(number)  # still
        self._core.happened(ev.JobApproved(at_s=self._core.clock.now(), job=number, by=by))
        self._core.settle()

    def _held(self, number: int) -> Job:
        job = self._core.books.job(number)
        if job.state is not JobState.HELD:
            raise Refused(f"job {number} waits for no approval: it is {job.state}")
        return job

    def night(self, number: int) -> api.Night:
        """When and where what is left of a planned job should print."""
        books, now_s = self._core.books, self._core.clock.now()
        job = books.job(number)
        if not job.plates:
            raise Refused(f"job {number} has no plan yet: it is {job.state}")
        plates = list(books.plates_of(job))
        waiting = [plate for plate in plates if books.plate_state(plate) is PlateState.WAITING]
        views = tuple(describe_plates(waiting, books))
        seen = forecast(Situation(views, tuple(self._core.fleet_printers()), self._core.rules, now_s))
        slots = sorted([*self._slots(plates), *seen.slots], key=lambda slot: (slot.starts_s, slot.printer))
        return self._view(job, plates, slots, seen.left, seen.lower_bound_s)

    def _slots(self, plates: list[Plate]) -> list[Slot]:
        """What prints or is printed: as reached, and as expected."""
        slots = []
        for plate in plates:
            for attempt in self._core.books.prints_of(plate):
                factor = self._core.books.printer(attempt.printer).time_factor
                begun_s = attempt.started_s if attempt.started_s is not None else attempt.assigned_s
                ends_s = attempt.ended_s if attempt.ended_s is not None else begun_s + plate.seconds(factor)
                slots.append(Slot(plate.id, attempt.printer, begun_s, ends_s))
        return slots

    def _view(
        self, job: Job, plates: list[Plate], slots: list[Slot], left: tuple[str, ...], bound_s: float
    ) -> api.Night:
        context = self._core.build_view_context(self._state)
        by_id = {plate.id: plate for plate in plates}
        prices = [plate.price for plate in plates if plate.price is not None]
        begin_s = min((slot.starts_s for slot in slots), default=context.now_s)
        end_s = max((slot.ends_s for slot in slots), default=context.now_s)
        return api.Night(
            job=job.id,
            plan=job.plan or "",
            slots=[
                api.SlotView(
                    plate=slot.plate,
                    parts=list(by_id[slot.plate].parts),
                    printer=slot.printer,
                    starts=context.format_time(slot.starts_s) or "",
                    ends=context.format_time(slot.ends_s) or "",
                    grams=by_id[slot.plate].grams,
                    price=by_id[slot.plate].price,
                )
                for slot in slots
            ],
            left=list(left),
            notices=list(job.repairs),
            makespan_s=end_s - begin_s,
            lower_bound_s=max(0.0, min(bound_s, end_s) - begin_s),
            grams=sum(plate.grams for plate in plates),
            price=sum(prices) if len(prices) == len(plates) else None,
            currency=self._core.fleet.fleet.currency,
        )


def add_ahead(app: FastAPI, ahead: Ahead) -> None:
    """The routes of reels, approvals and the night."""

    @app.post("/printers/{name}/load")
    async def load(name: str, request: api.LoadRequest, by: ByOperator) -> api.Reel:
        reel = await ahead.load(name, request, by)
        return api.Reel(
            material=reel.material, colour=reel.colour, grams=reel.grams, nozzle_mm=reel.nozzle_mm
        )

    @app.post("/jobs/{number}/approve")
    async def approve(number: int, request: api.ApproveRequest, by: ByOperator) -> None:
        await ahead.approve(number, request, by)

    @app.get("/jobs/{number}/night")
    async def night(number: int) -> api.Night:
        return ahead.night(number)
