"""Lock files of processes: the kernel releases a lock when its process ends."""

from __future__ import annotations

import fcntl
import os
import select
import signal
import time
from contextlib import suppress
from pathlib import Path

AGENT_LOCK = "lock"  # file in an agent's folder
_LOCK_TRIES, _RETRY_INTERVAL_S = 20, 0.05
_KILL_TIMEOUT_S = 1.0  # wall seconds for a killed process to end
_PID_BYTES = 10


def is_locked(path: Path) -> bool:
    """Return True while a process holds the lock of this file; False if the file does not exist."""
    try:
        with path.open("rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False


def acquire_lock(path: Path) -> int | None:
    """Take the lock until the descriptor is closed; retry, as `is_locked` takes the lock briefly.

    Returns
    -------
    int | None
        The descriptor; None if another process has the lock.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    for _ in range(_LOCK_TRIES):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(_RETRY_INTERVAL_S)
        else:
            break
    else:
        os.close(descriptor)
        return None
    # Erase the previous holder's id, so that `kill_holder` does not kill that process. The file keeps its
    # size, as the disk may be full.
    try:
        os.pwrite(descriptor, b" " * os.fstat(descriptor).st_size, 0)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def write_pid(descriptor: int) -> None:
    """Write the process id into the lock file, for `kill_holder`."""
    os.pwrite(descriptor, b"%-*d" % (_PID_BYTES, os.getpid()), 0)


def find_holder(path: Path) -> int | None:
    """Return the id of the process that holds the lock; None if it is free or has no id."""
    try:
        pid = int(path.read_bytes())
    except (OSError, ValueError):
        return None
    return pid if is_locked(path) else None


def kill_holder(path: Path) -> bool:
    """Kill the process that holds the lock, even a stopped one; return True if the lock is free now."""
    pid = find_holder(path)
    if pid is not None:
        with suppress(OSError):
            process = os.pidfd_open(pid)
            try:
                if is_locked(path):  # if not, the process has ended, and its id may be reused
                    signal.pidfd_send_signal(process, signal.SIGKILL)
                    select.select([process], [], [], _KILL_TIMEOUT_S)
            finally:
                os.close(process)
    return not is_locked(path)
