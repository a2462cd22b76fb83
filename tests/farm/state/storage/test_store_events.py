"""Deletion of old events, never of the last one, whose number shows that no commit is lost."""

import sqlite3

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farm.state import events as ev
from farm.state.books import Books
from farm.state.storage.store import Store, StoreError


def record_events(store, *times_s, person="ann"):
    for at_s in times_s:
        store.commit(ev.MaintenanceEnded(at_s=at_s, printer="a", by=person), Books(), Books())


def list_times_s(store):
    return [at_s for at_s, _, _ in store.read_all_events()]


@settings(deadline=None, max_examples=30)  # every commit is synced to the disk
@given(
    times_s=st.lists(st.floats(0, 100), max_size=12),
    end_s=st.floats(0, 110),
    max_count=st.integers(1, 20),
    batch_size=st.integers(1, 5),
)
def test_remaining_events_are_the_latest(tmp_path_factory, times_s, end_s, max_count, batch_size):
    path = tmp_path_factory.mktemp("books") / "farm.db"
    with Store(path) as store:
        record_events(store, *times_s)
        last_number = store.find_last_deletable_number(end_s, max_count)
        expected_count = store.count_events(last_number)
        deleted_count = 0
        while batch_count := store.delete_events(last_number, batch_size):
            deleted_count += batch_count
        kept_times_s = list_times_s(store)
        assert deleted_count == expected_count == len(times_s) - len(kept_times_s)
        assert kept_times_s == times_s[len(times_s) - len(kept_times_s) :]
        assert len(kept_times_s) <= max_count and bool(kept_times_s) is bool(times_s)
        assert (
            all(at_s < end_s for at_s in times_s[:deleted_count]) or deleted_count == len(times_s) - max_count
        )
        record_events(store, 200.0)
    with Store(path) as store:
        assert store.copied_s is None  # no event counts as lost
        assert list_times_s(store) == [*kept_times_s, 200.0]


def test_deleting_events_makes_the_file_smaller(tmp_path):
    path = tmp_path / "farm.db"
    with Store(path) as store:
        record_events(store, *(float(n) for n in range(300)), person="a" * 4000)
        assert not store.release_space(min_bytes=10**6)  # all space is in use
        while store.delete_events(store.find_last_deletable_number(0.0, 10)):
            pass
        assert not store.release_space()  # less than 16 MB are free
        assert store.release_space(min_bytes=10**5)
        assert path.stat().st_size < 300 * 4000 / 5
        assert list_times_s(store) == [float(n) for n in range(290, 300)]


def test_failed_deletion_of_events_raises_a_store_error(tmp_path):
    with Store(tmp_path / "farm.db") as store:
        record_events(store, 1.0, 2.0)
        with sqlite3.connect(tmp_path / "farm.db", isolation_level=None) as connection:
            connection.execute("BEGIN IMMEDIATE")
            store._db.execute("PRAGMA busy_timeout = 0")
            with pytest.raises(StoreError, match="old events cannot be deleted"):
                store.delete_events(1)
        connection.close()
        assert list_times_s(store) == [1.0, 2.0]


def test_failed_reads_raise_a_store_error(tmp_path):
    with Store(tmp_path / "farm.db") as store:
        record_events(store, 1.0, 2.0)
    reads = (
        store.find_last_event_number,
        store.read_all_events,
        lambda: store.read_events(0, 10),
        lambda: store.find_last_deletable_number(1.5, 10),
        lambda: store.count_events(2),
        lambda: store.copied_s,
        store.load,
    )
    for read in reads:
        with pytest.raises(StoreError, match="the database cannot be read"):
            read()
