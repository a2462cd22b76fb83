"""Store of the books: commits, migrations and errors."""

import os
import stat
import zlib

import pytest

from books.make_books import (
    apply_events,
    make_end_event,
    make_fleet_events,
    make_job,
    make_key,
    make_plan_event,
    make_planned_books,
)
from farm.model import Key, KeyKind
from farm.state import events as ev
from farm.state.books import Books
from farm.state.storage.migrations import FIRST_VERSIONS, SCHEMA_VERSION, TABLES
from farm.state.storage.store import Store, StoreError, read_books
from farm.state.transitions import apply


def convert_to_version(db, version):
    """Convert the database to the schema of an older version."""
    for kind, table in TABLES.items():
        if FIRST_VERSIONS.get(kind, 0) > version:
            db.execute(f"DROP TABLE {table}")
        elif version < 3:
            db.execute(f"ALTER TABLE {table} DROP COLUMN crc")
    db.execute(f"PRAGMA user_version = {version}")


def list_job_events():
    """List the events that add a fleet, and a job with a plan."""
    return [
        *make_fleet_events(),
        ev.JobSubmitted(at_s=0.0, job=make_job()),
        ev.PlanningStarted(at_s=0.0, job=1),
        make_plan_event(),
    ]


def commit_events(store, events):
    """Apply events to empty books and commit each; return the books."""
    books = Books()
    for event in events:
        new_books, _ = apply(event, books)
        store.commit(event, books, new_books)
        books = new_books
    return books


def test_store_returns_committed_entities(tmp_path):
    with Store(tmp_path / "farm.db") as store:
        books = commit_events(store, list_job_events())
    with Store(tmp_path / "farm.db") as store:
        assert store.load() == books
        assert [kind for _, kind, _ in store.read_all_events()][-1] == "JobPlanned"


def test_books_in_a_public_folder_are_private(tmp_path):
    """Include books that an older version created."""
    tmp_path.chmod(0o755)
    old_mask = os.umask(0o022)
    try:
        for _ in range(2):
            with Store(tmp_path / "farm.db") as store:
                old_books = Books()
                new_books, _ = apply(make_fleet_events()[0], old_books)
                store.commit(make_fleet_events()[0], old_books, new_books)
                modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}
                assert {"farm.db", "farm.db-wal", "farm.db-shm"} <= set(modes)
                assert set(modes.values()) == {0o600}, modes
            (tmp_path / "farm.db").chmod(0o644)
    finally:
        os.umask(old_mask)


def test_failed_commit_changes_nothing(tmp_path):
    store = Store(tmp_path / "farm.db")
    old_books = Books()
    new_books, _ = apply(make_fleet_events()[0], old_books)
    store.close()
    with pytest.raises(StoreError, match="cannot be written"):
        store.commit(make_fleet_events()[0], old_books, new_books)
    with Store(tmp_path / "farm.db") as second_store:
        assert second_store.load() == old_books


def test_invalid_database_is_an_error_with_its_path(tmp_path):
    (tmp_path / "farm.db").write_text("these are not the books that you are looking for" * 50)
    with pytest.raises(StoreError, match="cannot be opened"):
        Store(tmp_path / "farm.db")


def test_database_of_the_first_schema_is_migrated(tmp_path):
    import sqlite3

    path = tmp_path / "farm.db"
    books = make_planned_books(plates=1)
    with Store(path) as store:
        store.commit(make_plan_event(), Books(), books)
    with sqlite3.connect(path) as db:  # formerly, a verdict was a field of the part
        db.execute("UPDATE part SET body = json_set(body, '$.verdict', NULL)")
        convert_to_version(db, 1)
    db.close()
    with Store(path) as store:
        assert store.load() == books


def test_row_that_cannot_be_read_is_named(tmp_path):
    import sqlite3

    with Store(tmp_path / "farm.db") as store:
        event = make_fleet_events()[0]
        store.commit(event, Books(), apply(event, Books())[0])
    with sqlite3.connect(tmp_path / "farm.db") as db:
        body = '{"name": "a", "bed": "soft"}'
        db.execute("UPDATE printer SET body = ?, crc = ?", (body, zlib.crc32(body.encode())))
    db.close()
    with Store(tmp_path / "farm.db") as store, pytest.raises(StoreError, match="printer a, bed"):
        store.load()


def test_part_cleared_in_an_earlier_version_is_good(tmp_path):
    import sqlite3

    path = tmp_path / "farm.db"
    books = make_planned_books(plates=2)
    books, _ = apply_events(
        books,
        *(
            ev.JobSubmitted(at_s=0.0, job=make_job(2)),
            ev.PlanningStarted(at_s=0.0, job=2),
            make_plan_event(2, plates=1),
        ),
        ev.PlateAssigned(at_s=1.0, plate="2/01", printer="a", print_id="0"),
        make_end_event("0", at_s=100.0),
        ev.BedCleared(at_s=150.0, printer="a", by="ann"),
        ev.PlateAssigned(at_s=151.0, plate="1/01", printer="a", print_id="1"),
        ev.PlateAssigned(at_s=151.0, plate="1/02", printer="b", print_id="2"),
        make_end_event("1", at_s=200.0),
        make_end_event("2", at_s=201.0),
        ev.BedCleared(at_s=202.0, printer="a", by="ann"),
    )
    with Store(path) as store:
        store.commit(make_plan_event(), Books(), books)
    with sqlite3.connect(path) as db:
        db.execute("UPDATE print SET body = json_remove(body, '$.verdict')")
        db.execute("UPDATE job SET body = json_set(body, '$.state', 'printed')")
        convert_to_version(db, 1)
    db.close()
    with Store(path) as store:
        books = store.load()
    assert {p.id: p.verdict for p in books.prints.values()} == {"0": "good", "1": "good", "2": None}
    assert {number: job.state for number, job in books.jobs.items()} == {1: "printed", 2: "done"}
    books, _ = apply_events(books, ev.BedCleared(at_s=300.0, printer="b", by="ann"))
    assert books.jobs[1].state == "done"


