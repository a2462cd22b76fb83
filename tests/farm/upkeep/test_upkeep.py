"""Upkeep after a backup: expired files are deleted, even if the daemon is killed at any moment."""

import asyncio
import os
import signal
import time
from datetime import datetime
from pathlib import Path

import pytest
import trimesh

from books.old_jobs import DAY_S, NOW_S, add_good_prints, make_old_books, write_files
from books.recording_controller import PLUS_MODEL, Farm, RecordedEffects, make_fleet
from farm.errors import RefusedError
from farm.model import JobState
from farm.paths import StateFolder
from farm.planning import list_job_files
from farm.state import events as ev
from farm.state import validate_books
from farm.state.books import Books
from farm.state.retention import list_referenced_files
from farm.state.storage import Store, StoreError, back_up, link_files, list_files, open_books
from farm.state.storage.backups import list_backups
from farm.upkeep import upkeep
from farm.upkeep.upkeep import Upkeep
from farm.views import ViewContext, describe_job, list_history, list_tasks
from farm.views.report import JobContents, render_page
from hosts.manual_clock import ManualClock

JOB_AGES = ((JobState.DONE, 200), (JobState.DONE, 100), (JobState.CANCELLED, 95), (JobState.DONE, 10),
        (JobState.PRINTED, 300), (JobState.PRINTING, 0))  # fmt: skip
OLD_JOBS = [1, 2, 3]


class InlineWorkers:
    """Workers that run a task at once."""

    def __init__(self, work=None):
        self._work = work

    async def run(self, work, *args, limit):
        return (self._work or work)(*args)


def omit_pictures(files, parts, folder):
    return {}


class LinkingEffects(RecordedEffects):
    """Effects that link the files of jobs, as those of the daemon do."""

    def __init__(self, state):
        super().__init__()
        self._state = state

    def perform(self, effect, books):
        super().perform(effect, books)
        if isinstance(effect, ev.LinkFiles):
            link_job_files(books, self._state, effect.job)


def link_job_files(books, state, number):
    job = books.jobs[number]
    names = list_job_files(job, map(books.parts.__getitem__, job.parts), books.list_plates(job))
    link_files(state.find_job_folder(number), state.files, names)


def fill_state(root, ages=JOB_AGES, event_count=40):
    """Make a state folder with jobs, their files and links, and events of the last 200 days."""
    state = StateFolder(root)
    state.make()
    books = add_good_prints(make_old_books(*ages))
    with Store(state.books) as store:
        for number in range(event_count):
            at_s = NOW_S - 200 * DAY_S * (1 - number / event_count)
            store.commit(ev.MaintenanceEnded(at_s=at_s, printer="a", by=f"ann-{number}"), Books(), books)
    write_files(books, state)
    for number in books.jobs:
        link_job_files(books, state, number)
    return state, books


def open_upkeep(state, work=omit_pictures, **keep):
    """Open a daemon's upkeep on a state folder; the caller closes the store of the farm."""
    farm = Farm(state.root, (PLUS_MODEL,) * 3, clock=ManualClock(NOW_S), keep=keep)
    farm.controller._effects = LinkingEffects(state)
    return farm, Upkeep(farm.controller, farm.store, state, InlineWorkers(work))


def show_job(state, books, number):
    """Return the views of `farm status JOB` and `farm history`, and lay out `farm report`."""
    context = ViewContext(make_fleet((PLUS_MODEL,) * 3), books, {}, state, NOW_S)
    view, rows = describe_job(context, books.jobs[number]), list_history(context, number)
    page = render_page(view, list_history(context), datetime.fromisoformat(view.now), [], JobContents())
    assert view.name in page
    return view, rows


def check_jobs(state, books, old_books):
    """Check that every job is shown as before the prune, and that no file of the books is missing."""
    assert list_referenced_files(books) <= list_files(state.files).keys()
    for number, job in books.jobs.items():
        (old_view, old_rows), (view, rows) = (
            show_job(state, old_books, number),
            show_job(state, books, number),
        )
        changed_fields = {"parts", "plates", "pruned"}
        assert rows == old_rows
        assert view.model_dump(exclude=changed_fields) == old_view.model_dump(exclude=changed_fields)
        assert [part.prints for part in view.parts] == [part.prints for part in old_view.parts]
        paths = [*(part.file for part in view.parts), *(plate.gcode for plate in view.plates)]
        is_pruned = job.pruned_s is not None
        assert (view.pruned is not None) is is_pruned
        assert all(path is None if is_pruned else Path(path).is_file() for path in paths)


