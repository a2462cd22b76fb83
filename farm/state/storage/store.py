"""Books on disk: SQLite in WAL mode, one transaction for each event. No other module imports sqlite3."""

from __future__ import annotations

import os
import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Self, TypeVar

from pydantic import ValidationError

from farm.errors import FarmError
from farm.model import Entity, Key, share_field_set
from farm.state.books import Books, list_changed_entities, list_removed_keys, locate_entity
from farm.state.event_rows import EVENTS_QUERY, PRINTER_QUERY, EventRow, make_row
from farm.state.events import BooksRestored, Event
from farm.state.lifecycles import InvalidTransition
from farm.state.storage.event_count import EventCount
from farm.state.storage.migrations import (
    CHANGED_ROW_QUERY,
    CHECKSUMS_VERSION,
    COPIED_TABLE_STATEMENT,
    EXPECTED_TABLE_STATEMENTS,
    FIRST_VERSIONS,
    MIGRATIONS,
    SCHEMA_VERSION,
    TABLES,
)
from farm.text import describe_first_error

E = TypeVar("E", bound=Entity)


class StoreError(FarmError):
    """Error for books that cannot be opened, read or written."""


class DamagedBooks(StoreError):
    """Error for damaged books on the disk."""


_HISTORY_QUERY = """
    SELECT at_s, kind, json_extract(body, '$.state') FROM event
    WHERE json_extract(body, ?) = ? OR json_extract(body, ?) = ? ORDER BY seq DESC LIMIT 8
"""
"""Query for the last events about an entity; the first event of a job contains the whole job."""
_ENVIRONMENT_ERRORS = frozenset(
    (
        *(sqlite3.SQLITE_PERM, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_NOMEM),
        *(sqlite3.SQLITE_READONLY, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL, sqlite3.SQLITE_CANTOPEN),
    )
)
"""SQLite's errors that the host causes: full disk, permissions, memory, locks. Others mean damaged books."""


def copy_books(source: Path, target: Path, at_s: float) -> None:
    """Copy books, even if they are in use; the target appears once the copy is complete. Raises StoreError.

    The copy contains `at_s`, the time of the copy, until a `BooksRestored` is committed to it. Until then no
    bed counts as clear, even if a person puts the copy in place, or a daemon dies during the restoration.
    """
    partial = target.with_name(f".{target.name}.half")
    try:
        partial.unlink(missing_ok=True)
        with closing(sqlite3.connect(source)) as books, closing(sqlite3.connect(partial)) as copy:
            books.backup(copy)
            # Otherwise a damaged write-ahead log could revert the books to a state before the copy.
            books.execute("PRAGMA wal_checkpoint(PASSIVE)")
            with copy:
                copy.execute(COPIED_TABLE_STATEMENT)
                copy.execute("DELETE FROM copied")
                copy.execute("INSERT INTO copied VALUES (?)", (at_s,))
        with partial.open("rb") as file:
            os.fsync(file.fileno())
        partial.replace(target)
    except (sqlite3.Error, OSError) as error:
        partial.unlink(missing_ok=True)
        raise StoreError(f"the database {source} cannot be copied to {target}: {error}") from error


def read_books(path: Path) -> tuple[Books, int]:
    """Read books without changing them, even while a daemon has them open.

    Returns
    -------
    books, version
        The books, and the schema version of the file.

    Raises
    ------
    DamagedBooks
        If the file is not a database of the farm, or the checksum of a row does not match.
    StoreError
        If the books cannot be read.
    """
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as db:
            db.create_function("crc32", 1, zlib.crc32, deterministic=True)
            (result,) = db.execute("PRAGMA integrity_check(1)").fetchone()
            if result != "ok":
                raise DamagedBooks(f"the database {path} is damaged: {' '.join(result.split())}")
            (version,) = db.execute("PRAGMA user_version").fetchone()
            if version not in MIGRATIONS:
                raise StoreError(f"the database {path} was written by a newer version of farm ({version})")
            kinds = _list_kinds(version) if version >= CHECKSUMS_VERSION else ()
            for table in (TABLES[kind] for kind in kinds):
                changed_row = db.execute(CHANGED_ROW_QUERY.format(table)).fetchone()
                if changed_row is not None:
                    raise DamagedBooks(
                        f"the database {path} is damaged: {table} {changed_row[0]} was changed"
                    )
            return _load_books(db, version), version
    except sqlite3.Error as error:
        raise StoreError(f"the database {path} cannot be read: {error}") from error


