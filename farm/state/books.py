"""Books: the jobs, parts, plates, prints, printers, outages and keys of a farm. Pure.

Books are immutable: `put` returns new books, which share the unchanged entities with the old ones. So the
store finds the changed entities by identity.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, compress, islice
from operator import is_, is_not
from typing import TypeVar

from farm.errors import NotFoundError
from farm.model import (
    Entity,
    Job,
    JobState,
    Key,
    Outage,
    Part,
    Plate,
    Print,
    Printer,
    PrintState,
)
from farm.state.outage import OUTAGE_WINDOW_S
from farm.state.plate_state import PlateState, derive_plate_state

E = TypeVar("E", bound=Entity)


@dataclass(frozen=True, slots=True)
class Books:
    """State of the farm: its entities by id. Immutable."""

    jobs: Mapping[int, Job] = field(default_factory=dict)
    parts: Mapping[str, Part] = field(default_factory=dict)
    plates: Mapping[str, Plate] = field(default_factory=dict)
    prints: Mapping[str, Print] = field(default_factory=dict)
    printers: Mapping[str, Printer] = field(default_factory=dict)
    outages: Mapping[int, Outage] = field(default_factory=dict)
    keys: Mapping[str, Key] = field(default_factory=dict)
    outage_window_s: float = OUTAGE_WINDOW_S  # depends on the scale of the farm's clock
    # Indices, which `put` updates: open prints by id and by printer, and the last ended print by printer.
    _open_prints: Mapping[str, Print] = field(default_factory=dict, compare=False)
    _open_prints_by_printer: Mapping[str, Print] = field(default_factory=dict, compare=False)
    _last_prints: Mapping[str, Print] = field(default_factory=dict, compare=False)
    # An object for each job, which is replaced when the job changes.
    _job_versions: Mapping[int, object] = field(default_factory=dict, compare=False)

    @classmethod
    def from_entities(cls, entities: Iterable[Entity]) -> Books:
        """Create books from entities."""
        return put(cls(), *entities)

    @property
    def outage(self) -> Outage | None:
        """Outage that no person has confirmed yet; None if there is none."""
        return next((o for o in self.outages.values() if o.confirmed_s is None), None)

    @property
    def lost_hosts(self) -> frozenset[str]:
        """Hosts that are recorded as lost."""
        losses = (printer.host_loss for printer in self.printers.values())
        return frozenset(loss.host for loss in losses if loss is not None)

    def get_job(self, job_id: int) -> Job:
        try:
            return self.jobs[job_id]
        except KeyError:
            raise NotFoundError(f"there is no job {job_id}; `farm status` lists them") from None

    def find_job_version(self, job_id: int) -> object:
        """Return an object that is replaced when the job or one of its parts, plates or prints changes."""
        return self._job_versions.get(job_id)

    def get_printer(self, name: str) -> Printer:
        try:
            return self.printers[name]
        except KeyError:
            names = ", ".join(sorted(self.printers)) or "none"
            raise NotFoundError(f"there is no printer {name}; the fleet has {names}") from None

    def get_key(self, key_id: str) -> Key:
        try:
            return self.keys[key_id]
        except KeyError:
            raise NotFoundError(f"there is no key {key_id}; `farm key` lists them") from None

    def list_prints(self, plate: Plate) -> Iterator[Print]:
        """Yield the prints of a plate, oldest first."""
        return (self.prints[print_id] for print_id in plate.prints)

    def list_job_prints(self, job: Job) -> list[Print]:
        """List the prints of a job's plates, each once: a plate shares its prints with its replacements."""
        return list({p.id: p for plate in self.list_plates(job) for p in self.list_prints(plate)}.values())

    def has_started(self, job_id: int) -> bool:
        """Return whether any plate of a job has ever been assigned to a printer."""
        return any(plate.prints for plate in self.list_plates(self.get_job(job_id)))

    def find_plate_state(self, plate: Plate) -> PlateState:
        """Derive the state of a plate."""
        return derive_plate_state(plate, [self.prints[print_id] for print_id in plate.prints])

    def list_plates(self, job: Job) -> Iterator[Plate]:
        return (self.plates[plate_id] for plate_id in job.plates)

    def list_open_prints(self, job_id: int | None = None) -> Iterator[Print]:
        """Yield the prints that have not ended, of one job or of all jobs."""
        if job_id is None:
            return iter(self._open_prints.values())
        plates = self.list_plates(self.jobs[job_id]) if job_id in self.jobs else ()
        # Replacements of a plate share its prints.
        print_ids = dict.fromkeys(print_id for plate in plates for print_id in plate.prints)
        return (self._open_prints[print_id] for print_id in print_ids if print_id in self._open_prints)

    def find_open_print(self, printer: str) -> Print | None:
        return self._open_prints_by_printer.get(printer)

    def find_print_to_judge(self, printer: str) -> Print | None:
        """Return the last print of a printer if it is done and has no verdict yet; else None."""
        last_print = self._last_prints.get(printer)
        return (
            last_print
            if last_print is not None and last_print.verdict is None and last_print.state is PrintState.DONE
            else None
        )

    def list_unjudged_restored_prints(self, printer: str) -> Iterator[Print]:
        """Yield a printer's prints that were done after the restored backup was made and have no verdict."""
        prints = (p for p in self.prints.values() if p.printer == printer and p.state is PrintState.DONE)
        return (p for p in prints if p.restored and p.verdict is None)

    @property
    def next_print_number(self) -> int:
        """Sequence number of the next print."""
        return len(self.prints) + 1

    def find_last_print(self, printer: str) -> Print | None:
        """Return the last ended print of a printer; None if there is none."""
        return self._last_prints.get(printer)

    def list_waiting_plates(self) -> Iterator[Plate]:
        """Yield the waiting plates of printing jobs, in the order in which the jobs were submitted."""
        printing_jobs = (job for job in self.jobs.values() if job.state is JobState.PRINTING)
        for job in sorted(printing_jobs, key=lambda j: j.id):
            yield from (p for p in self.list_plates(job) if self.find_plate_state(p) is PlateState.WAITING)

    def list_open_jobs(self) -> list[Job]:
        """List the jobs that have not ended, in the order of the queue."""
        return sorted(
            (job for job in self.jobs.values() if not job.state.ended), key=lambda job: job.queue_rank
        )

    def list_unplanned_jobs(self) -> list[Job]:
        """List the jobs in planning, then the queued jobs, each in the order of the queue."""
        jobs = (j for j in self.jobs.values() if j.state in (JobState.QUEUED, JobState.PLANNING))
        return sorted(jobs, key=lambda j: (j.state is not JobState.PLANNING, j.queue_rank))


