"""The file store: names are hashes, files never change."""

import hashlib

from farm.state.storage.file_store import name_files, sha256_of, store_file


def test_a_stored_file_has_its_hash_for_a_name_and_cannot_be_written(tmp_path):
    store = tmp_path / "files"
    store.mkdir()
    source = tmp_path / "part.STL"
    source.write_bytes(b"solid")
    name = store_file(store, source)
    assert name == hashlib.sha256(b"solid").hexdigest() + ".stl"
    assert not source.exists()
    assert (store / name).read_bytes() == b"solid"
    assert (store / name).stat().st_mode & 0o222 == 0
    assert sha256_of(store / name) + ".stl" == name


def test_the_same_bytes_are_stored_once(tmp_path):
    store = tmp_path / "files"
    store.mkdir()
    for name in ("a.stl", "b.stl"):
        (tmp_path / name).write_bytes(b"solid")
    assert store_file(store, tmp_path / "a.stl") == store_file(store, tmp_path / "b.stl")
    assert len(list(store.iterdir())) == 1
    assert not (tmp_path / "b.stl").exists()


def test_stored_files_are_found_by_the_names_that_they_have_now_beside_a_persons_own(tmp_path):
    store, folder = tmp_path / "files", tmp_path / "jobs" / "1"
    store.mkdir()
    (tmp_path / "a.stl").write_bytes(b"solid")
    name = store_file(store, tmp_path / "a.stl")
    for _ in range(2):
        name_files(folder, store, {"p01.stl": name})
    assert (folder / "p01.stl").read_bytes() == b"solid"
    (folder / "notes.txt").write_text("mine")
    (folder / "mine.stl").symlink_to(tmp_path / "elsewhere.stl")
    name_files(folder, store, {"p01a.stl": name})
    assert {path.name for path in folder.iterdir()} == {"p01a.stl", "notes.txt", "mine.stl"}
