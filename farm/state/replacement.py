"""Plates made otherwise than they were planned, in place of one that waits. Pure."""

from __future__ import annotations

from farm.model import JobState
from farm.state import events as ev
from farm.state.books import Books, edited, put
from farm.state.consequences import Result
from farm.state.plate_state import PlateState


def replace_plate(event: ev.PlateReplaced, books: Books) -> Result:
    """Book the new plates, which go on with the old one's prints; nothing where it does not wait any more."""
    plate = books.plates[event.plate]
    job = books.job(plate.job)
    waits = plate.id in job.plates and books.plate_state(plate) is PlateState.WAITING
    if job.state is not JobState.PRINTING or not waits:
        return books, ()
    kept = {"prints": plate.prints, "counted_from": plate.counted_from, "paused": plate.paused}
    plates = [edited(new, **kept) for new in event.plates]
    names = tuple(new.id for new in plates)
    old = edited(plate, replaced_by=names, hold=None)
    job = edited(
        job,
        plates=_instead(job.plates, (plate.id,), names),
        parts=_instead(job.parts, plate.parts, tuple(part.id for part in event.parts)),
        picture=event.picture or job.picture,
        assembly=event.assembly or job.assembly,
        cuts={**job.cuts, plate.parts[0]: event.decomposition} if event.decomposition else job.cuts,
    )
    return put(books, old, job, *plates, *event.parts), (ev.NameFiles(job=job.id),)


def _instead(names: tuple[str, ...], old: tuple[str, ...], new: tuple[str, ...]) -> tuple[str, ...]:
    """The names with the new ones where the old ones were."""
    at = names.index(old[0])
    kept = tuple(name for name in names if name not in old)
    return (*kept[:at], *new, *kept[at:])
