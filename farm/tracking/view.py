"""What the books and the agents' latest words look like to a person. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime

from farm import api
from farm.config import Fleet, PrinterSection
from farm.errors import EXIT_CODES, ExitCode
from farm.model import (
    AgentPrint,
    AgentSnapshot,
    Bed,
    Hold,
    HoldCode,
    Job,
    JobState,
    Link,
    PlanProgress,
    PlanStep,
    Plate,
    Print,
    Printer,
    PrintState,
    Verdict,
)
from farm.paths import StateFolder
from farm.tracking.account import job_account, took_s
from farm.tracking.asks import asks
from farm.tracking.books import Books
from farm.tracking.deadlines import deadlines
from farm.tracking.outcome import Standing

_PASSING_HOLDS = {
    HoldCode.NOT_FRONT, HoldCode.PRINTER_BUSY, HoldCode.ALL_ITS_PRINTERS_BUSY, HoldCode.PRINTER_CONNECTING,
    HoldCode.START_TIME, HoldCode.QUIET_HOURS, HoldCode.UNATTENDED, HoldCode.HEATING_LIMIT,
    HoldCode.KEPT_AS_SPARE, HoldCode.JUST_LOST, HoldCode.CUT_AGAIN,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Scene:
    """All that a view is drawn from."""

    fleet: Fleet
    books: Books
    snapshots: Mapping[str, AgentSnapshot]
    state: StateFolder
    now_s: float
    ends_s: Mapping[str, float] = field(default_factory=dict)  # of waiting plates, as far as it is foreseen
    settled: bool = True  # the farm has been up long enough for every printer to have connected
    progress: Mapping[int, PlanProgress] = field(default_factory=dict)  # of the jobs being planned
    warning: str | None = None  # what is wrong with the farm itself

    def moment(self, at_s: float | None) -> str | None:
        """ISO 8601 in the fleet's zone."""
        return (
            None if at_s is None else datetime.fromtimestamp(at_s, self.fleet.zone).isoformat("T", "seconds")
        )


def job_view(scene: Scene, job: Job) -> api.JobView:
    """Everything about a job."""
    books = scene.books
    plates = list(books.plates_of(job))
    prints = books.prints_of_job(job)
    account = job_account(books, job)
    elapsed_s = _elapsed_s(job, prints, scene.now_s)
    remaining_s = None if job.state is not JobState.PRINTING else _remaining_s(scene, plates)
    ended = job.state in (JobState.PRINTED, JobState.DONE)
    makespan_s = None
    if ended or not job.state.ended:  # a job that failed or was cancelled was no quicker for it
        makespan_s = elapsed_s if ended or elapsed_s is None else elapsed_s + (remaining_s or 0.0)
        makespan_s = makespan_s or job.estimated_s
    busy_s = sum(_busy_s(scene, plate) for plate in plates)
    reached_s = sum(map(took_s, prints))
    used = {attempt.printer for attempt in prints} | {p.printer for p in plates if not p.prints}
    exit_code = EXIT_CODES[job.error] if job.error else ExitCode.DONE
    if job.state is JobState.FAILED and job.planned_s is not None:
        exit_code = ExitCode.JOB_FAILED
    return api.JobView(
        id=job.id,
        name=job.name,
        state=job.state,
        error=job.error,
        reason=job.reason,
        paused=job.paused,
        exit_code=int(exit_code),
        hold=job.hold,
        progress=scene.progress.get(job.id) if job.state is JobState.PLANNING else None,
        submitted=scene.moment(job.submitted_s) or "",
        submitted_by=job.submitted_by,
        options=job.options,
        parts=[_part_view(scene, name) for name in job.parts],
        plates=[_plate_view(scene, plate) for plate in plates],
        repairs=list(job.repairs),
        scale=job.scale,
        plan=job.plan,
        starts=scene.moment(job.not_before_s),
        estimated_s=job.estimated_s,
        lower_bound_s=job.lower_bound_s,
        eta=scene.moment(job.ended_s if ended else _eta_s(scene, job, remaining_s)),
        elapsed_s=elapsed_s,
        serial_s=job.serial_s,
        speedup=job.serial_s / makespan_s if job.serial_s and makespan_s else None,
        utilisation=busy_s / (len(used) * makespan_s) if used and makespan_s else None,
        printed=account.printed,
        good=account.good,
        current_s=makespan_s,
        wasted_s=account.wasted_s,
        wasted_grams=account.wasted_grams,
        grams=sum(plate.grams for plate in plates) if plates else None,
        filament_mm=sum(plate.filament_mm for plate in plates) if plates else None,
        price=_price(plates),
        currency=scene.fleet.fleet.currency,
        starved_share=sum(p.starved_s for p in prints) / reached_s if reached_s else None,
        folder=str(scene.state.job(job.id)) if job.plates else None,
        waits_for_person=_waits_for_person(books, job, plates),
    )


