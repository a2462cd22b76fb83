"""Cache of files by their hash."""

import hashlib
import os

import pytest

from farm.compute.cluster.file_cache import FileCache


def compute_file_name(content):
    return hashlib.sha256(content).hexdigest()


def test_file_with_another_hash_is_not_kept(tmp_path):
    cache = FileCache(tmp_path / "files")
    with pytest.raises(ValueError, match="damaged in transit"):
        cache.store(compute_file_name(b"right"), b"wrong")
    assert list((tmp_path / "files").iterdir()) == []
    assert cache.list_missing_files([compute_file_name(b"right"), compute_file_name(b"right")]) == (
        compute_file_name(b"right"),
    )


def test_least_recently_used_files_are_deleted_first_and_files_in_use_are_kept(tmp_path):
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / ".half").touch()
    cache = FileCache(tmp_path / "files", max_bytes=10)
    old_file, used_file, new_file = (content * 5 for content in (b"a", b"b", b"c"))
    for modified_s, content in enumerate((used_file, old_file, new_file)):
        cache.store(compute_file_name(content), content)
        os.utime(cache.make_path(compute_file_name(content)), (modified_s, modified_s))
    with cache.keep_files([compute_file_name(used_file)]), cache.keep_files([compute_file_name(new_file)]):
        pass
    assert {path.read_bytes() for path in (tmp_path / "files").iterdir()} == {used_file, new_file}


def test_cache_that_is_too_small_keeps_the_files_of_a_running_task(tmp_path):
    cache = FileCache(tmp_path / "files", max_bytes=1)
    content = b"a" * 100
    with cache.keep_files([compute_file_name(content)]):
        cache.store(compute_file_name(content), content)
        with cache.keep_files([]):
            pass
        assert cache.list_missing_files([compute_file_name(content)]) == ()
    assert cache.list_missing_files([compute_file_name(content)]) == (compute_file_name(content),)