def _load_books(db: sqlite3.Connection, version: int = SCHEMA_VERSION) -> Books:
    return Books.from_entities(entity for kind in _list_kinds(version) for entity in _read_rows(db, kind))


def _list_kinds(version: int) -> list[type[Entity]]:
    """List the kinds of entities that have a table in a version of the schema."""
    return [kind for kind in TABLES if FIRST_VERSIONS.get(kind, 0) <= version]


def _read_rows(db: sqlite3.Connection, kind: type[E]) -> list[E]:
    try:
        rows = db.execute(f"SELECT id, body FROM {TABLES[kind]}").fetchall()
    except sqlite3.Error as error:
        raise StoreError(f"the database cannot be read: {error}") from error
    entities = []
    for key, body in rows:
        try:
            entities.append(share_field_set(kind.model_validate_json(body)))
        except ValidationError as error:
            raise StoreError(
                f"the database cannot be read: {TABLES[kind]} {key}, {describe_first_error(error.errors())}; "
                "was it written by another version of farm?"
            ) from error
    return entities


class Store:
    """Database of the books. Every method may raise StoreError.

    Each entity is a row in the table of its kind, with its fields as JSON. The daemon reads all books at its
    start and keeps them in memory, so the tables need no columns for single fields. A field that has its
    default value is not stored; the defaults must therefore never change.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._count = EventCount(path)
        self._last_number: int | None = None  # number of the last event in the current transaction
        self._is_writing = False  # True inside a block of `transaction`
        is_new = not path.exists() or not path.stat().st_size
        _restrict_access(path)
        try:
            self._db = sqlite3.connect(path, isolation_level=None)
            self._db.create_function("crc32", 1, zlib.crc32, deterministic=True)
        except sqlite3.Error as error:
            raise StoreError(f"the database {path} cannot be opened: {error}") from error
        try:
            self._open_database(is_new)
        except BaseException:
            self._db.close()
            raise

    def _open_database(self, is_new: bool) -> None:
        path = self._path
        try:
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = FULL")
            (result,) = self._db.execute("PRAGMA integrity_check(1)").fetchone()
            if result != "ok":
                raise DamagedBooks(f"the database {path} is damaged: {' '.join(result.split())}")
            self._create_or_migrate()
            self._check_rows()
            if is_new:  # the count belongs to former books, which were moved away
                self._count.remove()
            self._has_lost_events = self._find_last_event_number() < self._count.read()
        except (sqlite3.Error, UnicodeDecodeError) as error:  # the error's text may be invalid UTF-8
            is_environment_error = getattr(error, "sqlite_errorcode", 0) & 0xFF in _ENVIRONMENT_ERRORS
            message = f"the database {path} cannot be opened: {error}"
            if is_environment_error:
                raise StoreError(f"{message}; check its disk space and its permissions") from error
            raise DamagedBooks(message) from error
        except OSError as error:
            raise StoreError(f"the database {path} cannot be opened: {error}") from error

    def _create_or_migrate(self) -> None:
        """Create empty books, or migrate those of an earlier version."""
        (version,) = self._db.execute("PRAGMA user_version").fetchone()
        if version not in MIGRATIONS:
            raise StoreError(
                f"the database {self._path} was written by a newer version ({version}): upgrade, or "
                "use another folder with --state"
            )
        self._db.execute("BEGIN IMMEDIATE")
        for statement in MIGRATIONS[version]:
            self._db.execute(statement)
        self._db.execute(COPIED_TABLE_STATEMENT)
        self._db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        self._db.execute("COMMIT")

    def _check_rows(self) -> None:
        """Raise DamagedBooks if a row does not match its checksum: SQLite does not detect changed rows."""
        tables = self._db.execute("SELECT sql FROM sqlite_master WHERE type = 'table'")
        if {sql for (sql,) in tables} != EXPECTED_TABLE_STATEMENTS:
            raise DamagedBooks(f"the database {self._path} is damaged: it has unexpected tables")
        for table in TABLES.values():
            changed_row = self._db.execute(CHANGED_ROW_QUERY.format(table)).fetchone()
            if changed_row is not None:
                raise DamagedBooks(
                    f"the database {self._path} is damaged: {table} {changed_row[0]} was changed"
                )

    def find_last_event_number(self) -> int:
        """Return the number of the last event; 0 if there is none. Raises StoreError."""
        with _convert_read_errors():
            return self._find_last_event_number()

    def _find_last_event_number(self) -> int:
        (number,) = self._db.execute("SELECT coalesce(max(seq), 0) FROM event").fetchone()
        return int(number)

    @property
    def copied_s(self) -> float | None:
        """Time after which events are missing from these books; None if no events are missing.

        Events are missing from a backup, and after lost commits, until a `BooksRestored` is committed.
        Raises StoreError.
        """
        with _convert_read_errors():
            (at_s,) = self._db.execute("SELECT max(at_s) FROM copied").fetchone()
            if at_s is None and self._has_lost_events:
                (at_s,) = self._db.execute("SELECT coalesce(max(at_s), 0) FROM event").fetchone()
        return None if at_s is None else float(at_s)

    def load(self) -> Books:
        """Load the books as last committed. Raises StoreError."""
        return _load_books(self._db)

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Write the commits of a block in one transaction, with one sync to the disk: all of them or none."""
        if self._is_writing:  # the outer block ends the transaction
            yield
            return
        self._is_writing, self._last_number = True, None
        try:
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:  # on a full disk, SQLite itself has rolled back
                    self._db.execute("ROLLBACK")
                raise
        except sqlite3.Error as error:
            raise StoreError(f"the database cannot be written: {error}; nothing was started") from error
        finally:
            self._is_writing = False
        if self._last_number is not None:  # otherwise the block has committed nothing
            self._count.write(self._last_number)

    def commit(self, event: Event, old_books: Books, new_books: Books) -> None:
        """Write an event and the entities that it changed in one transaction, synced to the disk."""
        with self.transaction():
            self._last_number = self._db.execute(
                "INSERT INTO event (at_s, kind, body) VALUES (?, ?, ?)",
                (event.at_s, type(event).__name__, event.model_dump_json()),
            ).lastrowid
            for entity in list_changed_entities(old_books, new_books):
                body = entity.model_dump_json(exclude_defaults=True)
                self._db.execute(
                    f"INSERT OR REPLACE INTO {TABLES[type(entity)]} VALUES (?, ?, ?)",
                    (str(locate_entity(entity)[1]), body, zlib.crc32(body.encode())),
                )
            for key in list_removed_keys(old_books, new_books):
                self._db.execute(f"DELETE FROM {TABLES[Key]} WHERE id = ?", (key.id,))
            if isinstance(event, BooksRestored):
                self._db.execute("DELETE FROM copied")
        if isinstance(event, BooksRestored):
            self._has_lost_events = False

    def read_all_events(self) -> list[tuple[float, str, str]]:
        """Return the event log: farm time, kind and JSON of each event."""
        with _convert_read_errors():
            return self._db.execute("SELECT at_s, kind, body FROM event ORDER BY seq").fetchall()

    def read_events(self, last_number: int, limit: int) -> list[EventRow]:
        """Read the events after a number, oldest first, without confidential fields. Raises StoreError."""
        return self._read_rows(EVENTS_QUERY, last_number, limit)

    def read_printer_events(self, printer: str, limit: int) -> list[EventRow]:
        """Read the maintenance, reels, losses and alarms of a printer, newest first. Raises StoreError."""
        return self._read_rows(PRINTER_QUERY, printer, limit)

    def _read_rows(self, query: str, *values: object) -> list[EventRow]:
        with _convert_read_errors():
            return [make_row(row) for row in self._db.execute(query, values)]

    def find_last_deletable_number(self, cutoff_s: float, limit: int) -> int:
        """Return the number of the last event to delete: it is before `cutoff_s`, or `limit` others follow.

        The newest event is always kept, because its number shows that no commit was lost. Returns 0 if there
        is no event to delete.
        """
        with _convert_read_errors():
            (oldest,) = self._db.execute("SELECT coalesce(min(seq), 0) FROM event").fetchone()
            newest = self._find_last_event_number()
            query = "SELECT min(seq) FROM event WHERE at_s >= ?"
            (first_kept,) = self._db.execute(query, (cutoff_s,)).fetchone()
        last = max(newest if first_kept is None else first_kept - 1, newest - limit)
        last = min(last, newest - 1)
        return int(last) if last >= oldest > 0 else 0

    def count_events(self, last_number: int) -> int:
        """Count the stored events up to an event number."""
        with _convert_read_errors():
            (count,) = self._db.execute(
                "SELECT count(*) FROM event WHERE seq <= ?", (last_number,)
            ).fetchone()
        return int(count)

    def delete_events(self, last_number: int, max_count: int = 2000) -> int:
        """Delete the oldest events up to a number, at most `max_count`; return how many were deleted."""
        try:
            return self._db.execute(
                "DELETE FROM event WHERE seq IN (SELECT seq FROM event WHERE seq <= ? ORDER BY seq LIMIT ?)",
                (last_number, max_count),
            ).rowcount
        except sqlite3.Error as error:
            raise StoreError(f"old events cannot be deleted: {error}") from error

    def release_space(self, min_bytes: int = 16 * 2**20) -> bool:
        """Shrink the database if half of it, at least `min_bytes`, is unused; return whether it shrank."""
        try:
            (page_count,), (unused_page_count,), (page_bytes,) = (
                self._db.execute(f"PRAGMA {name}").fetchone()
                for name in ("page_count", "freelist_count", "page_size")
            )
            if unused_page_count * page_bytes < min_bytes or unused_page_count < page_count // 2:
                return False
            self._db.execute("VACUUM")
            self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        except sqlite3.Error as error:
            raise StoreError(f"the database {self._path} cannot be made smaller: {error}") from error
        return True

    def add_history(self, error: InvalidTransition) -> InvalidTransition:
        """Return the error with the last events about its entity, oldest first."""
        if error.lifecycle is None:
            return error
        path = f"$.{error.lifecycle.key_field}"
        with suppress(sqlite3.Error):  # the error is returned without its history
            rows = self._db.execute(_HISTORY_QUERY, (path, error.key, f"{path}.id", error.key)).fetchall()
            return error.with_history(
                f"{datetime.fromtimestamp(at_s, UTC):%Y-%m-%d %H:%M:%S} {kind}{f' {state}' if state else ''}"
                for at_s, kind, state in reversed(rows)
            )
        return error

    def close(self) -> None:
        self._db.close()
        self._count.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def _convert_read_errors() -> Iterator[None]:
    """Raise SQLite's errors in a block that reads the database as StoreError."""
    try:
        yield
    except sqlite3.Error as error:
        raise StoreError(f"the database cannot be read: {error}") from error


def _restrict_access(path: Path) -> None:
    """Let only the owner read and write a database; SQLite creates the files beside it with the same mode.

    Earlier versions created books that all users could read, in a folder that all users could open.
    """
    with suppress(OSError):  # if the file cannot be created, SQLite reports that
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600))
    for suffix in ("", "-wal", "-shm"):
        with suppress(OSError):  # missing, or owned by another user
            path.with_name(path.name + suffix).chmod(0o600)
