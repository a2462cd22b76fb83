"""The store: what was committed is there, what could not be committed is not."""

import pytest

from farm.tracking import events as ev
from farm.tracking.books import Books
from farm.tracking.rules import apply
from farm.tracking.store import Store, StoreError
from make_books import fleet, job, plan, printing


def test_the_store_gives_back_what_was_committed(tmp_path):
    books = Books()
    with Store(tmp_path / "farm.db") as store:
        for event in (
            *fleet(),
            ev.JobSubmitted(at_s=0.0, job=job()),
            ev.PlanningStarted(at_s=0.0, job=1),
            plan(),
        ):
            after, _ = apply(event, books)
            store.commit(event, books, after)
            books = after
    with Store(tmp_path / "farm.db") as store:
        assert store.load() == books
        assert [kind for _, kind, _ in store.events()][-1] == "JobPlanned"


def test_an_event_that_cannot_be_written_leaves_nothing(tmp_path):
    store = Store(tmp_path / "farm.db")
    before = Books()
    after, _ = apply(fleet()[0], before)
    store.close()
    with pytest.raises(StoreError, match="cannot be written"):
        store.commit(fleet()[0], before, after)
    with Store(tmp_path / "farm.db") as again:
        assert again.load() == before


def test_books_that_are_no_database_are_named(tmp_path):
    (tmp_path / "farm.db").write_text("these are not the books that you are looking for" * 50)
    with pytest.raises(StoreError, match="cannot be opened"):
        Store(tmp_path / "farm.db")


def test_books_of_the_first_form_are_brought_up_to_date(tmp_path):
    import sqlite3

    path = tmp_path / "farm.db"
    books = printing(plates=1)
    with Store(path) as store:
        store.commit(plan(), Books(), books)
    with sqlite3.connect(path) as db:  # a verdict was the part's
        db.execute("UPDATE part SET body = json_set(body, '$.verdict', NULL)")
        db.execute("PRAGMA user_version = 1")
    db.close()
    with Store(path) as store:
        assert store.load() == books


def test_a_row_that_cannot_be_read_is_named(tmp_path):
    import sqlite3

    with Store(tmp_path / "farm.db") as store:
        event = fleet()[0]
        store.commit(event, Books(), apply(event, Books())[0])
    with sqlite3.connect(tmp_path / "farm.db") as db:
        db.execute("""UPDATE printer SET body = '{"name": "a", "bed": "soft"}'""")
    db.close()
    with Store(tmp_path / "farm.db") as store, pytest.raises(StoreError, match="printer a, bed"):
        store.load()
