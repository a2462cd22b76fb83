"""How events change the books. Pure.

``apply(event, books)`` gives new books and the instructions that follow; a refused event leaves no trace.
"""

from __future__ import annotations

from functools import singledispatch

from drivers.errors import Fault
from farm.errors import ErrorCode
from farm.model import (
    Bed,
    FilamentState,
    Hold,
    HoldCode,
    JobState,
    Print,
    Printer,
    PrintState,
    Verdict,
)
from farm.state import events as ev
from farm.state.books import Books, edited, put
from farm.state.consequences import (
    Result,
    cancel_plate,
    end_job,
    mark_bed_not_clear,
    mark_printer_lost,
    request_cancel,
    shift_print_times,
    update_job_state,
)
from farm.state.faults import LOSSES, UNCHARGED, OwnFault
from farm.state.plate_state import PlateState, successful_print
from farm.state.recovery import restore
from farm.state.reels import subtract_grams, used_grams
from farm.state.replacement import replace_plate
from farm.state.salvaged_parts import book_part_whole
from farm.state.time_factor import update_time_factor


def _approval(job: int) -> Hold:
    text = f"its plan is frozen until `farm approve {job}` releases it"
    return Hold(code=HoldCode.APPROVAL, text=text)


@singledispatch
def apply(event: ev.Event, books: Books) -> Result:
    """New books and what is to be done, after an event.

    Raises
    ------
    NoSuchThing
        Where the event names a job or printer that the books do not have.
    """
    raise TypeError(f"no rule for {type(event).__name__}")


@apply.register
def _(event: ev.PrinterAdded, books: Books) -> Result:
    if event.name in books.printers:
        return books, ()
    return put(books, Printer(name=event.name, bed=event.bed)), ()


@apply.register
def _(event: ev.ClockSet, books: Books) -> Result:
    return shift_print_times(books, event.by_s), ()


@apply.register
def _(event: ev.JobSubmitted, books: Books) -> Result:
    return put(books, event.job), ()


@apply.register
def _(event: ev.JobHeld, books: Books) -> Result:
    return put(books, edited(books.job(event.job), hold=event.hold)), ()


@apply.register
def _(event: ev.PlanningStarted, books: Books) -> Result:
    return put(books, edited(books.job(event.job), state=JobState.PLANNING, hold=None)), ()


@apply.register
def _(event: ev.PlanningAbandoned, books: Books) -> Result:
    job = books.job(event.job)
    if job.state is not JobState.PLANNING:
        return books, ()
    return put(books, edited(job, state=JobState.QUEUED, hold=event.hold)), ()


@apply.register
def _(event: ev.JobPlanned, books: Books) -> Result:
    job = books.job(event.job)
    if job.state is not JobState.PLANNING:  # cancelled meanwhile
        return books, ()
    job = edited(
        job,
        state=JobState.HELD if event.held else JobState.PRINTING,
        parts=tuple(part.id for part in event.parts),
        plates=tuple(plate.id for plate in event.plates),
        repairs=event.repairs,
        scale=event.scale,
        serial_s=event.serial_s,
        estimated_s=event.estimated_s,
        lower_bound_s=event.lower_bound_s,
        plan=event.plan,
        picture=event.picture,
        assembly=event.assembly,
        decomposition=event.decomposition,
        planned_s=event.at_s,
        hold=(restore.HOLD if job.restored else _approval(job.id)) if event.held else None,
    )
    return put(books, job, *event.parts, *event.plates), (ev.NameFiles(job=job.id),)


@apply.register
def _(event: ev.JobApproved, books: Books) -> Result:
    job = books.job(event.job)
    if job.state is not JobState.HELD:
        return books, ()
    return update_job_state(
        put(books, edited(job, state=JobState.PRINTING, hold=None)), job.id, event.at_s
    ), ()


@apply.register
def _(event: ev.JobFailed, books: Books) -> Result:
    return end_job(books, event.job, JobState.FAILED, event.at_s, event.error, event.reason)


@apply.register
def _(event: ev.JobCancelled, books: Books) -> Result:
    planning = books.job(event.job).state is JobState.PLANNING
    books, instructions = end_job(
        books, event.job, JobState.CANCELLED, event.at_s, ErrorCode.CANCELLED, f"cancelled by {event.by}"
    )
    return books, (ev.StopPlanning(job=event.job), *instructions) if planning else instructions


@apply.register
def _(event: ev.PlateAssigned, books: Books) -> Result:
    plate = books.plates[event.plate]
    printer = books.printer(event.printer)
    if books.open_print_on(printer.name) is not None:
        raise ValueError(f"{printer.name} is booked already")
    if plate.replaced_by:
        raise ValueError(f"{plate.id} is not printed any more")
    if printer.bed is not Bed.CLEAR:
        raise ValueError(f"the bed of {printer.name} is not known to be clear")
    attempt = Print(
        id=event.print_id,
        plate=plate.id,
        job=plate.job,
        printer=printer.name,
        number=books.next_number,
        assigned_s=event.at_s,
    )
    plate = edited(plate, prints=(*plate.prints, attempt.id), hold=None)
    return put(books, plate, attempt), (ev.SendStart(print_id=attempt.id, printer=printer.name),)


