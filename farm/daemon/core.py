"""The one event loop's heart: events in, books committed, instructions out.

Everything here runs on one thread and never waits. `happened` is the only way in which the books change:
event, new state, commit, and only then what follows from it.
"""

from __future__ import annotations

import logging
import math
import uuid
from collections import Counter
from collections.abc import Callable
from typing import Protocol

from drivers.clock import Clock
from farm.config import Fleet, PrinterSection
from farm.errors import FarmError, Refused
from farm.model import (
    AgentSnapshot,
    Bed,
    FilamentState,
    Hold,
    HoldCode,
    Job,
    JobOptions,
    JobState,
    Link,
    PlanProgress,
    Plate,
    Print,
    PrintState,
    Verdict,
)
from farm.paths import StateFolder
from farm.scheduling.assign import assign
from farm.scheduling.front import begin, unmatched
from farm.scheduling.rules import Rules
from farm.scheduling.snapshot import Box, Kind, Need, PlateView, PrinterView
from farm.services.models import Inspected
from farm.services.planning import Plan, TooFewPrinters
from farm.tracking import events as ev
from farm.tracking.outage import LOSSES, WINDOW_S
from farm.tracking.outcome import Standing
from farm.tracking.reconcile import observe, owed, reconcile, unexpected
from farm.tracking.rules import apply
from farm.tracking.store import Store
from farm.tracking.view import Scene

log = logging.getLogger(__name__)

PATIENCE_S = 30.0
"""Wall seconds in which printers are expected to connect after the farm has started."""
REFUSALS = 5
"""How often an agent may refuse to start a print; a port that is just opening refuses too."""
REFUSED_FAULT = "refused"


class Hands(Protocol):
    """What carries out instructions: it starts things and returns at once."""

    def perform(self, instruction: ev.AnyInstruction) -> None: ...

    def plan(self, job: Job, printers: list[PrinterSection], rounds: int) -> None: ...


