"""Backups of the books: made every night, kept for a week, and restored if the books are damaged."""

import asyncio
from datetime import UTC, datetime
from functools import partial
from unittest.mock import Mock
from zoneinfo import ZoneInfo

import pytest

from books.make_books import apply_events, make_fleet_events, make_job, make_plan_event
from books.recording_controller import INSPECTED_MODEL, Farm
from drivers.clock import Clock
from farm.errors import FarmError
from farm.model import Bed, FilamentState, HoldCode, JobOptions, JobState, PrintState
from farm.paths import StateFolder
from farm.planning.plan import Plan
from farm.state import events as ev
from farm.state.books import Books
from farm.state.storage import backups
from farm.state.storage.backups import (
    BACKUP_COUNT,
    back_up,
    compute_next_backup_s,
    is_backup_due,
    list_backups,
    open_books,
    parse_backup_time_s,
)
from farm.state.storage.store import Store, StoreError
from farm.state.transitions import apply
from farm.views import list_tasks

FIRST_BACKUP_S = 1_790_000_000.0
DAY_S = 86400.0


@pytest.fixture
def state(tmp_path):
    return StateFolder(tmp_path)


def write_books(state):
    """Write books with three printers, and return them."""
    books = Books()
    with Store(state.books) as store:
        for event in make_fleet_events():
            new_books, _ = apply(event, books)
            store.commit(event, books, new_books)
            books = new_books
    return books


def make_held_books():
    """Make books with a job that waits for its approval."""
    events = (ev.JobSubmitted(at_s=0.0, job=make_job()), ev.PlanningStarted(at_s=0.0, job=1))
    return apply_events(
        Books(), *make_fleet_events(), *events, make_plan_event().model_copy(update={"held": True})
    )[0]


def test_books_in_use_are_backed_up_and_old_backups_are_deleted(state):
    books = write_books(state)
    assert is_backup_due(state, FIRST_BACKUP_S)
    with Store(state.books):
        for night in range(BACKUP_COUNT + 2):
            back_up(state, FIRST_BACKUP_S + night * DAY_S)
    backup_times_s = [parse_backup_time_s(copy) for copy in list_backups(state)]
    assert backup_times_s == [FIRST_BACKUP_S + night * DAY_S for night in range(BACKUP_COUNT + 1, 1, -1)]
    assert not is_backup_due(state, backup_times_s[0] + DAY_S - 1)
    (state.backups / "books-before-upgrade.db").touch()  # a person's copy: neither used nor deleted
    assert [parse_backup_time_s(copy) for copy in list_backups(state)] == backup_times_s
    with Store(list_backups(state)[0]) as copy:
        assert copy.load() == books


@pytest.mark.parametrize("damage", ["no database", "a page", "empty file"])
def test_damaged_database_is_restored_from_the_newest_intact_backup(state, damage):
    books = write_books(state)
    back_up(state, FIRST_BACKUP_S)
    back_up(state, FIRST_BACKUP_S + DAY_S).write_bytes(b"half a copy" * 100)
    intact_bytes = state.books.read_bytes()
    damaged_bytes = {
        "no database": b"these are not the books that you are looking for" * 50,
        "a page": intact_bytes[:4096] + b"\xff" * 4096 + intact_bytes[8192:],
        "empty file": b"",
    }[damage]
    state.books.write_bytes(damaged_bytes)
    store, restored_s = open_books(state, FIRST_BACKUP_S + 2 * DAY_S)
    with store:
        assert restored_s == FIRST_BACKUP_S
        assert store.load() == books
    (moved_file,) = state.root.glob("farm.db.damaged-*[0-9]")
    assert moved_file.read_bytes() == damaged_bytes


def test_backup_is_recognised_until_its_restore_is_recorded(state):
    write_books(state)
    back_up(state, FIRST_BACKUP_S).replace(state.books)  # for example, a person copies it back
    for _ in range(2):  # the first daemon dies before it has recorded the restore
        store, copied_s = open_books(state, FIRST_BACKUP_S + DAY_S)
        with store:
            assert copied_s == FIRST_BACKUP_S
            books = store.load()
            event = ev.BooksRestored(at_s=FIRST_BACKUP_S + DAY_S, copied_s=FIRST_BACKUP_S)
            new_books, _ = apply(event, books)
    with Store(state.books) as store:
        store.commit(event, books, new_books)
    store, copied_s = open_books(state, FIRST_BACKUP_S + DAY_S)
    with store:
        assert copied_s is None
    assert parse_backup_time_s(back_up(state, FIRST_BACKUP_S + 2 * DAY_S)) == FIRST_BACKUP_S + 2 * DAY_S


def test_missing_backup_is_reported_with_advice(state):
    state.books.write_bytes(b"no books" * 999)
    with pytest.raises(FarmError, match="no intact backup of it: move"):
        open_books(state, FIRST_BACKUP_S)
    assert state.books.read_bytes() == b"no books" * 999


def test_database_of_a_newer_version_is_not_reported_as_damaged(state):
    import sqlite3

    write_books(state)
    back_up(state, FIRST_BACKUP_S)
    with sqlite3.connect(state.books) as db:
        db.execute("PRAGMA user_version = 99")
    db.close()
    with pytest.raises(StoreError, match="newer version"):
        open_books(state, FIRST_BACKUP_S)


def test_failed_backup_keeps_earlier_ones(state):
    write_books(state)
    back_up(state, FIRST_BACKUP_S)
    state.books.write_bytes(b"no books" * 999)
    with pytest.raises(StoreError, match="cannot be copied"):
        back_up(state, FIRST_BACKUP_S + DAY_S)
    assert [parse_backup_time_s(copy) for copy in list_backups(state)] == [FIRST_BACKUP_S]
    assert len(list(state.backups.iterdir())) == 1


