"""Opening of damaged books: they are unchanged, restored with a report, or refused."""

import shutil

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from books.make_books import make_end_event, make_fleet_events, make_job, make_plan_event
from farm.errors import FarmError
from farm.model import Bed
from farm.paths import StateFolder
from farm.state import events as ev
from farm.state.books import Books
from farm.state.storage.backups import back_up, open_books
from farm.state.storage.store import Store
from farm.state.transitions import apply

BACKED_UP_COUNT = 5  # events before the backup
EVENTS = (
    *make_fleet_events(),
    ev.JobSubmitted(at_s=0.0, job=make_job()),
    ev.PlanningStarted(at_s=0.0, job=1),
    make_plan_event(plates=3),
    ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="a"),
    ev.PlateAssigned(at_s=2.0, plate="1/02", printer="b", print_id="b"),
    make_end_event("a", at_s=100.0),
    ev.BedCleared(at_s=150.0, printer="a", by="ann"),
    ev.PlateAssigned(at_s=151.0, plate="1/03", printer="a", print_id="c"),
    make_end_event("c", at_s=200.0),
    make_end_event("b", at_s=201.0),
)
NOW_S = 1000.0


class KilledDaemon:
    """Folder of a killed daemon, and its books after each event."""

    def __init__(self, folder, history):
        self.folder, self.history = folder, history


@pytest.fixture(scope="module")
def killed_daemon(tmp_path_factory):
    """Kill a daemon with most commits still in the write-ahead log."""
    state = StateFolder(tmp_path_factory.mktemp("night"))
    history = [Books()]
    with Store(state.books) as store:
        for number, event in enumerate(EVENTS):
            if number == BACKED_UP_COUNT:
                back_up(state, 1.0)
            new_books, _ = apply(event, history[-1])
            store.commit(event, history[-1], new_books)
            history.append(new_books)
        killed_folder = tmp_path_factory.mktemp("killed") / "state"
        shutil.copytree(state.root, killed_folder)
    return KilledDaemon(killed_folder, history)


def open_damaged_books(killed_daemon, folder, damage_database):
    """Open damaged books; return True if they were restored, False if unchanged, None if refused."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(killed_daemon.folder, folder)
    state = StateFolder(folder)
    damage_database(state)
    try:
        store, copied_s = open_books(state, NOW_S)
    except FarmError as error:
        assert "\n" not in str(error)
        return None
    with store:
        books = store.load()
        if copied_s is None:
            assert books == killed_daemon.history[-1]
            return False
        assert books in killed_daemon.history[BACKED_UP_COUNT:]
        new_books, _ = apply(ev.BooksRestored(at_s=NOW_S, copied_s=copied_s), books)
        store.commit(ev.BooksRestored(at_s=NOW_S, copied_s=copied_s), books, new_books)
        assert all(printer.bed is Bed.NOT_CLEAR for printer in new_books.printers.values())
    store, copied_s = open_books(state, NOW_S + 1.0)
    with store:
        assert (store.load(), copied_s) == (new_books, None)
    return True


def flip_bit(path, offset, bit=0):
    data = bytearray(path.read_bytes())
    data[offset % len(data)] ^= 1 << bit
    path.write_bytes(data)


@settings(max_examples=200, deadline=None)
@given(
    file_name=st.sampled_from(["", "", "-wal", "-wal", "-count"]),
    offset=st.integers(0, 2**20),
    bit=st.integers(0, 7),
)
def test_flipped_bit_anywhere_is_detected(killed_daemon, tmp_path_factory, file_name, offset, bit):
    folder = tmp_path_factory.getbasetemp() / "flipped"
    open_damaged_books(
        killed_daemon,
        folder,
        lambda state: flip_bit(state.books.with_name(f"farm.db{file_name}"), offset, bit),
    )


@settings(max_examples=30, deadline=None)
@given(share=st.floats(0, 0.999))
def test_truncated_write_ahead_log_is_detected(killed_daemon, tmp_path_factory, share):
    """Detect a truncated log, because SQLite does not, and old books may show a full bed as clear."""

    def truncate_log(state):
        log = state.books.with_name("farm.db-wal")
        log.write_bytes(log.read_bytes()[: int(share * log.stat().st_size)])

    assert open_damaged_books(killed_daemon, tmp_path_factory.getbasetemp() / "cut", truncate_log)


def test_intact_database_is_opened_unchanged(killed_daemon, tmp_path):
    assert open_damaged_books(killed_daemon, tmp_path / "state", lambda state: None) is False
    state = StateFolder(tmp_path / "state")
    for path in state.root.glob("farm.db*"):  # a person moves all files but the counter
        if not path.name.endswith("-count"):
            path.unlink()
    shutil.rmtree(state.backups)
    store, copied_s = open_books(state, NOW_S)
    with store:
        assert (store.load(), copied_s) == (Books(), None)


def test_every_changed_row_is_found(killed_daemon, tmp_path):
    """Find a changed digit, which leaves the pages of SQLite valid."""
    import sqlite3

    def make_row_damage(table):
        def damage_database(state):
            with sqlite3.connect(state.books) as db:
                db.execute(f"UPDATE {table} SET body = replace(body, '1', '2')")
            db.close()

        return damage_database

    for table in ("job", "plate", "print"):
        assert open_damaged_books(killed_daemon, tmp_path / table, make_row_damage(table))
