"""Bounded log files of processes that log to stdout and stderr; a rotation loses no line."""

from __future__ import annotations

import os
from pathlib import Path

MAX_BYTES = 2 * 2**20
"""Size at which a log is renamed; an agent writes about 1 KB per print."""
LOG_COUNT = 3
"""Number of renamed logs that are kept."""


def rotate_log(path: Path, max_bytes: int = MAX_BYTES, file_count: int = LOG_COUNT) -> bool:
    """Rename a log that is full, and let stdout and stderr of this process continue in a new one.

    Files are renamed, not copied, and descriptors are replaced in one step, so every line is in the old
    file or in the new one. Another process that has the old file open continues to write there. If the disk
    is full, nothing changes.

    Parameters
    ----------
    path
        The log. Renamed logs are `path.1`, the newest, to `path.N` with N = `file_count`.
    max_bytes
        Size at which the log is renamed.
    file_count
        Number of renamed logs that are kept; at least 1.

    Returns
    -------
    bool
        True if the log was renamed.
    """
    try:
        status = path.stat()
        if status.st_size < max_bytes:
            return False
        new_file = path.with_name(f".{path.name}.new")
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND | os.O_CLOEXEC
        descriptor = os.open(new_file, flags, status.st_mode & 0o777)
    except OSError:
        return False
    try:
        for number in range(file_count, 0, -1):
            source_path = _number_path(path, number - 1)
            if source_path.exists():
                source_path.replace(_number_path(path, number))
        new_file.replace(path)
        for stream in (1, 2):
            if _is_open_as(stream, status):
                os.dup2(descriptor, stream)
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return True


def _number_path(path: Path, number: int) -> Path:
    """Return the path of a renamed log; the log itself for 0."""
    return path.with_name(f"{path.name}.{number}") if number else path


def _is_open_as(descriptor: int, status: os.stat_result) -> bool:
    """Return True if the descriptor refers to the file with this status."""
    try:
        return os.path.samestat(os.fstat(descriptor), status)
    except OSError:  # closed
        return False