@pytest.mark.parametrize("problem", ["no folder", "the disk", "an internal error"])
def test_failed_backup_is_reported_and_retried(state, problem, tmp_path, monkeypatch):
    write_books(state)
    if problem == "no folder":
        state.backups.write_text("a file in its place")
    else:
        error = OSError(28, "No space left on device") if problem == "the disk" else ValueError("oh")
        monkeypatch.setattr(backups, "back_up", Mock(side_effect=error))
    farm, timers, cleanups = Farm(tmp_path / "farm"), [], []
    nightly = backups.NightlyBackup(
        state,
        Clock(),
        UTC,
        lambda *timer: timers.append(timer),
        partial(farm.controller.warn, "backup"),
        cleanups.append,
    )
    asyncio.run(nightly.begin())
    ((_, _, next_timer),) = timers
    context = farm.build_view_context(state)
    assert [item.code for item in list_tasks(context)][:1] == ["farm"]
    assert "the nightly backup of the database failed" in list_tasks(context)[0].text
    if problem == "no folder":
        state.backups.unlink()
    monkeypatch.undo()
    asyncio.run(next_timer())
    assert len(timers) == 2
    assert cleanups == list_backups(state)
    assert len(list_backups(state)) == 1
    assert "farm" not in [item.code for item in list_tasks(farm.build_view_context(state))]


def test_next_backup_is_at_four_after_any_clock_change():
    zone = ZoneInfo("Europe/London")

    def parse_time_s(text):
        return datetime.fromisoformat(text).replace(tzinfo=zone).timestamp()

    assert compute_next_backup_s(parse_time_s("2026-03-28 05:00"), zone) == parse_time_s("2026-03-29 04:00")
    assert compute_next_backup_s(parse_time_s("2026-10-24 23:00"), zone) == parse_time_s("2026-10-25 04:00")
    assert compute_next_backup_s(parse_time_s("2026-10-25 04:00"), zone) == parse_time_s("2026-10-26 04:00")


def test_restored_database_starts_nothing_before_an_inspection(tmp_path):
    farm = Farm(tmp_path)
    farm.report_ready("a", "b")
    event = make_plan_event(1, 3)
    farm.jobs.submit("r" * 8, "m.stl", INSPECTED_MODEL, JobOptions())
    farm.controller.on_plan(1, Plan(event.parts, event.plates, (), 1.0, 500.0))
    farm.jobs.submit("s" * 8, "n.stl", INSPECTED_MODEL, JobOptions())
    instruction_count = len(farm.effects.instructions)
    farm.controller.start(farm.effects, restored_s=FIRST_BACKUP_S)
    books = farm.controller.books
    assert {printer.bed for printer in books.printers.values()} == {Bed.NOT_CLEAR}
    assert {printer.filament for printer in books.printers.values()} == {FilamentState.UNKNOWN}
    assert (books.jobs[1].state, books.jobs[1].hold.code) == (JobState.HELD, HoldCode.APPROVAL)
    assert books.jobs[2].options.hold
    next_books, _ = apply(ev.PlanningStarted(at_s=FIRST_BACKUP_S, job=2), books)
    next_books, _ = apply(make_plan_event(2, 1).model_copy(update={"held": True}), next_books)
    # The job may have been planned and printed since the backup.
    assert next_books.jobs[2].hold == books.jobs[1].hold
    restored_books, _ = apply(
        ev.BooksRestored(at_s=FIRST_BACKUP_S, copied_s=FIRST_BACKUP_S), make_held_books()
    )
    assert restored_books.jobs[1].hold == books.jobs[1].hold  # a held job may have been approved since then
    for name in "ab":
        farm.report(name)  # its agent does not know the print, which was only assigned
    assert {p.state for p in farm.controller.books.prints.values()} == {PrintState.CANCELLED}
    assert not [i for i in farm.effects.instructions[instruction_count:] if isinstance(i, ev.SendStart)]
    for name in "ab":
        farm.clear_bed(name, FilamentState.PARKED)
    assert not [i for i in farm.effects.instructions[instruction_count:] if isinstance(i, ev.SendStart)]
    farm.controller.handle(ev.JobApproved(at_s=farm.controller.clock.now(), job=1, by="ann"))
    assert len([i for i in farm.effects.instructions[instruction_count:] if isinstance(i, ev.SendStart)]) == 2


def test_full_disk_empties_the_slice_cache_for_the_backup(state, monkeypatch):
    write_books(state)
    state.slices.mkdir()
    entry = state.slices / f"{'0' * 64}.json"
    entry.write_text("{}")
    back_up(state, FIRST_BACKUP_S)
    assert entry.exists()
    monkeypatch.setattr(backups.shutil, "disk_usage", lambda _: Mock(free=10**6))
    back_up(state, FIRST_BACKUP_S + DAY_S)
    assert not entry.exists() and len(list_backups(state)) == 2


def test_unreadable_backup_is_discarded(state, monkeypatch):
    write_books(state)
    back_up(state, FIRST_BACKUP_S)
    copy_books = backups.copy_books

    def damage_copy(source, target, now_s):
        copy_books(source, target, now_s)
        target.write_bytes(target.read_bytes()[:-4096] + b"x" * 4096)

    monkeypatch.setattr(backups, "copy_books", damage_copy)
    with pytest.raises(StoreError):
        back_up(state, FIRST_BACKUP_S + DAY_S)
    assert [parse_backup_time_s(result) for result in list_backups(state)] == [FIRST_BACKUP_S]
