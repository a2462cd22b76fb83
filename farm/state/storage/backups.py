"""Nightly backups of the books, and their restoration if the books are damaged."""

from __future__ import annotations

import asyncio
import logging
import shutil
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime, timedelta, tzinfo
from pathlib import Path

from drivers.clock import Clock
from farm.errors import FarmError
from farm.paths import StateFolder
from farm.state.storage.store import DamagedBooks, Store, StoreError, copy_books
from slicing.cache_limit import trim_cache

log = logging.getLogger(__name__)

BACKUP_COUNT = 7
_MIN_INTERVAL_S = 60.0  # minimum wall seconds between two backups, for fast simulated clocks
_RESERVE_BYTES = 64 * 2**20  # disk space that a backup needs, in addition to two copies of the books
_BACKUP_HOUR = 4  # local time; after the hour in which daylight saving time begins or ends
_NAME_FORMAT = "books-%Y%m%dT%H%M%SZ"
_NAME_PATTERN = f"books-{'[0-9]' * 8}T{'[0-9]' * 6}Z.db"


def back_up(state: StateFolder, now_s: float) -> Path:
    """Back up the books, verify the copy, and delete all but the latest backups. May run in a thread.

    If the disk is too full, the slice cache is emptied first, because slices can be computed again.

    Raises
    ------
    StoreError
        If the books cannot be copied, or the copy cannot be read; earlier backups are kept.
    """
    try:
        state.backups.mkdir(mode=0o700, exist_ok=True)
        free_bytes = shutil.disk_usage(state.root).free
    except OSError as error:
        raise StoreError(f"the database cannot be backed up: {error}") from error
    needed_bytes = 2 * state.books.stat().st_size + _RESERVE_BYTES if state.books.exists() else 0
    if free_bytes < needed_bytes:
        log.warning("the disk is full: the slice cache %s is emptied for the backup", state.slices)
        trim_cache(state.slices, 0)
    target = state.backups / f"{datetime.fromtimestamp(now_s, UTC).strftime(_NAME_FORMAT)}.db"
    copy_books(state.books, target, now_s)
    try:
        with Store(target) as copy:  # checks every page and row
            copy.load()
    except StoreError:
        target.unlink(missing_ok=True)
        raise
    for old_backup in list_backups(state)[BACKUP_COUNT:]:
        old_backup.unlink(missing_ok=True)
    return target


class NightlyBackup:
    """Nightly backup of the books. If one fails, this is reported, and the next one is made the next night.

    Parameters
    ----------
    state, clock, zone
        The state folder, the farm's clock, and the time zone of the nights.
    call_at
        Sets a timer. Arguments: farm time, name of the timer, function to call.
    report
        Called with a message after a failure, and with None after a success.
    clean_up
        Called with the newest backup, even after a failure; deletes old files in the background.
    """

    def __init__(
        self,
        state: StateFolder,
        clock: Clock,
        zone: tzinfo,
        call_at: Callable[[float, str, Callable[[], Awaitable[None]]], None],
        report: Callable[[str | None], None],
        clean_up: Callable[[Path], None],
    ) -> None:
        self._state, self._clock, self._zone = state, clock, zone
        self._call_at, self._report, self._clean_up = call_at, report, clean_up

    async def begin(self) -> None:
        """Back up if there is no backup of the last 24 hours, and set the timer for the next backup."""
        await self.run(only_if_due=True)

    async def run(self, only_if_due: bool = False) -> None:
        """Back up (with `only_if_due`, only if a backup is due), and set the timer for the next night."""
        now_s = self._clock.now()
        try:
            if not only_if_due or is_backup_due(self._state, now_s):
                backup = await asyncio.to_thread(back_up, self._state, now_s)
                log.info("the database was backed up to %s", backup)
                self._clean_up(backup)
            self._report(None)
        except Exception as error:  # a failed backup must not stop the daemon
            log.exception("the nightly backup of the database failed")
            self._report(
                f"the nightly backup of the database failed ({error}): check the folder {self._state.backups}"
            )
            for backup in list_backups(self._state)[:1]:
                self._clean_up(backup)  # the disk may be full: deleting old files helps
        finally:
            earliest_s = self._clock.now() + _MIN_INTERVAL_S * self._clock.scale
            self._call_at(
                max(compute_next_backup_s(now_s, self._zone), earliest_s), "back up the books", self.run
            )


def list_backups(state: StateFolder) -> list[Path]:
    """List the backups, newest first; other files in the folder are ignored."""
    return sorted(state.backups.glob(_NAME_PATTERN), reverse=True)


def parse_backup_time_s(backup: Path) -> float:
    """Return the farm time at which a backup was made."""
    return datetime.strptime(backup.stem, _NAME_FORMAT).replace(tzinfo=UTC).timestamp()


def compute_next_backup_s(now_s: float, zone: tzinfo) -> float:
    """Return the farm time at which the next backup is due."""
    now = datetime.fromtimestamp(now_s, zone)
    due_at = now.replace(hour=_BACKUP_HOUR, minute=0, second=0, microsecond=0, fold=0)
    return (due_at if due_at.timestamp() > now_s else due_at + timedelta(days=1)).timestamp()


def is_backup_due(state: StateFolder, now_s: float) -> bool:
    """Return whether there is no backup of the last 24 hours, for example because the farm was off."""
    newest = next(iter(list_backups(state)), None)
    return newest is None or parse_backup_time_s(newest) < now_s - 86400.0


def open_books(state: StateFolder, now_s: float) -> tuple[Store, float | None]:
    """Open the books; damaged ones are renamed and replaced by the newest intact backup.

    Returns
    -------
    store, copied_s
        The books, and the time after which their events are missing; None if no events are missing. Books
        from a backup are incomplete until later prints have been added from the agents' journals.

    Raises
    ------
    FarmError
        If the books cannot be opened for another reason, or if no backup is intact.
    """
    try:
        if list_backups(state) and not (state.books.is_file() and state.books.stat().st_size):
            raise DamagedBooks(f"the database {state.books} is missing")
        store = Store(state.books)
        if store.copied_s is not None:
            log.error("the database %s contains no events after %.0f s", state.books, store.copied_s)
        return store, store.copied_s
    except DamagedBooks as error:
        damage = error
    log.error("%s", damage)
    for backup in list_backups(state):
        try:
            Store(backup).close()
        except StoreError as error:
            log.error("the backup %s cannot be used: %s", backup, error)
            continue
        damaged_path = state.books.with_name(f"{state.books.name}.damaged-{now_s:.0f}")
        for suffix in ("-wal", "-shm", "-count", ""):
            path = state.books.with_name(state.books.name + suffix)
            if path.exists():
                path.rename(damaged_path.with_name(damaged_path.name + suffix))
        copy_books(backup, state.books, parse_backup_time_s(backup))
        log.error("the database was restored from %s; the damaged one is %s", backup, damaged_path)
        return Store(state.books), parse_backup_time_s(backup)
    raise FarmError(
        f"{damage}, and {state.backups} has no intact backup of it: move {state.books} away, and the "
        "farm starts with an empty database"
    )
