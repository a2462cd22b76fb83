"""Eviction from a full cache of slices."""

import os

from hypothesis import given
from hypothesis import strategies as st

from slicing.cache_limit import CacheEntry, find_least_recently_used_entries, trim_cache

ENTRIES = st.lists(
    st.builds(CacheEntry, st.text(min_size=1), st.integers(0, 1000), st.floats(0, 1e9)),
    unique_by=lambda e: e.name,
)


@given(ENTRIES, st.integers(0, 5000))
def test_kept_entries_fit_and_are_the_most_recently_used(entries, max_bytes):
    removed_names = set(find_least_recently_used_entries(entries, max_bytes))
    kept_entries = [entry for entry in entries if entry.name not in removed_names]
    removed_entries = [entry for entry in entries if entry.name in removed_names]
    assert sum(entry.size_bytes for entry in kept_entries) <= max_bytes
    assert max((e.last_used_s for e in removed_entries), default=0.0) <= min(
        (e.last_used_s for e in kept_entries), default=1e9
    )
    # No entry is removed without need, because the last removed one would not fit.
    if removed_entries:
        last_removed_entry = max(removed_entries, key=lambda entry: (entry.last_used_s, entry.name))
        assert sum(entry.size_bytes for entry in (*kept_entries, last_removed_entry)) > max_bytes


def write_entry(folder, letter, last_used_s, suffixes=("json", "gcode")):
    for suffix in suffixes:
        path = folder / f"{letter * 64}.{suffix}"
        path.write_bytes(b"x" * 50)
        os.utime(path, (last_used_s, last_used_s))


def test_least_recently_used_entries_are_deleted_completely(tmp_path):
    write_entry(tmp_path, "a", 1000)
    write_entry(tmp_path, "b", 2000)
    write_entry(tmp_path, "c", 3000)
    partial_file = tmp_path / f".{'d' * 64}.gcode.k3j_x"
    partial_file.write_bytes(b"x" * 50)
    os.utime(partial_file, (500, 500))
    os.utime(tmp_path / f"{'a' * 64}.json", (2500, 2500))  # the entry was read again
    other_file = tmp_path / "thesis.gcode"
    other_file.write_bytes(b"x" * 1000)
    os.utime(other_file, (1, 1))
    trim_cache(tmp_path, 200)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        other_file.name,
        *(f"{letter * 64}.{suffix}" for letter in "ac" for suffix in ("json", "gcode")),
    }


def test_missing_folder_is_ignored(tmp_path):
    trim_cache(tmp_path / "nowhere", 0)
