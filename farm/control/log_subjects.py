"""Subjects of an event, for the fields of its line in the log. Pure."""

from __future__ import annotations

from farm.model import Key
from farm.state import Books
from farm.state import events as ev


def find_subjects(event: object, books: Books) -> dict[str, object]:
    """Find the job, plate, printer and person of an event, by the names of its fields.

    Parameters
    ----------
    event
        Event of `farm.state.events`.
    books
        Has the prints that events name by their ids.

    Returns
    -------
    dict of str to object
        Those that are known, by the names in `log_format.SUBJECTS`.
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
