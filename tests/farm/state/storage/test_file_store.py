"""File store: names are hashes, files never change."""

import hashlib
import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

from farm.state.storage.file_store import (
    NEW_FILE_GRACE_S,
    compute_sha256,
    delete_files,
    link_files,
    list_files,
    remove_broken_links,
    store_file,
)


def test_stored_file_is_named_by_its_hash_and_read_only(tmp_path):
    store = tmp_path / "files"
    store.mkdir()
    source = tmp_path / "part.STL"
    source.write_bytes(b"solid")
    name = store_file(store, source)
    assert name == hashlib.sha256(b"solid").hexdigest() + ".stl"
    assert not source.exists()
    assert (store / name).read_bytes() == b"solid"
    assert (store / name).stat().st_mode & 0o222 == 0
    assert compute_sha256(store / name) + ".stl" == name


def test_same_bytes_are_stored_once(tmp_path):
    store = tmp_path / "files"
    store.mkdir()
    for name in ("a.stl", "b.stl"):
        (tmp_path / name).write_bytes(b"solid")
    assert store_file(store, tmp_path / "a.stl") == store_file(store, tmp_path / "b.stl")
    assert len(list(store.iterdir())) == 1
    assert not (tmp_path / "b.stl").exists()


def test_links_get_the_current_names_and_other_files_stay(tmp_path):
    store, folder = tmp_path / "files", tmp_path / "jobs" / "1"
    store.mkdir()
    (tmp_path / "a.stl").write_bytes(b"solid")
    name = store_file(store, tmp_path / "a.stl")
    for _ in range(2):
        link_files(folder, store, {"p01.stl": name})
    assert (folder / "p01.stl").read_bytes() == b"solid"
    (folder / "notes.txt").write_text("mine")
    (folder / "mine.stl").symlink_to(tmp_path / "elsewhere.stl")
    link_files(folder, store, {"p01a.stl": name})
    assert {path.name for path in folder.iterdir()} == {"p01a.stl", "notes.txt", "mine.stl"}


def store_content(store, tmp_path, content):
    (tmp_path / "new.stl").write_bytes(content)
    return store_file(store, tmp_path / "new.stl")


def test_unnamed_files_are_deleted_an_hour_after_they_were_stored(tmp_path):
    store = tmp_path / "files"
    store.mkdir()
    name = store_content(store, tmp_path, b"solid")
    now_s = (store / name).stat().st_mtime
    assert delete_files(store, [name, "gone.stl"], now_s + NEW_FILE_GRACE_S - 1) == 0
    assert delete_files(store, [name], now_s - 7200.0) == 0  # the clock was set back
    assert delete_files(store, [name], now_s + NEW_FILE_GRACE_S) == 5
    assert list_files(store) == {}


def test_file_that_is_stored_again_counts_as_new(tmp_path):
    """Store a model of an old job again; the event that names it follows later."""
    store = tmp_path / "files"
    store.mkdir()
    name = store_content(store, tmp_path, b"solid")
    os.utime(store / name, (1000.0, 1000.0))
    assert store_content(store, tmp_path, b"solid") == name
    assert delete_files(store, [name], time.time()) == 0
    assert (store / name).read_bytes() == b"solid"


def test_age_of_a_file_counts_from_when_it_was_stored(tmp_path):
    store, source = tmp_path / "files", tmp_path / "old.stl"
    store.mkdir()
    source.write_bytes(b"solid")
    os.utime(source, (1000.0, 1000.0))
    name = store_file(store, source)
    assert delete_files(store, [name], time.time()) == 0


def test_file_stored_during_a_deletion_is_kept(tmp_path):
    store = tmp_path / "files"
    store.mkdir()
    stop_event = threading.Event()

    def delete_all_files():
        while not stop_event.is_set():
            delete_files(store, list_files(store), time.time())

    with ThreadPoolExecutor() as pool:
        deletion = pool.submit(delete_all_files)
        try:
            for _ in range(300):
                name = store_content(store, tmp_path, b"solid")
                assert (store / name).exists()
                with suppress(FileNotFoundError):
                    os.utime(store / name, (1000.0, 1000.0))  # old enough to be deleted at any moment
        finally:
            stop_event.set()
        deletion.result()


def test_links_to_deleted_files_are_removed(tmp_path):
    store, jobs = tmp_path / "files", tmp_path / "jobs"
    store.mkdir()
    kept_name, removed_name = store_content(store, tmp_path, b"a"), store_content(store, tmp_path, b"b")
    link_files(jobs / "1", store, {"p01.stl": kept_name, "p02.stl": removed_name})
    (jobs / "1" / "notes.txt").write_text("mine")
    (store / removed_name).unlink()
    remove_broken_links(jobs)
    assert {path.name for path in (jobs / "1").iterdir()} == {"p01.stl", "notes.txt"}
