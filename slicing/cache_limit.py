"""Size limit of the slice cache (`slicing.slice_store`): the entries used most recently are kept."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

CACHE_BYTES = 4 * 2**30
"""Maximum size of a cache; a part that fills a bed has 0.07 GB of G-code."""
# KEY.json and KEY.gcode, and .KEY.gcode.xyz if a program was killed while it wrote that file.
_ENTRY_FILE = re.compile(r"\.?([0-9a-f]{64})\.(?:json|gcode)(?:\.\w+)?")


@dataclass(frozen=True, slots=True)
class CacheEntry:
    """Stored slice: its name, its size, and the time of its last use in s, on one clock for all entries."""

    name: str
    size_bytes: int
    last_used_s: float


def find_least_recently_used_entries(entries: Iterable[CacheEntry], max_bytes: int) -> list[str]:
    """Choose the entries to remove, the least recently used first.

    Parameters
    ----------
    entries
        All entries of a cache.
    max_bytes
        Maximum total size of the entries that are kept.

    Returns
    -------
    list of str
        Names of the entries to remove.
    """
    sorted_entries = sorted(entries, key=lambda entry: (entry.last_used_s, entry.name))
    excess_bytes = sum(entry.size_bytes for entry in sorted_entries) - max_bytes
    names = []
    for entry in sorted_entries:
        if excess_bytes <= 0:
            break
        names.append(entry.name)
        excess_bytes -= entry.size_bytes
    return names


def trim_cache(folder: Path, max_bytes: int = CACHE_BYTES) -> None:
    """Remove the least recently used slices until the others fit; files that cannot be removed are kept.

    A process that is about to read a removed entry slices the part again.

    Parameters
    ----------
    folder
        Folder of the cache; other files in it are not touched.
    max_bytes
        Maximum total size of its entries.
    """
    files: dict[str, list[Path]] = {}
    entries: dict[str, CacheEntry] = {}
    for path in _list_files(folder):
        match = _ENTRY_FILE.fullmatch(path.name)
        if match is None:
            continue
        with contextlib.suppress(OSError):
            status = path.stat()
            name = match[1]
            files.setdefault(name, []).append(path)
            entry = entries.get(name, CacheEntry(name, 0, 0.0))
            last_used_s = max(entry.last_used_s, status.st_mtime)
            entries[name] = CacheEntry(name, entry.size_bytes + status.st_size, last_used_s)
    for name in find_least_recently_used_entries(entries.values(), max_bytes):
        for path in files[name]:
            with contextlib.suppress(OSError):
                path.unlink()


def _list_files(folder: Path) -> list[Path]:
    """List the files of a folder, those that make an entry valid (.json) first; none if it cannot be read."""
    try:
        return sorted(folder.iterdir(), key=lambda path: path.suffix != ".json")
    except OSError:
        return []
