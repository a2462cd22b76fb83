"""Memory available to a process."""

from __future__ import annotations

import os
import resource


def read_machine_memory_bytes() -> int:
    """Return the physical memory of this computer in bytes."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def read_process_memory_bytes() -> int:
    """Return the memory in bytes that this process may use: the machine's, or less if it has a limit."""
    soft, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return (
        read_machine_memory_bytes()
        if soft == resource.RLIM_INFINITY
        else min(soft, read_machine_memory_bytes())
    )
