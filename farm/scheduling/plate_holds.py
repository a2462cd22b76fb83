"""Holds of plates that no printer is offered: paused, stopped, out of attempts, in an outage. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from farm.config import PrinterSection
from farm.model import Hold, HoldCode, Job, JobState, Plate
from farm.state.books import Books
from farm.state.faults import LOSSES
from farm.state.plate_state import PlateState, stopped_print


def may_hold_back(books: Books, job: Job) -> bool:
    """Tell whether a printing job itself has something for which a plate is offered to no printer."""
    if job.paused:
        return True
    for plate in books.plates_of(job):
        state = books.plate_state(plate)
        if state is PlateState.OUT_OF_ATTEMPTS:
            return True
        last = books.prints[plate.prints[-1]] if plate.prints else None
        if state is PlateState.WAITING and (plate.paused or (last is not None and last.fault in LOSSES)):
            return True
    return False


def find_plate_holds(
    books: Books,
    printers: Iterable[PrinterSection],
    now_s: float,
    may_hold: Callable[[Books, Job], bool] = may_hold_back,
) -> dict[str, Hold]:
    """Find the plates that are offered to no printer.

    Parameters
    ----------
    books
        All jobs, plates, prints and printers.
    printers
        The printers of `fleet.yaml`.
    now_s
        Farm time, seconds since the epoch.
    may_hold
        `may_hold_back`, or what remembers its answers.

    Returns
    -------
    dict
        The reason of each such plate, by its id.
    """
    held = {}
    unreported = " ".join(
        section.name for section in printers if section.enabled and _has_not_reported(books, section.name)
    )
    everything = books.outage is not None
    for job in books.jobs.values():
        if job.state is not JobState.PRINTING:
            continue
        if not (everything or (unreported and job.restored) or may_hold(books, job)):
            continue
        for plate in books.plates_of(job):
            hold = _find_hold(books, job, plate, unreported if job.restored else "", now_s)
            if hold is not None:
                held[plate.id] = hold
    return held


def _has_not_reported(books: Books, printer: str) -> bool:
    """Tell whether a printer may have printed what restored books take for waiting; not in maintenance."""
    entry = books.printer(printer)
    return entry.unreported_since_s is not None and entry.maintenance is None


def _find_hold(books: Books, job: Job, plate: Plate, unreported: str, now_s: float) -> Hold | None:
    """Find why a plate may start on no printer; `unreported` printers may have printed it already."""
    state = books.plate_state(plate)
    if state is PlateState.OUT_OF_ATTEMPTS:
        text = (
            f"plate {plate.id} failed too often: print it again with `farm reprint {job.id} {plate.parts[0]}`"
        )
        return Hold(code=HoldCode.OUT_OF_ATTEMPTS, text=text)
    if state is not PlateState.WAITING:
        return None
    if books.outage is not None:
        text = (
            f"{' '.join(books.outage.printers)} were lost at the same time: inspect them, then `farm resume`"
        )
        return Hold(code=HoldCode.OUTAGE, text=text)
    if unreported:
        text = (
            f"{unreported} may have printed it since the books were copied: "
            "connect them, or `farm maintenance`"
        )
        return Hold(code=HoldCode.UNTOLD, text=text)
    if job.paused:
        return Hold(code=HoldCode.PAUSED, text=f"job {job.id} is paused: `farm resume {job.id}`")
    part = plate.parts[0]
    if (halted := stopped_print(plate, books.prints_of(plate))) is not None:
        text = f"`farm estop` stopped it on {halted.printer}: `farm resume {part}` prints it again"
        return Hold(code=HoldCode.STOPPED, text=text)
    if plate.paused:
        return Hold(code=HoldCode.PAUSED, text=f"part {part} is paused: `farm resume {part}`")
    last = books.prints[plate.prints[-1]] if plate.prints else None
    lost_s = last.ended_s if last is not None and last.fault in LOSSES else None
    if last is not None and lost_s is not None and abs(now_s - lost_s) <= books.outage_window_s:
        text = f"{last.printer} was lost just now: waiting in case others are lost too"
        return Hold(code=HoldCode.JUST_LOST, text=text)
    return None
