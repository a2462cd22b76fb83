"""Upkeep after each backup: old events, files of old jobs and old slices are deleted.

Each deletion is committed to the database before it is carried out.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Coroutine
from pathlib import Path

from farm import api
from farm.compute import DeferredFunction, Limit, Pool
from farm.control import Controller
from farm.errors import FarmError
from farm.model import Job
from farm.paths import StateFolder
from farm.state import Books
from farm.state import events as ev
from farm.state.retention import (
    RetentionRules,
    describe_shortage,
    find_keep_reason,
    list_deletable_files,
    list_job_file_names,
    list_jobs_pruned_since_backup,
    list_referenced_files,
    select_jobs,
)
from farm.state.storage import (
    NEW_FILE_GRACE_S,
    Store,
    StoredFile,
    StoreError,
    back_up,
    delete_files,
    list_backups,
    list_files,
    parse_backup_time_s,
    remove_broken_links,
)
from farm.state.transitions import apply
from farm.text import format_count
from farm.upkeep.disk_use import measure_disk
from slicing.cache_limit import trim_cache

log = logging.getLogger(__name__)

MAX_EVENTS = 500_000
"""Maximum number of events that are kept, about 300 MB; a print has about ten events."""
FARM_CALLER = "the farm"
"""Name of the caller in the events of deletions that no person requested."""
# The limit includes the time in which a worker may first have to compile its code.
_DRAWING_LIMIT = Limit("drawing the parts of an old job", 1800.0)
_store_part_pictures = DeferredFunction("farm.upkeep.part_pictures:store_part_pictures")
_DAY_S = 86400.0


class Upkeep:
    """Deletion of files and events that exceed the limits of `fleet.keep`, one run at a time.

    All methods must be called on the event loop's thread.

    Parameters
    ----------
    controller
        Controller of the farm's state, which records each deletion as an event.
    store
        The database, whose old events are deleted.
    state
        The state folder.
    workers
        Processes that draw the parts of a job before its files are deleted.
    """

    def __init__(self, controller: Controller, store: Store, state: StateFolder, workers: Pool) -> None:
        self._controller, self._store = controller, store
        self._state, self._workers = state, workers
        keep = controller.fleet.fleet.keep
        self._rules, self._keep_gb = RetentionRules(keep.days, keep.gb * 1e9), keep.gb
        self._run_lock = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    # -- background -------------------------------------------------------------------------------------

    def finish_earlier_deletions(self) -> None:
        """Finish, in the background, the deletions that an earlier daemon did not complete."""
        self._start_task(self._finish_deletions())

    def clean_up(self, backup: Path) -> None:
        """Delete expired files and events after a nightly backup, in the background."""
        self._start_task(self._run_upkeep(backup, FARM_CALLER))

    async def check_free_space(self) -> None:
        """Warn people if the disk is likely to be full within two nights; otherwise withdraw the warning."""
        controller, reserve_gb = self._controller, self._controller.fleet.fleet.uploads.free_gb
        now_s, scale = controller.clock.now(), controller.clock.scale
        try:
            disk_use = await asyncio.to_thread(measure_disk, self._state, controller.books, now_s, scale)
        except OSError as error:
            log.warning("the disk cannot be measured: %s", error)
            return
        controller.warn("disk", describe_shortage(str(self._state.root), disk_use, self._keep_gb, reserve_gb))

    def stop(self) -> None:
        """Stop the deletions; the next daemon finishes them."""
        for task in self._tasks:
            task.cancel()

    def _start_task(self, work: Coroutine[object, object, object]) -> None:
        async def run_work() -> None:
            try:
                async with self._run_lock:
                    await work
                self._controller.warn("prune", None)
            except Exception as error:  # the daemon continues, and tries again the next night
                log.exception("old files cannot be deleted")
                self._controller.warn(
                    "prune",
                    f"old files cannot be deleted ({error}): check {self._state.root}, then `farm prune`",
                )

        task = asyncio.get_running_loop().create_task(run_work())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # -- command ----------------------------------------------------------------------------------------

    async def prune(self, caller_name: str, dry_run: bool) -> api.PruneResponse:
        """Back up, then delete expired files and events; with `dry_run`, only list them.

        Raises
        ------
        FarmError
            If the backup fails and there is no earlier backup; in this case no file is deleted.
        """
        async with self._run_lock:
            now_s = self._controller.clock.now()
            if dry_run:
                return await self._preview_prune(now_s)
            try:
                backup = await asyncio.to_thread(back_up, self._state, now_s)
            except StoreError as error:  # such as a full disk; jobs in the latest backup can still be pruned
                backups = list_backups(self._state)
                if not backups:
                    raise
                backup = backups[0]
                log.error("%s; only jobs that ended before the backup %s are pruned", error, backup)
            return await self._run_upkeep(backup, caller_name)

    async def _preview_prune(self, now_s: float) -> api.PruneResponse:
        """Compute the response to a prune without deleting anything."""
        books = self._controller.books
        files = await asyncio.to_thread(list_files, self._state.files)
        job_ids = self._select_jobs(files, books, now_s)
        changed_books = books
        for job_id in job_ids:
            changed_books, _ = apply(ev.JobPruned(at_s=now_s, job=job_id, by=FARM_CALLER), changed_books)
        wall_s = time.time()
        released_files = {
            name
            for names, min_age_s in self._list_deletions(files, changed_books)
            for name in names
            if wall_s - files[name].stored_s >= min_age_s
        }
        last_old_event = self._store.find_last_deletable_number(
            now_s - self._rules.max_age_days * _DAY_S, MAX_EVENTS
        )
        return api.PruneResponse(
            dry_run=True,
            jobs=[self._describe_job(books.jobs[job_id], files, books) for job_id in job_ids],
            freed_bytes=sum(files[name].size_bytes for name in released_files),
            stored_bytes=sum(file.size_bytes for name, file in files.items() if name not in released_files),
            events=self._store.count_events(last_old_event),
        )

    # -- steps ------------------------------------------------------------------------------------------

    async def _run_upkeep(self, backup: Path, caller_name: str) -> api.PruneResponse:
        """Delete expired files and events after a verified backup."""
        started_s = time.monotonic()
        events = await self._delete_old_events(backup)
        jobs = await self._prune_jobs(parse_backup_time_s(backup), caller_name)
        freed_bytes = await self._finish_deletions()
        files = await asyncio.to_thread(list_files, self._state.files)
        await asyncio.to_thread(trim_cache, self._state.slices)
        log.info(
            "%s pruned, %d bytes freed, %d events deleted in %.1f s",
            *(format_count(len(jobs), "job"), freed_bytes, events, time.monotonic() - started_s),
        )
        await self.check_free_space()
        stored_bytes = sum(file.size_bytes for file in files.values())
        return api.PruneResponse(
            dry_run=False, jobs=jobs, freed_bytes=freed_bytes, stored_bytes=stored_bytes, events=events
        )

    async def _delete_old_events(self, backup: Path) -> int:
        """Delete expired events in batches; return the number of deleted events."""
        now_s = self._controller.clock.now()
        last = self._store.find_last_deletable_number(now_s - self._rules.max_age_days * _DAY_S, MAX_EVENTS)
        if not last:
            return 0
        self._controller.handle(ev.EventsCompacted(at_s=now_s, last=last, backup=backup.name))
        deleted_count = 0
        while batch := self._store.delete_events(last):
            deleted_count += batch
            await asyncio.sleep(0)  # lets the event loop serve agents and people between batches
        self._store.release_space()
        return deleted_count

    async def _prune_jobs(self, backup_s: float, caller_name: str) -> list[api.PrunedJob]:
        """Draw the parts of each expired job, and record the job as pruned; return the pruned jobs."""
        controller = self._controller
        files = await asyncio.to_thread(list_files, self._state.files)
        pruned_jobs = []
        for job_id in self._select_jobs(files, controller.books, controller.clock.now(), backup_s):
            job = controller.books.get_job(job_id)
            pictures = await self._draw_parts(job)
            # a person may have changed the job in the meantime
            if find_keep_reason(controller.books, controller.books.get_job(job_id)) is None:
                pruned_jobs.append(self._describe_job(job, files, controller.books))
                at_s = controller.clock.now()
                controller.handle(ev.JobPruned(at_s=at_s, job=job_id, by=caller_name, part_pictures=pictures))
        return pruned_jobs

    async def _draw_parts(self, job: Job) -> dict[str, str]:
        parts = self._controller.books.parts
        stls = {name: parts[name].file for name in job.parts if parts[name].file.endswith(".stl")}
        if not stls:
            return {}
        try:
            work = self._workers.run(
                _store_part_pictures, self._state.files, stls, self._state.work, limit=_DRAWING_LIMIT
            )
            return dict(await work)
        except FarmError as error:
            log.warning("job %d: its parts are not drawn: %s", job.id, error, extra={"job": job.id})
            return {}

    async def _finish_deletions(self) -> int:
        """Delete files of pruned jobs, and old files to which no job refers; return their total bytes.

        Such files remain if a daemon was killed while it was pruning jobs or storing files. After a backup
        was restored, the files of some jobs may be gone; these jobs are recorded as pruned.
        """
        controller, folder = self._controller, self._state.files
        files = await asyncio.to_thread(list_files, folder)
        for job_id in list_jobs_pruned_since_backup(controller.books, files):
            log.warning("job %d: its files are gone; it counts as pruned", job_id, extra={"job": job_id})
            controller.handle(ev.JobPruned(at_s=controller.clock.now(), job=job_id, by=FARM_CALLER))
        freed_bytes = 0
        for names, min_age_s in self._list_deletions(files, controller.books):
            freed_bytes += await asyncio.to_thread(delete_files, folder, names, time.time(), min_age_s)
        await asyncio.to_thread(remove_broken_links, self._state.jobs)
        return freed_bytes

    def _list_deletions(
        self, files: dict[str, StoredFile], books: Books
    ) -> list[tuple[frozenset[str], float]]:
        """List sets of file names to delete, each with the minimum age of its files in wall seconds.

        Files to which no job refers are kept for `fleet.keep.days`, because they may belong to a database
        that a person restores.
        """
        deletable = list_deletable_files(books)
        unreferenced = files.keys() - deletable - list_referenced_files(books)
        days_s = self._rules.max_age_days * _DAY_S / self._controller.clock.scale
        return [
            (deletable & files.keys(), NEW_FILE_GRACE_S),
            (frozenset(unreferenced), max(NEW_FILE_GRACE_S, days_s)),
        ]

    def _select_jobs(
        self, files: dict[str, StoredFile], books: Books, now_s: float, backup_s: float | None = None
    ) -> list[int]:
        sizes = {name: file.size_bytes for name, file in files.items()}
        return select_jobs(books, sizes, self._rules, now_s, now_s if backup_s is None else backup_s)

    def _describe_job(self, job: Job, files: dict[str, StoredFile], books: Books) -> api.PrunedJob:
        names = list_job_file_names(books, job)
        return api.PrunedJob(
            id=job.id,
            name=job.name,
            size_bytes=sum(files[name].size_bytes for name in names if name in files),
        )
