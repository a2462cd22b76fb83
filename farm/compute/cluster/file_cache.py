"""Cache of files by their SHA-256 in a folder of limited size, which keeps the most recently used files."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

MAX_CACHE_BYTES = 8 * 2**30


class FileCache:
    """Cache of files. Only one process may use a folder.

    Parameters
    ----------
    folder
        Folder of the cache, which is created.
    max_bytes
        Limit on the total size; files that tasks use are kept even above it.
    """

    def __init__(self, folder: Path, max_bytes: int = MAX_CACHE_BYTES) -> None:
        self._folder, self._max_bytes = folder, max_bytes
        self._use_counts: Counter[str] = Counter()  # number of tasks that use each file
        folder.mkdir(parents=True, exist_ok=True)
        for partial in folder.glob(".*"):  # files of a process that was killed while it wrote them
            partial.unlink()

    def make_path(self, sha256: str) -> Path:
        """Return the path at which a file is or would be stored."""
        return self._folder / sha256

    def store(self, sha256: str, content: bytes) -> None:
        """Store a file.

        Raises
        ------
        ValueError
            If the content has a different hash.
        OSError
            If it cannot be written.
        """
        if hashlib.sha256(content).hexdigest() != sha256:
            raise ValueError(f"the file {sha256[:12]} was damaged in transit")
        path = self.make_path(sha256)
        if path.exists():
            return
        handle, name = tempfile.mkstemp(dir=self._folder, prefix=".")
        try:
            with os.fdopen(handle, "wb") as sink:
                sink.write(content)
            Path(name).chmod(0o444)
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise

    def list_missing_files(self, hashes: Iterable[str]) -> tuple[str, ...]:
        """Return the hashes of the files that are not in the cache, without duplicates."""
        return tuple(dict.fromkeys(sha256 for sha256 in hashes if not self.make_path(sha256).exists()))

    @contextmanager
    def keep_files(self, hashes: Iterable[str]) -> Iterator[None]:
        """Keep a task's files during the `with` block, even those stored within it; then trim the cache."""
        used_hashes = set(hashes)
        self._use_counts.update(used_hashes)
        try:
            yield
        finally:
            for sha256 in used_hashes:
                with suppress(OSError):
                    os.utime(self.make_path(sha256))
            self._use_counts -= Counter(used_hashes)
            self._trim_cache()

    def _trim_cache(self) -> None:
        """Remove the least recently used files until the others fit into the limit; files in use stay."""
        files = []
        with os.scandir(self._folder) as entries:
            for entry in entries:
                if not entry.name.startswith("."):
                    with suppress(FileNotFoundError):
                        status = entry.stat()
                        files.append((status.st_mtime_ns, entry.name, status.st_size))
        excess_bytes = sum(size_bytes for _, _, size_bytes in files) - self._max_bytes
        for _, name, size_bytes in sorted(files):
            if excess_bytes <= 0:
                return
            if name not in self._use_counts:
                self.make_path(name).unlink(missing_ok=True)
                excess_bytes -= size_bytes
