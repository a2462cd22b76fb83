"""Timeline of a planned job: the actual or forecast times and printers of its plates. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from farm import api
from farm.errors import RefusedError
from farm.model import Job, Plate
from farm.scheduling import Forecast, Situation, Slot, describe_plates, forecast_prints
from farm.state import Books, PlateState
from farm.views.context import ViewContext
from farm.views.jobs.description import sum_prices


def describe_timeline(context: ViewContext, job_id: int, situation: Situation) -> api.Timeline:
    """Describe the times and printers of a job's plates: actual if they have started, otherwise forecast.

    The forecast is for the plates of all jobs, as in `farm status`; the lower bound is for this job alone.
    The forecast assumes that a held or paused job continues now.

    Parameters
    ----------
    context
        Current data of the farm.
    job_id
        Id of the job.
    situation
        Situation for the forecast, with the waiting plates of all jobs.

    Raises
    ------
    NotFoundError
        If there is no such job.
    RefusedError
        If the job has no plan.
    """
    books = context.books
    job = books.get_job(job_id)
    if not job.plates:
        raise RefusedError(f"job {job_id} has no plan yet: it is {job.state}")
    plates = {plate.id: plate for plate in books.list_plates(job)}
    forecast, bound_s = _forecast_job(job, plates.values(), situation, books)
    expected_slots = [slot for slot in forecast.slots if slot.plate in plates]
    slots = [*_list_started_slots(plates.values(), books), *expected_slots]
    slots.sort(key=lambda slot: (slot.start_s, slot.printer))
    begin_s = min((slot.start_s for slot in slots), default=context.now_s)
    end_s = max((slot.end_s for slot in slots), default=context.now_s)
    return api.Timeline(
        job=job.id,
        now=context.format_time(context.now_s) or "",
        plan=job.plan or "",
        slots=[_make_slot_view(slot, plates[slot.plate], context) for slot in slots],
        left=[plates[plate].name for plate in forecast.unprintable_plates if plate in plates],
        notices=list(job.repairs),
        makespan_s=end_s - begin_s,
        lower_bound_s=max(0.0, min(bound_s, end_s) - begin_s),
        grams=sum(plate.grams for plate in plates.values()),
        price=sum_prices(plates.values()),
        currency=context.fleet.fleet.currency,
    )


def _forecast_job(
    job: Job, plates: Iterable[Plate], situation: Situation, books: Books
) -> tuple[Forecast, float]:
    """Forecast the prints of all jobs; also return the lower bound of the end of one job alone."""
    waiting_plates = (plate for plate in plates if books.find_plate_state(plate) is PlateState.WAITING)
    own_plates = tuple(describe_plates(waiting_plates, books))
    other_plates = tuple(plate for plate in situation.waiting_plates if plate.job != job.id)
    forecast = forecast_prints(
        situation.with_waiting_plates((*other_plates, *own_plates)), include_bound=False
    )
    return forecast, forecast_prints(situation.with_waiting_plates(own_plates)).lower_bound_s


def _list_started_slots(plates: Iterable[Plate], books: Books) -> Iterator[Slot]:
    """Yield the times of all prints of plates; an open print lasts until its expected end."""
    for plate in plates:
        for attempt in books.list_prints(plate):
            factors = books.get_printer(attempt.printer).time_factors
            start_s = attempt.started_s if attempt.started_s is not None else attempt.assigned_s
            end_s = attempt.ended_s
            if end_s is None:
                end_s = start_s + plate.compute_expected_s(factors)
            yield Slot(plate.id, attempt.printer, start_s, end_s)


def _make_slot_view(slot: Slot, plate: Plate, context: ViewContext) -> api.SlotView:
    return api.SlotView(
        plate=slot.plate,
        parts=list(plate.parts),
        printer=slot.printer,
        starts=context.format_time(slot.start_s) or "",
        ends=context.format_time(slot.end_s) or "",
        grams=plate.grams,
        price=plate.price,
    )
