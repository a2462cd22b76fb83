"""Journal of an agent: one JSON object per line, on disk before the agent acts on it."""

from __future__ import annotations

import errno
import json
import logging
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from drivers.errors import JournalError
from drivers.records.journal_state import JournalState

log = logging.getLogger(__name__)

JOURNAL = "journal.jsonl"  # file in an agent's folder
MAX_BYTES = 2 * 2**20
"""Size above which a journal is shortened; its recent prints need up to 0.8 MB."""
ESTOP_REASON = "stopped by `farm estop`"  # reason for attention after an emergency stop


def read_journal(path: Path) -> tuple[JournalState, int]:
    """Read a journal.

    An unreadable record may have started a print: unless a later record ends that print, the printer may be
    hot. In any case a person has to check the printer.

    Returns
    -------
    (JournalState, int)
        The state, and the length of the complete records in bytes.
    """
    state, length_bytes, may_be_hot = JournalState(), 0, False
    if path.exists():
        for number, line in enumerate(path.read_bytes().split(b"\n")[:-1], 1):  # the last one is incomplete
            length_bytes += len(line) + 1
            try:
                record = json.loads(line)
                state.apply(record)
                may_be_hot = may_be_hot and not {"print", "hot"} & record.keys()
            except (ValueError, TypeError, AttributeError):
                log.warning("%s:%d: cannot be read: %.80r", path, number, line)
                state.board.attention_reason = f"its journal is damaged: see line {number} of {path}"
                may_be_hot = True
    state.board.hot = state.board.hot or may_be_hot
    return state, length_bytes


class Journal:
    """Append-only file. `write` returns once the record is on the disk.

    Attributes
    ----------
    state
        The state after all records.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.state, self._length_bytes = read_journal(path)
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
        os.ftruncate(self._fd, self._length_bytes)
        _sync_folder(path)  # else a power cut may lose a new file with all its records

    def write(self, at_s: float, **record: Any) -> None:
        """Write one record to the disk, and apply it to `state`.

        Raises
        ------
        JournalError
            The write failed: neither the file nor `state` has changed.
        """
        line = (json.dumps({"at_s": round(at_s, 3), **record}) + "\n").encode()
        try:
            os.lseek(self._fd, self._length_bytes, os.SEEK_SET)
            if os.write(self._fd, line) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(self._fd)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._fd, self._length_bytes)
            raise JournalError(
                f"{self._path}: cannot be written ({error.strerror}); check its disk"
            ) from error
        self._length_bytes += len(line)
        self.state.apply(record)

    def shorten(self, max_bytes: int = MAX_BYTES) -> bool:
        """Replace a long journal by the fewest records that restore its state; keep the long one as a copy.

        Call it while nothing prints. After an error the old journal remains in use.

        Returns
        -------
        bool
            True if it was replaced.
        """
        if self._length_bytes <= max_bytes:
            return False
        new_path, old_path = (self._path.with_name(self._path.name + suffix) for suffix in (".new", ".1"))
        data = b"".join(json.dumps(record).encode() + b"\n" for record in self.state.list_records())
        try:
            new_path.unlink(missing_ok=True)
            descriptor = os.open(new_path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            log.warning("%s: is not shortened: %s", self._path, error)
            return False
        try:
            if os.write(descriptor, data) < len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(descriptor)
            old_path.unlink(missing_ok=True)
            os.link(self._path, old_path)
            new_path.replace(self._path)
        except OSError as error:
            log.warning("%s: is not shortened: %s", self._path, error)
            os.close(descriptor)
            return False
        os.close(self._fd)
        self._fd, self._length_bytes = descriptor, len(data)
        with suppress(OSError):
            _sync_folder(self._path)
        return True


def _sync_folder(path: Path) -> None:
    """Write a file's entry in its folder to the disk."""
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