@apply.register
def _(event: ev.PlatesHeld, books: Books) -> Result:
    held = (edited(books.plates[name], hold=hold) for name, hold in event.holds.items())
    return put(books, *held), ()


@apply.register
def _(event: ev.PlateReplaced, books: Books) -> Result:
    return replace_plate(event, books)


@apply.register
def _(event: ev.PrintProgressed, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    if attempt.state.ended:
        return books, ()
    started_s = attempt.started_s if attempt.started_s is not None else event.started_s
    extruded = attempt.extruded or event.extruded
    paused = attempt.paused or event.state is PrintState.PAUSED
    attempt = edited(
        attempt, state=event.state, started_s=started_s, extruded=extruded, paused=paused, restored=False
    )
    books = put(books, attempt)
    return (mark_bed_not_clear(books, attempt.printer) if extruded else books), ()


@apply.register
def _(event: ev.PrintWithdrawn, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    if attempt.state is not PrintState.ASSIGNED or attempt.cancel_reason is not None:
        return books, ()
    stopped, stop = request_cancel(attempt, event.reason)
    return put(books, stopped), (stop,)


@apply.register
def _(event: ev.PauseRequested, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    if attempt.state.ended or attempt.cancel_reason is not None:
        return books, ()
    send = ev.SendPause(print_id=attempt.id, printer=attempt.printer, wanted=event.wanted)
    return put(books, edited(attempt, pause_requested=event.wanted)), (send,)


@apply.register
def _(event: ev.PrintEnded, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    forget = ev.SendForget(print_id=attempt.id, printer=attempt.printer)
    if attempt.state.ended:
        return books, (forget,)
    state = event.state
    fault, reason = event.fault, event.reason
    # It may well have been done, or ended by a person whose word these books have not.
    unknown = attempt.restored and (fault == OwnFault.PRINT_LOST or state is PrintState.CANCELLED)
    begun = attempt.state is not PrintState.ASSIGNED or event.started_s is not None
    if state is PrintState.CANCELLED and attempt.fail_reason is not None:
        state, fault, reason = PrintState.FAILED, OwnFault.BY_A_PERSON, attempt.fail_reason
    elif state is PrintState.CANCELLED and attempt.cancel_reason is None and begun:
        state = PrintState.FAILED  # nobody here asked for it
    if state is PrintState.DONE and attempt.fail_reason is not None:  # it ended before it was told
        attempt = edited(attempt, verdict=Verdict.BAD, verdict_why=attempt.fail_reason)
    attempt = edited(
        attempt,
        state=state,
        fault=fault,
        reason=reason,
        charged=not unknown and attempt.cancel_reason is None and fault not in UNCHARGED,
        started_s=attempt.started_s if attempt.started_s is not None else event.started_s,
        ended_s=event.ended_s,
        extruded=attempt.extruded or event.extruded,
        starved_s=event.starved_s,
    )
    grams = used_grams(books.plates[attempt.plate], state, attempt.extruded, event.printed_share)
    attempt = edited(attempt, grams=grams)
    printer = books.printer(attempt.printer)
    printer = edited(printer, filament=event.filament, reel=subtract_grams(printer.reel, grams))
    if state is PrintState.DONE and attempt.started_s is not None and not attempt.paused:
        plate = books.plates[attempt.plate]
        reached_s = event.ended_s - attempt.started_s - plate.prelude_s
        factor = update_time_factor(printer.time_factor, plate.print_time_s, reached_s, event.starved_s)
        printer = edited(printer, time_factor=factor)
    if state is PrintState.FAILED and fault == Fault.ESTOP:  # what a person stopped waits for their word
        books = put(books, edited(books.plates[attempt.plate], paused=True))
    if state is PrintState.FAILED:
        printer = edited(
            printer, attention_reason=reason or fault or "its print failed", attention_since_s=event.ended_s
        )
    books = put(books, attempt, printer)
    # A print that failed may have extruded without anybody having seen it.
    if attempt.extruded or state is PrintState.FAILED:
        books = mark_bed_not_clear(books, attempt.printer)
    books = update_job_state(books, attempt.job, event.at_s)
    if state is PrintState.FAILED and fault in LOSSES and not unknown:
        books = mark_printer_lost(books, attempt.printer, event.ended_s, event.at_s)
    return books, (forget,)


@apply.register
def _(event: ev.BedCleared, books: Books) -> Result:
    printer = books.printer(event.printer)
    if books.open_print_on(printer.name) is not None:
        raise ValueError(f"{printer.name} is printing")
    filament = event.filament or printer.filament
    judged = books.print_to_judge(printer.name)
    books = put(books, edited(printer, bed=Bed.CLEAR, attention_reason=None, alarm=None, filament=filament))
    if judged is not None:
        books = put(books, edited(judged, verdict=event.verdict, verdict_why=event.why))
        books = update_job_state(books, judged.job, event.at_s)
    if event.verdict is Verdict.GOOD:
        for earlier in list(books.unjudged_restored_prints(printer.name)):
            books = update_job_state(
                put(books, edited(earlier, verdict=Verdict.GOOD)), earlier.job, event.at_s
            )
    stops: tuple[ev.AnyInstruction, ...] = ()
    if event.whole is not None:
        books, stops = book_part_whole(books, event.whole, event.by, event.at_s)
    return books, (*stops, ev.SendCleared(printer=printer.name, filament=event.filament))


@apply.register
def _(event: ev.PrintFailRequested, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    if attempt.state.ended or attempt.cancel_reason is not None:
        return books, ()
    stopped, stop = request_cancel(edited(attempt, fail_reason=event.why), event.why)
    return put(books, stopped), (stop,)


@apply.register
def _(event: ev.PlatePaused, books: Books) -> Result:
    plate = books.plates[event.plate]
    if books.plate_state(plate) is not PlateState.WAITING:
        return books, ()
    return put(books, edited(plate, paused=event.wanted)), ()


@apply.register
def _(event: ev.PlateCancelled, books: Books) -> Result:
    plate = books.plates[event.plate]
    books, stops = cancel_plate(books, plate, f"cancelled by {event.by}")
    return update_job_state(books, plate.job, event.at_s), stops


@apply.register
def _(event: ev.ReprintRequested, books: Books) -> Result:
    plate = books.plates[event.plate]
    done = successful_print(books.prints_of(plate))
    if done is not None:
        books = put(books, edited(done, verdict=Verdict.BAD, verdict_why=event.why))
    books = put(books, edited(plate, cancelled=False, paused=False, counted_from=len(plate.prints)))
    return update_job_state(books, plate.job, event.at_s, again=True), ()


@apply.register
def _(event: ev.JobPaused, books: Books) -> Result:
    job = books.job(event.job)
    books = put(books, edited(job, paused=event.wanted))
    if not event.wanted:
        books = put(books, *(edited(plate, paused=False) for plate in books.plates_of(job)))
    instructions: list[ev.AnyInstruction] = []
    for attempt in list(books.open_prints(event.job)):
        books, sends = apply(
            ev.PauseRequested(at_s=event.at_s, print_id=attempt.id, wanted=event.wanted), books
        )
        instructions += sends
    return books, tuple(instructions)


@apply.register
def _(event: ev.MaintenanceStarted, books: Books) -> Result:
    return put(books, edited(books.printer(event.printer), maintenance=event.why)), ()


@apply.register
def _(event: ev.MaintenanceEnded, books: Books) -> Result:
    return put(books, edited(books.printer(event.printer), maintenance=None, attention_reason=None)), ()


@apply.register
def _(event: ev.PrinterLost, books: Books) -> Result:
    return mark_printer_lost(books, event.printer, event.at_s, event.at_s), ()


@apply.register
def _(event: ev.OutageConfirmed, books: Books) -> Result:
    outage = books.outage
    return (books if outage is None else put(books, edited(outage, confirmed_s=event.at_s))), ()


@apply.register
def _(event: ev.BooksRestored, books: Books) -> Result:
    return restore.restore_books(event, books), ()


@apply.register
def _(event: ev.PrintFound, books: Books) -> Result:
    return restore.book_found_print(event, books), ()


@apply.register
def _(event: ev.AgentJournalImported, books: Books) -> Result:
    return restore.finish_journal_import(event, books), ()


@apply.register
def _(event: ev.ReelLoaded, books: Books) -> Result:
    return put(books, edited(books.printer(event.printer), reel=event.reel)), ()


@apply.register
def _(event: ev.BedReported, books: Books) -> Result:
    printer = books.printer(event.printer)
    bed = event.bed if printer.bed is Bed.UNKNOWN else printer.bed
    filament = event.filament if printer.filament is FilamentState.UNKNOWN else printer.filament
    return put(books, edited(printer, bed=bed, filament=filament)), ()


@apply.register
def _(event: ev.PrinterAlarmed, books: Books) -> Result:
    printer = books.printer(event.printer)
    alarmed = edited(
        printer,
        alarm=event.reason,
        alarm_s=event.at_s,
        attention_reason=event.reason,
        attention_since_s=event.at_s,
    )
    return put(books, alarmed), ()


@apply.register
def _(event: ev.BedBecameUnknown, books: Books) -> Result:
    printer = books.printer(event.printer)
    unknown = edited(printer, bed=Bed.UNKNOWN, filament=FilamentState.UNKNOWN)
    doubted = edited(unknown, attention_reason=event.reason, attention_since_s=event.at_s)
    return put(books, doubted), ()
