"""Retention of files: the files to which the books refer, the jobs to prune, the space on the disk. Pure."""

from farm.state.retention.disk_forecast import (
    DiskUse,
    compute_daily_bytes,
    describe_shortage,
    estimate_nights_until_full,
)
from farm.state.retention.file_names import list_deletable_files, list_job_file_names, list_referenced_files
from farm.state.retention.selection import (
    MIN_AGE_S,
    RetentionRules,
    find_keep_reason,
    list_jobs_pruned_since_backup,
    list_prunable_files,
    select_jobs,
)

__all__ = [
    "MIN_AGE_S",
    "DiskUse",
    "RetentionRules",
    "compute_daily_bytes",
    "describe_shortage",
    "estimate_nights_until_full",
    "find_keep_reason",
    "list_deletable_files",
    "list_job_file_names",
    "list_jobs_pruned_since_backup",
    "list_prunable_files",
    "list_referenced_files",
    "select_jobs",
]