def test_files_of_old_jobs_are_deleted_except_pictures(tmp_path):
    state, old_books = fill_state(tmp_path)
    farm, cleanup = open_upkeep(state)
    with farm.store:
        answer = asyncio.run(cleanup.prune("ann", dry_run=False))
        books = farm.controller.books
    assert [job.id for job in answer.jobs] == OLD_JOBS
    assert [number for number, job in books.jobs.items() if job.pruned_s is not None] == OLD_JOBS
    assert answer.freed_bytes == 3 * 6 * 1000  # all files but the picture
    assert list_files(state.files).keys() == list_referenced_files(books)
    assert answer.stored_bytes == 1000 * len(list_referenced_files(books))
    assert [path.name for path in state.find_job_folder(1).iterdir()] == ["assembly.png"]
    assert len(list(state.find_job_folder(4).iterdir())) > 4
    check_jobs(state, books, old_books)
    assert len(list_backups(state)) == 1
    with Store(state.books) as store:
        assert store.load() == books
        pruned_events = [body for _, kind, body in store.read_all_events() if kind == "JobPruned"]
    assert len(pruned_events) == 3 and all('"by":"ann"' in body for body in pruned_events)


def test_dry_run_lists_the_same_and_changes_nothing(tmp_path):
    state, old_books = fill_state(tmp_path)
    farm, cleanup = open_upkeep(state)
    with farm.store:
        preview = asyncio.run(cleanup.prune("ann", dry_run=True))
        assert farm.controller.books == old_books and not list_backups(state)
        assert len(list_files(state.files)) == len(list_referenced_files(old_books))
        result = asyncio.run(cleanup.prune("ann", dry_run=False))
    assert preview == result.model_copy(update={"dry_run": True})


def test_full_store_deletes_the_oldest_files_first(tmp_path):
    state, _ = fill_state(tmp_path)
    farm, cleanup = open_upkeep(state, days=365, gb=36e-6)
    with farm.store:
        answer = asyncio.run(cleanup.prune("ann", dry_run=False))
    assert [job.id for job in answer.jobs] == [1]
    assert answer.stored_bytes == 36_000


def test_parts_of_a_pruned_job_keep_small_pictures(tmp_path):
    state, old_books = fill_state(tmp_path, ages=((JobState.DONE, 100),))
    for name in ("1-p01.stl", "1-p02.stl"):
        trimesh.creation.box((10, 20, 30)).export(state.files / name)
        os.utime(state.files / name, (1000.0, 1000.0))
    farm, cleanup = open_upkeep(state, work=None)
    with farm.store:
        asyncio.run(cleanup.prune("ann", dry_run=False))
        books = farm.controller.books
    view, _ = show_job(state, books, 1)
    assert all(Path(part.picture).read_bytes().startswith(b"\x89PNG") for part in view.parts)
    assert {path.name for path in state.find_job_folder(1).iterdir()} == {
        "assembly.png",
        "p01.png",
        "p02.png",
    }
    check_jobs(state, books, old_books)


def test_files_of_an_unknown_database_stay_for_the_kept_days(tmp_path):
    """Keep files, because a person may have moved the database and may put it back."""
    state, old_books = fill_state(tmp_path)
    for name in list_referenced_files(old_books):
        stored_s = time.time() - (89 if name.endswith("gcode") else 91) * DAY_S
        os.utime(state.files / name, (stored_s, stored_s))
    state.books.rename(tmp_path / "moved.db")
    farm, cleanup = open_upkeep(state)
    with farm.store:
        asyncio.run(finish_cleanup(cleanup))
    assert list_files(state.files).keys() == {
        name for name in list_referenced_files(old_books) if name.endswith("gcode")
    }


def test_old_events_are_deleted_after_the_backup(tmp_path):
    state, books = fill_state(tmp_path, event_count=400)
    farm, cleanup = open_upkeep(state)
    with farm.store:
        answer = asyncio.run(cleanup.prune("ann", dry_run=False))
        events = farm.store.read_all_events()
    assert answer.events == 220  # spread evenly over 200 days
    assert min(at_s for at_s, _, _ in events) >= NOW_S - 90 * DAY_S
    kept_events = [body for _, kind, body in events if kind == "MaintenanceEnded"]
    assert len(kept_events) == 180 and '"ann-399"' in kept_events[-1]
    (copy,) = list_backups(state)
    with Store(copy) as backup:
        assert len(backup.read_all_events()) == 400 and backup.load() == books
    with Store(state.books) as store:
        assert store.copied_s is None  # no event counts as lost
        store.commit(ev.MaintenanceEnded(at_s=NOW_S, printer="a", by="ann"), Books(), Books())
    with Store(state.books) as store:
        assert store.copied_s is None


def test_backup_from_before_a_compaction_is_restored(tmp_path):
    """Mark the jobs that were pruned since the backup as pruned again; no file is missing."""
    state, old_books = fill_state(tmp_path)
    farm, cleanup = open_upkeep(state)
    with farm.store:
        asyncio.run(cleanup.prune("ann", dry_run=False))
    state.books.write_bytes(b"damage" * 1000)
    for suffix in ("-wal", "-shm"):
        state.books.with_name(state.books.name + suffix).unlink(missing_ok=True)
    store, copied_s = open_books(state, NOW_S)
    assert copied_s == NOW_S and store.load() == old_books
    store.close()
    farm, cleanup = open_upkeep(state)
    with farm.store:
        farm.controller.handle(ev.BooksRestored(at_s=NOW_S, copied_s=copied_s))
        for name in "abc":
            farm.controller.handle(ev.BedCleared(at_s=NOW_S, printer=name, by="ann"))
        asyncio.run(cleanup.prune("ann", dry_run=False))
        books = farm.controller.books
    assert [number for number, job in books.jobs.items() if job.pruned_s is not None] == OLD_JOBS
    assert validate_books(books) == validate_books(old_books)
    assert list_referenced_files(books) <= list_files(state.files).keys()


