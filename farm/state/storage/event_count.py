"""Number of events that were ever committed, in a file beside the database."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

_SUFFIX = "-count"  # appended to the name of the database file


class EventCount:
    """File with the number of events that were ever committed to a database.

    The number reveals lost commits: if a checksum in the write-ahead log is wrong, SQLite drops the rest of
    the log without an error. The file is not synced to the disk, so its number may be too small after a power
    cut, but never too large. Disk errors are ignored, because the file serves only to detect lost commits.
    """

    def __init__(self, database: Path) -> None:
        self._path = database.with_name(database.name + _SUFFIX)
        self._descriptor: int | None = None

    def read(self) -> int:
        """Return the number of committed events; 0 if unknown."""
        with suppress(OSError, ValueError):
            return int(self._path.read_bytes())
        return 0

    def write(self, count: int) -> None:
        """Write the number of committed events."""
        with suppress(OSError):
            if self._descriptor is None:
                flags = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC
                self._descriptor = os.open(self._path, flags, 0o600)
            os.pwrite(self._descriptor, b"%020d" % count, 0)

    def remove(self) -> None:
        """Delete the file, because the database whose events it counts was moved away. Raises OSError."""
        self._path.unlink(missing_ok=True)

    def close(self) -> None:
        """Close the file."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