def printer_view(scene: Scene, section: PrinterSection, hold: Hold | None) -> api.PrinterView:
    """Everything about a printer; `hold` is what keeps it from a plate, if anything."""
    entry = scene.books.printer(section.name)
    snapshot = _snapshot(scene, section.name)
    attempt = scene.books.open_print_on(section.name)
    return api.PrinterView(
        name=section.name,
        model=section.model,
        state=_printer_state(entry, snapshot, attempt, section.enabled),
        bed=entry.bed,
        filament=entry.filament,
        reel=_reel(section, entry),
        agent_pid=snapshot.agent_pid,
        nozzle_c=snapshot.nozzle_c,
        bed_c=snapshot.bed_c,
        targets=api.Targets(nozzle_c=snapshot.nozzle_target_c, bed_c=snapshot.bed_target_c),
        heaters_off=snapshot.heaters_off,
        time_factor=entry.time_factor,
        print=_progress(scene, attempt) if attempt else None,
        last=_last_print(scene, section.name),
        look=entry.look or (snapshot.reason if snapshot.link in (Link.FAULT, Link.ABSENT) else None),
        maintenance=entry.maintenance,
        hold=hold,
    )


def _last_print(scene: Scene, printer: str) -> api.LastPrint | None:
    attempt = scene.books.last_on(printer)
    if attempt is None:
        return None
    off = None
    if attempt.state is PrintState.DONE and not attempt.paused:
        off = took_s(attempt) / scene.books.plates[attempt.plate].estimated_s - 1
    return api.LastPrint(
        plate=attempt.plate,
        state=attempt.state,
        ended=scene.moment(attempt.ended_s),
        off=off,
        verdict=attempt.verdict,
    )


def _reel(section: PrinterSection, entry: Printer) -> api.Reel:
    """What is on it; how much of it, where somebody said so."""
    return api.Reel(
        material=section.material,
        colour=section.colour,
        grams=entry.reel.grams if entry.reel is not None else None,
        nozzle_mm=section.nozzle_mm,
    )


def todo(scene: Scene) -> list[api.Todo]:
    """What a person has to do now: look, connect, clear; each printer once."""
    looks, absent, full, ending = [], [], [], []
    outage = scene.books.outage
    if outage is not None:
        names = " ".join(outage.printers)
        text = f"{names} were lost at once (power, a hub, the host?): look at them, then `farm resume`"
        looks.append(api.Todo(code="outage", printers=list(outage.printers), text=text))
    for section in scene.fleet.printers:
        entry, snapshot = scene.books.printer(section.name), _snapshot(scene, section.name)
        attempt = scene.books.open_print_on(section.name)
        away = snapshot.link is Link.ABSENT or (
            snapshot.link in (Link.STARTING, Link.CONNECTING) and scene.settled
        )
        if entry.maintenance is not None and attempt is None:
            continue  # a person has it in hand
        if outage is not None and section.name in outage.printers:
            continue  # told once, for all of them
        why = entry.look or (snapshot.reason if snapshot.link is Link.FAULT else None)
        if section.enabled and away:
            also = f"; and look at it: {entry.look}" if entry.look else ""
            if entry.untold_since_s is not None:
                also += "; the books are a copy: what it printed since is not known"
            what = f"{section.name}: {snapshot.reason or 'no answer from it'}"
            text = f"connect {what}{also}"
            absent.append(api.Todo(code="connect", printers=[section.name], text=text, brief=what))
        elif why:
            what = f"{section.name} {why}{_when(scene, entry)}"
            text = f"look at {section.name}: {why}; then `farm cleared {section.name}`"
            looks.append(api.Todo(code="look", printers=[section.name], text=text, brief=what))
        elif attempt is not None:
            left_s = _print_remaining_s(scene, attempt, scene.books.plates[attempt.plate])
            said, zone = _said(scene, attempt), scene.fleet.zone
            ending += deadlines(attempt, said, left_s, scene.now_s, zone)
        elif entry.bed is not Bed.CLEAR:
            full.append(section.name)
    clear = []
    if full:
        beds = "1 bed" if len(full) == 1 else f"{len(full)} beds"
        text = f"clear {beds}: {' '.join(full)}, then `farm cleared PRINTER`"
        clear = [api.Todo(code="clear", printers=full, text=text)]
    own = [api.Todo(code="farm", printers=[], text=text) for text in _troubles(scene)]
    return [*own, *looks, *absent, *ending, *clear, *asks(scene.books)]