def test_reprint_of_a_pruned_job_is_refused_with_its_reason(tmp_path):
    state, _ = fill_state(tmp_path)
    farm, cleanup = open_upkeep(state)
    with farm.store:
        asyncio.run(cleanup.prune("ann", dry_run=False))
        with pytest.raises(RefusedError, match=r"were pruned on \d{4}-\d\d-\d\d .*submit bracket.stl again"):
            farm.parts.reprint(1, "p01", "", "ann")
        assert farm.controller.books.jobs[1].state is JobState.DONE
        farm.parts.reprint(4, "p01", "", "ann")


def test_failed_run_is_reported_and_the_next_one_continues(tmp_path, monkeypatch):
    state, _ = fill_state(tmp_path)
    farm, cleanup = open_upkeep(state)

    async def run_nights():
        backup = back_up(state, NOW_S)
        with monkeypatch.context() as patch:
            patch.setattr(upkeep, "delete_files", fail_on_disk)
            cleanup.clean_up(backup)
            await asyncio.gather(*cleanup._tasks)
        context = farm.build_view_context(state)
        assert "old files cannot be deleted (no disk)" in list_tasks(context)[0].text
        cleanup.clean_up(backup)
        await asyncio.gather(*cleanup._tasks)

    def fail_on_disk(*_):
        raise OSError("no disk")

    with farm.store:
        asyncio.run(run_nights())
        assert farm.build_view_context(state).warnings == ()
        assert list_files(state.files).keys() == list_referenced_files(farm.controller.books)


def test_full_disk_deletes_jobs_from_before_the_last_backup(tmp_path, monkeypatch):
    """Prune although a full disk prevents the backup."""
    state, _ = fill_state(tmp_path)
    back_up(state, NOW_S - 97 * DAY_S)

    def fail_on_full_disk(*_):
        raise StoreError("the disk is full")

    monkeypatch.setattr(upkeep, "back_up", fail_on_full_disk)
    farm, cleanup = open_upkeep(state)
    with farm.store:
        answer = asyncio.run(cleanup.prune("ann", dry_run=False))
        assert [job.id for job in answer.jobs] == [1, 2]  # job 3 ended after the backup
        for copy in list_backups(state):
            copy.unlink()
        with pytest.raises(StoreError, match="the disk is full"):
            asyncio.run(cleanup.prune("ann", dry_run=False))


def run_until_killed(state, step):
    """Prune in a process that is killed before change number `step`; return True if it finished."""
    child = os.fork()
    if child == 0:
        try:
            remaining_calls = step

            def die_at_call(function, *args, **kwargs):
                nonlocal remaining_calls
                remaining_calls -= 1
                if remaining_calls < 0:
                    os.kill(os.getpid(), signal.SIGKILL)
                return function(*args, **kwargs)

            for owner, name in CHANGES:
                function = getattr(owner, name)
                setattr(owner, name, lambda *args, _f=function, **kwargs: die_at_call(_f, *args, **kwargs))
            _, cleanup = open_upkeep(state)
            asyncio.run(cleanup.prune("ann", dry_run=False))
            os._exit(0)
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.waitstatus_to_exitcode(status) == 0
    return not os.WIFSIGNALED(status)


CHANGES = (
    *((Store, name) for name in ("commit", "delete_events", "release_space")),
    *((Path, name) for name in ("unlink", "replace", "symlink_to")),
)
"""Functions that change the disk: a run is killed before each of their calls."""


def test_interrupted_prune_is_finished_at_the_next_start(tmp_path):
    for step in range(200):
        state, old_books = fill_state(tmp_path / str(step), event_count=10)
        is_done = run_until_killed(state, step)
        farm, cleanup = open_upkeep(state)
        with farm.store:
            check_jobs(state, farm.controller.books, old_books)  # the prune is incomplete
            asyncio.run(finish_cleanup(cleanup))
            books = farm.controller.books
            assert list_files(state.files).keys() == list_referenced_files(books)
            dead_links = [link for link in state.jobs.glob("*/*") if not link.exists()]
            assert not dead_links
            asyncio.run(cleanup.prune("ann", dry_run=False))
            check_jobs(state, farm.controller.books, old_books)
            jobs = farm.controller.books.jobs.values()
            assert sorted(job.id for job in jobs if job.pruned_s is not None) == OLD_JOBS
            assert min(at_s for at_s, _, _ in farm.store.read_all_events()) >= NOW_S - 90 * DAY_S
        if is_done:
            break
    assert is_done and step > 30


async def finish_cleanup(cleanup):
    cleanup.finish_earlier_deletions()
    await asyncio.gather(*cleanup._tasks)
