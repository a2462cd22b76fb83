"""Retention: files that the books name, jobs whose files are deleted, nights until the disk is full. Pure."""

from farm.state.retention.disk_forecast import (
    DiskUse,
    average_day_bytes,
    describe_shortage,
    nights_until_full,
)
from farm.state.retention.file_names import file_names_of_job, list_deletable_files, named_files
from farm.state.retention.selection import (
    MIN_AGE_S,
    KeepRules,
    find_need,
    list_lost_jobs,
    list_prunable_files,
    select_jobs,
)

__all__ = [
    "MIN_AGE_S",
    "DiskUse",
    "KeepRules",
    "average_day_bytes",
    "describe_shortage",
    "file_names_of_job",
    "find_need",
    "list_deletable_files",
    "list_lost_jobs",
    "list_prunable_files",
    "named_files",
    "nights_until_full",
    "select_jobs",
]