@pytest.mark.parametrize("version", [2, 3])
def test_books_without_a_table_of_keys_are_read_and_extended(tmp_path, version):
    path = tmp_path / "farm.db"
    with Store(path) as store:
        books, _ = apply(make_fleet_events()[0], Books())
        store.commit(make_fleet_events()[0], Books(), books)
        convert_to_version(store._db, version)
    assert read_books(path) == (books, version)
    with Store(path) as store:
        assert store.load() == books
        event = ev.KeyAdded(at_s=1.0, key=make_key())
        new_books, _ = apply(event, books)
        store.commit(event, books, new_books)
    assert read_books(path) == (new_books, SCHEMA_VERSION)


def test_removed_key_is_removed_from_the_disk(tmp_path):
    path = tmp_path / "farm.db"
    old_key, new_key = (
        make_key(id=name, kind=KeyKind.SESSION, expires_s=float(expires_s))
        for expires_s, name in ((5, "s1"), (50, "s2"))
    )
    books = Books()
    with Store(path) as store:
        for event in (
            ev.SessionOpened(at_s=1.0, session=old_key),
            ev.SessionOpened(at_s=10.0, session=new_key),
        ):
            new_books, _ = apply(event, books)
            store.commit(event, books, new_books)
            books = new_books
        assert store.load() == books
    assert read_books(path)[0].keys == {"s2": new_key}


def test_key_of_a_version_without_sessions_is_not_a_session():
    body = make_key().model_dump(mode="json", exclude={"kind"})
    assert Key.model_validate(body).kind is KeyKind.KEY


def test_either_all_commits_of_a_transaction_are_written_or_none(tmp_path):
    events = make_fleet_events()
    with Store(tmp_path / "farm.db") as store:
        with pytest.raises(StoreError), store.transaction():
            commit_events(store, events)
            store._db.execute("INSERT INTO no_such_table VALUES (1)")
        assert store.load() == Books() and store.find_last_event_number() == 0
        with store.transaction():
            books = commit_events(store, events)
        assert store.load() == books and store.find_last_event_number() == len(events)
        assert int((tmp_path / "farm.db-count").read_bytes()) == len(events)


def test_rows_omit_defaults_and_complete_rows_are_read_too(tmp_path):
    path = tmp_path / "farm.db"
    with Store(path) as store:
        books = commit_events(store, list_job_events())
        assert store.load() == books
        (body,) = store._db.execute("SELECT body FROM plate WHERE id = '1/01'").fetchone()
        assert "sliced_s" in body and "replaced_by" not in body and "null" not in body
        for name, plate in books.plates.items():  # as farm 0.1 wrote them
            text = plate.model_dump_json()
            row = (text, zlib.crc32(text.encode()), name)
            store._db.execute("UPDATE plate SET body = ?, crc = ? WHERE id = ?", row)
    assert read_books(path)[0] == books


def test_entities_that_are_read_share_the_set_of_their_fields(tmp_path):
    with Store(tmp_path / "farm.db") as store:
        books, _ = apply_events(Books(), *make_fleet_events())
        store.commit(make_fleet_events()[0], Books(), books)
        first_printer, second_printer, *_ = store.load().printers.values()
    assert first_printer.model_fields_set is second_printer.model_fields_set
    copy = first_printer.model_copy(update={"maintenance": "oil"})
    assert (
        copy.maintenance == "oil"
        and second_printer.maintenance is None
        and "maintenance" in copy.model_fields_set
    )


def test_failed_commit_is_not_counted_by_a_later_empty_transaction(tmp_path):
    """Check that the next start finds no lost event, for which it would restore a backup."""
    first_event, second_event, *_ = make_fleet_events()
    with Store(tmp_path / "farm.db") as store:
        with store.transaction():
            pass
        assert not (tmp_path / "farm.db-count").exists()
        books, _ = apply(first_event, Books())
        store.commit(first_event, Books(), books)
        store._db.execute(f"PRAGMA max_page_count = {store._db.execute('PRAGMA page_count').fetchone()[0]}")
        with pytest.raises(StoreError, match="full"):  # a full disk
            for _ in range(1000):
                store.commit(second_event, books, books)
        with store.transaction():
            pass
        assert int((tmp_path / "farm.db-count").read_bytes()) == store.find_last_event_number()
    with Store(tmp_path / "farm.db") as store:
        assert store.copied_s is None


def test_commit_after_a_failed_one_is_on_the_disk(tmp_path):
    """End the transaction that a failed COMMIT leaves open, so that the next commit is not part of it."""
    event, *_ = make_fleet_events()
    books, _ = apply(event, Books())
    with Store(tmp_path / "farm.db") as store:
        store._db.execute("PRAGMA foreign_keys = ON")
        store._db.execute("CREATE TEMP TABLE parent (id PRIMARY KEY)")
        store._db.execute("CREATE TEMP TABLE child (id REFERENCES parent DEFERRABLE INITIALLY DEFERRED)")
        with pytest.raises(StoreError, match="FOREIGN KEY"), store.transaction():
            store.commit(event, Books(), books)
            store._db.execute("INSERT INTO child VALUES (1)")
        store.commit(event, Books(), books)
        assert read_books(tmp_path / "farm.db")[0] == books
