"""The books on disk: SQLite in WAL mode, one transaction an event. The only import of sqlite3."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Self, TypeVar

from pydantic import ValidationError

from farm.errors import FarmError
from farm.model import Entity, Job, Outage, Part, Plate, Print, Printer
from farm.tracking.books import Books, changed
from farm.tracking.events import BooksRestored, Event

E = TypeVar("E", bound=Entity)

SCHEMA = 2
_TABLES: dict[type[Entity], str] = {
    Job: "job",
    Part: "part",
    Plate: "plate",
    Print: "print",
    Printer: "printer",
    Outage: "outage",
}


class StoreError(FarmError):
    """The books cannot be opened or written."""


class DamagedBooks(StoreError):
    """What is on the disk are no books any more."""


_LYING = """
    SELECT json_extract(p.body, '$.id') AS id, json_extract(p.body, '$.job') AS job
    FROM print AS p JOIN printer ON printer.id = json_extract(p.body, '$.printer')
    WHERE json_extract(printer.body, '$.bed') <> 'clear' AND json_extract(p.body, '$.ended_s') = (
        SELECT max(json_extract(q.body, '$.ended_s')) FROM print AS q
        WHERE json_extract(q.body, '$.printer') = printer.id
    )
"""
_FROM_1 = (  # a verdict was the part's, and of no use; it is the print's, and asked for by its bed
    "UPDATE part SET body = json_remove(body, '$.verdict')",
    f"CREATE TEMP TABLE lying AS {_LYING}",
    "UPDATE print SET body = json_set(body, '$.verdict', 'good')"
    " WHERE json_extract(body, '$.state') = 'done' AND id NOT IN (SELECT id FROM lying)",
    "UPDATE job SET body = json_set(body, '$.state', 'done')"
    " WHERE json_extract(body, '$.state') = 'printed' AND CAST(id AS INTEGER) NOT IN (SELECT job FROM lying)",
    "DROP TABLE lying",
)
"""What was taken off its bed before anybody was asked is good; what lies there may still be judged."""
_COPIED = "CREATE TABLE IF NOT EXISTS copied (at_s REAL NOT NULL)"


def copy_books(source: Path, target: Path, at_s: float) -> None:
    """Copy books that may be in use, whole or not at all. Raises StoreError.

    The copy says of itself that it is one, made at `at_s`, until a `BooksRestored` is committed to it: so no
    bed is taken for clear, whoever puts it in the place of the books, and if a daemon dies over it.
    """
    half = target.with_name(f".{target.name}.half")
    try:
        half.unlink(missing_ok=True)
        with closing(sqlite3.connect(source)) as books, closing(sqlite3.connect(half)) as copy:
            books.backup(copy)
            with copy:
                copy.execute(_COPIED)
                copy.execute("DELETE FROM copied")
                copy.execute("INSERT INTO copied VALUES (?)", (at_s,))
        with half.open("rb") as file:
            os.fsync(file.fileno())
        half.replace(target)
    except (sqlite3.Error, OSError) as error:
        half.unlink(missing_ok=True)
        raise StoreError(f"the books {source} cannot be copied to {target}: {error}") from error


class Store:
    """Where the books are kept. Every method may raise StoreError.

    Each entity is a row of its kind's table, with its fields as JSON: the books are read whole at start and
    live in memory, so that nothing but the daemon's own model needs to know them.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._db = sqlite3.connect(path, isolation_level=None)
        except sqlite3.Error as error:
            raise StoreError(f"the books {path} cannot be opened: {error}") from error
        try:
            self._open(path)
        except BaseException:
            self._db.close()
            raise

    def _open(self, path: Path) -> None:
        try:
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = FULL")
            (found,) = self._db.execute("PRAGMA quick_check(1)").fetchone()
            if found != "ok":
                raise DamagedBooks(f"the books {path} are damaged: {' '.join(found.split())}")
            self._create(path)
        except sqlite3.OperationalError as error:  # a full disk, no right to write: nothing is damaged
            raise StoreError(f"the books {path} cannot be opened: {error}") from error
        except sqlite3.DatabaseError as error:
            raise DamagedBooks(f"the books {path} cannot be opened: {error}") from error

    def _create(self, path: Path) -> None:
        (version,) = self._db.execute("PRAGMA user_version").fetchone()
        if version > SCHEMA:
            raise StoreError(
                f"the books {path} are of a newer farm ({version}): upgrade, or use another --state"
            )
        self._db.execute("BEGIN IMMEDIATE")
        if version == 1:
            for statement in _FROM_1:
                self._db.execute(statement)
        for table in _TABLES.values():
            self._db.execute(f"CREATE TABLE IF NOT EXISTS {table} (id TEXT PRIMARY KEY, body TEXT NOT NULL)")
        self._db.execute(
            "CREATE TABLE IF NOT EXISTS event"
            " (seq INTEGER PRIMARY KEY, at_s REAL NOT NULL, kind TEXT NOT NULL, body TEXT NOT NULL)"
        )
        self._db.execute(_COPIED)
        self._db.execute(f"PRAGMA user_version = {SCHEMA}")
        self._db.execute("COMMIT")

    @property
    def copied_s(self) -> float | None:
        """When these books were copied, where they are a copy that nobody has restored yet."""
        (at_s,) = self._db.execute("SELECT max(at_s) FROM copied").fetchone()
        return None if at_s is None else float(at_s)

    def load(self) -> Books:
        """The books as last committed."""
        return Books.of(entity for kind in _TABLES for entity in self._rows(kind))

    def _rows(self, kind: type[E]) -> list[E]:
        try:
            rows = self._db.execute(f"SELECT id, body FROM {_TABLES[kind]}").fetchall()
        except sqlite3.Error as error:
            raise StoreError(f"the books cannot be read: {error}") from error
        entities = []
        for key, body in rows:
            try:
                entities.append(kind.model_validate_json(body))
            except ValidationError as error:
                first = error.errors()[0]
                place = ".".join(map(str, first["loc"]))
                raise StoreError(
                    f"the books cannot be read: {_TABLES[kind]} {key}, {place}: {first['msg']}; "
                    "were they written by another version of farm?"
                ) from error
        return entities

    def commit(self, event: Event, before: Books, after: Books) -> None:
        """Write an event and all that it changed, in one transaction, to the disk itself."""
        try:
            self._db.execute("BEGIN IMMEDIATE")
            try:
                self._db.execute(
                    "INSERT INTO event (at_s, kind, body) VALUES (?, ?, ?)",
                    (event.at_s, type(event).__name__, event.model_dump_json()),
                )
                for entity in changed(before, after):
                    self._db.execute(
                        f"INSERT OR REPLACE INTO {_TABLES[type(entity)]} VALUES (?, ?)",
                        (_key(entity), entity.model_dump_json()),
                    )
                if isinstance(event, BooksRestored):
                    self._db.execute("DELETE FROM copied")
            except BaseException:
                if self._db.in_transaction:  # SQLite rolls back by itself where the disk is full
                    self._db.execute("ROLLBACK")
                raise
            self._db.execute("COMMIT")
        except sqlite3.Error as error:
            raise StoreError(f"the books cannot be written: {error}; nothing was started") from error

    def events(self) -> list[tuple[float, str, str]]:
        """The event log: farm time, name, JSON."""
        return self._db.execute("SELECT at_s, kind, body FROM event ORDER BY seq").fetchall()

    def close(self) -> None:
        self._db.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _key(entity: Entity) -> str:
    match entity:
        case Printer():
            return entity.name
        case Job() | Part() | Plate() | Print() | Outage():
            return str(entity.id)
    raise TypeError(f"the store keeps no {type(entity).__name__}")