def _troubles(scene: Scene) -> list[str]:
    """What is wrong with the farm itself."""
    found = [scene.warning] if scene.warning else []
    for number, progress in scene.progress.items():
        if progress.step is PlanStep.NO_ROOM:
            found.append(
                f"make room on the disk of {scene.state.root}: job {number} cannot be planned before"
            )
    return found


def _when(scene: Scene, printer: Printer) -> str:
    """Since when a printer has to be looked at."""
    if printer.look is None or printer.look_s is None:
        return ""
    return datetime.fromtimestamp(printer.look_s, scene.fleet.zone).strftime(" %H:%M")


def _snapshot(scene: Scene, name: str) -> AgentSnapshot:
    return scene.snapshots.get(name) or AgentSnapshot(printer=name, link=Link.STARTING)


def _elapsed_s(job: Job, prints: list[Print], now_s: float) -> float | None:
    """Parallel printing time: from the first print command to the end of the last part."""
    started = [p.started_s for p in prints if p.started_s is not None]
    if not started:
        return None
    return (job.ended_s if job.ended_s is not None else now_s) - min(started)


def _remaining_s(scene: Scene, plates: list[Plate]) -> float:
    """Until the last plate ends; of what waits as it is foreseen, else as if it started now. At least 0."""
    return max((_plate_remaining_s(scene, plate) for plate in plates), default=0.0)


def _plate_remaining_s(scene: Scene, plate: Plate) -> float:
    stands = scene.books.standing(plate)
    if stands is Standing.WAITING:
        return max(0.0, scene.ends_s.get(plate.id, scene.now_s + plate.estimated_s) - scene.now_s)
    if stands is not Standing.PRINTING:
        return 0.0
    attempt = _last(scene.books, plate)
    return plate.estimated_s if attempt.started_s is None else _print_remaining_s(scene, attempt, plate)


def _print_remaining_s(scene: Scene, attempt: Print, plate: Plate) -> float:
    """By the timeline once it prints (heat-up is over then), by the estimate before."""
    factor = scene.books.printer(attempt.printer).time_factor
    said = _said(scene, attempt)
    if said is not None and said.progress_s > 0:
        return max(0.0, plate.print_time_s - said.progress_s) * factor
    return max(0.0, plate.seconds(factor) - (scene.now_s - (attempt.started_s or scene.now_s)))


def _said(scene: Scene, attempt: Print) -> AgentPrint | None:
    """What the printer's agent says of it."""
    snapshot = scene.snapshots.get(attempt.printer)
    said = snapshot.print if snapshot is not None else None
    return said if said is not None and said.print_id == attempt.id else None


def _eta_s(scene: Scene, job: Job, remaining_s: float | None) -> float | None:
    return None if remaining_s is None or job.state is not JobState.PRINTING else scene.now_s + remaining_s


def _busy_s(scene: Scene, plate: Plate) -> float:
    """Printing time of a plate: reached where it is done, as estimated otherwise."""
    if plate.prints:
        attempt = _last(scene.books, plate)
        if attempt.state is PrintState.DONE and attempt.started_s is not None and attempt.ended_s is not None:
            return attempt.ended_s - attempt.started_s
    return plate.estimated_s


