"""Lock files that say whether a process lives: the kernel gives the lock up with the process."""

from __future__ import annotations

import fcntl
from pathlib import Path


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
