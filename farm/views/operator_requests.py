"""Tasks that jobs wait for: approval, filament, and parts stopped by `farm estop`. Pure."""

from __future__ import annotations

from farm import api
from farm.model import JobState
from farm.state.books import Books
from farm.state.plate_state import stopped_print
from farm.text import format_count, format_mass


def list_requests(books: Books) -> list[api.Todo]:
    """List plans to approve, reels to change and reels to weigh; each once."""
    found = []
    restored = [job.id for job in books.jobs.values() if job.state is JobState.HELD and job.restored]
    if restored:
        jobs = f"job{'s' * (len(restored) > 1)} {' '.join(map(str, restored))}"
        text = (
            f"the database was restored from a backup: check which parts of {jobs} were printed since, "
            "`farm cancel JOB/PART` those, then `farm approve JOB`"
        )
        found.append(api.Todo(code="restored", printers=[], text=text))
    for job in books.jobs.values():
        if job.state is JobState.HELD and not job.options.dry_run:
            grams = sum(plate.grams for plate in books.plates_of(job))
            what = f"job {job.id} ({format_count(len(job.parts), 'part')}, {format_mass(grams)})"
            text = f"approve {what}: `farm approve {job.id}`"
            found.append(api.Todo(code="approve", printers=[], text=text, brief=what))
    found += _stopped(books)
    short: dict[str, str] = {}  # the next plate of each reel
    for plate in books.waiting_plates():
        if plate.hold is not None and plate.hold.reel is not None:
            short.setdefault(plate.hold.reel.printer, plate.hold.reel.text)
    for name, what in sorted(short.items()):
        text = f"{what}: load a reel, then `farm load {name}`"
        found.append(api.Todo(code="reel", printers=[name], text=text, brief=what))
    doubtful = [name for name, printer in books.printers.items() if printer.reel and printer.reel.doubted]
    if doubtful:
        names = " ".join(doubtful)
        text = f"weigh the reels of {names} (the database was restored), then `farm load PRINTER --grams G`"
        found.append(api.Todo(code="reel", printers=doubtful, text=text, brief=f"weigh {names}"))
    return found


def _stopped(books: Books) -> list[api.Todo]:
    """Jobs with parts that `farm estop` stopped, and which wait for a person's word."""
    parts: dict[int, list[str]] = {}
    for plate in books.waiting_plates():
        if stopped_print(plate, books.prints_of(plate)) is not None:
            parts.setdefault(plate.job, []).extend(plate.parts)
    found = []
    for job, names in parts.items():
        what = f"{format_count(len(names), 'part')} of job {job}"
        words = f"print them again with `farm resume {job}`, or give one up with `farm cancel JOB/PART`"
        if len(names) == 1:
            what = f"part {names[0]}"
            words = (
                f"print it again with `farm resume {names[0]}`, or give it up with `farm cancel {names[0]}`"
            )
        text = f"{what} stopped by `farm estop`: {words}"
        found.append(api.Todo(code="stopped", printers=[], text=text, brief=what))
    return found
