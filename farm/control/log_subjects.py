"""Log lines of events, with the job, plate, printer and person of each event as fields."""

from __future__ import annotations

from logging import Logger

from farm.model import Key
from farm.state import Books
from farm.state import events as ev


def log_event(log: Logger, event: ev.AnyEvent, books: Books) -> None:
    """Write an event to the log, after it has been applied to `books`."""
    fields = event.model_dump_json(exclude={"at_s"}, exclude_none=True)
    log.info("%s %s", type(event).__name__, fields, extra=find_subjects(event, books))


def find_subjects(event: object, books: Books) -> dict[str, object]:
    """Find the job, plate, printer and person of an event from the fields of the event.

    Parameters
    ----------
    event
        Event of `farm.state.events`.
    books
        The books, which contain the prints that events name by id.

    Returns
    -------
    dict of str to object
        The subjects that are known, by their names in `log_format.SUBJECTS`.
    """
    job, plate, printer, user = (getattr(event, name, None) for name in ("job", "plate", "printer", "by"))
    if (attempt := books.prints.get(getattr(event, "print_id", ""))) is not None:
        job, plate, printer = attempt.job, attempt.plate, attempt.printer
    if isinstance(event, ev.JobSubmitted):
        job, user = event.job.id, event.job.submitted_by
    if job is None and isinstance(plate, str):
        job = int(plate.partition("/")[0])
    for key in (getattr(event, name, None) for name in ("key", "session")):
        if isinstance(key, Key):
            user = key.by
    subjects = {"job": job, "plate": plate, "printer": printer, "who": user}
    return {name: subject for name, subject in subjects.items() if subject is not None}