def replace_fields(entity: E, **changes: object) -> E:
    """Return an entity with some fields replaced; the same object if nothing changes."""
    if all(getattr(entity, name) == value for name, value in changes.items()):
        return entity
    return entity.model_copy(update=changes)


def remove_keys(books: Books, key_ids: Iterable[str]) -> Books:
    """Return the books without the given keys. No other entities are ever removed."""
    removed_ids = set(key_ids)
    if not removed_ids:
        return books
    return replace(books, keys={key.id: key for key in books.keys.values() if key.id not in removed_ids})


def put(books: Books, *entities: Entity) -> Books:
    """Return the books with some entities added, in place of those with the same ids."""
    changed_tables: dict[str, dict[object, Entity]] = {}
    job_versions: dict[int, object] = {}

    def copy_table(table: str) -> dict[object, Entity]:
        return changed_tables.setdefault(table, dict(getattr(books, table)))

    for entity in entities:
        table, key = locate_entity(entity)
        if changed_tables.get(table, getattr(books, table)).get(key) is entity:
            continue
        copy_table(table)[key] = entity
        if isinstance(entity, Job | Part | Plate | Print):
            job_versions[entity.id if isinstance(entity, Job) else entity.job] = object()
        if isinstance(entity, Print) and not entity.state.ended:
            copy_table("_open_prints")[entity.id] = entity
            copy_table("_open_prints_by_printer")[entity.printer] = entity
        elif isinstance(entity, Print):
            copy_table("_open_prints").pop(entity.id, None)
            open_print = copy_table("_open_prints_by_printer").get(entity.printer)
            if isinstance(open_print, Print) and open_print.id == entity.id:
                copy_table("_open_prints_by_printer").pop(entity.printer)
            if _is_last_ended_print(entity, copy_table("_last_prints").get(entity.printer)):
                copy_table("_last_prints")[entity.printer] = entity
    if not changed_tables:
        return books
    if job_versions:
        job_versions = {**books._job_versions, **job_versions}
    return replace(books, **changed_tables, _job_versions=job_versions or books._job_versions)  # type: ignore[arg-type]


def _is_last_ended_print(attempt: Print, last_print: Entity | None) -> bool:
    """Return whether an ended print is the latest of its printer. Prints that never started do not count."""
    if attempt.started_s is None and attempt.state is PrintState.CANCELLED:
        return False
    return not isinstance(last_print, Print) or _make_order_key(attempt) >= _make_order_key(last_print)


def _make_order_key(attempt: Print) -> tuple[int, float]:
    """Return a key that sorts prints by number; old prints, which have no number, by their end."""
    return attempt.number, attempt.ended_s or 0.0


def locate_entity(entity: Entity) -> tuple[str, object]:
    """Return the name of the table in the books that contains an entity, and the entity's key in it."""
    match entity:
        case Job():
            return "jobs", entity.id
        case Part():
            return "parts", entity.id
        case Plate():
            return "plates", entity.id
        case Print():
            return "prints", entity.id
        case Printer():
            return "printers", entity.name
        case Outage():
            return "outages", entity.id
        case Key():
            return "keys", entity.id
    raise TypeError(f"the books contain no {type(entity).__name__}")


def list_changed_entities(old_books: Books, new_books: Books) -> Iterable[Entity]:
    """Yield the entities of the new books that are missing from the old books, or are different there."""
    for table in ("jobs", "parts", "plates", "prints", "printers", "outages", "keys"):
        old_table, new_table = getattr(old_books, table), getattr(new_books, table)
        if new_table is not old_table:
            yield from _list_changes(old_table, new_table)


def _list_changes(old_table: Mapping[object, E], new_table: Mapping[object, E]) -> Iterable[E]:
    """Return the new and replaced entities of a table, quickly if the order is the same, as after `put`."""
    if not all(map(is_, old_table, new_table)):
        return (entity for key, entity in new_table.items() if old_table.get(key) is not entity)
    replaced_entities = compress(new_table.values(), map(is_not, new_table.values(), old_table.values()))
    return chain(replaced_entities, islice(new_table.values(), len(old_table), None))


def list_removed_keys(old_books: Books, new_books: Books) -> Iterable[Key]:
    """Yield the keys of the old books that are missing from the new ones."""
    if new_books.keys is not old_books.keys:
        yield from (key for key in old_books.keys.values() if key.id not in new_books.keys)
