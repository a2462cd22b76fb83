"""Store of files that are named by their SHA-256 and never changed: models, part meshes, G-code."""

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
        The folder, which is created if it is missing.
    store
        The store.
    names
        Names of the stored files, each by the name of its link.
    """
    folder.mkdir(parents=True, exist_ok=True)
    relative = Path(os.path.relpath(store, folder))
    for link in folder.iterdir():
        if link.name in names or (link.is_symlink() and link.readlink().parent == relative):
            link.unlink()
    for name, file_name in names.items():
        (folder / name).symlink_to(relative / file_name)


def remove_broken_links(jobs: Path) -> None:
    """Remove links to missing files from the folders of all jobs."""
    for link in jobs.glob("*/*"):
        if link.is_symlink() and not link.exists():
            link.unlink(missing_ok=True)


def store_file(folder: Path, source: Path) -> str:
    """Move a complete file into the store, named by its hash and suffix; return the new name.

    The bytes are synced to the disk before the file gets its name, so every file in the store is complete.
    A file that is stored again counts as new, so that `delete_files` keeps it until the books refer to it.
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
                    status = entry.stat(follow_symlinks=False)
                    files[entry.name] = StoredFile(status.st_size, status.st_mtime)
    return files


def delete_files(
    folder: Path, names: Iterable[str], now_s: float, min_age_s: float = NEW_FILE_GRACE_S
) -> int:
    """Delete files to which the books do not refer; return the number of freed bytes.

    Recently stored files are kept, because an event that refers to them may still follow.

    Parameters
    ----------
    folder
        The store.
    names
        Names of the files.
    now_s
        Wall time, in seconds since the epoch.
    min_age_s
        Wall seconds for which a file is kept after it was stored.
    """
    freed_bytes = 0
    for name in names:
        with _lock(folder, fcntl.LOCK_EX), suppress(FileNotFoundError):
            status = (folder / name).stat()
            if now_s - status.st_mtime >= min_age_s:
                (folder / name).unlink()
                freed_bytes += status.st_size
    return freed_bytes


@contextmanager
def _lock(folder: Path, operation: int) -> Iterator[None]:
    """Hold a lock on the store's folder: a shared one to store a file, an exclusive one to delete a file."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, operation)
        yield
    finally:
        os.close(descriptor)
