"""Measurement of the state folder: files of jobs, and free space on its disk."""

from __future__ import annotations

import shutil
import time

from farm.paths import StateFolder
from farm.state import Books
from farm.state.retention import (
    DiskUse,
    compute_daily_bytes,
    list_prunable_files,
)
from farm.state.storage import list_files

_DAY_S = 86400.0


def measure_disk(state: StateFolder, books: Books, farm_now_s: float, time_scale: float) -> DiskUse:
    """Measure the files of jobs and the free space; safe to call in a thread.

    Parameters
    ----------
    state
        The state folder, which exists.
    books
        The farm's state, which determines the files that a prune may delete.
    farm_now_s
        Time on the farm's clock, in seconds since the epoch.
    time_scale
        Seconds of the farm's clock per wall second.

    Raises
    ------
    OSError
        If the folder cannot be read.
    """
    files, wall_s = list_files(state.files), time.time()
    prunable = list_prunable_files(books, files, farm_now_s)
    ages_and_sizes = (
        ((wall_s - file.stored_s) * time_scale / _DAY_S, file.size_bytes) for file in files.values()
    )
    return DiskUse(
        free_bytes=shutil.disk_usage(state.root).free,
        stored_bytes=sum(file.size_bytes for file in files.values()),
        prunable_bytes=sum(files[name].size_bytes for name in prunable),
        daily_bytes=compute_daily_bytes(ages_and_sizes),
    )