def _price(plates: list[Plate]) -> float | None:
    """Of all plates; None where one of them has none."""
    prices = [plate.price for plate in plates if plate.price is not None]
    return sum(prices) if plates and len(prices) == len(plates) else None


def _last(books: Books, plate: Plate) -> Print:
    return books.prints[plate.prints[-1]]


def _waits_for_person(books: Books, job: Job, plates: list[Plate]) -> bool:
    """Whether nothing will go on with this job before a person does something."""
    if job.state is JobState.HELD:
        return True
    if job.state is JobState.QUEUED:
        waiting = [job.hold]
        printing = any(True for _ in books.open_prints())
    elif job.state is JobState.PRINTING:
        waiting = [plate.hold for plate in plates]
        printing = any(True for _ in books.open_prints(job.id))
    else:
        return False
    return not printing and any(hold is not None and hold.code not in _PASSING_HOLDS for hold in waiting)


def _part_view(scene: Scene, name: str) -> api.PartView:
    part = scene.books.parts[name]
    plate = scene.books.plates[part.plate]
    return api.PartView(
        id=part.id,
        cut_from=part.cut_from,
        verdict=_verdict(scene.books, plate),
        plate=part.plate,
        file=str(scene.state.files / part.file),
        prints=[print_view(scene, attempt) for attempt in scene.books.prints_of(plate)],
    )


def print_view(scene: Scene, attempt: Print) -> api.PrintView:
    """One attempt, its moments in the fleet's zone."""
    return api.PrintView(
        part=scene.books.plates[attempt.plate].parts[0],
        printer=attempt.printer,
        state=attempt.state,
        fault=attempt.fault,
        reason=attempt.reason,
        verdict=attempt.verdict,
        why=attempt.verdict_why,
        started=scene.moment(attempt.started_s),
        ended=scene.moment(attempt.ended_s),
    )


def _verdict(books: Books, plate: Plate) -> Verdict | None:
    """A person's word on the last print that was done."""
    done = [attempt for attempt in books.prints_of(plate) if attempt.state is PrintState.DONE]
    return done[-1].verdict if done else None


def _plate_view(scene: Scene, plate: Plate) -> api.PlateStatus:
    own = [p for p in scene.books.prints_of(plate) if p.plate == plate.id]  # not of what it was made of
    return api.PlateStatus(
        id=plate.id,
        parts=list(plate.parts),
        printer=own[-1].printer if own else plate.printer,
        gcode=str(scene.state.files / plate.gcode),
        estimated_s=plate.estimated_s,
        grams=plate.grams,
        filament_mm=plate.filament_mm,
        price=plate.price,
        cached=plate.cached,
        warnings=list(plate.warnings),
        printing=any(not attempt.state.ended for attempt in scene.books.prints_of(plate)),
        hold=plate.hold,
    )


def _progress(scene: Scene, attempt: Print) -> api.PrintProgress:
    plate = scene.books.plates[attempt.plate]
    remaining_s = _print_remaining_s(scene, attempt, plate)
    said = _said(scene, attempt)
    return api.PrintProgress(
        job=attempt.job,
        plate=attempt.plate,
        state=attempt.state,
        progress=min(1.0, max(0.0, 1 - remaining_s / plate.estimated_s)),
        remaining_s=remaining_s,
        layer=said.layer if said else None,
        layers=plate.layers,
        z_mm=said.z_mm if said else None,
        feature=said.feature if said else None,
        pause_ends=scene.moment(said.pause_ends_s if said else None),
    )


def _printer_state(entry: Printer, snapshot: AgentSnapshot, attempt: Print | None, enabled: bool) -> str:
    if not enabled:
        return "disabled"
    if attempt is not None:
        return str(attempt.state)
    if entry.maintenance is not None:
        return "maintenance"
    if entry.look is not None and snapshot.link is not Link.ABSENT:
        return "look"
    return "idle" if snapshot.link is Link.READY else str(snapshot.link)
