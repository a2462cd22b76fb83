"""Memory that a process may use."""

from __future__ import annotations

import os
import resource


def machine_bytes() -> int:
    """Return the memory of this computer."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def process_bytes() -> int:
    """Return the memory that this process may use: its limit (a worker has one), or the computer's."""
    soft, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return machine_bytes() if soft == resource.RLIM_INFINITY else min(soft, machine_bytes())
