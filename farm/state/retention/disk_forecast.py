"""Forecast of the nights until the disk is full, from the bytes stored in the last days. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

WARNING_NIGHTS = 2.0
"""A warning is given if the disk will be full within this number of nights."""
_WINDOWS_DAYS = (7.0, 2.0)
_GB = 1e9


@dataclass(frozen=True, slots=True)
class DiskUse:
    """Space on the disk of the state folder.

    Attributes
    ----------
    free_bytes
        Free space.
    stored_bytes
        Size of all files of jobs.
    prunable_bytes
        Size of the files that pruning may delete.
    daily_bytes
        Bytes stored per day: the average of `compute_daily_bytes`.
    """

    free_bytes: float
    stored_bytes: float
    prunable_bytes: float
    daily_bytes: float


def compute_daily_bytes(files: Iterable[tuple[float, int]]) -> float:
    """Compute the bytes stored per day: the average of the last week, or of the last two days if larger.

    Parameters
    ----------
    files
        Age in days and size in bytes of each file.
    """
    ages_and_sizes = [(max(0.0, age_days), size_bytes) for age_days, size_bytes in files]
    oldest_days = max((age_days for age_days, _ in ages_and_sizes), default=0.0)
    averages = []
    for window_days in _WINDOWS_DAYS:
        stored_bytes = sum(size_bytes for age_days, size_bytes in ages_and_sizes if age_days <= window_days)
        averages.append(stored_bytes / max(1.0, min(window_days, oldest_days)))
    return max(averages)


def estimate_nights_until_full(use: DiskUse, max_bytes: float, reserve_bytes: float) -> float:
    """Estimate the number of nights until the disk is full.

    Parameters
    ----------
    use
        Space on the disk.
    max_bytes
        Maximum size of the files of jobs; every night, prunable files are deleted until the limit is met.
    reserve_bytes
        Bytes that must stay free.

    Returns
    -------
    float
        Nights; infinite if nothing is stored.
    """
    available_bytes = use.free_bytes - reserve_bytes
    if available_bytes <= 0.0:
        return 0.0
    if use.daily_bytes <= 0.0:
        return math.inf
    nights_until_pruning = max(0.0, (max_bytes - use.stored_bytes) / use.daily_bytes)
    nights = available_bytes / use.daily_bytes
    return nights if nights <= nights_until_pruning else nights + use.prunable_bytes / use.daily_bytes


def describe_shortage(folder: str, use: DiskUse, max_gb: float, reserve_gb: float) -> str | None:
    """Describe a disk that will be full within two nights, with the remedy; None if there is enough space.

    Parameters
    ----------
    folder
        The state folder, which is on this disk.
    use
        Space on the disk.
    max_gb, reserve_gb
        GB that the files of jobs may use, and GB that must stay free.
    """
    nights = estimate_nights_until_full(use, max_gb * _GB, reserve_gb * _GB)
    if nights > WARNING_NIGHTS:
        return None
    count = "one night" if nights < 1.5 else "two nights"
    state = "is full now" if nights < 0.5 else f"will be full in about {count}"
    return (
        f"the disk of {folder} {state} ({use.free_bytes / _GB:.1f} GB free, "
        f"{use.daily_bytes / _GB:.1f} GB stored per day): free some space, or lower `fleet.keep` in "
        "fleet.yaml, start the daemon again and run `farm prune`"
    )
