"""Books restored from a copy take over what an agent's journal says was printed since. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from farm.model import AgentPrint, AgentSnapshot, Plate, PrintState
from farm.state import events as ev
from farm.state.books import Books
from farm.state.plate_state import PlateState
from farm.state.reconcile import CLOCKS_APART_S, reconcile
from farm.state.transitions import apply


def import_agent_journal(
    books: Books, snapshot: AgentSnapshot, prints: Sequence[AgentPrint], now_s: float
) -> Iterator[ev.AnyEvent]:
    """Derive what has happened on a printer since its books were copied.

    Parameters
    ----------
    snapshot
        Its agent's latest word.
    prints
        All that had not ended when the books were copied, in order. Only the last can be open, and none is
        another printer's: what is said otherwise is held for a person.
    now_s
        Farm time.
    """
    name, unknown = snapshot.printer, 0

    def applied(events: Iterable[ev.AnyEvent]) -> Iterator[ev.AnyEvent]:
        nonlocal books
        for event in events:
            books, _ = apply(event, books)
            yield event

    left = books.open_print_on(name)
    if left is not None and left.id not in {said.print_id for said in prints}:
        yield from applied(reconcile(left, snapshot.model_copy(update={"print": None}), now_s))
    for said in prints:
        attempt = books.prints.get(said.print_id)
        if attempt is None or attempt.printer != name:
            free = attempt is None and books.open_print_on(name) is None
            plate = find_plate(books, name, said) if free else None
            if plate is None:
                unknown += said.state is PrintState.DONE or not said.state.ended
                continue
            found = ev.PrintFound(
                at_s=said.started_s or now_s, plate=plate.id, printer=name, print_id=said.print_id
            )
            yield from applied([found])
            attempt = books.prints[said.print_id]
        if not attempt.state.ended:
            yield from applied(reconcile(attempt, snapshot.model_copy(update={"print": said}), now_s))
    yield ev.AgentJournalImported(at_s=now_s, printer=name, unknown=unknown)


def find_plate(books: Books, printer: str, said: AgentPrint) -> Plate | None:
    """Find the plate of a print that the books do not know: one of its very file that is not printed.

    Plates of one file are alike: one that waits is taken first, or one that was planned for this printer. A
    print that began before a job was planned is none of its.
    """
    if said.sha256 is None or said.started_s is None:
        return None
    alike = [
        plate
        for job in books.jobs.values()
        if job.planned_s is not None and job.planned_s <= said.started_s + CLOCKS_APART_S
        for plate in books.plates_of(job)
        if plate.sha256 == said.sha256 and (_waits(books, plate) or _waited(books, plate))
    ]
    return min(alike, key=lambda p: (not _waits(books, p), p.printer != printer), default=None)


def _waits(books: Books, plate: Plate) -> bool:
    return books.plate_state(plate) is PlateState.WAITING


def _waited(books: Books, plate: Plate) -> bool:
    """Tell whether a plate may wait again: no agent has confirmed yet that its open prints still are."""
    still = [attempt.restored for attempt in books.prints_of(plate) if not attempt.state.ended]
    return books.plate_state(plate) is PlateState.PRINTING and all(still)