class Core:
    """The farm's state and its rules, without any I/O but the store's."""

    def __init__(
        self,
        fleet: Fleet,
        store: Store,
        clock: Clock,
        rooms: Callable[[PrinterSection], tuple[Box, ...]],
        hands: Hands,
    ) -> None:
        self.fleet = fleet
        self.clock = clock
        self.since_s = clock.now()
        self.snapshots: dict[str, AgentSnapshot] = {}
        self.progress: dict[int, PlanProgress] = {}
        self.stopping = False
        self._store = store
        self._room = rooms
        self._rules = Rules.of(fleet.fleet)
        self._hands = hands
        self._least: dict[int, int] = {}  # parts that a job was seen to need
        self._refusals: Counter[str] = Counter()
        self.books = store.load()

    # -- events -----------------------------------------------------------------------------------------

    def happened(self, *happenings: ev.AnyEvent) -> None:
        """Take events into the books, commit each, and carry out what follows."""
        for event in happenings:
            after, instructions = apply(event, self.books)
            self._store.commit(event, self.books, after)
            self.books = after
            log.info(
                "%s %s", type(event).__name__, event.model_dump_json(exclude={"at_s"}, exclude_none=True)
            )
            for instruction in instructions:
                self._hands.perform(instruction)

    def start(self) -> None:
        """Bring yesterday's books in line with today's fleet, and give up plans that died with a daemon."""
        now_s = self.clock.now()
        for section in self.fleet.printers:
            if section.name not in self.books.printers:
                bed = Bed.UNKNOWN if section.simulated else Bed.NOT_CLEAR
                self.happened(ev.PrinterAdded(at_s=now_s, name=section.name, bed=bed))
        for job in list(self.books.jobs.values()):
            if job.state is JobState.PLANNING:
                self.happened(ev.PlanningAbandoned(at_s=now_s, job=job.id, hold=None))

    def heard(self, snapshot: AgentSnapshot) -> None:
        """An agent said how things are."""
        now_s = self.clock.now()
        attempt = self.books.open_print_on(snapshot.printer)
        if attempt is not None:
            self.happened(*reconcile(attempt, snapshot, now_s))
        else:
            before = self.snapshots.get(snapshot.printer)
            if before is not None and before.link is Link.READY and snapshot.link is Link.ABSENT:
                self.happened(ev.PrinterLost(at_s=now_s, printer=snapshot.printer))
            self.happened(*observe(self.books.printer(snapshot.printer), snapshot, now_s))
        said = snapshot.print
        if said is not None and (attempt is None or said.print_id != attempt.id):
            printer = self.books.printer(snapshot.printer)
            known = self.books.prints.get(said.print_id)
            for follows in unexpected(printer, known, snapshot, now_s):
                if isinstance(follows, ev.Event):
                    self.happened(follows)
                else:
                    self._hands.perform(follows)
        # Only now: where the books could not be written, the same word is news again.
        self.snapshots[snapshot.printer] = snapshot
        self.settle()

    # -- decisions --------------------------------------------------------------------------------------

    def settle(self) -> None:
        """Give plates to printers, and begin the job in front, as far as both can be done now."""
        self._remind()
        if self.stopping:
            return
        now_s = self.clock.now()
        held_back = self._held_back(now_s)
        waiting = [
            self._plate_view(plate) for plate in self.books.waiting_plates() if plate.id not in held_back
        ]
        given, holds = assign(waiting, self.printer_views(), self._rules, now_s)
        for assignment in given:
            self.happened(
                ev.PlateAssigned(
                    at_s=now_s, plate=assignment.plate, printer=assignment.printer, print_id=uuid.uuid4().hex
                )
            )
        news = {
            name: hold for name, hold in (holds | held_back).items() if self.books.plates[name].hold != hold
        }
        if news:
            self.happened(ev.PlatesHeld(at_s=now_s, holds=dict(news)))
        self._settle_front(holds)

    def _held_back(self, now_s: float) -> dict[str, Hold]:
        """The plates that are offered to no printer, and why."""
        held = {}
        for job in self.books.jobs.values():
            for plate in self.books.plates_of(job) if not job.state.ended else ():
                hold = self._own_hold(job, plate, now_s)
                if hold is not None:
                    held[plate.id] = hold
        return held

    def _own_hold(self, job: Job, plate: Plate, now_s: float) -> Hold | None:
        """Why a plate would start on no printer at all."""
        standing = self.books.standing(plate)
        if standing is Standing.OUT_OF_ATTEMPTS:
            text = f"plate {plate.id} failed too often: `farm reprint {job.id} {plate.parts[0]}`"
            return Hold(code=HoldCode.OUT_OF_ATTEMPTS, text=text)
        if standing is not Standing.WAITING:
            return None
        if self.books.outage is not None:
            text = f"{' '.join(self.books.outage.printers)} were lost at once: look, then `farm resume`"
            return Hold(code=HoldCode.OUTAGE, text=text)
        if job.paused:
            return Hold(code=HoldCode.PAUSED, text=f"job {job.id} is paused: `farm resume {job.id}`")
        last = self.books.prints[plate.prints[-1]] if plate.prints else None
        if last is not None and last.fault in LOSSES and now_s - (last.ended_s or 0.0) <= WINDOW_S:
            text = f"{last.printer} was lost just now: others may be lost with it"
            return Hold(code=HoldCode.JUST_LOST, text=text)
        return None

    def _remind(self) -> None:
        """Tell agents again what they were told while they were away."""
        for attempt in list(self.books.open_prints()):
            snapshot = self.snapshots.get(attempt.printer)
            if snapshot is not None:
                for instruction in owed(attempt, snapshot):
                    if self.books.outage is not None and isinstance(instruction, ev.SendStart):
                        continue  # nothing heats until a person has confirmed
                    self._hands.perform(instruction)

    def refused(self, print_id: str, reason: str) -> None:
        """An agent would not start a print; where it still will not after several times, the print failed."""
        attempt = self.books.prints[print_id]
        self._refusals[print_id] += 1
        if attempt.state is not PrintState.ASSIGNED or self._refusals[print_id] < REFUSALS:
            return
        now_s = self.clock.now()
        self.happened(
            ev.PrintEnded(
                at_s=now_s,
                print_id=print_id,
                state=PrintState.FAILED,
                fault=REFUSED_FAULT,
                reason=f"its agent would not start it: {reason}",
                started_s=None,
                ended_s=now_s,
                extruded=False,
                filament=self.books.printer(attempt.printer).filament,
            )
        )
        self.settle()

    def _settle_front(self, held: dict[str, Hold]) -> None:
        """Begin the job in front. One that no printer matches (any more) is held, and others pass it."""
        views = self.printer_views()
        front: Job | None = None
        for job in self.books.queue():
            nobody = unmatched(_need(job), views)
            if job.state is JobState.PLANNING:
                front = job
            elif nobody is not None:
                self._hold(job, nobody)
            elif job.paused:
                self._hold(job, Hold(code=HoldCode.PAUSED, text=f"it is paused: `farm resume {job.id}`"))
            elif front is not None:
                self._hold(job, Hold(code=HoldCode.NOT_FRONT, text=f"job {front.id} is in front of it"))
            else:
                front = job
                self._begin(job, views, held)

    def _begin(self, job: Job, views: list[PrinterView], held: dict[str, Hold]) -> None:
        """Plan a job, or say what it waits for."""
        taken = frozenset(self.books.plates[name].printer for name in held)
        least = self._least.get(job.id, 0)
        wanted = job.options.printers if job.own_gcode is None else None  # its plan chooses one of them
        answer = begin(_need(job), wanted, least, views, taken, patient=self._arriving())
        if isinstance(answer, Hold):
            self._hold(job, answer)
            return
        self.happened(ev.PlanningStarted(at_s=self.clock.now(), job=job.id))
        sections = [self.fleet.printer(name) for name in answer.printers]
        self._hands.plan(self.books.job(job.id), sections, answer.rounds)

    def _hold(self, job: Job, hold: Hold) -> None:
        if job.hold != hold:
            self.happened(ev.JobHeld(at_s=self.clock.now(), job=job.id, hold=hold))

    def progressed(self, number: int, progress: PlanProgress) -> None:
        """The planner is so far with a job."""
        self.progress[number] = progress

    def planned(self, number: int, result: Plan | FarmError) -> None:
        """A plan was made, or could not be made."""
        now_s = self.clock.now()
        self.progress.pop(number, None)
        job = self.books.job(number)
        if job.state is not JobState.PLANNING:
            return  # cancelled meanwhile
        if isinstance(result, TooFewPrinters):
            self._least[number] = result.needed
            self.happened(ev.PlanningAbandoned(at_s=now_s, job=number, hold=None))
        elif isinstance(result, FarmError):
            self.happened(ev.JobFailed(at_s=now_s, job=number, error=result.code, reason=str(result)))
        else:
            self.happened(
                ev.JobPlanned(
                    at_s=now_s,
                    job=number,
                    parts=result.parts,
                    plates=result.plates,
                    repairs=result.repairs,
                    scale=result.scale,
                    serial_s=result.serial_s,
                    estimated_s=result.estimated_s,
                    picture=result.picture,
                )
            )
        self.settle()

    # -- what people ask --------------------------------------------------------------------------------

    def submitted(self, request_id: str) -> int | None:
        """The job that this request made, if it was heard before."""
        return next((job.id for job in self.books.jobs.values() if job.request_id == request_id), None)

    def submit(self, request_id: str, name: str, model: Inspected, options: JobOptions) -> tuple[int, bool]:
        """Take a job; the same request id gives the same job. Returns its number, and whether it is old."""
        known = self.submitted(request_id)
        if known is not None:
            return known, True
        number = max(self.books.jobs, default=0) + 1
        now_s = self.clock.now()
        job = Job(
            id=number,
            request_id=request_id,
            name=name,
            model_file=model.file,
            options=options,
            own_gcode=model.own_gcode,
            repairs=model.repairs,
            scale=model.scale,
            submitted_s=now_s,
        )
        self.happened(ev.JobSubmitted(at_s=now_s, job=job))
        self.settle()
        return number, False

    def cancel(self, number: int) -> None:
        job = self.books.job(number)
        if job.state.ended:
            raise Refused(f"job {number} has ended already: it is {job.state}")
        self.happened(ev.JobCancelled(at_s=self.clock.now(), job=number))
        self.progress.pop(number, None)
        self.settle()

    def cleared(
        self,
        printer: str,
        by: str,
        filament: FilamentState | None,
        verdict: Verdict = Verdict.GOOD,
        why: str | None = None,
    ) -> None:
        """A person cleared a bed, and says how what was printed on it is."""
        self.books.printer(printer)
        if self.books.open_print_on(printer) is not None:
            raise Refused(f"{printer} is printing: its bed cannot be clear")
        if verdict is Verdict.BAD and self.books.to_judge(printer) is None:
            raise Refused(f"nothing that was printed on {printer} waits for a verdict: leave --bad out")
        now_s = self.clock.now()
        self.happened(
            ev.BedCleared(at_s=now_s, printer=printer, by=by, filament=filament, verdict=verdict, why=why)
        )
        self.settle()

    def pause(self, printer: str, wanted: bool) -> None:
        """Have what is printed there wait, or go on; while it heats it is told when it prints."""
        self.books.printer(printer)
        attempt = self.books.open_print_on(printer)
        if attempt is None:
            raise Refused(f"{printer} prints nothing")
        if attempt.cancel_asked is not None or attempt.state is PrintState.ENDING:
            raise Refused(f"{printer}: its print is ending")
        if not wanted and not attempt.pause_asked and attempt.state is not PrintState.PAUSED:
            raise Refused(f"{printer} is not paused")
        self.happened(ev.PauseAsked(at_s=self.clock.now(), print_id=attempt.id, wanted=wanted))

    def abort_all(self) -> None:
        """End every job that is being printed."""
        for number in sorted({attempt.job for attempt in self.books.open_prints()}):
            if not self.books.job(number).state.ended:
                self.happened(ev.JobCancelled(at_s=self.clock.now(), job=number))

    # -- views ------------------------------------------------------------------------------------------

    def printer_views(self) -> list[PrinterView]:
        return [self._printer_view(section) for section in self.fleet.printers if section.enabled]

    def _printer_view(self, section: PrinterSection) -> PrinterView:
        entry = self.books.printer(section.name)
        snapshot = self.snapshots.get(section.name)
        link = snapshot.link if snapshot is not None else Link.STARTING
        look = entry.look
        if snapshot is not None and link is Link.FAULT and look is None:
            look = snapshot.reason or "its agent reports a fault"
        if entry.maintenance is not None:
            look = f"in maintenance: {entry.maintenance}"
        attempt = self.books.open_print_on(section.name)
        verified = snapshot is None or snapshot.reset_verified
        return PrinterView(
            name=section.name,
            kind=Kind(self._room(section), section.material, section.colour, section.nozzle_mm),
            bed=entry.bed,
            filament=entry.filament,
            link=link,
            booked=attempt is not None,
            look=look,
            heating=attempt is not None and attempt.state in (PrintState.ASSIGNED, PrintState.HEATING),
            free_s=None if attempt is None else self._expected_end_s(attempt, entry.time_factor),
            time_factor=entry.time_factor,
            unattended=section.unattended and verified,
            why_attended="fleet.yaml says so" if verified else "its board was not seen to reset",
        )

    def _expected_end_s(self, attempt: Print, factor: float) -> float:
        """When a print should end, as expected when it began: in whole minutes, so that it is seldom news."""
        begun_s = attempt.started_s if attempt.started_s is not None else attempt.assigned_s
        return math.ceil((begun_s + self.books.plates[attempt.plate].seconds(factor)) / 60) * 60.0

    def _plate_view(self, plate: Plate) -> PlateView:
        failed = {p.printer for p in self.books.prints_of(plate) if p.state is PrintState.FAILED}
        options = self.books.job(plate.job).options
        used = sum(1 for _ in self.books.open_prints(plate.job))
        need = Need(
            material=plate.material,
            colour=options.colour,
            nozzle_mm=plate.nozzle_mm,
            box=(*plate.min_mm[:2], *plate.max_mm),
        )
        return PlateView(
            id=plate.id,
            job=plate.job,
            need=need,
            planned=plate.printer,
            estimated_s=plate.estimated_s,
            grams=plate.grams,
            heating_s=plate.prelude_s,
            first_layer_s=plate.first_layer_s,
            failed_on=frozenset(failed),
            places=None if options.printers is None else max(0, options.printers - used),
        )

    def scene(self, state: StateFolder) -> Scene:
        """All that a view is drawn from."""
        return Scene(
            self.fleet,
            self.books,
            self.snapshots,
            state,
            self.clock.now(),
            settled=not self._arriving(),
            progress=self.progress,
        )

    def _arriving(self) -> bool:
        """Whether the farm has just started: printers that do not answer yet are still expected."""
        return self.clock.now() - self.since_s < PATIENCE_S * self.clock.scale


def _need(job: Job) -> Need:
    """What a job asks of a printer before it is planned."""
    own = job.own_gcode
    return Need(
        material=job.options.material,
        colour=job.options.colour,
        nozzle_mm=own.nozzle_mm if own else None,
        box=(*own.min_mm[:2], *own.max_mm) if own else None,
    )
