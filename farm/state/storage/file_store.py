"""Files named by their SHA-256, never changed: models, part meshes, G-code."""

from __future__ import annotations

import fcntl
import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

NEW_FILE_GRACE_S = 3600.0
"""Wall seconds for which a new file is kept even if the books do not refer to it."""


def compute_sha256(path: Path) -> str:
    """Compute the SHA-256 of a file's bytes, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def link_files(folder: Path, store: Path, names: Mapping[str, str]) -> None:
    """Create links in a folder to files in the store, and remove its other links to the store.

    Parameters
    ----------
    folder
        The folder, which is created.
    store
        The store.
    names
        Names of the stored files, by the names of their links.
    """
    folder.mkdir(parents=True, exist_ok=True)
    relative = Path(os.path.relpath(store, folder))
    for link in folder.iterdir():
        if link.name in names or (link.is_symlink() and link.readlink().parent == relative):
            link.unlink()
    for name, file_name in names.items():
        (folder / name).symlink_to(relative / file_name)


def remove_broken_links(jobs: Path) -> None:
    """Remove the links in the folders of all jobs to files that no longer exist."""
    for link in jobs.glob("*/*"):
        if link.is_symlink() and not link.exists():
            link.unlink(missing_ok=True)


def store_file(folder: Path, source: Path) -> str:
    """Move a finished file into the store, under its hash and suffix; return its new name.

    The bytes are synced to the disk before the new name exists, so every file with such a name is complete.
    A file that is stored again counts as new: `delete_files` does not delete it before the books refer to it.
    """
    name = compute_sha256(source) + source.suffix.lower()
    target = folder / name
    with _lock(folder, fcntl.LOCK_SH):
        if target.exists():
            os.utime(target)
            source.unlink()
            return name
    with source.open("rb") as file:
        os.fsync(file.fileno())
    source.chmod(0o444)
    os.utime(source)
    with _lock(folder, fcntl.LOCK_SH):
        source.replace(target)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    return name


@dataclass(frozen=True, slots=True)
class StoredFile:
    """Size of a file, and the wall time (s) at which it was last stored."""

    size_bytes: int
    stored_s: float


def list_files(folder: Path) -> dict[str, StoredFile]:
    """List the files of the store by name."""
    files = {}
    with os.scandir(folder) as entries:
        for entry in entries:
            if not entry.name.startswith(".") and entry.is_file(follow_symlinks=False):
                with suppress(FileNotFoundError):
                    facts = entry.stat(follow_symlinks=False)
                    files[entry.name] = StoredFile(facts.st_size, facts.st_mtime)
    return files


def delete_files(
    folder: Path, names: Iterable[str], now_s: float, min_age_s: float = NEW_FILE_GRACE_S
) -> int:
    """Delete files to which the books do not refer; return the number of freed bytes.

    Recently stored files stay, because the event that refers to them may follow.

    Parameters
    ----------
    folder
        The store.
    names
        The files.
    now_s
        Wall time, in seconds since the epoch.
    min_age_s
        Minimum age of deleted files, in wall seconds since they were stored.
    """
    freed_bytes = 0
    for name in names:
        with _lock(folder, fcntl.LOCK_EX), suppress(FileNotFoundError):
            facts = (folder / name).stat()
            if now_s - facts.st_mtime >= min_age_s:
                (folder / name).unlink()
                freed_bytes += facts.st_size
    return freed_bytes


@contextmanager
def _lock(folder: Path, operation: int) -> Iterator[None]:
    """Hold the lock of the store's folder: shared for storing a file, exclusive for deleting one."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, operation)
        yield
    finally:
        os.close(descriptor)
