"""Lock files that say whether a process lives, and which: the kernel gives the lock up with the process."""

from __future__ import annotations

import fcntl
import os
import select
import signal
import time
from contextlib import suppress
from pathlib import Path

AGENT_LOCK = "lock"  # in an agent's folder
_TRIES, _WAIT_S = 20, 0.05
_DEATH_S = 1.0
_PID_BYTES = 10


def held(path: Path) -> bool:
    """Whether somebody holds the lock of this file; False where there is no such file."""
    try:
        with path.open("rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False


def hold(path: Path) -> int | None:
    """Take the lock, for as long as the descriptor lives; whoever only looks (`held`) lets go at once.

    Returns
    -------
    int | None
        The descriptor; None where somebody else has it.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    for _ in range(_TRIES):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(_WAIT_S)
        else:
            break
    else:
        os.close(descriptor)
        return None
    try:  # who held it before is no process to kill; in place, as a full disk has no room for more
        os.pwrite(descriptor, b" " * os.fstat(descriptor).st_size, 0)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def sign(descriptor: int) -> None:
    """Write down which process holds the lock, and may be killed for it."""
    os.pwrite(descriptor, b"%-*d" % (_PID_BYTES, os.getpid()), 0)


def holder(path: Path) -> int | None:
    """The process that holds the lock; None where nobody does, or nobody knows who."""
    try:
        pid = int(path.read_bytes())
    except (OSError, ValueError):
        return None
    return pid if held(path) else None


def kill_holder(path: Path) -> bool:
    """Kill the process that holds the lock, even a stopped one; True where nobody holds it any more."""
    pid = holder(path)
    if pid is not None:
        with suppress(OSError):
            process = os.pidfd_open(pid)
            try:
                if held(path):  # else it ended meanwhile, and the number may be another's
                    signal.pidfd_send_signal(process, signal.SIGKILL)
                    select.select([process], [], [], _DEATH_S)
            finally:
                os.close(process)
    return not held(path)
