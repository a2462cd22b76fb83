"""What jobs ask of a person before they go on: approval, and filament. Pure."""

from __future__ import annotations

from farm import api
from farm.model import HoldCode, JobState
from farm.tracking.books import Books


def asks(books: Books) -> list[api.Todo]:
    """Plans to be approved, reels that are too short for what waits, and reels to be weighed; each once."""
    found = []
    for job in books.jobs.values():
        if job.state is JobState.HELD and not job.options.dry_run:
            grams = sum(plate.grams for plate in books.plates_of(job))
            what = f"job {job.id} ({len(job.parts)} parts, {grams / 1000:.2g} kg)"
            text = f"approve {what}: `farm approve {job.id}`"
            found.append(api.Todo(code="approve", printers=[], text=text, brief=what))
    holds = (plate.hold for plate in books.waiting_plates())
    short = {hold.text for hold in holds if hold is not None and hold.code is HoldCode.REEL_TOO_SHORT}
    found += [
        api.Todo(code="reel", printers=[], text=text, brief=text.partition(":")[0]) for text in sorted(short)
    ]
    doubtful = [name for name, printer in books.printers.items() if printer.reel and printer.reel.doubted]
    if doubtful:
        names = " ".join(doubtful)
        text = f"weigh the reels of {names} (the books are a copy), then `farm load PRINTER --grams G`"
        found.append(api.Todo(code="reel", printers=doubtful, text=text, brief=f"weigh {names}"))
    return found
